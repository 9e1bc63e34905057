//! Boards on one CAN bus, in lockstep.
//!
//! Each board runs for a quantum of time by itself, then the wire carries what they sent. A frame takes
//! at least 47 µs, so with a quantum below that what it does to a board lies in that board's future, and
//! happens at its exact time (see [`Wire`] for what is not exact). Boards may run on several threads:
//! the result is the same to the last bit.

use crate::board::Board;
use crate::time::Time;
use crate::wire::{Node, Wire};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Turns of a waiting thread after which it lets others run.
const SPINS: u32 = 2_000;

/// Boards and their bus.
pub struct Network {
    boards: Vec<Board>,
    wire: Wire,
    quantum: Time,
    threads: usize,
    now: Time,
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
}

impl Network {
    /// Boards on a wire; the order is that of the wire's nodes. A quantum of 20 µs is a good one.
    pub fn new(boards: Vec<Board>, wire: Wire, quantum: Time, threads: usize) -> Self {
        Self {
            boards,
            wire,
            quantum: Time(quantum.0.max(1)),
            threads: threads.max(1),
            now: Time(0),
        }
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
            while self.now < time {
                let next = time.min(self.now + self.quantum);
                for board in &mut self.boards {
                    board.run_until(next);
                }
                if self.boards.iter().any(|board| board.stopped().is_some()) {
                    return;
                }
                carry(&mut self.wire, next, self.boards.iter_mut());
                self.now = next;
            }
            return;
        }
        self.run_on_threads(time);
    }

    fn run_on_threads(&mut self, time: Time) {
        let (quantum, mut reached) = (self.quantum, self.now);
        let groups = spread(&mut self.boards, self.threads);
        let (wire, signals) = (&mut self.wire, &Signals::default());
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
                wait(|| signals.done.load(Ordering::Acquire) == others.len());
                let mut guards: Vec<_> = groups.iter().map(lock).collect();
                let mut boards: Vec<_> = guards.iter_mut().flat_map(|g| g.iter_mut()).collect();
                if boards.iter().any(|(_, board)| board.stopped().is_some()) {
                    break;
                }
                boards.sort_by_key(|(place, _)| *place);
                carry(wire, now, boards.into_iter().map(|(_, board)| &mut **board));
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

/// The wire to `until`, between these boards.
fn carry<'a>(wire: &mut Wire, until: Time, boards: impl Iterator<Item = &'a mut Board>) {
    let mut nodes: Vec<&mut dyn Node> = boards.map(|board| board.chip() as &mut dyn Node).collect();
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
