//! Boards on one CAN bus, in lockstep.
//!
//! Each board runs alone for a quantum of time; then the wire transfers what the boards sent. With a quantum of up to
//! 42 bits, less than the shortest frame, the effects of a frame on a board are in that board's future and occur at
//! their exact times (exceptions: see [`Wire`]). Boards may run on several threads; the result is identical to the last
//! bit.

use crate::board::Board;
use crate::time::Time;
use crate::wire::{Node, VirtualNode, Wire};
use crate::workers::Workers;
use std::time::Instant;

/// Number of calls of [`Network::run_until`] after which the slower of one and several threads is tried again.
const TRY_AGAIN: u32 = 200;

/// Boards and their bus.
pub struct Network {
    boards: Vec<Box<Board>>,
    /// Threads that run the boards; `None` until the first run on several threads.
    workers: Option<Workers>,
    /// Nodes without a board.
    others: Vec<VirtualNode>,
    wire: Wire,
    quantum: Time,
    threads: usize,
    now: Time,
    costs: Costs,
}

/// Recent costs of running on one thread and on several. On a busy machine either may be faster. The costs affect only
/// the speed.
#[derive(Clone, Copy, Debug, Default)]
struct Costs {
    /// Wall-clock seconds per simulated second, for one thread and for several.
    of: [f64; 2],
    calls: u32,
}

impl Costs {
    /// Mode of the next run: 0 for one thread, 1 for several.
    fn choose(&mut self) -> usize {
        self.calls += 1;
        let better = usize::from(self.of[1] <= self.of[0]);
        if self.calls % TRY_AGAIN < 4 {
            1 - better
        } else {
            better
        }
    }

    fn note(&mut self, way: usize, cost: f64) {
        let old = self.of[way];
        self.of[way] = if old > 0.0 {
            0.8 * old + 0.2 * cost
        } else {
            cost
        };
    }
}

impl Clone for Network {
    fn clone(&self) -> Self {
        Self {
            boards: self.boards.clone(),
            // The copy creates its own threads when needed.
            workers: None,
            others: self.others.clone(),
            wire: self.wire.clone(),
            quantum: self.quantum,
            threads: self.threads,
            now: self.now,
            costs: self.costs,
        }
    }
}

impl Network {
    /// Creates a network; the order of the boards is that of the wire's nodes. A quantum of 40 µs works well; the
    /// longest is 42 bits of the bus.
    pub fn new(boards: Vec<Board>, wire: Wire, quantum: Time, threads: usize) -> Self {
        Self {
            boards: boards.into_iter().map(Box::new).collect(),
            workers: None,
            wire,
            quantum: Time(quantum.0.max(1)),
            threads: threads.max(1),
            now: Time(0),
            others: Vec::new(),
            costs: Costs::default(),
        }
    }

    /// Adds a node without a board; the wire must have been created with enough nodes. Returns the index of the node on
    /// the wire.
    pub fn add(&mut self, node: VirtualNode) -> usize {
        self.others.push(node);
        self.boards.len() + self.others.len() - 1
    }

    /// Nodes without a board, in the order in which they were added.
    pub fn others(&mut self) -> &mut [VirtualNode] {
        &mut self.others
    }

    /// Time that all boards and the wire have reached.
    pub fn now(&self) -> Time {
        self.now
    }

    /// The boards.
    pub fn boards(&mut self) -> impl Iterator<Item = &mut Board> {
        self.boards.iter_mut().map(|board| &mut **board)
    }

    /// A board by its index; `None` if there is no such board.
    pub fn board(&mut self, place: usize) -> Option<&mut Board> {
        self.boards.get_mut(place).map(|board| &mut **board)
    }

    /// The wire.
    pub fn wire(&mut self) -> &mut Wire {
        &mut self.wire
    }

    /// Runs all boards and the wire to `time`.
    pub fn run_until(&mut self, time: Time) {
        if self.threads.min(self.boards.len()) < 2 {
            return self.run_here(time);
        }
        let (from, start) = (self.now, Instant::now());
        let way = self.costs.choose();
        match way {
            0 => self.run_here(time),
            _ => self.run_on_threads(time),
        }
        let span = (self.now - from).seconds();
        if span > 0.0 {
            self.costs.note(way, start.elapsed().as_secs_f64() / span);
        }
    }

    fn run_here(&mut self, time: Time) {
        while self.now < time {
            let next = time.min(self.now + self.quantum);
            for board in &mut self.boards {
                board.run_until(next);
            }
            advance_wire(
                &mut self.wire,
                next,
                self.boards.iter_mut().map(|board| &mut **board),
                &mut self.others,
            );
            self.now = next;
        }
    }

    fn run_on_threads(&mut self, time: Time) {
        let (count, threads) = (self.boards.len(), self.threads);
        let workers = self
            .workers
            .get_or_insert_with(|| Workers::new(count, threads.min(count) - 1));
        workers.give(&mut self.boards);
        while self.now < time {
            let next = time.min(self.now + self.quantum);
            let carried = workers.run(next, |boards| {
                let boards = boards.iter_mut().map(|board| &mut **board);
                advance_wire(&mut self.wire, next, boards, &mut self.others);
            });
            if carried.is_none() {
                break;
            }
            self.now = next;
        }
        workers.take(&mut self.boards);
    }
}

/// Advances the wire to `until` with these boards and nodes.
fn advance_wire<'a>(
    wire: &mut Wire,
    until: Time,
    boards: impl Iterator<Item = &'a mut Board>,
    others: &mut [VirtualNode],
) {
    let boards = boards.map(|board| board.chip() as &mut dyn Node);
    let others = others.iter_mut().map(|node| node as &mut dyn Node);
    let mut nodes: Vec<&mut dyn Node> = boards.chain(others).collect();
    wire.advance(until, &mut nodes);
}
