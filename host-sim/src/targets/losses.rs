//! Losses and restarts of boards, and the end of the run that may follow.

use core_algos::topology::{Role, Topology};
use serde::Serialize;
use std::fmt;

/// Time from the decision to end a run to its end, ticks: the motors switch off within this time.
const TICKS_TO_END: u32 = 1500;

/// Event of a board.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// The board was lost, with the reason.
    Lost(String),
    /// The motors of all other axles were off this many ms after the loss of the board.
    MotorsOff(u32),
    /// The board was restarted.
    Restarted,
    /// The host cleared the faults of the nodes.
    Cleared,
    /// The host repeated the task.
    Resumed,
}

/// Event of a board, with its time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Time of the event, s.
    pub time_s: f64,
    /// Name of the board, or `host`.
    pub role: &'static str,
    /// Kind of the event.
    pub what: EventKind,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time_s, role, what } = self;
        write!(f, "{time_s:.3} s: ")?;
        match what {
            EventKind::Lost(why) => write!(f, "{role} board lost: {why}"),
            EventKind::MotorsOff(after) => write!(
                f,
                "all other motors off {after} ms after the {role} board was lost"
            ),
            EventKind::Restarted => write!(f, "{role} board restarted"),
            EventKind::Cleared => write!(f, "faults cleared by the {role}"),
            EventKind::Resumed => write!(f, "task repeated by the {role}"),
        }
    }
}

/// Record of losses and restarts.
#[derive(Clone, Debug)]
pub struct Losses {
    topology: Topology,
    events: Vec<Event>,
    /// Latest restart of an axle board, ms.
    restarted: Option<u32>,
    /// Axle board lost last and time of the loss, ms, until all other motors are off.
    awaiting_motors_off: Option<(Role, u32)>,
    /// Reason and time of the end of the run, ms.
    end: Option<(String, u32)>,
}

impl Losses {
    /// Record without losses.
    pub fn new(topology: Topology) -> Self {
        Self {
            topology,
            events: Vec::new(),
            restarted: None,
            awaiting_motors_off: None,
            end: None,
        }
    }

    /// Events of the boards since the start of the run.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// True if there is an event of the board.
    pub fn has(&self, role: Role) -> bool {
        let name = self.topology.name(role);
        self.events.iter().any(|event| event.role == name)
    }

    /// Latest restart of an axle board, ms; `None` without a restart.
    pub fn last_restart(&self) -> Option<u32> {
        self.restarted
    }

    /// Reason that the run must end at `tick`; `None` if the run can continue.
    pub fn end(&self, tick: u32) -> Option<&str> {
        let (why, at) = self.end.as_ref()?;
        (tick >= *at).then_some(why)
    }

    /// Records an action of the host.
    pub fn note(&mut self, tick: u32, what: EventKind) {
        self.record(tick, "host", what);
    }

    /// Records the loss of a board. If `comes_back` is false, the loss of an axle board ends the run.
    pub fn lost(&mut self, tick: u32, role: Role, why: String, comes_back: bool) {
        let name = self.topology.name(role);
        self.record(tick, name, EventKind::Lost(why));
        if role.is_beam() {
            return;
        }
        self.awaiting_motors_off = Some((role, tick));
        if !comes_back {
            let why = format!("the {name} board was lost");
            self.end.get_or_insert((why, tick + TICKS_TO_END));
        }
    }

    /// Records the restart of a board.
    pub fn restarted(&mut self, tick: u32, role: Role) {
        if !role.is_beam() {
            self.restarted = Some(tick);
        }
        self.record(tick, self.topology.name(role), EventKind::Restarted);
    }

    /// Ends the run, because the estimate of the posture is lost.
    pub fn lost_estimate(&mut self, tick: u32) {
        let why =
            "the front board was restarted and its lead node lost the estimate of the posture";
        self.end
            .get_or_insert((why.to_owned(), tick + TICKS_TO_END));
    }

    /// Records when all motors are off after the loss of an axle board; `off` is true if all are off at `tick`.
    pub fn record_motors_off(&mut self, tick: u32, off: bool) {
        if let (Some((role, since)), true) = (self.awaiting_motors_off, off) {
            let off = EventKind::MotorsOff(tick - since);
            self.record(tick, self.topology.name(role), off);
            self.awaiting_motors_off = None;
        }
    }

    fn record(&mut self, tick: u32, role: &'static str, what: EventKind) {
        let event = Event {
            time_s: f64::from(tick) * 1e-3,
            role,
            what,
        };
        self.events.push(event);
    }
}
