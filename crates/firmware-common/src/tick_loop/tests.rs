//! Tests of the tick loop with a board and hardware that record the calls.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use core_algos::bus::LeadMode;
use core_algos::link::MotorState;
use core_algos::safety::OperatingState;
use core_algos::topology::Node;
use embassy_futures::block_on;
use embassy_sync::watch::Watch;

use super::*;
use crate::clock::CORE_HZ;
use crate::link::{Channels, LinkEnd};

type Calls = Rc<RefCell<Vec<String>>>;

/// Core cycles in a microsecond.
const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;

struct Fake {
    calls: Calls,
    now: Micros,
    cycles: u32,
    arrived: VecDeque<Arrived>,
    sent: Vec<Message>,
    lit: bool,
    bus_off: bool,
}

impl Fake {
    fn note(&self, call: &str) {
        self.calls.borrow_mut().push(call.to_owned());
    }
}

impl Hardware for Fake {
    fn check_in(&mut self) {
        self.note("check in");
    }

    fn now(&self) -> Micros {
        self.now
    }

    fn cycles(&self) -> u32 {
        self.cycles
    }

    fn is_bus_off(&self) -> bool {
        self.bus_off
    }

    fn set_led(&mut self, lit: bool) {
        self.lit = lit;
    }

    fn receive(&mut self) -> Option<Arrived> {
        self.arrived.pop_front()
    }

    fn send(&mut self, message: &Message) -> Option<Message> {
        self.sent.push(*message);
        Some(*message)
    }

    fn send_link_frame(&mut self) {
        self.note("link frame");
    }
}

/// A board whose tick takes `step_us`.
struct Board {
    calls: Calls,
    ticks: VecDeque<Option<Micros>>,
    step_us: u32,
    motors: MotorState,
    status: Option<Message>,
}

impl Board {
    fn note(&self, call: &str) {
        self.calls.borrow_mut().push(call.to_owned());
    }
}

impl BoardTick for Board {
    type Hardware = Fake;
    type Input = u8;
    type Samples = u8;
    type LogReport = Health;

    async fn wait(&mut self) -> Option<(Micros, u8)> {
        self.note("wait");
        let tick = self.ticks.pop_front().expect("a tick that the test gave");
        tick.map(|local| (local, 5))
    }

    fn begin(&mut self, local: Micros, input: u8, common: &mut Common<Fake>) -> u8 {
        self.note("begin");
        common.sync.step(local);
        input
    }

    fn receive(&mut self, samples: &u8, arrived: &Arrived) {
        assert_eq!(*samples, 5);
        self.note(&format!("receive {}", arrived.local));
    }

    fn step(&mut self, samples: &u8, common: &mut Common<Fake>) {
        assert_eq!(*samples, 5);
        self.note("step");
        if let Some(message) = self.status {
            common.send_of_node(&message);
        }
        common.hardware.cycles = common
            .hardware
            .cycles
            .wrapping_add(self.step_us * CYCLES_PER_US);
    }

    fn motors(&self) -> MotorState {
        self.motors
    }

    fn report(&mut self, _: &u8, health: Health, common: &mut Common<Fake>) -> Health {
        self.note("report");
        common.send(&health.message(Role::axle(1), 12.0, 30.0));
        common.send_identity(Role::axle(1), &health);
        health
    }
}

type Reported = watch::Receiver<'static, CriticalSectionRawMutex, Health, 1>;

struct TickBench {
    tick: TickLoop<Board>,
    calls: Calls,
    link: LinkEnd,
    reports: Reported,
}

impl TickBench {
    fn new() -> Self {
        let calls = Calls::default();
        let (tick_end, link) = Box::leak(Box::new(Channels::new())).split();
        let hardware = Fake {
            calls: calls.clone(),
            now: 0,
            // The cycle counter starts near its maximum, so that it wraps in the first ticks.
            cycles: u32::MAX - 1_000,
            arrived: VecDeque::new(),
            sent: Vec::new(),
            lit: false,
            bus_off: false,
        };
        let board = Board {
            calls: calls.clone(),
            ticks: VecDeque::new(),
            step_us: 10,
            motors: MotorState::Off,
            status: None,
        };
        let identity = Identity::new(&[7; 12], "test build");
        let common = Common::new(
            Role::LEAD,
            hardware,
            tick_end,
            TickSync::leading(),
            identity,
        );
        let watch: &'static Watch<_, _, 1> = Box::leak(Box::new(Watch::new()));
        Self {
            tick: TickLoop::new(board, common, watch.sender()),
            calls,
            link,
            reports: watch.receiver().expect("the first"),
        }
    }

    /// Runs a tick that begins at this local time, or a skipped tick for `None`. Returns the calls.
    fn run_tick(&mut self, local: Option<Micros>) -> Vec<String> {
        self.tick.board.ticks.push_back(local);
        self.tick.common.hardware.now = local.unwrap_or_default();
        block_on(self.tick.run_tick());
        self.calls.take()
    }

    /// Runs ticks on time, by number.
    fn run_ticks(&mut self, ticks: core::ops::RangeInclusive<u64>) {
        for tick in ticks {
            self.run_tick(Some(tick * TICK));
        }
    }

    fn sent(&mut self) -> Vec<Message> {
        core::mem::take(&mut self.tick.common.hardware.sent)
    }
}

fn status(state: OperatingState) -> Message {
    Message::NodeStatus {
        node: Node::axle(0),
        sequence: 0,
        state,
        reason: 0,
        notices: Conditions::NONE,
    }
}

#[test]
fn parts_of_a_tick_run_in_the_order_of_the_data() {
    let mut bench = TickBench::new();
    let message = Message::LeadStatus {
        sequence: 0,
        mode: LeadMode::Idle,
        steering_rad: 0.0,
        velocity_m_s: 0.0,
    };
    for local in [17, 18] {
        let arrived = Arrived { local, message };
        bench.tick.common.hardware.arrived.push_back(arrived);
    }
    let expected = [
        "wait",
        "check in",
        "begin",
        "receive 17",
        "receive 18",
        "step",
        "link frame",
    ];
    assert_eq!(bench.run_tick(Some(TICK)), expected);
}

#[test]
fn tick_without_samples_checks_in_and_is_left_out() {
    let mut bench = TickBench::new();
    assert_eq!(bench.run_tick(None), ["wait", "check in"]);
    bench.run_ticks(1..=99);
    assert_eq!(bench.reports.try_get(), None, "it does not count");
}

#[test]
fn link_has_the_state_of_the_motors_after_each_tick() {
    let mut bench = TickBench::new();
    let states = [
        MotorState::Driven,
        MotorState::Braking,
        MotorState::Off,
        MotorState::Driven,
    ];
    for (tick, motors) in (1..).zip(states) {
        bench.tick.board.motors = motors;
        bench.run_tick(Some(tick * TICK));
        assert_eq!(bench.link.motors(), motors);
    }
}

#[test]
fn health_is_sent_and_reported_with_every_hundredth_tick() {
    let mut bench = TickBench::new();
    let mut reported = Vec::new();
    for tick in 1..=350 {
        bench.run_tick(Some(tick * TICK));
        let health = bench.reports.try_changed();
        let sent = bench.sent();
        assert_eq!(health.is_some(), !sent.is_empty(), "tick {tick}");
        if let Some(health) = health {
            reported.push(tick);
            let expected = health.message(Role::axle(1), 12.0, 30.0);
            assert_eq!(sent, [expected]);
            assert_eq!(health.sequence, sequence(tick * TICK));
            assert!(health.in_step);
        }
    }
    assert_eq!(reported, [100, 200, 300]);
}

#[test]
fn identity_is_sent_with_every_tenth_health_report() {
    let mut bench = TickBench::new();
    let is_identity = |message: &Message| matches!(message, Message::BoardIdentity { .. });
    bench.run_ticks(1..=999);
    assert!(!bench.sent().iter().any(is_identity));
    bench.run_ticks(1000..=1000);
    assert!(bench.sent().iter().any(is_identity));
}

#[test]
fn late_tick_is_counted_as_jitter_and_its_missed_tick_as_missed() {
    let mut bench = TickBench::new();
    bench.run_ticks(1..=50);
    // Tick 51 is left out, and tick 52 begins 0.3 ms late.
    bench.tick.board.ticks.push_back(Some(52 * TICK));
    bench.tick.common.hardware.now = 52 * TICK + 300;
    block_on(bench.tick.run_tick());
    bench.run_ticks(53..=101);
    let health = bench.reports.try_get().expect("a report");
    assert_eq!(health.timing.jitter_us, 1_300);
    assert_eq!(health.missed, 1);
    bench.run_ticks(102..=201);
    let health = bench.reports.try_get().expect("a report");
    assert_eq!(health.timing.jitter_us, 0);
    assert_eq!(health.missed, 1);
}

#[test]
fn longest_tick_is_reset_by_each_report() {
    let mut bench = TickBench::new();
    bench.run_ticks(1..=10);
    bench.tick.board.step_us = 620;
    bench.run_ticks(11..=11);
    bench.tick.board.step_us = 10;
    bench.run_ticks(12..=100);
    let longest = |bench: &mut TickBench| bench.reports.try_get().unwrap().timing.longest_us;
    assert_eq!(longest(&mut bench), 620);
    bench.run_ticks(101..=200);
    assert_eq!(longest(&mut bench), 10);
}

#[test]
fn led_shows_the_state_that_the_node_sends() {
    let mut bench = TickBench::new();
    bench.tick.board.status = Some(status(OperatingState::Active));
    bench.run_ticks(1..=2);
    let lit = |bench: &mut TickBench, ticks: core::ops::Range<u64>| {
        let lit = ticks.filter(|tick| {
            bench.run_tick(Some(tick * TICK));
            bench.tick.common.hardware.lit
        });
        lit.count()
    };
    assert_eq!(lit(&mut bench, 3..2_003), 2_000);
    bench.tick.board.status = Some(status(OperatingState::Idle));
    bench.run_ticks(2_003..=2_004);
    assert_eq!(lit(&mut bench, 2_005..4_005), 100);
}

#[test]
fn message_that_arrived_reaches_the_common_time() {
    let mut bench = TickBench::new();
    bench.tick.common.sync = TickSync::following();
    bench.run_ticks(1..=100);
    assert!(!bench.reports.try_get().unwrap().in_step);
    for tick in 101..=300u64 {
        let message = Message::TimeSync {
            epoch: (tick / 10) as u32,
            last_delay_us: Some(100),
        };
        if tick % 10 == 0 {
            let local = tick * TICK + 100;
            let arrived = Arrived { local, message };
            bench.tick.common.hardware.arrived.push_back(arrived);
        }
        bench.run_tick(Some(tick * TICK));
    }
    assert!(bench.reports.try_get().unwrap().in_step);
}

#[test]
fn message_of_another_board_with_the_same_role_sets_role_taken_for_a_second() {
    let mut bench = TickBench::new();
    let mut conditions = |tick: u64, arrived: Option<Message>| {
        let arrived = arrived.map(|message| Arrived { local: 0, message });
        bench.tick.common.hardware.arrived.extend(arrived);
        bench.run_tick(Some(tick * TICK));
        bench
            .tick
            .common
            .conditions()
            .contains(Condition::RoleTaken)
    };
    assert!(!conditions(1, None));
    assert!(conditions(2, Some(status(OperatingState::Idle))));
    assert!(conditions(1001, None));
    assert!(!conditions(1002, None));
}

#[test]
fn bus_off_is_a_condition() {
    let mut bench = TickBench::new();
    bench.run_tick(Some(TICK));
    assert!(bench.tick.common.conditions().is_empty());
    bench.tick.common.hardware.bus_off = true;
    let expected = Conditions::only(Condition::BusOff);
    assert_eq!(bench.tick.common.conditions(), expected);
}
