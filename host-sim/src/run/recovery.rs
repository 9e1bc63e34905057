//! Monitor of the nodes' heartbeats on the bus, and recovery by the host after the restart of a board.

use crate::targets::EventKind;
use core_algos::bus::field::CalibrationResult;
use core_algos::bus::{self, CanFrame, Message, layout};
use core_algos::safety::{Condition, Conditions, OperatingState};
use core_algos::topology::{Node, Topology};
use serde::{Serialize, Serializer};
use std::fmt;

/// Notices that name a faulty sensor.
pub const SENSORS: [Condition; 6] = [
    Condition::GaugeLost,
    Condition::InertialLost,
    Condition::WheelsInconsistent,
    Condition::GaugesInconsistent,
    Condition::GyrosInconsistent,
    Condition::BeamInconsistent,
];

/// Heartbeat of a node.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Status {
    /// Time at which the node sent the heartbeat, s.
    pub time_s: f64,
    /// Node that sent the heartbeat.
    pub node: Node,
    /// Name of the node.
    #[serde(skip)]
    pub name: &'static str,
    /// Operating state of the node.
    pub state: OperatingState,
    /// First stop or cut since faults were last cleared; for a node that is not armed, the condition that
    /// prevents arming.
    #[serde(serialize_with = "name_and_code")]
    pub reason: Option<Condition>,
    /// Notices and degradations since the previous heartbeat.
    #[serde(serialize_with = "names")]
    pub notices: Conditions,
}

impl Status {
    /// Heartbeat in a message sent at `tick` (ms); `None` for another message.
    pub fn of(topology: Topology, tick: u32, message: &Message) -> Option<Self> {
        match *message {
            Message::NodeStatus {
                node,
                state,
                reason,
                notices,
                ..
            } => Some(Self {
                time_s: f64::from(tick) * 1e-3,
                node,
                name: topology.node_name(node),
                state,
                reason: Condition::from_code(reason),
                notices,
            }),
            _ => None,
        }
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = self.state.name();
        write!(f, "{:.3} s: {}: {state}", self.time_s, self.name)?;
        match self.reason {
            Some(condition) => {
                let entry = condition.entry();
                write!(f, ", {} ({:#04x})", entry.name, entry.code)
            }
            None => Ok(()),
        }
    }
}

fn name_and_code<S: Serializer>(reason: &Option<Condition>, to: S) -> Result<S::Ok, S::Error> {
    let entry = reason.map(|condition| condition.entry());
    entry.map(|entry| (entry.code, entry.name)).serialize(to)
}

fn names<S: Serializer>(conditions: &Conditions, to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(conditions.iter().map(|condition| condition.entry().name))
}

/// Monitor of heartbeats on the bus.
#[derive(Clone, Debug)]
pub struct Monitor {
    /// Topology of the robot.
    pub topology: Topology,
    latest: Vec<Option<Status>>,
    changes: Vec<Status>,
    /// Index of the first change of the present task.
    first: usize,
    /// True for nodes whose next heartbeat still holds notices from before the task.
    stale: Vec<bool>,
    noticed: Vec<Conditions>,
    /// Latest result of a calibration, and the gauge that caused the result.
    pub calibrated: Option<(CalibrationResult, u8)>,
}

/// True for a frame that the monitor decodes; most frames on the bus are skipped.
fn is_monitored(frame: &CanFrame) -> bool {
    let first = layout::find(frame.id).map(|layout| layout.id);
    first.is_some_and(|id| [layout::id::NODE_STATUS, layout::id::BEAM_CALIBRATED].contains(&id))
}

impl Monitor {
    /// Monitor that has received nothing.
    pub fn new(topology: Topology) -> Self {
        let nodes = topology.node_count();
        Self {
            topology,
            latest: vec![None; nodes],
            changes: Vec::new(),
            first: 0,
            stale: vec![false; nodes],
            noticed: vec![Conditions::NONE; nodes],
            calibrated: None,
        }
    }

    /// Processes a frame sent at `tick` (ms).
    pub fn receive(&mut self, tick: u32, frame: &CanFrame) {
        if !is_monitored(frame) {
            return;
        }
        let message = bus::decode(frame);
        if let Ok(Message::BeamCalibrated { result, gauge, .. }) = message {
            self.calibrated = Some((result, gauge));
        }
        let status = |message| Status::of(self.topology, tick, &message);
        let Some(status) = message.ok().and_then(status) else {
            return;
        };
        let Some(place) = self.topology.place_of_node(status.node) else {
            return;
        };
        if !std::mem::take(&mut self.stale[place]) {
            let noticed = &mut self.noticed[place];
            *noticed = noticed.union(status.notices);
        }
        let before = self.latest[place].replace(status);
        let same = |before: Status| (before.state, before.reason) == (status.state, status.reason);
        if !before.is_some_and(same) {
            self.changes.push(status);
        }
    }

    /// Latest heartbeat of a node; `None` if none was received.
    pub fn latest(&self, node: Node) -> Option<&Status> {
        self.latest[self.topology.place_of_node(node)?].as_ref()
    }

    /// First heartbeat of each node, and every heartbeat with a changed state or reason.
    pub fn changes(&self) -> &[Status] {
        &self.changes
    }

    /// Reason that the robot stopped, with code, time and remedy; `None` if no node reported a fault.
    pub fn why_stopped(&self) -> Option<String> {
        let first = self.first_fault()?;
        let advice = first.reason.map(|code| code.entry().remedy);
        let advice = advice.map_or_else(String::new, |remedy| format!(": {remedy}"));
        let notices = self.notices();
        let named = SENSORS.iter().filter(|&&sensor| notices.contains(sensor));
        let names: Vec<_> = named.map(|sensor| sensor.entry().name).collect();
        let noticed = match names.is_empty() {
            true => String::new(),
            false => format!("; notices: {}", names.join(", ")),
        };
        Some(format!(
            "the robot stopped with a fault at {first}{advice}{noticed}"
        ))
    }

    /// Tick (ms) since which a node has been in fault; `None` if the node is not in fault.
    pub fn fault_since(&self, node: Node) -> Option<u64> {
        let of_node = |status: &&Status| status.node == node;
        let last = self.changes.iter().rev().find(of_node)?;
        (last.state == OperatingState::Fault).then_some((last.time_s * 1e3).round() as u64)
    }

    /// Begins a task: clears the notices. Faults cleared before the task no longer count.
    pub fn begin_task(&mut self) {
        self.noticed.fill(Conditions::NONE);
        self.stale = self.latest.iter().map(Option::is_some).collect();
        let stopped = |status: &Status| is_stopped(status.state);
        if !self.latest.iter().flatten().any(stopped) {
            self.first = self.changes.len();
        }
    }

    /// All notices and degradations of a node since the task began.
    pub fn noticed(&self, node: Node) -> Conditions {
        let place = self.topology.place_of_node(node);
        place.map_or(Conditions::NONE, |place| self.noticed[place])
    }

    /// All notices and degradations of all nodes since the task began.
    pub fn notices(&self) -> Conditions {
        let all = self.noticed.iter().copied();
        all.fold(Conditions::NONE, Conditions::union)
    }

    /// First heartbeat that reported a stop or cut since the task began, or the heartbeat of a fault not yet cleared.
    /// `None` without a stop or cut.
    pub fn first_fault(&self) -> Option<&Status> {
        let mut changes = self.changes.iter().skip(self.first);
        changes.find(|status| is_stopped(status.state) && status.reason.is_some())
    }

    /// Clears the changes; keeps the latest heartbeats.
    pub fn forget_changes(&mut self) {
        self.changes.clear();
        self.first = 0;
    }
}

fn is_stopped(state: OperatingState) -> bool {
    matches!(state, OperatingState::SafeStop | OperatingState::Fault)
}

/// Time from a restart to the host's first check of the nodes, ticks.
pub const CHECK_DELAY_TICKS: u32 = 1000;
/// Time in which the nodes must become idle after an attempt to clear the faults, ticks.
const CLEARING_TICKS: u32 = 500;
/// Attempts before the host gives up.
const ATTEMPTS: u32 = 3;

/// Recovery by the host after the restart of an axle board: the host clears the faults until all nodes are ready, then
/// repeats the task. The robot itself never drives on after a fault.
#[derive(Clone, Copy, Debug, Default)]
pub struct Recovery {
    /// Latest detected restart, ms.
    restart: Option<u32>,
    /// Tick of the next check of the nodes, and number of attempts.
    next: Option<(u32, u32)>,
}

impl Recovery {
    /// True if an action of the host is pending.
    pub fn is_pending(&self) -> bool {
        self.next.is_some()
    }

    /// Action of the host at a tick; `restart` is the latest restart of an axle board, ms. `None` if the host does
    /// nothing at the tick.
    pub fn step(
        &mut self,
        tick: u32,
        restart: Option<u32>,
        monitor: &Monitor,
    ) -> Option<EventKind> {
        if self.restart != restart {
            self.restart = restart;
            self.next = restart.map(|at| (at + CHECK_DELAY_TICKS, 0));
        }
        let (_, attempts) = self.next.filter(|(at, _)| *at == tick)?;
        let axles = monitor.topology.axles().map(Node::Axle);
        let ready = std::iter::once(Node::Lead).chain(axles).all(|node| {
            let status = monitor.latest(node);
            status.is_some_and(|it| it.state == OperatingState::Idle && it.reason.is_none())
        });
        self.next =
            (!ready && attempts < ATTEMPTS).then_some((tick + CLEARING_TICKS, attempts + 1));
        match ready {
            true => Some(EventKind::Resumed),
            false => self.next.map(|_| EventKind::Cleared),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(node: Node, state: OperatingState, reason: u8, notices: Conditions) -> CanFrame {
        let message = Message::NodeStatus {
            node,
            sequence: 0,
            state,
            reason,
            notices,
        };
        bus::encode(&message).unwrap()
    }

    #[test]
    fn monitor_keeps_changes_and_drops_repetitions() {
        let mut monitor = Monitor::new(Topology::PAIR);
        let low = Condition::SupplyLow.code();
        let lost = Conditions::only(Condition::MessageLost);
        for tick in 0..30 {
            monitor.receive(
                tick,
                &frame(Node::Lead, OperatingState::Idle, 0, Conditions::NONE),
            );
            let (state, reason) = match tick {
                ..10 => (OperatingState::Active, 0),
                10..20 => (OperatingState::SafeStop, low),
                _ => (OperatingState::Fault, low),
            };
            let notices = if tick == 5 { lost } else { Conditions::NONE };
            monitor.receive(tick, &frame(Node::axle(1), state, reason, notices));
        }
        let times: Vec<f64> = monitor.changes().iter().map(|c| c.time_s).collect();
        assert_eq!(times, [0.0, 0.0, 0.01, 0.02]);
        let first = monitor.first_fault().unwrap();
        assert_eq!((first.node, first.time_s), (Node::axle(1), 0.01));
        assert_eq!(first.reason, Some(Condition::SupplyLow));
        assert!(first.to_string().contains("SafeStop, supply low (0x8a)"));
        let latest = monitor.latest(Node::axle(1)).unwrap();
        assert_eq!(latest.state, OperatingState::Fault);
        assert!(
            monitor
                .noticed(Node::axle(1))
                .contains(Condition::MessageLost)
        );
        // A robot of two axles has no third axle; the number of a third axle must not be taken for the index of the
        // beam.
        let third_axle = frame(Node::axle(2), OperatingState::Fault, 0x80, lost);
        monitor.receive(30, &third_axle);
        assert_eq!(
            crate::bus::virtual_bus::sender(Topology::PAIR, &third_axle),
            None
        );
        assert_eq!(monitor.latest(Node::beam(0)), None);
        let mut monitor = Monitor::new(Topology::new(4).unwrap());
        monitor.receive(30, &third_axle);
        let latest = monitor.latest(Node::axle(2)).unwrap();
        assert_eq!((latest.name, latest.node), ("Axle3", Node::axle(2)));
    }
}
