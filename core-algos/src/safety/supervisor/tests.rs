use super::super::state::tests::demanded;
use super::*;
use proptest::prelude::{any, prop, prop_assert, prop_assert_eq};

const TICK: Micros = 1_000;

struct SupervisorBench {
    supervisor: Supervisor,
    state: State,
    now: Micros,
}

impl SupervisorBench {
    fn new() -> Self {
        Self {
            supervisor: Config::default().build().unwrap(),
            state: State::default(),
            now: 0,
        }
    }

    /// Supervisor in this state. In *fault* the latched cause is over; in the other states nothing is latched.
    fn in_state(state: OperatingState) -> Self {
        use StateRequest::{Arm, Disarm, Ready, Start};
        let mut bench = Self::new();
        let requests: &[StateRequest] = match state {
            OperatingState::Boot => &[],
            OperatingState::Idle => &[Ready],
            OperatingState::Armed => &[Ready, Arm],
            OperatingState::Active => &[Ready, Arm, Start],
            OperatingState::SafeStop => &[Ready, Arm, Start, Disarm],
            OperatingState::Fault => {
                bench.with(CUT);
                &[]
            }
        };
        bench.tick(NOTHING);
        for request in requests {
            bench.request(*request);
        }
        assert_eq!(bench.state.operating(), state);
        bench
    }

    fn driving() -> Self {
        Self::in_state(OperatingState::Active)
    }

    fn step(&mut self, input: Input) -> Output {
        self.supervisor.step(&mut self.state, self.now, &input)
    }

    /// Steps one tick later.
    fn tick(&mut self, input: Input) -> Output {
        self.now += TICK;
        self.step(input)
    }

    fn request(&mut self, request: StateRequest) -> Output {
        self.tick(with_request(NOTHING, request))
    }

    fn with(&mut self, condition: Condition) -> Output {
        self.tick(present(condition))
    }

    /// Steps until the state changes; returns the number of steps.
    fn ticks_until_change(&mut self, input: Input) -> usize {
        (1..60_000)
            .find(|_| self.tick(input).changed)
            .expect("a change")
    }
}

/// Condition of class cut without a hold time.
const CUT: Condition = Condition::DriverFault;

const NOTHING: Input = Input {
    conditions: Conditions::NONE,
    request: None,
    moved_m: 0.0,
    halted: false,
};

const HALTED: Input = Input {
    halted: true,
    ..NOTHING
};

fn present(condition: Condition) -> Input {
    Input {
        conditions: Conditions::only(condition),
        ..NOTHING
    }
}

fn with_request(input: Input, request: StateRequest) -> Input {
    Input {
        request: Some(request),
        ..input
    }
}

fn hard(condition: Condition) -> bool {
    condition.class().is_hard()
}

/// Hold time of a condition, ticks.
fn ticks_of(condition: Condition) -> u64 {
    condition.entry().hold / TICK
}

/// Every state with a single condition: no effect before the hold time, the state of the table at its end, and the
/// whole hold time again after a break of one tick.
#[test]
fn condition_takes_effect_after_its_hold_time_in_every_state() {
    let mut tried = 0;
    for (state, condition) in pairs() {
        let ticks = ticks_of(condition);
        let mut bench = SupervisorBench::in_state(state);
        // Two rounds of the longest hold time take longer than the default stop timeout.
        bench.supervisor = patient();
        let before = bench.state.count(condition.class());
        for round in 0..2 {
            for _ in 0..ticks {
                let output = bench.with(condition);
                assert_eq!(output.state, state, "{condition:?} {round}");
                assert!(!bench.state.present.contains(condition));
            }
            if round == 0 && ticks > 0 {
                bench.tick(NOTHING);
            }
        }
        let output = bench.with(condition);
        let next = demanded(state, Cause::Condition(condition), false);
        let context = format!("{state:?} {condition:?}");
        assert_eq!(output.state, next, "{context}");
        assert_eq!(output.changed, next != state, "{context}");
        assert_eq!(output.permit, next.permit(), "{context}");
        assert!(bench.state.present.contains(condition));
        let count = bench.state.count(condition.class());
        assert_eq!(count, before + 1, "{context}: it came up once");
        bench.with(condition);
        assert_eq!(
            bench.state.count(condition.class()),
            count,
            "{context}: and stays"
        );
        bench.tick(NOTHING);
        assert!(!bench.state.present.contains(condition), "{context}: gone");
        tried += 1;
    }
    assert_eq!(tried, 6 * Condition::ALL.len());
}

/// Supervisor with the longest timeouts.
fn patient() -> Supervisor {
    let config = Config {
        stop_timeout_s: 10.0,
        degraded_time_s: 3600.0,
        ..Config::default()
    };
    config.build().unwrap()
}

fn pairs() -> impl Iterator<Item = (OperatingState, Condition)> {
    let states = OperatingState::ALL.into_iter();
    states.flat_map(|state| Condition::ALL.map(|condition| (state, condition)))
}

/// Every state, two conditions and a request in one tick: the table is applied for the first condition, the second and
/// then the request. With a stop or cut, the motors neither hold nor drive.
#[test]
fn two_conditions_and_a_request_follow_the_table() {
    let requests = [None].into_iter().chain(StateRequest::ALL.map(Some));
    let requests: Vec<Option<StateRequest>> = requests.collect();
    for (state, first) in pairs() {
        let start = SupervisorBench::in_state(state);
        for other in Condition::ALL.into_iter().filter(|other| *other >= first) {
            let mut bench = SupervisorBench {
                state: start.state,
                ..SupervisorBench::new()
            };
            let both = Conditions::only(first).with(other, true);
            // Both conditions count as present, as after their hold times.
            bench.now = start.now;
            bench.state.present = both;
            bench.state.holding = both;
            for request in &requests {
                let mut bench = SupervisorBench {
                    state: bench.state,
                    ..SupervisorBench {
                        now: bench.now,
                        ..SupervisorBench::new()
                    }
                };
                let output = bench.tick(Input {
                    conditions: both,
                    request: *request,
                    ..NOTHING
                });
                let cleared = *request == Some(StateRequest::Clear);
                let latched =
                    hard(first) || hard(other) || (state == OperatingState::Fault && !cleared);
                let mut next = state;
                for cause in [first, other].map(Cause::Condition) {
                    next = demanded(next, cause, latched);
                }
                if let Some(request) = request {
                    next = demanded(next, Cause::Request(*request), latched);
                }
                let context = format!("{state:?} {first:?} {other:?} {request:?}");
                assert_eq!(output.state, next, "{context}");
                let drives = matches!(output.permit, Permit::Hold | Permit::Drive);
                assert!(!(drives && latched), "{context}");
                let reason = output.reason.is_some();
                assert_eq!(reason, latched, "{context}");
            }
        }
    }
}

/// Among conditions of one tick, the worst counts as the first.
#[test]
fn first_condition_is_the_reason_until_it_is_cleared() {
    let mut bench = SupervisorBench::driving();
    let both = Conditions::only(Condition::EmergencyStop).with(CUT, true);
    bench.tick(Input {
        conditions: both,
        ..NOTHING
    });
    assert_eq!(bench.state.first(), Some(CUT));
    bench.with(Condition::NotANumber);
    assert_eq!(bench.state.first(), Some(CUT));
    // The first condition is gone and another condition holds, which becomes the reason after clearing.
    let output = bench.tick(with_request(
        present(Condition::EmergencyStop),
        StateRequest::Clear,
    ));
    assert_eq!(output.state, OperatingState::Fault);
    assert_eq!(output.reason, Some(Condition::EmergencyStop));
    let output = bench.request(StateRequest::Clear);
    assert_eq!((output.state, output.reason), (OperatingState::Idle, None));
}

/// A stop under way keeps its reason.
#[test]
fn clear_changes_nothing_outside_of_a_fault() {
    for state in OperatingState::ALL {
        let mut bench = SupervisorBench::in_state(state);
        let clears = state == OperatingState::Fault;
        assert_eq!(
            bench.request(StateRequest::Clear).changed,
            clears,
            "{state:?}"
        );
    }
    let mut bench = SupervisorBench::driving();
    bench.with(Condition::EmergencyStop);
    for _ in 0..100 {
        let output = bench.request(StateRequest::Clear);
        assert_eq!(output.state, OperatingState::SafeStop);
        assert_eq!(output.reason, Some(Condition::EmergencyStop));
    }
    let output = bench.tick(HALTED);
    assert_eq!(output.state, OperatingState::Fault);
    assert_eq!(output.reason, Some(Condition::EmergencyStop));
}

#[test]
fn stop_condition_that_is_over_needs_no_clearing_while_motors_are_off() {
    for state in [OperatingState::Boot, OperatingState::Idle] {
        let request = match state {
            OperatingState::Boot => StateRequest::Ready,
            _ => StateRequest::Arm,
        };
        let mut bench = SupervisorBench::in_state(state);
        for _ in 0..=ticks_of(Condition::SupplyLow) {
            bench.with(Condition::SupplyLow);
        }
        let output = bench.tick(with_request(present(Condition::SupplyLow), request));
        assert_eq!(
            (output.state, output.reason),
            (state, Some(Condition::SupplyLow))
        );
        let output = bench.tick(NOTHING);
        assert_eq!((output.state, output.reason), (state, None));
        assert!(bench.request(request).changed);
    }
}

#[test]
fn condition_of_one_tick_is_reported_once() {
    let mut bench = SupervisorBench::new();
    bench.with(Condition::ClockStepped);
    bench.with(Condition::MessageLost);
    let lost = Conditions::only(Condition::MessageLost);
    let occurred = bench.state.take_occurred();
    assert_eq!(occurred, lost.with(Condition::ClockStepped, true));
    assert_eq!(bench.state.take_occurred(), lost, "still present");
    bench.tick(NOTHING);
    bench.state.take_occurred();
    assert_eq!(bench.state.take_occurred(), Conditions::NONE);
}

/// A stop ends with rest, or at the tick beyond 2 s. Each stop has its own 2 s.
#[test]
fn a_stop_ends_with_rest_or_after_two_seconds() {
    let mut bench = SupervisorBench::driving();
    for round in 0..3 {
        // A requested stop ends without a fault.
        assert_eq!(
            bench.request(StateRequest::Disarm).state,
            OperatingState::SafeStop
        );
        assert_eq!(bench.ticks_until_change(NOTHING), 2001, "{round}");
        assert_eq!(bench.state.operating(), OperatingState::Idle);
        // The time of a stop that ends by rest does not count for the next stop.
        for request in [StateRequest::Arm, StateRequest::Start, StateRequest::Disarm] {
            bench.request(request);
        }
        for _ in 0..1500 {
            assert!(!bench.tick(NOTHING).changed);
        }
        assert_eq!(bench.tick(HALTED).state, OperatingState::Idle);
        for request in [StateRequest::Arm, StateRequest::Start] {
            bench.request(request);
        }
    }
    let mut bench = SupervisorBench::driving();
    // The tick of the condition is already a tick of the stop.
    bench.with(Condition::EmergencyStop);
    assert_eq!(bench.ticks_until_change(NOTHING), 2000);
    assert_eq!(bench.state.operating(), OperatingState::Fault);
    // Rest has an effect only during a stop.
    let mut bench = SupervisorBench::driving();
    assert!(!bench.tick(HALTED).changed);
}

/// The allowance ends at the tick beyond 20 s or beyond 2 m, in either direction.
#[test]
fn degraded_driving_ends_by_time_or_distance() {
    // One tick begins the degradation, 50 more are its hold time, then the allowance begins.
    for (moved_m, ticks) in [
        (0.0, 51 + 20_001),
        (0.25, 51 + 9),
        (-0.25, 51 + 9),
        (f32::NAN, 51 + 1),
        (f32::INFINITY, 51 + 1),
    ] {
        let mut bench = SupervisorBench::driving();
        let degraded = Input {
            moved_m,
            ..present(Condition::BeamLost)
        };
        assert_eq!(bench.ticks_until_change(degraded), ticks, "{moved_m}");
        assert_eq!(bench.state.first(), Some(Condition::DegradedTooLong));
        assert_eq!(bench.state.operating(), OperatingState::SafeStop);
        // At rest, a lasting degradation does not prevent clearing.
        let rest = Input {
            halted: true,
            ..present(Condition::BeamLost)
        };
        assert_eq!(bench.tick(rest).state, OperatingState::Fault);
        let cleared = bench.tick(with_request(rest, StateRequest::Clear));
        assert_eq!(cleared.state, OperatingState::Idle);
    }
}

/// Time and distance count only while the robot is active, and only for the current degradation.
#[test]
fn allowance_is_used_while_driving_and_restored_at_the_end() {
    let degraded = |moved_m| Input {
        moved_m,
        ..present(Condition::BeamLost)
    };
    let mut bench = SupervisorBench::in_state(OperatingState::Armed);
    for _ in 0..25_000 {
        assert!(!bench.tick(degraded(0.25)).changed);
    }
    bench.tick(with_request(degraded(0.0), StateRequest::Start));
    assert_eq!(bench.ticks_until_change(degraded(0.25)), 9);

    for (moved_m, most) in [(0.0, 51 + 19_999), (0.25, 51 + 8)] {
        let mut bench = SupervisorBench::driving();
        for round in 0..3 {
            for _ in 0..most {
                assert!(!bench.tick(degraded(moved_m)).changed, "{round}");
            }
            // The tick at which the degradation ends still counts.
            bench.tick(NOTHING);
            bench.tick(NOTHING);
        }
    }
}

/// A clock that stands still or runs back adds no time, and no interval counts twice. A gap counts as 100 ms.
#[test]
fn hold_time_is_kept_if_the_clock_stands_still_runs_back_or_jumps() {
    // Hold time 200 ms.
    let condition = Condition::OverTemperature;
    let mut bench = SupervisorBench::driving();
    bench.with(condition);
    let began = bench.now;
    let mut at = |ms: i64| {
        bench.now = began.saturating_add_signed(ms * 1_000);
        bench.step(present(condition)).state == OperatingState::Active
    };
    assert!(
        at(90) && at(90) && at(10) && at(0) && at(-1) && at(90),
        "90 ms"
    );
    assert!(at(95) && at(5) && at(195), "195 ms");
    assert!(at(199));
    // The hold time is exact to the microsecond.
    bench.now = began + 199_999;
    assert_eq!(bench.step(present(condition)).state, OperatingState::Active);
    bench.now = began + 200_000;
    assert_eq!(
        bench.step(present(condition)).state,
        OperatingState::SafeStop
    );
    for (gap_ms, active) in [(100, true), (101, true), (100_000, true)] {
        let mut bench = SupervisorBench::driving();
        bench.with(condition);
        bench.now += gap_ms * 1_000;
        assert_eq!(
            bench.step(present(condition)).state == OperatingState::Active,
            active
        );
        bench.now += 99_000;
        assert_eq!(
            bench.step(present(condition)).state,
            OperatingState::Active,
            "{gap_ms}"
        );
        bench.now += 1_000;
        assert_eq!(
            bench.step(present(condition)).state,
            OperatingState::SafeStop,
            "{gap_ms}"
        );
    }
}

properties! {
    /// Random conditions, requests and times: motors never hold or drive while a stop or cut is latched, and a cut
    /// without hold time switches them off within the same tick.
    #[test]
    fn motors_never_drive_with_a_latched_stop_or_cut(
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
            let hard = state.latched.iter().any(hard);
            prop_assert!(!(hard && matches!(output.permit, Permit::Drive | Permit::Hold)));
            let cut = conditions.iter().any(|c| c.class() == Class::Cut && c.entry().hold == 0);
            prop_assert!(!cut || output.permit == Permit::Off);
            prop_assert_eq!(hard, output.reason.is_some());
        }
    }
}
