//! Record of a board, assembled from the entries of its reports: inputs and outputs of its nodes at each tick.

use super::HostCommand;
use crate::bus::virtual_bus::{is_of_nodes, sender};
use core_algos::bus::CanFrame;
use core_algos::link::record::{Entry, Reference};
use core_algos::node::board::Samples;
use core_algos::node::lead;
use core_algos::node::robot::RobotConfig;
use core_algos::topology::{Role, Wheels};

/// Recorded event of a board. Times are ticks of the boards, ms.
#[derive(Clone, Debug, PartialEq)]
pub enum BoardEvent {
    /// The nodes started before this tick.
    Begin(u32, Box<RobotConfig>),
    /// A command was executed before this tick.
    Command(u32, HostCommand),
    /// A tick of the board.
    Tick(Box<BoardTick>),
    /// Output of the lead node at this tick.
    Lead(u32, Box<lead::Output>),
    /// The record ends before this tick.
    End(u32, String),
}

/// Tick of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardTick {
    /// Time of the tick, ms.
    pub tick: u32,
    /// Samples of the board's sensors.
    pub samples: Samples,
    /// Torques commanded (left, right), N m.
    pub torque_nm: Wheels<f32>,
    /// Frames that the nodes received before the tick.
    pub received: Vec<CanFrame>,
    /// Frames that the board sent after the tick.
    pub sent: Vec<CanFrame>,
}

/// Record of a board.
#[derive(Clone, Debug)]
pub struct BoardRecord {
    role: Role,
    config: Box<RobotConfig>,
    /// Set from the start of the nodes to the end of the record.
    nodes: Option<Nodes>,
    begun: bool,
    events: Vec<BoardEvent>,
}

/// State of a record.
#[derive(Clone, Debug)]
struct Nodes {
    reference: Reference,
    /// Next tick, ms.
    next: u32,
    /// Latest tick; more of its sent frames may follow.
    open: Option<Box<BoardTick>>,
    /// Frames that the nodes receive before the next tick: their own frames, and frames of other boards.
    own: Vec<CanFrame>,
    received: Vec<CanFrame>,
    /// Frames of drivers and clock that the board sends before the next tick.
    early: Vec<CanFrame>,
}

impl BoardRecord {
    /// Record of a board whose nodes have this configuration; the record begins with the start of the nodes.
    pub fn new(role: Role, config: RobotConfig) -> Self {
        Self {
            role,
            config: Box::new(config),
            nodes: None,
            begun: false,
            events: Vec::new(),
        }
    }

    /// True from the start of the nodes to the end of the record.
    pub fn is_running(&self) -> bool {
        self.nodes.is_some()
    }

    /// True from the start of the nodes onwards.
    pub fn has_begun(&self) -> bool {
        self.begun
    }

    /// Removes and gives the events recorded since the last call.
    pub fn take(&mut self) -> Vec<BoardEvent> {
        std::mem::take(&mut self.events)
    }

    /// Ends the record, with a reason.
    pub fn end(&mut self, reason: String) {
        self.close();
        if let Some(nodes) = self.nodes.take() {
            self.events.push(BoardEvent::End(nodes.next, reason));
        }
    }

    /// Records an output of the lead node.
    pub fn lead(&mut self, tick: u32, output: &lead::Output) {
        if self.is_running() {
            let output = Box::new(*output);
            self.events.push(BoardEvent::Lead(tick, output));
        }
    }

    /// Completes the latest tick.
    fn close(&mut self) {
        if let Some(nodes) = &mut self.nodes
            && let Some(tick) = nodes.open.take()
        {
            // The beam node does not receive its own frames.
            let own = tick.sent.iter().filter(|frame| is_of_nodes(frame)).copied();
            nodes.own = match self.role {
                Role::Beam(_) => Vec::new(),
                _ => own.collect(),
            };
            nodes.next = tick.tick.wrapping_add(1);
            self.events.push(BoardEvent::Tick(tick));
        }
    }

    /// Adds the next entry of the board's reports to the record.
    pub fn put(&mut self, entry: &Entry) {
        let own = entry.frame();
        let own = own.map(|frame| (frame, sender(self.config.topology(), &frame)));
        if !matches!(own, Some((_, Some(role))) if role == self.role) {
            self.close();
        }
        match *entry {
            Entry::Begin { tick } => {
                let config = self.config.clone();
                self.events.push(BoardEvent::Begin(tick, config));
                self.begun = true;
                self.nodes = Some(Nodes {
                    reference: Reference::before(tick),
                    next: tick,
                    open: None,
                    own: Vec::new(),
                    received: Vec::new(),
                    early: Vec::new(),
                });
            }
            Entry::End => self.end("its nodes differ from its configuration".to_owned()),
            _ => {}
        }
        let Some(nodes) = &mut self.nodes else {
            return;
        };
        match *entry {
            Entry::Frame(..) => match (own, &mut nodes.open) {
                (Some((frame, _)), Some(open)) => open.sent.push(frame),
                (Some((frame, from)), None) if from == Some(self.role) => nodes.early.push(frame),
                (Some((frame, _)), None) => nodes.received.push(frame),
                (None, _) => {}
            },
            Entry::Wait => {
                nodes.own.clear();
                nodes.received.clear();
            }
            Entry::Order(order) => {
                let command = BoardEvent::Command(nodes.next, HostCommand::from(order));
                self.events.push(command);
            }
            Entry::Tick {
                step,
                samples,
                torque_nm,
            } => {
                let (tick, samples) = nodes.reference.resolve(step, &samples);
                if tick < nodes.next {
                    return self.end("the common time of the boards decreased".to_owned());
                }
                let mut received = std::mem::take(&mut nodes.own);
                received.append(&mut nodes.received);
                nodes.open = Some(Box::new(BoardTick {
                    tick,
                    samples,
                    torque_nm: torque_nm.unwrap_or_default(),
                    received,
                    sent: std::mem::take(&mut nodes.early),
                }));
            }
            Entry::Begin { .. } | Entry::End | Entry::Carried(_) => {}
        }
    }
}
