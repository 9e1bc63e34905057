//! Boards on one CAN bus, in lockstep.
//!
//! Each board runs for a quantum of time by itself, then the wire carries what they sent. A frame takes
//! at least 47 µs, so with a quantum below that what it does to a board lies in that board's future, and
//! happens at its exact time (see [`Wire`] for what is not exact). Boards may run on several threads:
//! the result is the same to the last bit.

use crate::board::Board;
use crate::time::Time;
use crate::wire::{Node, VirtualNode, Wire};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Turns of a waiting thread after which it lets others run.
const SPINS: u32 = 2_000;

/// Calls of [`Network::run_until`] after which the slower way of running is tried again.
const TRY_AGAIN: u32 = 200;

/// Boards and their bus.
pub struct Network {
    boards: Vec<Board>,
    /// Nodes without a board.
    others: Vec<VirtualNode>,
    wire: Wire,
    quantum: Time,
    threads: usize,
    now: Time,
    costs: Costs,
}

/// What running took of late, on one thread and on several: on a machine that is busy with something
/// else one is faster. It decides on nothing but speed.
#[derive(Clone, Copy, Debug, Default)]
struct Costs {
    /// Seconds a simulated second.
    of: [f64; 2],
    calls: u32,
}

impl Costs {
    /// The way to run next: 0 for one thread.
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

/// Boards that run on one thread, with their places.
type Group<'a> = Mutex<Vec<(usize, &'a mut Board)>>;

/// How a worker is told what to do.
#[derive(Default)]
struct Signals {
    /// End of the quantum to be run, ps.
    until: AtomicU64,
    /// Number of the quantum.
    quantum: AtomicUsize,
    /// Workers that have finished it.
    done: AtomicUsize,
    stop: AtomicBool,
    /// A worker has panicked.
    failed: AtomicBool,
}

/// Tells the others if its thread panics: nobody waits for it then.
struct Alarm<'a>(&'a Signals);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.failed.store(true, Ordering::Release);
        }
    }
}

impl Network {
    /// Boards on a wire; the order is that of the wire's nodes. A quantum of 40 µs is
    /// a good one, 42 bits of the bus the longest.
    pub fn new(boards: Vec<Board>, wire: Wire, quantum: Time, threads: usize) -> Self {
        Self {
            boards,
            wire,
            quantum: Time(quantum.0.max(1)),
            threads: threads.max(1),
            now: Time(0),
            others: Vec::new(),
            costs: Costs::default(),
        }
    }

    /// Adds a node without a board; the wire must have been made for so many nodes. Gives its place at
    /// the wire.
    pub fn add(&mut self, node: VirtualNode) -> usize {
        self.others.push(node);
        self.boards.len() + self.others.len() - 1
    }

    /// The nodes without a board, in the order in which they were added.
    pub fn others(&mut self) -> &mut [VirtualNode] {
        &mut self.others
    }

    /// The time everything has come to.
    pub fn now(&self) -> Time {
        self.now
    }

    /// The boards.
    pub fn boards(&mut self) -> &mut [Board] {
        &mut self.boards
    }

    /// A board.
    pub fn board(&mut self, place: usize) -> Option<&mut Board> {
        self.boards.get_mut(place)
    }

    /// The wire.
    pub fn wire(&mut self) -> &mut Wire {
        &mut self.wire
    }

    /// Runs everything to `time`, or until a debugger stops a board; then the others may be up to a
    /// quantum ahead of it, and wait for it.
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
            if self.boards.iter().any(|board| board.stopped().is_some()) {
                return;
            }
            carry(
                &mut self.wire,
                next,
                self.boards.iter_mut(),
                &mut self.others,
            );
            self.now = next;
        }
    }

    fn run_on_threads(&mut self, time: Time) {
        let (quantum, mut reached) = (self.quantum, self.now);
        let groups = spread(&mut self.boards, self.threads);
        let (wire, nodes, signals) = (&mut self.wire, &mut self.others, &Signals::default());
        let Some((own, others)) = groups.split_first() else {
            return;
        };
        std::thread::scope(|scope| {
            for group in others {
                scope.spawn(move || work(group, signals));
            }
            while reached < time {
                let now = time.min(reached + quantum);
                signals.done.store(0, Ordering::Relaxed);
                signals.until.store(now.0, Ordering::Relaxed);
                signals.quantum.fetch_add(1, Ordering::Release);
                run(&mut lock(own), now);
                let failed = || signals.failed.load(Ordering::Acquire);
                wait(|| signals.done.load(Ordering::Acquire) == others.len() || failed());
                if failed() {
                    break;
                }
                let mut guards: Vec<_> = groups.iter().map(lock).collect();
                let mut boards: Vec<_> = guards.iter_mut().flat_map(|g| g.iter_mut()).collect();
                if boards.iter().any(|(_, board)| board.stopped().is_some()) {
                    break;
                }
                boards.sort_by_key(|(place, _)| *place);
                let boards = boards.into_iter().map(|(_, board)| &mut **board);
                carry(wire, now, boards, nodes);
                reached = now;
            }
            signals.stop.store(true, Ordering::Relaxed);
            signals.quantum.fetch_add(1, Ordering::Release);
        });
        self.now = reached;
    }
}

fn lock<'a, 'b>(group: &'a Group<'b>) -> MutexGuard<'a, Vec<(usize, &'b mut Board)>> {
    group.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run(boards: &mut [(usize, &mut Board)], until: Time) {
    for (_, board) in boards {
        board.run_until(until);
    }
}

/// The wire to `until`, between these boards and nodes.
fn carry<'a>(
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

/// Boards on threads, so that each has about as many instructions to run as the others had so far.
fn spread(boards: &mut [Board], threads: usize) -> Vec<Group<'_>> {
    let count = threads.min(boards.len());
    let mut groups: Vec<(u64, Vec<(usize, &mut Board)>)> =
        (0..count).map(|_| (0, Vec::new())).collect();
    let mut boards: Vec<(usize, &mut Board)> = boards.iter_mut().enumerate().collect();
    boards.sort_by_key(|(place, board)| (std::cmp::Reverse(board.core().instructions()), *place));
    for (place, board) in boards {
        if let Some((load, group)) = groups.iter_mut().min_by_key(|(load, _)| *load) {
            *load += board.core().instructions() + 1;
            group.push((place, board));
        }
    }
    groups
        .into_iter()
        .map(|(_, group)| Mutex::new(group))
        .collect()
}

/// A worker: runs its boards quantum by quantum until told to stop.
fn work(group: &Group, signals: &Signals) {
    let _alarm = Alarm(signals);
    let mut seen = 0;
    loop {
        wait(|| signals.quantum.load(Ordering::Acquire) != seen);
        seen += 1;
        if signals.stop.load(Ordering::Relaxed) {
            return;
        }
        run(
            &mut lock(group),
            Time(signals.until.load(Ordering::Relaxed)),
        );
        signals.done.fetch_add(1, Ordering::Release);
    }
}

fn wait(ready: impl Fn() -> bool) {
    let mut turns = 0;
    while !ready() {
        turns += 1;
        if turns < SPINS {
            std::hint::spin_loop();
        } else {
            std::thread::yield_now();
        }
    }
}
