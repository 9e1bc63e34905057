//! Tests of a board that drives, between both ends of its link, with fixed inputs.

use std::sync::LazyLock;

use core_algos::bus::CanFrame;
use core_algos::control::path::{PathError, PathPoint};
use core_algos::link::framing::Decoder;
use core_algos::link::order::POINTS;
use core_algos::link::protocol::{self, CrashRecord, PROTOCOL, Refusal, Reply, Request, StackUse};
use core_algos::link::record::{Entry, entries};
use core_algos::link::segment::{self, Direction};
use core_algos::link::{Identity, MotorState, Order, RunLink, Stamp, lease};
use core_algos::math::Posture;
use core_algos::node::lead::{LeadNode, Output as LeadOutput, Task};
use core_algos::node::robot::RobotConfig;
use core_algos::time::Micros;
use core_algos::topology::Role;
use embassy_futures::block_on;

use super::*;

static CONFIG: LazyLock<RobotConfig> = LazyLock::new(RobotConfig::default);

/// Serial port and bus that keep all bytes and frames sent.
#[derive(Default)]
struct Sent {
    serial: Vec<u8>,
    bus: Vec<CanFrame>,
    busy: bool,
}

impl Output for Sent {
    fn write(&mut self, bytes: &[u8]) {
        self.serial.extend_from_slice(bytes);
    }

    fn is_free(&self) -> bool {
        !self.busy
    }

    fn send(&mut self, frames: impl Iterator<Item = CanFrame>) {
        self.bus.extend(frames);
    }
}

/// Front board that drives: its link, the tick's end, and the lead node.
struct LinkBench {
    driving: Driving,
    tick: TickEnd,
    lead: Box<LeadNode>,
    sent: Sent,
    now: Micros,
    number: u8,
}

impl LinkBench {
    /// A board that has received a hello on both routes.
    fn new() -> Self {
        let identity = Identity {
            build: "test build",
            role: Role::LEAD,
        };
        let run_link = || RunLink::new(identity, &CONFIG, StackUse::unknown, CrashRecord::default);
        let (tick, end) = Box::leak(Box::new(Channels::new())).split();
        let run_links = Box::leak(Box::new([run_link(), run_link()]));
        let mut bench = Self {
            driving: Driving::new(Role::LEAD, run_links, end),
            tick,
            lead: Box::new(LeadNode::new(CONFIG.build_lead().unwrap())),
            sent: Sent::default(),
            now: 1_000,
            number: 0,
        };
        let (protocol, nonce) = (PROTOCOL, 1);
        for route in [Route::Serial, Route::Bus] {
            bench.send_request(route, &Request::Hello { protocol, nonce });
        }
        bench
    }

    fn handle_event(&mut self, event: Event) -> Option<Route> {
        self.driving.handle_event(self.now, event, &mut self.sent)
    }

    /// Sends a request; returns the replies and the route of a requested session.
    fn send_request(&mut self, route: Route, request: &Request) -> (Vec<Vec<u8>>, Option<Route>) {
        self.number += 1;
        let frame = protocol::encode(self.number, request).unwrap();
        let mut session = None;
        match route {
            Route::Serial => session = self.handle_event(Event::Bytes(frame.bytes())),
            Route::Bus => {
                for frame in segment::frames(Role::LEAD, Direction::To, frame.repeated()) {
                    session = session.or(self.handle_event(Event::Frame(frame)));
                }
            }
        }
        (self.take(route), session)
    }

    /// Payloads sent on a route since the last call.
    fn take(&mut self, route: Route) -> Vec<Vec<u8>> {
        let bytes = match route {
            Route::Serial => core::mem::take(&mut self.sent.serial),
            Route::Bus => {
                let frames = core::mem::take(&mut self.sent.bus);
                let of_board = Some((Role::LEAD, Direction::From));
                assert!(frames.iter().all(|f| segment::address(f.id) == of_board));
                frames.iter().flat_map(|f| f.bytes().to_vec()).collect()
            }
        };
        let mut decoder = Decoder::new();
        let payloads = bytes
            .iter()
            .filter_map(|&byte| decoder.take_byte(byte).map(<[u8]>::to_vec));
        payloads.collect()
    }

    /// The single reply to a request.
    fn reply(&mut self, request: &Request) -> Vec<u8> {
        let (mut replies, _) = self.send_request(Route::Serial, request);
        assert_eq!(replies.len(), 1, "{request:?}");
        replies.remove(0)
    }

    /// The tick executes orders, and the link gets the result.
    fn execute(&mut self) {
        self.tick.execute_orders(&mut self.lead);
        let result = block_on(self.driving.end().result());
        self.handle_event(Event::Executed(result));
    }

    /// Entries of the reports that one turn of the link sends.
    fn entries(&mut self) -> Vec<String> {
        self.handle_event(Event::Nothing);
        entries_of(&self.take(Route::Serial))
    }
}

/// Entries of all reports among these payloads.
fn entries_of(payloads: &[Vec<u8>]) -> Vec<String> {
    let mut found = Vec::new();
    for payload in payloads {
        if let Reply::Report { entries: bytes, .. } = decoded(payload) {
            found.extend(entries(bytes).map(|entry| text(&entry.unwrap())));
        }
    }
    found
}

fn decoded(payload: &[u8]) -> Reply<'_> {
    protocol::decode(payload).unwrap().1
}

fn stamp(sequence: u16) -> Stamp {
    let owner = 7;
    Stamp { owner, sequence }
}

fn order(sequence: u16, order: Order) -> Request<'static> {
    let stamp = stamp(sequence);
    Request::Order { stamp, order }
}

fn goal() -> (Posture, Order) {
    let goal = Posture::new(1.0, 2.0, 0.5);
    (goal, Order::Task(Task::regulate(goal)))
}

fn text(entry: &Entry) -> String {
    format!("{entry:?}")
}

#[test]
fn order_executed_by_the_tick_is_answered_with_done_on_its_route() {
    for route in [Route::Serial, Route::Bus] {
        let mut bench = LinkBench::new();
        let (goal, task) = goal();
        let (replies, _) = bench.send_request(route, &order(1, task));
        assert!(replies.is_empty(), "before the tick");
        assert_eq!(bench.lead.latest_goal(), None);
        bench.execute();
        assert_eq!(bench.lead.latest_goal(), Some(goal));
        let replies = bench.take(route);
        assert_eq!(replies.len(), 1);
        let expected = Some((bench.number, Reply::Done));
        assert_eq!(protocol::decode(&replies[0]), expected);
        assert!(bench.sent.serial.is_empty() && bench.sent.bus.is_empty());
    }
}

#[test]
fn order_refused_by_the_lead_node_is_answered_with_the_reason_and_ends_the_record() {
    let mut bench = LinkBench::new();
    bench.reply(&Request::Watch);
    let mut points = [None; POINTS];
    points[0] = Some(PathPoint {
        kappa: 1e6,
        ..PathPoint::default()
    });
    bench.send_request(Route::Serial, &order(1, Order::Path { points, end: true }));
    bench.execute();
    let replies = bench.take(Route::Serial);
    let refused = Reply::Refused(Refusal::Point(PathError::TooTight));
    assert!(replies.iter().any(|reply| decoded(reply) == refused));
    assert_eq!(entries_of(&replies), [text(&Entry::End)]);
}

#[test]
fn order_is_executed_once() {
    let mut bench = LinkBench::new();
    bench.reply(&Request::Watch);
    bench.send_request(Route::Serial, &order(9, goal().1));
    bench.tick.execute_orders(&mut bench.lead);
    bench.tick.execute_orders(&mut bench.lead);
    assert_eq!(bench.entries(), [text(&Entry::Carried(9))]);
}

#[test]
fn lease_that_lapses_stops_the_robot_once() {
    let mut bench = LinkBench::new();
    bench.reply(&Request::Watch);
    let began = bench.now;
    bench.reply(&Request::Keep(stamp(1)));
    for (after, expected) in [
        (lease::TERM, vec![]),
        (lease::TERM + 1, vec![text(&Entry::Order(Order::Lost))]),
        (lease::TERM + 2, vec![]),
    ] {
        bench.now = began + after;
        bench.handle_event(Event::Nothing);
        bench.tick.execute_orders(&mut bench.lead);
        assert_eq!(bench.entries(), expected, "{after} µs after the order");
    }
}

#[test]
fn order_of_the_board_is_recorded() {
    let mut bench = LinkBench::new();
    bench.reply(&Request::Watch);
    let (goal, task) = goal();
    bench.tick.execute(task, &mut bench.lead);
    assert_eq!(bench.lead.latest_goal(), Some(goal));
    assert_eq!(bench.entries(), [text(&Entry::Order(task))]);
}

#[test]
fn begin_request_reaches_the_tick_once() {
    let mut bench = LinkBench::new();
    assert!(!bench.tick.take_begin());
    let reply = bench.reply(&Request::Record(stamp(1)));
    assert_eq!(decoded(&reply), Reply::Done);
    assert!(bench.tick.take_begin());
    assert!(!bench.tick.take_begin());
}

#[test]
fn session_is_refused_until_the_motors_are_off() {
    for route in [Route::Serial, Route::Bus] {
        let mut bench = LinkBench::new();
        for motors in [MotorState::Driven, MotorState::Braking] {
            bench.tick.set_motors(motors);
            let (replies, session) = bench.send_request(route, &Request::Rig);
            assert_eq!(decoded(&replies[0]), Reply::Refused(Refusal::Armed));
            assert_eq!(session, None);
        }
        bench.tick.set_motors(MotorState::Off);
        let (replies, session) = bench.send_request(route, &Request::Rig);
        assert_eq!(decoded(&replies[0]), Reply::Done);
        assert_eq!(session, Some(route));
    }
}

#[test]
fn telemetry_is_published_only_for_a_host_that_watches() {
    let mut bench = LinkBench::new();
    let publish = |bench: &mut LinkBench| {
        let output = LeadOutput::default();
        bench.tick.publish(bench.now, output, &mut bench.lead);
    };
    let telemetry = |bench: &mut LinkBench| {
        bench.handle_event(Event::Nothing);
        let reports = bench.take(Route::Serial);
        let part = |report: &Vec<u8>| match decoded(report) {
            Reply::Report { telemetry, .. } => telemetry.len(),
            _ => 0,
        };
        reports.iter().map(part).sum::<usize>()
    };
    publish(&mut bench);
    bench.reply(&Request::Watch);
    assert_eq!(telemetry(&mut bench), 0, "of the time before");
    publish(&mut bench);
    assert!(telemetry(&mut bench) > 0);
}

#[test]
fn report_waits_for_the_port() {
    let mut bench = LinkBench::new();
    bench.reply(&Request::Watch);
    bench.tick.put(&Entry::Wait);
    bench.sent.busy = true;
    assert!(bench.entries().is_empty());
    bench.sent.busy = false;
    assert_eq!(bench.entries(), [text(&Entry::Wait)]);
}

#[test]
fn reply_of_another_board_is_relayed_to_the_port() {
    let mut bench = LinkBench::new();
    let inner = protocol::encode(5, &Request::Stack).unwrap();
    let mut decoder = Decoder::new();
    let payload = inner.bytes().iter().find_map(|&byte| {
        let payload = decoder.take_byte(byte)?;
        Some(payload.to_vec())
    });
    let request = Request::Relay {
        role: Role::axle(1),
        payload: &payload.unwrap(),
    };
    let (replies, _) = bench.send_request(Route::Serial, &request);
    assert!(replies.is_empty());
    let requests = core::mem::take(&mut bench.sent.bus);
    let to_rear = Some((Role::axle(1), Direction::To));
    assert!(!requests.is_empty());
    assert!(requests.iter().all(|f| segment::address(f.id) == to_rear));
    let reply = protocol::encode(5, &Reply::Done).unwrap();
    for frame in segment::frames(Role::axle(1), Direction::From, reply.repeated()) {
        bench.handle_event(Event::Frame(frame));
    }
    let replies = bench.take(Route::Serial);
    assert!(matches!(decoded(&replies[0]), Reply::Relayed { .. }));
}
