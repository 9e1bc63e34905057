//! Nested vectored interrupt controller: pending, active and enabled exceptions, and their priorities.
//!
//! Exceptions are numbered as in IPSR: 1 (reset) to 15 (SysTick), interrupt lines from 16 on. In a set of exceptions,
//! exception n is bit n.

use crate::time::Cycles;

/// Numbers of the core's own exceptions.
pub mod exception {
    /// Non-maskable interrupt.
    pub const NMI: u16 = 2;
    /// Hard fault.
    pub const HARD_FAULT: u16 = 3;
    /// Memory management fault.
    pub const MEM_MANAGE: u16 = 4;
    /// Bus fault.
    pub const BUS_FAULT: u16 = 5;
    /// Usage fault.
    pub const USAGE_FAULT: u16 = 6;
    /// Supervisor call.
    pub const SVCALL: u16 = 11;
    /// Debug monitor.
    pub const DEBUG_MONITOR: u16 = 12;
    /// Request for system service.
    pub const PENDSV: u16 = 14;
    /// System timer.
    pub const SYSTICK: u16 = 15;
    /// First interrupt line.
    pub const FIRST_LINE: u16 = 16;
}

/// Number of interrupt lines of the STM32F405.
pub const LINES: u32 = 82;

/// Exceptions that cannot be disabled.
const ALWAYS: u128 = 1 << exception::NMI
    | 1 << exception::HARD_FAULT
    | 1 << exception::SVCALL
    | 1 << exception::DEBUG_MONITOR
    | 1 << exception::PENDSV
    | 1 << exception::SYSTICK;

const LINE_MASK: u128 = (1 << LINES) - 1;

/// Lowest priority: thread mode with nothing masked.
pub(super) const THREAD: i32 = 256;

#[derive(Clone, Debug)]
pub(super) struct Nvic {
    pub(super) pending: u128,
    pub(super) active: u128,
    pub(super) enabled: u128,
    /// Interrupt lines whose level is high.
    lines: u128,
    /// Priorities of exceptions 0 to 127; only the upper four bits are implemented.
    priorities: [u8; 128],
    /// PRIGROUP.
    pub(super) group: u32,
    /// Cycle at which each exception became pending, for the latency.
    pub(super) since: Box<[Cycles; 128]>,
    /// True if an exception became pending since the last check: an event for WFE if SEVONPEND is set.
    pub(super) arrived: bool,
}

impl Default for Nvic {
    fn default() -> Self {
        Self {
            pending: 0,
            active: 0,
            enabled: ALWAYS,
            lines: 0,
            priorities: [0; 128],
            group: 0,
            since: Box::new([0; 128]),
            arrived: false,
        }
    }
}

impl Nvic {
    /// Sets the levels of the lines. A line becomes pending if it rises, or if it is high and not active.
    pub(super) fn set_lines(&mut self, lines: u128, cycle: Cycles) {
        let lines = (lines & LINE_MASK) << exception::FIRST_LINE;
        let rising = lines & !self.lines;
        self.lines = lines;
        let news = (rising | lines & !self.active) & !self.pending;
        if news != 0 {
            self.pend_set(news, cycle);
        }
    }

    pub(super) fn pend(&mut self, number: u16, cycle: Cycles) {
        self.pend_set((1 << number) & !self.pending, cycle);
    }

    fn pend_set(&mut self, news: u128, cycle: Cycles) {
        let mut rest = news;
        while rest != 0 {
            self.since[(rest.trailing_zeros() & 127) as usize] = cycle;
            rest &= rest - 1;
        }
        self.pending |= news;
        self.arrived |= news != 0;
    }

    pub(super) fn unpend(&mut self, number: u16) {
        self.pending &= !(1 << number);
    }

    pub(super) fn is_active(&self, number: u16) -> bool {
        self.active >> number & 1 != 0
    }

    pub(super) fn is_enabled(&self, number: u16) -> bool {
        self.enabled >> number & 1 != 0
    }

    /// True if an enabled exception is pending.
    pub(super) fn waiting(&self) -> bool {
        self.pending & self.enabled != 0
    }

    /// Priority of an exception; a lower number is more urgent.
    pub(super) fn priority(&self, number: u16) -> i32 {
        match number {
            exception::NMI => -2,
            exception::HARD_FAULT => -1,
            _ => i32::from(self.priorities[usize::from(number & 127)]),
        }
    }

    /// Group priority, which decides on pre-emption.
    pub(super) fn group_of(&self, priority: i32) -> i32 {
        if priority < 0 {
            return priority;
        }
        priority & !((2 << self.group) - 1)
    }

    /// Pending and enabled exception of highest priority, with its priority; `None` if no exception waits.
    pub(super) fn first(&self) -> Option<(u16, i32)> {
        let mut rest = self.pending & self.enabled;
        let mut best: Option<(u16, i32)> = None;
        while rest != 0 {
            let number = rest.trailing_zeros() as u16;
            rest &= rest - 1;
            let priority = self.priority(number);
            if best.is_none_or(|(_, p)| priority < p) {
                best = Some((number, priority));
            }
        }
        best
    }

    /// Priority of the active exceptions, without masks.
    pub(super) fn active_priority(&self) -> i32 {
        let mut rest = self.active;
        let mut priority = THREAD;
        while rest != 0 {
            let number = rest.trailing_zeros() as u16;
            rest &= rest - 1;
            priority = priority.min(self.priority(number));
        }
        self.group_of(priority)
    }

    /// Word of a register array with one bit for each line.
    pub(super) fn word(set: u128, index: u32) -> u32 {
        if index > 2 {
            return 0;
        }
        (set >> exception::FIRST_LINE >> (32 * index)) as u32
    }

    /// Set of exceptions from a word of a register array.
    pub(super) fn set_of(value: u32, index: u32) -> u128 {
        if index > 2 {
            return 0;
        }
        (u128::from(value) << (32 * index) & LINE_MASK) << exception::FIRST_LINE
    }

    /// Priorities of four exceptions from `first` on.
    pub(super) fn priority_word(&self, first: u32) -> u32 {
        let mut word = 0;
        for k in 0..4 {
            let priority = self.priorities[((first + k) & 127) as usize];
            word |= u32::from(priority) << (8 * k);
        }
        word
    }

    /// Sets the priorities of those of four exceptions from `first` on whose bytes `mask` covers.
    pub(super) fn set_priority_word(&mut self, first: u32, value: u32, mask: u32) {
        for k in 0..4 {
            if mask >> (8 * k) & 1 == 0 {
                continue;
            }
            let number = first + k;
            let exists =
                matches!(number, 4..=6 | 11 | 12 | 14 | 15) || (16..16 + LINES).contains(&number);
            if exists {
                self.priorities[(number & 127) as usize] = (value >> (8 * k)) as u8 & 0xf0;
            }
        }
    }

    /// Sets exceptions pending, by a write to a set-pending register.
    pub(super) fn pend_all(&mut self, set: u128, cycle: Cycles) {
        self.pend_set(set & !self.pending, cycle);
    }
}
