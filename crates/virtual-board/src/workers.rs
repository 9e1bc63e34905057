//! Threads that run boards quantum by quantum.
//!
//! The threads live as long as their [`Workers`]. Each thread takes the next board that is still waiting; boards with
//! the highest recent load are first. The load of boards varies, so a fixed assignment would leave threads idle.

use crate::board::Board;
use crate::time::Time;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Number of polls after which a waiting thread yields.
const POLLS_UNTIL_YIELD: u32 = 2_000;
/// Number of polls after which a worker sleeps between polls, because the boards are not running.
const POLLS_UNTIL_SLEEP: u32 = 20_000;
const POLL_SLEEP: Duration = Duration::from_micros(100);

/// Threads, and the boards handed to them.
pub(crate) struct Workers {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

/// Slot of a board that is handed to the workers.
#[derive(Default)]
struct Slot {
    board: Option<Box<Board>>,
    /// Instructions that the board had executed before the latest quantum.
    before: u64,
}

struct Shared {
    boards: Vec<Mutex<Slot>>,
    /// Slots of the boards in the order in which they are taken.
    order: Vec<AtomicUsize>,
    /// End of the quantum, ps.
    until: AtomicU64,
    /// Number of attempts to take a board in this quantum; exceeds the number of boards if a worker found none left.
    taken: AtomicUsize,
    /// Number of boards that have reached the end of the quantum.
    done: AtomicUsize,
    stop: AtomicBool,
    /// True if a worker has panicked.
    failed: AtomicBool,
}

/// Reports a panic of its thread, so that no thread waits for it.
struct Alarm<'a>(&'a Shared);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.failed.store(true, Ordering::Release);
        }
    }
}

impl Workers {
    /// Creates workers for `boards` boards; `threads` does not count the calling thread.
    pub fn new(boards: usize, threads: usize) -> Self {
        let shared = Arc::new(Shared {
            boards: (0..boards).map(|_| Mutex::default()).collect(),
            order: (0..boards).map(AtomicUsize::new).collect(),
            until: AtomicU64::new(0),
            taken: AtomicUsize::new(boards),
            done: AtomicUsize::new(0),
            stop: AtomicBool::new(false),
            failed: AtomicBool::new(false),
        });
        let work = |_| {
            let shared = Arc::clone(&shared);
            std::thread::spawn(move || shared.work())
        };
        Self {
            threads: (0..threads).map(work).collect(),
            shared,
        }
    }

    /// Hands the boards to the workers.
    pub fn give(&self, boards: &mut Vec<Box<Board>>) {
        for (slot, board) in self.shared.boards.iter().zip(boards.drain(..)) {
            lock(slot).board = Some(board);
        }
    }

    /// Takes the boards back.
    ///
    /// # Panics
    ///
    /// Panics with the worker's payload if a worker has panicked.
    pub fn take(&mut self, boards: &mut Vec<Box<Board>>) {
        let slots = self.shared.boards.iter();
        boards.extend(slots.filter_map(|slot| lock(slot).board.take()));
        if self.shared.failed.load(Ordering::Acquire) {
            self.shared.stop.store(true, Ordering::Relaxed);
            for thread in self.threads.drain(..) {
                if let Err(panic) = thread.join() {
                    std::panic::resume_unwind(panic);
                }
            }
        }
    }

    /// Runs all boards to `until` and passes them, in their order, to `then`. Returns the result of `then`; `None` if a
    /// worker panicked.
    pub fn run<T>(&self, until: Time, then: impl FnOnce(&mut [&mut Board]) -> T) -> Option<T> {
        let shared = &*self.shared;
        shared.until.store(until.0, Ordering::Relaxed);
        shared.done.store(0, Ordering::Relaxed);
        // A thread that takes a board sees the values written before.
        shared.taken.store(0, Ordering::Release);
        shared.run_boards();
        let failed = || shared.failed.load(Ordering::Acquire);
        let all = shared.boards.len();
        wait(u32::MAX, || {
            shared.done.load(Ordering::Acquire) == all || failed()
        });
        if failed() {
            return None;
        }
        let mut slots: Vec<_> = shared.boards.iter().map(lock).collect();
        shared.put_in_order(&mut slots);
        let boards = slots
            .iter_mut()
            .filter_map(|slot| slot.board.as_deref_mut());
        Some(then(&mut boards.collect::<Vec<_>>()))
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A panic of the worker was reported by `take`, or this drop is part of its unwinding.
            let _ = thread.join();
        }
    }
}

impl Shared {
    /// Main loop of a worker.
    fn work(&self) {
        let _alarm = Alarm(self);
        let stop = || self.stop.load(Ordering::Relaxed);
        while !stop() {
            wait(POLLS_UNTIL_SLEEP, || {
                self.taken.load(Ordering::Relaxed) < self.boards.len() || stop()
            });
            self.run_boards();
        }
    }

    /// Runs boards until all are taken.
    fn run_boards(&self) {
        while let Some(place) = self.order.get(self.taken.fetch_add(1, Ordering::AcqRel)) {
            if let Some(slot) = self.boards.get(place.load(Ordering::Relaxed)) {
                let until = Time(self.until.load(Ordering::Relaxed));
                if let Some(board) = &mut lock(slot).board {
                    board.run_until(until);
                }
            }
            self.done.fetch_add(1, Ordering::Release);
        }
    }

    /// Sorts the boards by their load in this quantum, highest first, for the next quantum.
    fn put_in_order(&self, slots: &mut [MutexGuard<Slot>]) {
        let mut loads: Vec<(u64, usize)> = Vec::with_capacity(slots.len());
        for (place, slot) in slots.iter_mut().enumerate() {
            let now = slot.board.as_ref().map_or(0, |b| b.core().instructions());
            loads.push((now.wrapping_sub(slot.before), place));
            slot.before = now;
        }
        loads.sort_unstable_by_key(|&(load, place)| (std::cmp::Reverse(load), place));
        for (entry, (_, place)) in self.order.iter().zip(loads) {
            entry.store(place, Ordering::Relaxed);
        }
    }
}

fn lock(slot: &Mutex<Slot>) -> MutexGuard<'_, Slot> {
    slot.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits until `ready`; after `polls_until_sleep` polls, the thread sleeps between polls.
fn wait(polls_until_sleep: u32, ready: impl Fn() -> bool) {
    let mut turns = 0u32;
    while !ready() {
        turns = turns.saturating_add(1);
        match turns {
            ..POLLS_UNTIL_YIELD => std::hint::spin_loop(),
            _ if turns < polls_until_sleep => std::thread::yield_now(),
            _ => std::thread::sleep(POLL_SLEEP),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::{Bare, Circuit, Inputs};
    use std::sync::mpsc;

    /// A circuit that reports its time in steps of 10 µs, and panics at 1 ms.
    #[derive(Clone)]
    struct Clock(Time, mpsc::Sender<Time>);

    impl Circuit for Clock {
        fn next(&self) -> Time {
            self.0
        }

        fn advance(&mut self, at: Time, _inputs: &mut Inputs) {
            assert!(at < Time::from_micros(1000), "the clock has run down");
            self.0 = at + Time::from_micros(10);
            self.1.send(at).unwrap();
        }
    }

    #[test]
    fn boards_run_to_the_end_of_each_quantum_and_a_panic_reaches_the_caller() {
        for threads in 0..3 {
            let (sender, times) = mpsc::channel();
            let clock = Clock(Time::from_micros(10), sender);
            let mut boards = vec![
                Box::new(Board::new(Box::new(Bare), 0)),
                Box::new(Board::new(Box::new(clock), 0)),
            ];
            boards.iter_mut().for_each(|board| board.power(true));
            let mut workers = Workers::new(2, threads);
            workers.give(&mut boards);
            for micros in [40, 80] {
                let until = Time::from_micros(micros);
                assert_eq!(workers.run(until, |boards| boards.len()), Some(2));
                assert!(times.try_iter().last().unwrap() > until - Time::from_micros(11));
            }
            workers.take(&mut boards);
            assert_eq!(boards.len(), 2);
            workers.give(&mut boards);
            let end = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                workers.run(Time::from_micros(2000), |_| ());
                workers.take(&mut boards);
            }));
            let message = *end.unwrap_err().downcast::<&str>().unwrap();
            assert_eq!(message, "the clock has run down");
        }
    }
}
