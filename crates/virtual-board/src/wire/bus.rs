//! The wire: levels driven by all nodes, levels read by each node, time.

use super::can_node::{CanNode, Noise};
use super::frame::Frame;
use super::node::{Action, ErrorKind, Event, Node};
use super::statistics::Statistics;
use super::timing::BitClock;
use crate::time::Time;

/// A level of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Driven by at least one node; overrides recessive.
    Dominant,
    /// Driven by no node.
    Recessive,
}

/// Faults of the wire and the transceivers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Level at which the bus is stuck; `None` ends the fault.
    Level(Option<Level>),
    /// State of a node's transceiver.
    Transceiver {
        /// Index of the node with this transceiver.
        node: usize,
        /// True if the transceiver drives the bus as the controller requests.
        transmit_enabled: bool,
        /// True if the transceiver passes the bus level to the controller; otherwise the controller reads recessive.
        receive_enabled: bool,
    },
    /// Piece of the cut wire that a node is connected to; initially all nodes are on piece 0.
    Piece {
        /// Index of the connected node.
        node: usize,
        /// Number of the piece, below 256.
        piece: u8,
    },
    /// Each node reads each bit wrongly with this probability.
    Noise(f64),
}

/// A transmission that has ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Index of the transmitting node.
    pub node: usize,
    /// Transmitted frame.
    pub frame: Frame,
    /// Sample point of the start of frame.
    pub start: Time,
    /// Sample point of the last bit, or of the bit in which the error was detected.
    pub end: Time,
    /// Error that ended the transmission; `None` if the frame was acknowledged.
    pub error: Option<ErrorKind>,
}

/// The wire with its nodes.
///
/// # Causality
///
/// Each board runs alone for at most `quantum`, then the wire follows with [`Wire::advance`] and has all requests of
/// mailboxes up to that time. A frame that is on the bus then is simulated for one more quantum. The end of a frame is
/// at least 44 bits after its start, so the boards receive the end in time. Consequences, for a quantum of up to 42
/// bits:
///
/// - Exact: starts of frames, the winner of arbitration, ends of transmission and reception.
/// - Delivered up to a quantum late, with the exact time: starts of frames, lost arbitrations, errors in the first
///   quantum of a frame, the end of waiting for eleven recessive bits. The wire itself is exact.
/// - Effective up to a quantum late while a frame is on the bus: a reset or mode change of a node, and a fault injected
///   for the present. So a node that was reset in the middle of a frame may still acknowledge the frame.
/// - A mailbox aborted in the quantum in which its transmission would have begun does not begin.
#[derive(Clone)]
pub struct Wire {
    pub(super) can_nodes: Vec<CanNode>,
    /// Number of dominant drivers on each piece.
    pub(super) drivers: Vec<u16>,
    pub(super) forced: Option<Level>,
    pub(super) noise: Noise,
    /// Delay from a controller's output to all inputs: two transceivers and the wire.
    pub(super) delay: Time,
    quantum: Time,
    now: Time,
    asleep: bool,
    actions: Vec<(Time, usize, Action)>,
    faults: Vec<(Time, Fault)>,
    records: Option<Vec<Record>>,
    busy: usize,
}

impl Wire {
    /// Creates a wire for `nodes` nodes whose boards run in quanta of at most `quantum`. `seed` is for
    /// [`Fault::Noise`].
    pub fn new(nodes: usize, quantum: Time, seed: u64) -> Self {
        Self {
            can_nodes: (0..nodes).map(|_| CanNode::new()).collect(),
            drivers: vec![0; 256],
            forced: None,
            noise: Noise::new(seed),
            delay: Time::from_nanos(150),
            quantum,
            now: Time(0),
            asleep: true,
            actions: Vec::new(),
            faults: Vec::new(),
            records: None,
            busy: 0,
        }
    }

    /// Records transmissions from now on, for [`Self::take_records`].
    pub fn record(&mut self) {
        self.records.get_or_insert_default();
    }

    /// Transmissions since the last call.
    pub fn take_records(&mut self) -> Vec<Record> {
        self.records
            .as_mut()
            .map(std::mem::take)
            .unwrap_or_default()
    }

    /// Statistics of a node.
    pub fn statistics(&self, node: usize) -> Statistics {
        self.can_nodes
            .get(node)
            .map(|can_node| can_node.controller.statistics)
            .unwrap_or_default()
    }

    /// Injects a fault at `at`, but not before the wire's present time, which is up to a quantum ahead of the boards.
    pub fn inject(&mut self, at: Time, fault: Fault) {
        let at = at.max(self.now);
        let place = self.faults.partition_point(|&(time, _)| time <= at);
        self.faults.insert(place, (at, fault));
    }

    /// Advances to `until`, the time to which all nodes have run.
    pub fn advance(&mut self, until: Time, nodes: &mut [&mut dyn Node]) {
        self.collect(nodes);
        let horizon = until + self.quantum;
        loop {
            let (can_node, due) = self.next(until);
            let action = self.actions.first().map_or(Time::NEVER, |a| a.0);
            let fault = self.faults.first().map_or(Time::NEVER, |f| f.0);
            let at = due.min(action).min(fault);
            if at >= until {
                let closed = self.can_nodes.iter().any(|s| s.controller.is_closed());
                let limit = if closed { horizon } else { until };
                if at >= limit {
                    self.now = self.now.max(limit);
                    return;
                }
            }
            self.now = self.now.max(at);
            if fault == at {
                let (_, fault) = self.faults.remove(0);
                self.apply_fault(fault);
            } else if action == at {
                let (_, node, action) = self.actions.remove(0);
                self.act(node, action, nodes);
            } else if !self.fast_forward(can_node, action.min(fault).min(horizon)) {
                self.step(can_node, due, nodes);
            }
        }
    }

    /// Takes the actions of the nodes. An abort removes requests of its mailbox that are not applied yet.
    fn collect(&mut self, nodes: &mut [&mut dyn Node]) {
        for (i, (node, can_node)) in nodes.iter_mut().zip(&mut self.can_nodes).enumerate() {
            while let Some((at, action)) = node.take_action() {
                let Action::Abort { mailbox } = action else {
                    self.actions.push((at, i, action));
                    continue;
                };
                let is_same = |action: &Action| matches!(action, Action::Request { mailbox: m, .. } if *m == mailbox);
                let before = self.actions.len();
                self.actions
                    .retain(|(_, node, a)| *node != i || !is_same(a));
                let given_up = (before - self.actions.len()) as u64;
                can_node.controller.statistics.given_up += given_up;
                can_node.controller.abort(mailbox);
            }
        }
        self.actions.sort_by_key(|&(at, _, _)| at);
    }

    /// Node with the next event, and the time of the event. If no event is due before `until`, the time is
    /// [`Time::NEVER`].
    fn next(&mut self, until: Time) -> (usize, Time) {
        if self.asleep {
            let wake = self.quiet_until();
            if wake >= until {
                return (0, Time::NEVER);
            }
            self.wake(wake.max(self.now));
        }
        let mut best = (0, Time::NEVER);
        for (i, can_node) in self.can_nodes.iter().enumerate() {
            if can_node.due < best.1 {
                best = (i, can_node.due);
            }
        }
        best
    }

    fn quiet_until(&self) -> Time {
        let quiet = self.can_nodes.iter().map(|s| s.controller.quiet_until());
        quiet.min().unwrap_or(Time::NEVER)
    }

    /// Resumes the bit clocks of all nodes after an idle period.
    fn wake(&mut self, now: Time) {
        self.asleep = false;
        let delay = self.delay;
        for can_node in &mut self.can_nodes {
            can_node.clock.skip(now, delay);
            can_node.plan(delay);
        }
    }

    /// Samples a bit of a node, or begins its next bit.
    fn step(&mut self, i: usize, at: Time, nodes: &mut [&mut dyn Node]) {
        let can_node = &mut self.can_nodes[i];
        if can_node.clock.sampled {
            let drives = can_node.controller.dominant;
            can_node
                .clock
                .advance(can_node.controller.is_hard(), !drives);
            let changes = drives != can_node.dominant;
            can_node.plan(self.delay);
            if changes {
                self.drive(i, drives, at);
            }
            return;
        }
        let level = self.input(i);
        let can_node = &mut self.can_nodes[i];
        let (busy, now) = (can_node.controller.is_busy(), can_node.clock.sample_time());
        can_node.controller.sample(level, now);
        can_node.clock.sample();
        can_node.read = level;
        can_node.plan(self.delay);
        let is_busy = can_node.controller.is_busy();
        if can_node.dominant && !can_node.controller.is_in() {
            self.drive(i, false, at);
        }
        let delivered = self.deliver(i, now, nodes);
        if busy != is_busy {
            self.occupy(is_busy);
        }
        if self.busy == 0 && (delivered || busy) {
            self.sleep_if_idle(at);
        }
    }

    /// Suspends the bit clocks while the bus is idle.
    fn sleep_if_idle(&mut self, at: Time) {
        let still = self.forced.is_none() && self.noise.is_off();
        let driven = self.can_nodes.iter().any(|s| s.dominant);
        self.asleep = still && !driven && self.quiet_until() > at;
    }

    /// Updates the number of nodes for which the bus is not idle.
    fn occupy(&mut self, is_busy: bool) {
        if is_busy {
            self.busy += 1;
        } else {
            self.busy -= 1;
        }
    }

    /// Level that a node reads; true is dominant.
    fn input(&mut self, i: usize) -> bool {
        let can_node = &self.can_nodes[i];
        let level = can_node.is_reading() && self.level(can_node.piece);
        level != (!self.noise.is_off() && self.noise.next_bit_flips())
    }

    pub(super) fn level(&self, piece: usize) -> bool {
        match self.forced {
            Some(level) => level == Level::Dominant,
            None => self.drivers[piece] > 0,
        }
    }

    /// Sets the level that a node drives.
    fn drive(&mut self, i: usize, dominant: bool, at: Time) {
        let can_node = &mut self.can_nodes[i];
        let before = can_node.is_driving();
        can_node.dominant = dominant;
        let after = can_node.is_driving();
        let piece = can_node.piece;
        if before == after {
            return;
        }
        let level = self.level(piece);
        if after {
            self.drivers[piece] += 1;
        } else {
            self.drivers[piece] -= 1;
        }
        self.changed(piece, level, at);
    }

    /// Synchronizes the readers of a piece after an edge to dominant.
    fn changed(&mut self, piece: usize, before: bool, at: Time) {
        let level = self.level(piece);
        if level == before || !level {
            return;
        }
        let delay = self.delay;
        for can_node in &mut self.can_nodes {
            let reads = can_node.piece == piece && can_node.is_reading();
            if reads && !can_node.read && can_node.controller.is_in() {
                let hard = can_node.controller.is_hard();
                can_node.clock.edge(at + delay, hard, !can_node.dominant);
                can_node.plan(delay);
            }
        }
    }

    /// Delivers pending events to a node; true if there were any.
    fn deliver(&mut self, i: usize, at: Time, nodes: &mut [&mut dyn Node]) -> bool {
        let controller = &mut self.can_nodes[i].controller;
        if controller.events.is_empty() {
            return false;
        }
        let (tec, rec) = controller.counters();
        for kind in controller.events.drain(..) {
            if let Some(node) = nodes.get_mut(i) {
                node.event(Event { at, kind, tec, rec });
            }
        }
        if let Some(ended) = controller.ended.take()
            && let Some(records) = &mut self.records
        {
            records.push(Record {
                node: i,
                frame: ended.frame,
                start: ended.start,
                end: at,
                error: ended.error,
            });
        }
        true
    }

    /// Applies an action of a node.
    fn act(&mut self, i: usize, action: Action, nodes: &mut [&mut dyn Node]) {
        let now = self.now;
        self.wake_if_asleep();
        let can_node = &mut self.can_nodes[i];
        let busy = can_node.controller.is_busy();
        let timing = can_node.controller.settings().map(|s| s.timing);
        let was_in = can_node.controller.is_in();
        match action {
            Action::Set(settings) => {
                can_node.controller.set(settings);
                if can_node.controller.is_in() && (!was_in || timing != Some(settings.timing)) {
                    can_node.clock = BitClock::new(settings.timing, now);
                    can_node.read = true;
                }
            }
            Action::Request { mailbox, frame } => {
                return can_node.controller.request(mailbox, frame);
            }
            Action::Abort { mailbox } => return can_node.controller.abort(mailbox),
            Action::Reset => can_node.controller.reset(),
        }
        let dominant = can_node.dominant && can_node.controller.is_in();
        can_node.plan(self.delay);
        let is_busy = can_node.controller.is_busy();
        self.redrive(|wire| wire.can_nodes[i].dominant = dominant);
        if busy != is_busy {
            self.occupy(is_busy);
        }
        self.deliver(i, now, nodes);
    }

    fn wake_if_asleep(&mut self) {
        if std::mem::take(&mut self.asleep) {
            self.wake(self.now);
        }
    }

    /// Applies a change to nodes or wire, then updates all levels.
    fn redrive(&mut self, change: impl FnOnce(&mut Self)) {
        let before: Vec<bool> = (0..self.drivers.len()).map(|p| self.level(p)).collect();
        change(self);
        self.drivers.fill(0);
        for can_node in &self.can_nodes {
            if can_node.is_driving() {
                self.drivers[can_node.piece] += 1;
            }
        }
        let now = self.now;
        for (piece, level) in before.into_iter().enumerate() {
            self.changed(piece, level, now);
        }
    }

    fn apply_fault(&mut self, fault: Fault) {
        self.wake_if_asleep();
        match fault {
            Fault::Level(level) => self.redrive(|wire| wire.forced = level),
            Fault::Transceiver {
                node,
                transmit_enabled,
                receive_enabled,
            } => self.redrive(|wire| {
                if let Some(can_node) = wire.can_nodes.get_mut(node) {
                    (can_node.transmit_enabled, can_node.receive_enabled) =
                        (transmit_enabled, receive_enabled);
                }
            }),
            Fault::Piece { node, piece } => self.redrive(|wire| {
                if let Some(can_node) = wire.can_nodes.get_mut(node) {
                    can_node.piece = piece.into();
                }
            }),
            Fault::Noise(rate) => self.noise.set(rate),
        }
    }
}
