//! Data that the dashboard shows.

use core_algos::safety::{Conditions, OperatingState};
use core_algos::topology::Role;
use host_sim::bus::virtual_bus::BusStatistics;
use host_sim::run::keyboard::Hand;
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::recovery::{Monitor, Status};
use host_sim::run::robot::{Record, Robot};
use host_sim::targets::BoardTraffic;

/// Latest heartbeat and notices of a node, for the display.
#[derive(Clone, Debug, Default)]
pub struct NodeView {
    /// Name of the node.
    pub name: &'static str,
    /// Latest heartbeat of the node; `None` before the first.
    pub latest: Option<Status>,
    /// Notices and degradations so far.
    pub noticed: Conditions,
}

/// Everything that the dashboard shows at one instant.
#[derive(Clone, Debug, Default)]
pub struct View {
    /// Title of the run.
    pub title: String,
    /// Simulated time, s.
    pub time_s: f64,
    /// Number of ticks that began more than one tick behind real time.
    pub late_ticks: u32,
    /// Largest delay of a tick, s.
    pub most_late_s: f64,
    /// Nodes of the robot.
    pub nodes: Vec<NodeView>,
    /// Names of the axles, front first.
    pub axles: Vec<&'static str>,
    /// Names of the frames' boards, front first.
    pub frames: Vec<&'static str>,
    /// First heartbeat of each node with each stop or cut; the first heartbeat of the list names the cause.
    pub faults: Vec<Status>,
    /// Links to the boards.
    pub boards: Vec<BoardTraffic>,
    /// Bus between the boards.
    pub bus: BusStatistics,
    /// True posture of the midpoint at the instant of the lead's estimate: m, m, rad.
    pub truth: [f64; 3],
    /// Goal of the midpoint: m, m, rad.
    pub goal: [f64; 3],
    /// Latest record; the estimate replaces an unknown truth.
    pub record: Record,
    /// Estimated path of the midpoint, m.
    pub trail: Vec<[f64; 2]>,
    /// True if the simulation is paused, and its speed in multiples of real time; `None` if the run cannot be paused.
    pub pace: Option<(bool, f64)>,
    /// Command of a drive by keyboard.
    pub hand: Option<Hand>,
    /// Message that the robot stopped because no key was pressed, in a drive by keyboard.
    pub idle_stop: Option<String>,
    /// Message about the end of the run; `None` during the run.
    pub end: Option<String>,
}

impl View {
    /// View of a robot at the end of an epoch.
    pub fn of(robot: &dyn Robot, record: &Record) -> Self {
        let monitor = robot.monitor();
        let pace = robot.control().pace.as_ref();
        Self {
            time_s: record.time_s,
            late_ticks: pace.map_or(0, RealTimeLimiter::late),
            most_late_s: pace.map_or(0.0, |pace| pace.worst().as_secs_f64()),
            faults: faults(monitor.changes()),
            boards: robot.traffic(),
            bus: robot.bus(),
            record: record.with_estimate(),
            pace: pace.map(|pace| pace.keyboard().pace()),
            ..Self::before(monitor)
        }
    }

    /// View before the first epoch, with the heartbeats that the monitor has received.
    pub fn before(monitor: &Monitor) -> Self {
        let topology = monitor.topology;
        let axle = |axle| topology.name(Role::Axle(axle));
        let frame = |frame| topology.name(Role::Beam(frame));
        let node = |node| NodeView {
            name: topology.node_name(node),
            latest: monitor.latest(node).copied(),
            noticed: monitor.noticed(node),
        };
        Self {
            nodes: topology.nodes().map(node).collect(),
            axles: topology.axles().map(axle).collect(),
            frames: topology.frames().map(frame).collect(),
            ..Self::default()
        }
    }
}

/// First heartbeat of each node with each stop or cut.
fn faults(changes: &[Status]) -> Vec<Status> {
    let mut found: Vec<Status> = Vec::new();
    let stopped = |status: &&Status| {
        let state = matches!(
            status.state,
            OperatingState::SafeStop | OperatingState::Fault
        );
        state && status.reason.is_some()
    };
    for status in changes.iter().filter(stopped) {
        let known = |other: &Status| (other.node, other.reason) == (status.node, status.reason);
        if !found.iter().any(known) {
            found.push(*status);
        }
    }
    found
}
