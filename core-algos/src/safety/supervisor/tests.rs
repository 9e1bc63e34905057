use super::*;
use proptest::prelude::{any, prop, prop_assert, prop_assert_eq};

const TICK: Micros = 1_000;

struct Bench {
    supervisor: Supervisor,
    state: State,
    now: Micros,
}

impl Bench {
    fn new() -> Self {
        Self {
            supervisor: Config::default().build().unwrap(),
            state: State::default(),
            now: 0,
        }
    }

    fn driving() -> Self {
        let mut bench = Self::new();
        for request in [StateRequest::Ready, StateRequest::Arm, StateRequest::Start] {
            bench.ask(request);
        }
        assert_eq!(bench.state.operating(), OperatingState::Active);
        bench
    }

    fn step(&mut self, input: Input) -> Output {
        self.now += TICK;
        self.supervisor.step(&mut self.state, self.now, &input)
    }

    fn ask(&mut self, request: StateRequest) -> Output {
        self.step(Input {
            request: Some(request),
            ..Input::default()
        })
    }

    fn with(&mut self, condition: Condition) -> Output {
        self.ask_with(condition, None)
    }

    fn ask_with(&mut self, condition: Condition, request: Option<StateRequest>) -> Output {
        self.step(Input {
            request,
            ..present(condition)
        })
    }

    /// Drives on without the beam.
    fn degraded(&mut self, moved_m: f32) -> OperatingState {
        let input = Input {
            moved_m,
            ..present(Condition::BeamLost)
        };
        self.step(input).state
    }
}

fn present(condition: Condition) -> Input {
    Input {
        conditions: Conditions::only(condition),
        ..Input::default()
    }
}

/// A condition counts after its time, not before, and starts anew after a break.
#[test]
fn a_condition_counts_after_its_time() {
    for condition in Condition::ALL.into_iter().filter(|c| c.class().is_hard()) {
        let ticks = condition.entry().hold / TICK;
        let mut bench = Bench::driving();
        for _ in 0..ticks {
            let state = bench.with(condition).state;
            assert_eq!(state, OperatingState::Active, "{condition:?}");
        }
        if ticks > 0 {
            bench.step(Input::default());
            for _ in 0..ticks {
                assert_eq!(bench.with(condition).state, OperatingState::Active);
            }
        }
        let output = bench.with(condition);
        let expected = match condition.class() {
            Class::Stop => OperatingState::SafeStop,
            _ => OperatingState::Fault,
        };
        assert_eq!(output.reason, Some(condition));
        assert!(output.state == expected && output.changed, "{output:?}");
    }
}

#[test]
fn a_stop_ends_in_a_latched_fault_that_clears_when_its_cause_is_gone() {
    let mut bench = Bench::driving();
    while bench.with(Condition::SupplyLow).state == OperatingState::Active {}
    let halted = Input {
        halted: true,
        ..Input::default()
    };
    assert_eq!(bench.step(halted).state, OperatingState::Fault);
    for _ in 0..100 {
        assert_eq!(bench.step(Input::default()).state, OperatingState::Fault);
    }
    for request in [
        StateRequest::Ready,
        StateRequest::Arm,
        StateRequest::Start,
        StateRequest::Disarm,
    ] {
        assert_eq!(bench.ask(request).state, OperatingState::Fault);
    }
    // Not while it still holds.
    for _ in 0..50 {
        bench.with(Condition::SupplyLow);
    }
    let output = bench.ask_with(Condition::SupplyLow, Some(StateRequest::Clear));
    assert_eq!(output.state, OperatingState::Fault);
    bench.step(Input::default());
    let output = bench.ask(StateRequest::Clear);
    assert_eq!((output.state, output.reason), (OperatingState::Idle, None));
}

#[test]
fn what_was_present_for_a_tick_is_told_once() {
    let mut bench = Bench::new();
    bench.with(Condition::ClockStepped);
    bench.with(Condition::MessageLost);
    let lost = Conditions::only(Condition::MessageLost);
    let seen = bench.state.take_seen();
    assert_eq!(seen, lost.with(Condition::ClockStepped, true));
    assert_eq!(bench.state.take_seen(), lost, "still present");
    bench.step(Input::default());
    bench.state.take_seen();
    assert_eq!(bench.state.take_seen(), Conditions::NONE);
}

#[test]
fn a_stop_that_never_comes_to_rest_is_cut() {
    let mut bench = Bench::driving();
    bench.ask(StateRequest::Disarm);
    let ticks = (1..)
        .find(|_| bench.step(Input::default()).permit == Permit::Off)
        .unwrap();
    assert_eq!(ticks, 2001, "the first tick beyond 2 s");
    // Asked for, so no fault.
    assert_eq!(bench.state.operating(), OperatingState::Idle);
}

#[test]
fn degraded_driving_ends_by_time_or_by_way() {
    for (moved_m, least, most) in [(0.0, 20.0, 20.2), (0.25e-3, 8.0, 8.2), (f32::NAN, 0.0, 0.1)] {
        let mut bench = Bench::driving();
        let ticks = (1..40_000)
            .find(|_| bench.degraded(moved_m) != OperatingState::Active)
            .unwrap();
        let seconds = f64::from(ticks) * 1e-3;
        assert!((least..=most).contains(&seconds), "{moved_m}: {seconds}");
        assert_eq!(bench.state.first(), Some(Condition::DegradedTooLong));
        // At rest a degradation that lasts is no reason to refuse clearing.
        let mut rest = |request| {
            bench.step(Input {
                request,
                halted: true,
                ..present(Condition::BeamLost)
            })
        };
        assert_eq!(rest(None).state, OperatingState::Fault);
        assert_eq!(rest(Some(StateRequest::Clear)).state, OperatingState::Idle);
    }
}

#[test]
fn a_degradation_that_ends_gives_its_allowance_back() {
    let mut bench = Bench::driving();
    for round in 0..10 {
        for _ in 0..7_000 {
            assert_eq!(bench.degraded(0.25e-3), OperatingState::Active, "{round}");
        }
        bench.step(Input::default());
    }
}

#[test]
fn arming_is_refused_while_a_stop_condition_holds() {
    let mut bench = Bench::new();
    bench.ask(StateRequest::Ready);
    for _ in 0..50 {
        bench.with(Condition::NeighbourLost);
    }
    let output = bench.ask_with(Condition::NeighbourLost, Some(StateRequest::Arm));
    assert_eq!(output.state, OperatingState::Idle);
    bench.step(Input::default());
    assert_eq!(bench.ask(StateRequest::Arm).state, OperatingState::Armed);
}

properties! {
    /// Whatever comes, in whatever order, at whatever times: motors never drive while a hard
    /// condition is latched, and a cut switches them off within the same tick.
    #[test]
    fn nothing_drives_over_a_fault(
        steps in prop::collection::vec(
            (any::<u64>(), 0u8..8, any::<bool>(), prop::num::f32::ANY, 0u64..5_000), 1..300,
        ),
    ) {
        let supervisor = Config::default().build().unwrap();
        let mut state = State::default();
        let mut now: Micros = 10_000;
        for (bits, request, halted, moved_m, later) in steps {
            // Now and then the clock stands still or runs back.
            now = if later < 300 { now.saturating_sub(later) } else { now + later };
            let mut conditions = Conditions::NONE;
            for (k, condition) in Condition::ALL.into_iter().enumerate() {
                // Rare enough that the robot drives at times.
                conditions.set(condition, bits.rotate_left(3 * k as u32) & 0x3f == 0x2a);
            }
            let request = StateRequest::ALL.get(usize::from(request)).copied();
            let output = supervisor.step(&mut state, now, &Input { conditions, request, moved_m, halted });
            let hard = state.latched.iter().any(|c| c.class().is_hard());
            prop_assert!(!(hard && matches!(output.permit, Permit::Drive | Permit::Hold)));
            let cut = conditions.iter().any(|c| c.class() == Class::Cut && c.entry().hold == 0);
            prop_assert!(!cut || output.permit == Permit::Off);
            prop_assert_eq!(hard, output.reason.is_some());
        }
    }
}
