//! Window watchdog.
//!
//! Source: reference manual RM0090, chapter 22. A 7-bit counter counts down at PCLK1 / 4096, divided again by 1 to 8.
//! The chip is reset when the counter falls below 0x40, or when the program writes the counter while the count is above
//! the window.
//!
//! Not modelled: the phase of the prescaler (here a write starts a whole count; on the chip the first count may be
//! shorter); counting before activation; the early wake-up interrupt, whose request is a finding.

use super::Peripheral;
use super::cause::Cause;
use super::effect::Effect;
use super::map::Unit;
use super::register::{Register, merge, narrow};
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::{Cycles, NEVER};

const REGISTERS: &[Register] = &[
    narrow(0x00, "CR", 0xff),
    narrow(0x04, "CFR", 0x3ff),
    narrow(0x08, "SR", 1),
];

// Bits of CR and CFR.
bits! {
    WDGA 7, EWI 9
}
const COUNT: u32 = 0x7f;
/// Lowest count without a reset.
const LOWEST: u32 = 0x40;

#[derive(Clone)]
pub(crate) struct WindowWatchdog {
    /// Count while the watchdog is inactive.
    count: u32,
    configuration: u32,
    active: bool,
    /// Core cycles in one count.
    period: Cycles,
    /// Cycle of the reset; `None` unless the watchdog runs.
    reset_at: Option<Cycles>,
    /// Cycles left until the reset while the watchdog is stopped; `None` while it runs.
    left: Option<Cycles>,
    gated: bool,
    frozen: bool,
}

impl Default for WindowWatchdog {
    fn default() -> Self {
        Self {
            count: COUNT,
            configuration: COUNT,
            active: false,
            period: 1,
            reset_at: None,
            left: None,
            gated: true,
            frozen: false,
        }
    }
}

impl WindowWatchdog {
    /// Stops the watchdog while its clock is off, or resumes it.
    pub fn gate(&mut self, off: bool, shared: &mut Shared) {
        self.gated = off;
        self.plan(shared);
    }

    /// Stops the watchdog while a debugger halts the core, or resumes it.
    pub fn freeze(&mut self, frozen: bool, shared: &mut Shared) {
        self.frozen = frozen;
        self.plan(shared);
    }

    fn plan(&mut self, shared: &mut Shared) {
        let stands = self.gated || self.frozen;
        if stands && let Some(at) = self.reset_at.take() {
            self.left = Some(at.saturating_sub(shared.now));
        } else if !stands && let Some(left) = self.left.take() {
            self.reset_at = Some(shared.now + left);
        }
        shared.schedule(Unit::Wwdg, self.reset_at.unwrap_or(NEVER));
    }

    /// Core cycles in one count at the present clocks.
    fn cycles(&self, shared: &Shared) -> Cycles {
        (shared.clocks.apb1 * 4096) << (self.configuration >> 7 & 3)
    }

    /// Count of the watchdog at `now`.
    fn counted(&self, now: Cycles) -> u32 {
        let left = match (self.reset_at, self.left) {
            (Some(at), _) => at.saturating_sub(now),
            (_, Some(left)) => left,
            _ => return self.count,
        };
        LOWEST - 1 + left.div_ceil(self.period) as u32
    }

    fn bite(shared: &mut Shared) {
        shared.note(FindingKind::Reset, "by the window watchdog");
        shared.effect(Effect::Reset(Cause::WindowWatchdog));
    }

    /// Rescales the remaining time after a change of prescaler or bus clock.
    fn stretch(&mut self, shared: &mut Shared) {
        let (before, now) = (self.period, shared.now);
        self.period = self.cycles(shared);
        let scale = |left: Cycles| left * self.period / before;
        self.reset_at = self.reset_at.map(|at| now + scale(at.saturating_sub(now)));
        self.left = self.left.map(scale);
        self.plan(shared);
    }

    fn control(&mut self, value: u32, shared: &mut Shared) {
        let early = self.active && self.counted(shared.now) > self.configuration & COUNT;
        self.active |= value & WDGA != 0;
        self.count = value & COUNT;
        if !self.active {
            return;
        }
        if early || self.count < LOWEST {
            return Self::bite(shared);
        }
        self.period = self.cycles(shared);
        let counts = u64::from(self.count + 1 - LOWEST);
        (self.reset_at, self.left) = (None, Some(counts * self.period));
        self.plan(shared);
    }
}

impl Peripheral for WindowWatchdog {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        match offset {
            0x00 => u32::from(self.active) << 7 | self.counted(shared.now),
            0x04 => self.configuration,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            0x00 => self.control(value, shared),
            0x04 => {
                self.configuration = merge(self.configuration, value, mask);
                if value & EWI != 0 {
                    shared.note(FindingKind::NotModelled, "WWDG: early wake-up interrupt");
                }
                self.stretch(shared);
            }
            _ => {}
        }
    }

    fn event(&mut self, shared: &mut Shared) {
        if self.reset_at.is_some_and(|at| at <= shared.now) {
            self.reset_at = None;
            return Self::bite(shared);
        }
        self.plan(shared);
    }

    fn clocks_changed(&mut self, shared: &mut Shared) {
        if self.period != self.cycles(shared) {
            self.stretch(shared);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    /// A watchdog started with `count`, at 16 MHz without a divider.
    fn started(shared: &mut Shared, count: u32) -> WindowWatchdog {
        let mut dog = WindowWatchdog::default();
        dog.gate(false, shared);
        dog.write(0x00, WDGA | count, !0, shared);
        dog
    }

    /// Advances by `cycles`; true if the watchdog has reset the chip.
    fn pass(dog: &mut WindowWatchdog, shared: &mut Shared, cycles: Cycles) -> bool {
        let end = shared.now + cycles;
        if shared.arrive(Unit::Wwdg, end) {
            dog.event(shared);
        }
        shared.effects.pop_back() == Some(Effect::Reset(Cause::WindowWatchdog))
    }

    #[test]
    fn window_watchdog_resets_after_its_counts() {
        // Formula in the manual: 4096 · 2^WDGTB · (T[5:0] + 1) periods of PCLK1.
        for (count, wdgtb) in [(0x7f, 0), (0x40, 0), (0x4f, 3)] {
            let mut shared = shared();
            let mut dog = started(&mut shared, count);
            dog.write(0x04, wdgtb << 7 | COUNT, !0, &mut shared);
            let periods = (4096 << wdgtb) * u64::from(count - 0x3f);
            assert!(!pass(&mut dog, &mut shared, periods - 1), "{count}");
            assert_eq!(dog.read(0x00, &mut shared), WDGA | 0x40);
            assert!(pass(&mut dog, &mut shared, 1), "{count}");
        }
    }

    #[test]
    fn refreshed_window_watchdog_restarts_its_count() {
        let mut shared = shared();
        let mut dog = started(&mut shared, 0x41);
        assert!(!pass(&mut dog, &mut shared, 8000));
        dog.write(0x00, 0x41, !0, &mut shared);
        assert!(!pass(&mut dog, &mut shared, 8191));
        assert!(pass(&mut dog, &mut shared, 1));
    }

    #[test]
    fn write_above_the_window_or_below_the_lowest_count_resets() {
        for (window, value, resets) in [(0x50, 0x7f, true), (0x7f, 0x3f, true), (0x7f, 0x7f, false)]
        {
            let mut shared = shared();
            let mut dog = started(&mut shared, 0x60);
            dog.write(0x04, window, !0, &mut shared);
            dog.write(0x00, value, !0, &mut shared);
            assert_eq!(pass(&mut dog, &mut shared, 0), resets, "{window} {value}");
        }
    }

    #[test]
    fn gated_clock_and_halted_core_stop_the_window_watchdog() {
        let mut shared = shared();
        let mut dog = started(&mut shared, 0x41);
        dog.gate(true, &mut shared);
        assert!(!pass(&mut dog, &mut shared, 1_000_000));
        dog.freeze(true, &mut shared);
        dog.gate(false, &mut shared);
        assert!(!pass(&mut dog, &mut shared, 1_000_000));
        dog.freeze(false, &mut shared);
        assert!(!pass(&mut dog, &mut shared, 8191));
        assert!(pass(&mut dog, &mut shared, 1));
    }

    #[test]
    fn slower_bus_clock_lengthens_the_counts() {
        let mut shared = shared();
        let mut dog = started(&mut shared, 0x41);
        assert!(!pass(&mut dog, &mut shared, 4096));
        shared.clocks.apb1 = 4;
        dog.clocks_changed(&mut shared);
        assert!(!pass(&mut dog, &mut shared, 4 * 4096 - 1));
        assert!(pass(&mut dog, &mut shared, 1));
    }

    #[test]
    fn early_wake_up_is_a_finding() {
        let mut shared = shared();
        WindowWatchdog::default().write(0x04, EWI, !0, &mut shared);
        assert_eq!(shared.kinds(), [FindingKind::NotModelled]);
    }
}
