//! What happened to boards that were lost or came back, and what follows from it for the run.

use core_algos::topology::{Role, Topology};
use serde::Serialize;
use std::fmt;

/// Time the run goes on after it is clear that it must end, ticks: the motors go off within it.
const GRACE: u32 = 1500;

/// Event of a board.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum What {
    /// It went off, and why.
    Lost(String),
    /// The motors of all other axles were off, this many ms after it was lost.
    MotorsOff(u32),
    /// It was started again.
    Restarted,
    /// The host had the nodes forget their faults.
    Cleared,
    /// The host gave the task again.
    Resumed,
}

/// Event of a board, with its time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Time, s.
    pub time_s: f64,
    /// Board or host.
    pub role: &'static str,
    /// Description.
    pub what: What,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time_s, role, what } = self;
        write!(f, "{time_s:.3} s: ")?;
        match what {
            What::Lost(why) => write!(f, "{role} board lost: {why}"),
            What::MotorsOff(after) => write!(
                f,
                "all other motors off {after} ms after the {role} board was lost"
            ),
            What::Restarted => write!(f, "{role} board restarted"),
            What::Cleared => write!(f, "faults cleared by the {role}"),
            What::Resumed => write!(f, "task repeated by the {role}"),
        }
    }
}

/// The boards that were lost and came back.
#[derive(Clone, Debug)]
pub struct Losses {
    topology: Topology,
    events: Vec<Event>,
    /// Latest restart of an axle board, ms.
    restarted: Option<u32>,
    /// The axle that was lost last, and when, until the other's motors are off.
    watched: Option<(Role, u32)>,
    /// Why the run ends, and when.
    end: Option<(String, u32)>,
}

impl Losses {
    /// No board was lost.
    pub fn new(topology: Topology) -> Self {
        Self {
            topology,
            events: Vec::new(),
            restarted: None,
            watched: None,
            end: None,
        }
    }

    /// Events so far.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// True if there is an event of the board.
    pub fn has(&self, role: Role) -> bool {
        let name = self.topology.name(role);
        self.events.iter().any(|event| event.role == name)
    }

    /// Latest restart of an axle board, ms.
    pub fn last_restart(&self) -> Option<u32> {
        self.restarted
    }

    /// Why the run cannot go on at `tick`, if so.
    pub fn end(&self, tick: u32) -> Option<&str> {
        let (why, at) = self.end.as_ref()?;
        (tick >= *at).then_some(why)
    }

    /// Notes what the host did.
    pub fn note(&mut self, tick: u32, what: What) {
        self.record(tick, "host", what);
    }

    /// A board has gone off, to come back or not.
    pub fn lost(&mut self, tick: u32, role: Role, why: String, comes_back: bool) {
        let name = self.topology.name(role);
        self.record(tick, name, What::Lost(why));
        if role.is_beam() {
            return;
        }
        self.watched = Some((role, tick));
        if !comes_back {
            let why = format!("the {name} board was lost");
            self.end.get_or_insert((why, tick + GRACE));
        }
    }

    /// A board was started again.
    pub fn restarted(&mut self, tick: u32, role: Role) {
        if !role.is_beam() {
            self.restarted = Some(tick);
        }
        self.record(tick, self.topology.name(role), What::Restarted);
    }

    /// The run cannot go on, because the estimate of the posture is lost.
    pub fn lost_estimate(&mut self, tick: u32) {
        let why =
            "the front board was restarted and its lead node lost the estimate of the posture";
        self.end.get_or_insert((why.to_owned(), tick + GRACE));
    }

    /// Notes when the motors of the others are off; a board that is lost has none.
    pub fn watch(&mut self, tick: u32, off: bool) {
        if let (Some((role, since)), true) = (self.watched, off) {
            let off = What::MotorsOff(tick - since);
            self.record(tick, self.topology.name(role), off);
            self.watched = None;
        }
    }

    fn record(&mut self, tick: u32, role: &'static str, what: What) {
        let event = Event {
            time_s: f64::from(tick) * 1e-3,
            role,
            what,
        };
        self.events.push(event);
    }
}
