//! The flash accelerator: time of a read.
//!
//! The flash is read in lines of 16 bytes; a read takes one cycle plus the wait states. With prefetch on, the next line
//! is fetched while a line is executed. Lines for which the core had to wait are kept in an instruction cache of 64
//! lines; lines read as data are kept in a data cache of 8 lines. Replacement is least recently used (RM0090, 3.5.2).
//!
//! According to the manual, a line is copied into the cache when it is "not present in the currently used instruction
//! line, in the prefetched instruction line or in the instruction cache". So a line prefetched in time is not copied; a
//! line still being read when the core needs it counts as not present. A read in progress is never aborted: the next
//! read waits for it.

use crate::time::Cycles;

/// Number of lines of the flash.
const LINES: usize = (1 << 20) / 16;
/// Marks a cache entry without a line.
const NONE: u32 = u32::MAX;

/// Capacity of a cache's log of used entries; a full log is compacted to the latest use of each entry.
const REMEMBERED: usize = 1 << 12;

/// A cache of whole lines with least-recently-used replacement.
#[derive(Clone, Debug)]
struct Cache<const N: usize> {
    /// Cache entry of each line, plus one; zero if the line is not cached.
    place: Box<[u8; LINES]>,
    line: [u32; N],
    /// Log of the entries used, oldest first.
    uses: Box<[u8; REMEMBERED]>,
    /// Number of uses in the log.
    used: usize,
    /// Index into the log at which the search for the least recently used entry starts.
    oldest: usize,
    /// Index into the log of the latest use of each entry.
    latest: [u16; N],
    on: bool,
}

impl<const N: usize> Cache<N> {
    fn new() -> Self {
        Self {
            place: Box::new([0; LINES]),
            line: [NONE; N],
            uses: Box::new(std::array::from_fn(|entry| entry as u8)),
            used: N,
            oldest: 0,
            latest: std::array::from_fn(|entry| entry as u16),
            on: false,
        }
    }

    fn clear(&mut self) {
        for line in self.line {
            if let Some(place) = self.place.get_mut(line as usize) {
                *place = 0;
            }
        }
        self.line = [NONE; N];
    }

    #[inline]
    fn touch(&mut self, entry: usize) {
        if self.used == REMEMBERED {
            self.invalidate();
        }
        self.latest[entry] = self.used as u16;
        self.uses[self.used % REMEMBERED] = entry as u8;
        self.used += 1;
    }

    /// Compacts the log to the latest use of each entry.
    #[cold]
    #[inline(never)]
    fn invalidate(&mut self) {
        let mut order: [u8; N] = std::array::from_fn(|entry| entry as u8);
        order.sort_unstable_by_key(|&entry| self.latest[usize::from(entry)]);
        for (at, entry) in (0..).zip(order) {
            self.latest[usize::from(entry)] = at;
        }
        self.uses[..N].copy_from_slice(&order);
        self.used = N;
        self.oldest = 0;
    }

    fn holds(&self, line: u32) -> bool {
        self.place[line as usize % LINES] != 0
    }

    /// Entry of a line, which becomes the most recently used; `None` if the line is not cached.
    #[inline]
    fn hit(&mut self, line: u32) -> Option<usize> {
        let entry = usize::from(self.place[line as usize % LINES]).checked_sub(1)?;
        self.touch(entry);
        Some(entry)
    }

    /// Stores an uncached line in the least recently used entry; returns the entry.
    fn fill(&mut self, line: u32) -> usize {
        let entry = loop {
            let used = self.oldest;
            self.oldest += 1;
            let entry = usize::from(self.uses[used]);
            if usize::from(self.latest[entry]) == used {
                break entry;
            }
        };
        if let Some(place) = self.place.get_mut(self.line[entry] as usize) {
            *place = 0;
        }
        self.line[entry] = line;
        self.place[line as usize % LINES] = entry as u8 + 1;
        self.touch(entry);
        entry
    }
}

#[derive(Clone, Debug)]
pub(super) struct Accelerator {
    pub wait_states: u64,
    prefetch: bool,
    instructions: Cache<64>,
    data: Cache<8>,
    /// Content of the data cache, returned to the program even after the flash has changed.
    stale: [[u8; 16]; 8],
    current: u32,
    /// Prefetched line, and the cycle at which the flash is free again.
    ahead: (u32, Cycles),
}

impl Accelerator {
    pub fn new() -> Self {
        Self {
            wait_states: 0,
            prefetch: false,
            instructions: Cache::new(),
            data: Cache::new(),
            stale: [[0; 16]; 8],
            current: NONE,
            ahead: (NONE, 0),
        }
    }

    /// Applies the settings of ACR.
    pub fn set(&mut self, acr: u32) {
        self.wait_states = u64::from(acr & 7);
        self.prefetch = acr & 1 << 8 != 0;
        self.instructions.on = acr & 1 << 9 != 0;
        self.data.on = acr & 1 << 10 != 0;
        if acr & 1 << 11 != 0 {
            self.instructions.clear();
            (self.current, self.ahead) = (NONE, (NONE, 0));
        }
        if acr & 1 << 12 != 0 {
            self.data.clear();
        }
    }

    /// Fetches from a line that the program enters.
    #[inline]
    pub fn enter(&mut self, line: u32, cycle: &mut Cycles) {
        if line == self.current {
            return;
        }
        self.current = line;
        if self.wait_states == 0 {
            return;
        }
        self.enter_slow(line, cycle);
    }

    #[inline]
    fn enter_slow(&mut self, line: u32, cycle: &mut Cycles) {
        let missed = if self.ahead.0 == line {
            let late = *cycle < self.ahead.1;
            *cycle = (*cycle).max(self.ahead.1);
            late
        } else if self.instructions.on && self.instructions.hit(line).is_some() {
            false
        } else {
            *cycle = (*cycle).max(self.ahead.1) + self.wait_states;
            true
        };
        if missed && self.instructions.on {
            self.instructions.fill(line);
        }
        if self.prefetch {
            let next = line + 1;
            let there = self.instructions.on && self.instructions.holds(next);
            self.ahead = if there {
                (NONE, 0)
            } else {
                (next, *cycle + self.wait_states + 1)
            };
        }
    }

    /// Reads data in a line with the content `bytes`; returns the bytes that the program sees.
    #[inline]
    pub fn load<'a>(&'a mut self, line: u32, bytes: &'a [u8], cycle: &mut Cycles) -> &'a [u8] {
        if self.wait_states == 0 && !self.data.on {
            return bytes;
        }
        if self.data.on
            && let Some(entry) = self.data.hit(line)
        {
            return &self.stale[entry];
        }
        *cycle = (*cycle).max(self.ahead.1) + self.wait_states;
        if self.data.on {
            let entry = self.data.fill(line);
            if let Ok(bytes) = bytes.try_into() {
                self.stale[entry] = bytes;
            }
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(acr: u32) -> Accelerator {
        let mut art = Accelerator::new();
        art.set(acr);
        art
    }

    /// Stall cycles of entering each of `lines` in turn, with `work` cycles of execution in each.
    fn run(art: &mut Accelerator, lines: impl Iterator<Item = u32>, work: u64) -> Vec<u64> {
        let mut cycle = 1000;
        lines
            .map(|line| {
                let before = cycle;
                art.enter(line, &mut cycle);
                let took = cycle - before;
                cycle += work;
                took
            })
            .collect()
    }

    #[test]
    fn every_line_stalls_without_prefetch_and_cache() {
        let mut art = set(5);
        assert_eq!(run(&mut art, 0..4, 8), [5, 5, 5, 5]);
    }

    #[test]
    fn prefetch_hides_the_stalls_of_sequential_lines() {
        let mut art = set(5 | 1 << 8);
        // A line executes for eight cycles, so the prefetch of the next line, six cycles, ends in time.
        assert_eq!(run(&mut art, 0..4, 8), [5, 0, 0, 0]);
        // A line executes for four of the six cycles of a prefetch, so the core waits two cycles at each line.
        let mut art = set(5 | 1 << 8);
        assert_eq!(run(&mut art, 100..104, 4), [5, 2, 2, 2]);
    }

    #[test]
    fn sequential_lines_prefetched_too_late_are_cached() {
        let mut art = set(5 | 3 << 8);
        // A line executes for four of the six cycles of a prefetch: each line is late, and is cached.
        assert_eq!(run(&mut art, 100..104, 4), [5, 2, 2, 2]);
        assert_eq!(run(&mut art, 100..104, 4), [0, 0, 0, 0]);
        // A line executes for eight cycles, so only the first line is a miss and is cached.
        let mut art = set(5 | 3 << 8);
        run(&mut art, 100..104, 8);
        let cached: Vec<_> = (100..104)
            .map(|line| art.instructions.holds(line))
            .collect();
        assert_eq!(cached, [true, false, false, false]);
    }

    #[test]
    fn jump_waits_for_the_prefetch_in_progress() {
        let mut art = set(5 | 1 << 8);
        // One cycle after line 100 was entered, the prefetch of line 101 needs five more.
        assert_eq!(run(&mut art, [100, 200].into_iter(), 1), [5, 5 + 5]);
        let mut art = set(5 | 1 << 8);
        assert_eq!(run(&mut art, [100, 200].into_iter(), 6), [5, 5]);
    }

    #[test]
    fn cache_replaces_the_least_recently_used_line() {
        let mut art = set(5 | 1 << 9);
        let mut list: Vec<u32> = Vec::new();
        let mut state = 1u32;
        let mut cycle = 0;
        // The log is compacted several times.
        for _ in 0..20_000 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let line = state >> 16 & 0x7f;
            if art.current == line {
                continue;
            }
            let before = cycle;
            art.enter(line, &mut cycle);
            let place = list.iter().position(|&known| known == line);
            assert_eq!(cycle == before, place.is_some());
            if let Some(place) = place.or((list.len() == 64).then_some(0)) {
                list.remove(place);
            }
            list.push(line);
        }
    }

    #[test]
    fn loop_of_64_lines_runs_from_the_cache() {
        let mut art = set(5 | 1 << 9);
        let lap: Vec<u32> = (0..64).map(|k| 7 * k).collect();
        assert_eq!(run(&mut art, lap.iter().copied(), 1), [5; 64]);
        assert_eq!(run(&mut art, lap.iter().copied(), 1), [0; 64]);
        // With one line more than the cache holds, each line is replaced before its next use.
        let lap: Vec<u32> = (0..65).map(|k| 7 * k + 3).collect();
        for _ in 0..2 {
            assert_eq!(run(&mut art, lap.iter().copied(), 1), [5; 65]);
        }
        art.set(5 | 1 << 11);
        art.set(5 | 1 << 9);
        assert_eq!(run(&mut art, std::iter::once(3), 1), [5]);
    }
}
