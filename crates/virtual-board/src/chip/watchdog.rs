//! Independent watchdog.
//!
//! Source: reference manual RM0090, chapter 21. The watchdog counts the slow oscillator, which it keeps running. A
//! write to prescaler or reload takes effect after five periods of the oscillator; until then a flag of SR is set. The
//! first count after the start is from 0xfff, whatever the reload register holds (21.3); the reload value applies from
//! the first refresh. Not modelled: the phase of the prescaler, which restarts at each refresh.

use super::Peripheral;
use super::cause::Cause;
use super::effect::Effect;
use super::map::Unit;
use super::register::{Register, narrow};
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::Time;

const REGISTERS: &[Register] = &[
    narrow(0x00, "KR", 0xffff),
    narrow(0x04, "PR", 7),
    narrow(0x08, "RLR", 0xfff),
    narrow(0x0c, "SR", 3),
];

/// Periods of the slow oscillator until a write takes effect.
const UPDATE: u64 = 5;

/// A register in the clock domain of the slow oscillator.
#[derive(Clone, Copy, Debug)]
struct Slow {
    value: u32,
    /// Written value, and the time at which the value takes effect; `None` if no write is pending.
    next: Option<(u32, Time)>,
}

impl Slow {
    const fn new(value: u32) -> Self {
        Self { value, next: None }
    }

    fn write(&mut self, value: u32, name: &str, shared: &mut Shared) {
        if self.next.is_some() {
            let text = format!("IWDG_{name} written before the previous write took effect");
            return shared.note(FindingKind::Forbidden, text);
        }
        self.next = Some((value, shared.time() + shared.variation.slow(UPDATE)));
    }

    /// Applies the written value if its time has come; true if the value was applied.
    fn settle(&mut self, now: Time) -> bool {
        match self.next {
            Some((value, at)) if at <= now => {
                *self = Self::new(value);
                true
            }
            _ => false,
        }
    }
}

#[derive(Clone)]
pub(crate) struct Watchdog {
    prescaler: Slow,
    reload: Slow,
    open: bool,
    /// Time of the reset; `None` until the watchdog has started.
    reset_at: Option<Time>,
    /// Time left until the reset while a debugger stops the watchdog; `None` otherwise.
    frozen: Option<Time>,
}

impl Default for Watchdog {
    fn default() -> Self {
        Self {
            prescaler: Slow::new(0),
            reload: Slow::new(0xfff),
            open: false,
            reset_at: None,
            frozen: None,
        }
    }
}

impl Watchdog {
    /// Starts the watchdog; no effect if it runs.
    fn start(&mut self, shared: &mut Shared) {
        if self.reset_at.is_none() {
            self.count_from(0xfff, shared);
        }
    }

    /// Stops the watchdog while a debugger halts the core, or resumes it.
    pub fn freeze(&mut self, frozen: bool, shared: &mut Shared) {
        if frozen && self.frozen.is_none() {
            self.frozen = self.reset_at.map(|at| at - shared.time());
        } else if !frozen && let Some(left) = self.frozen.take() {
            self.reset_at = Some(shared.time() + left);
        }
        self.plan(shared);
    }

    /// Periods of the slow oscillator in one count.
    fn divider(&self) -> u64 {
        4 << self.prescaler.value.min(6)
    }

    fn count_from(&mut self, count: u32, shared: &mut Shared) {
        let periods = self.divider() * u64::from(count + 1);
        let span = shared.variation.slow(periods);
        if self.frozen.is_some() {
            self.frozen = Some(span);
        } else {
            self.reset_at = Some(shared.time() + span);
        }
        self.plan(shared);
    }

    fn plan(&self, shared: &mut Shared) {
        let reset_at = self.reset_at.filter(|_| self.frozen.is_none());
        let updates = [self.prescaler.next, self.reload.next];
        let updates = updates.into_iter().flatten().map(|(_, at)| at);
        let next = updates.chain(reset_at).min().unwrap_or(Time::NEVER);
        let cycle = shared.base.cycle_of(next);
        shared.schedule(Unit::Iwdg, cycle);
    }
}

impl Peripheral for Watchdog {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x04 => self.prescaler.value,
            0x08 => self.reload.value,
            0x0c => {
                let busy = |register: &Slow| u32::from(register.next.is_some());
                busy(&self.prescaler) | busy(&self.reload) << 1
            }
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, _mask: u32, shared: &mut Shared) {
        match (offset, value) {
            (0x00, 0x5555) => self.open = true,
            (0x00, _) => {
                self.open = false;
                match value {
                    0xaaaa if self.reset_at.is_some() => self.count_from(self.reload.value, shared),
                    0xcccc => self.start(shared),
                    _ => {}
                }
            }
            (0x04 | 0x08, _) if !self.open => {
                shared.note(FindingKind::Forbidden, "IWDG written without its key");
            }
            (0x04, _) => self.prescaler.write(value & 7, "PR", shared),
            (0x08, _) => self.reload.write(value & 0xfff, "RLR", shared),
            _ => shared.note(FindingKind::Forbidden, "IWDG_SR is read only"),
        }
        self.plan(shared);
    }

    fn event(&mut self, shared: &mut Shared) {
        let now = shared.time();
        if self.frozen.is_none() && self.reset_at.is_some_and(|at| at <= now) {
            shared.note(FindingKind::Reset, "by the independent watchdog");
            return shared.effect(Effect::Reset(Cause::Watchdog));
        }
        let before = self.divider();
        if self.prescaler.settle(now) {
            // The new prescaler changes the period of the remaining counts.
            let after = self.divider();
            let scale = |left: Time| Time(left.0 / before * after);
            self.reset_at = self.reset_at.map(|at| now + scale(at - now));
            self.frozen = self.frozen.map(scale);
        }
        self.reload.settle(now);
        self.plan(shared);
    }

    fn clocks_changed(&mut self, shared: &mut Shared) {
        self.plan(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    /// Advances by `micros` µs; true if the watchdog has reset the chip.
    fn pass(dog: &mut Watchdog, shared: &mut Shared, micros: u64) -> bool {
        let end = shared.after(Time::from_micros(micros));
        while shared.arrive(Unit::Iwdg, end) {
            dog.event(shared);
            if shared.effects.pop_back().is_some() {
                return true;
            }
        }
        false
    }

    /// A watchdog with prescaler 32 and 500 counts (500 ms), started and refreshed.
    fn started(shared: &mut Shared) -> Watchdog {
        let mut dog = Watchdog::default();
        for (offset, value) in [(0x00, 0x5555), (0x04, 3), (0x08, 499)] {
            dog.write(offset, value, !0, shared);
        }
        assert_eq!(dog.read(0x0c, shared), 3);
        // Five periods at 32 kHz are 156.25 µs.
        pass(&mut dog, shared, 156);
        assert_eq!((dog.read(0x0c, shared), dog.read(0x08, shared)), (3, 0xfff));
        pass(&mut dog, shared, 1);
        assert_eq!((dog.read(0x0c, shared), dog.read(0x08, shared)), (0, 499));
        for key in [0xcccc, 0xaaaa] {
            dog.write(0x00, key, !0, shared);
        }
        dog
    }

    #[test]
    fn watchdog_resets_unless_refreshed_in_time() {
        let mut shared = shared();
        let mut dog = started(&mut shared);
        let fed = shared.now;
        assert_eq!(shared.due(Unit::Iwdg), fed + 8_000_000);
        shared.now = fed + 4_000_000;
        dog.write(0x00, 0xaaaa, !0, &mut shared);
        assert_eq!(shared.due(Unit::Iwdg), fed + 12_000_000);
        shared.base.set_frequency(fed + 4_000_000, 168_000_000);
        dog.clocks_changed(&mut shared);
        let reset_at = shared.due(Unit::Iwdg);
        assert!(
            reset_at.abs_diff(fed + 4_000_000 + 84_000_000) <= 1,
            "{reset_at}"
        );
        shared.now = reset_at;
        dog.event(&mut shared);
        assert_eq!(shared.effects.back(), Some(&Effect::Reset(Cause::Watchdog)));
        dog.write(0x08, 1, !0, &mut shared);
        assert_eq!(shared.kinds(), [FindingKind::Reset, FindingKind::Forbidden]);
    }

    #[test]
    fn start_without_refresh_counts_from_0xfff() {
        let mut shared = shared();
        let mut dog = Watchdog::default();
        dog.write(0x00, 0xcccc, !0, &mut shared);
        // Table in the manual: 512 ms at prescaler 4.
        assert!(!pass(&mut dog, &mut shared, 511_999));
        assert!(pass(&mut dog, &mut shared, 2));
    }

    #[test]
    fn timeout_follows_the_frequency_of_the_slow_oscillator() {
        for (hz, millis) in [(17_000, 941), (47_000, 340)] {
            let mut shared = shared();
            let mut dog = started(&mut shared);
            shared.variation.slow_hz = hz;
            dog.write(0x00, 0xaaaa, !0, &mut shared);
            assert!(!pass(&mut dog, &mut shared, millis * 1000), "{hz}");
            assert!(pass(&mut dog, &mut shared, 1000), "{hz}");
        }
    }

    #[test]
    fn new_prescaler_scales_the_remaining_time() {
        let mut shared = shared();
        let mut dog = started(&mut shared);
        dog.write(0x00, 0x5555, !0, &mut shared);
        dog.write(0x04, 4, !0, &mut shared);
        // The five periods of the update pass at the old rate; the remaining time doubles to 999.8 ms.
        assert!(!pass(&mut dog, &mut shared, 999_800));
        assert!(pass(&mut dog, &mut shared, 100));
    }

    #[test]
    fn freeze_stops_the_watchdog_until_the_core_resumes() {
        let mut shared = shared();
        let mut dog = started(&mut shared);
        assert!(!pass(&mut dog, &mut shared, 200_000));
        dog.freeze(true, &mut shared);
        assert!(!pass(&mut dog, &mut shared, 1_000_000));
        dog.freeze(false, &mut shared);
        assert!(!pass(&mut dog, &mut shared, 299_990));
        assert!(pass(&mut dog, &mut shared, 20));
    }

    #[test]
    fn write_before_the_previous_one_takes_effect_is_a_finding() {
        let mut shared = shared();
        let mut dog = Watchdog::default();
        for (offset, value) in [(0x00, 0x5555), (0x08, 499), (0x08, 500)] {
            dog.write(offset, value, !0, &mut shared);
        }
        assert_eq!(shared.findings.list().len(), 1);
        pass(&mut dog, &mut shared, 200);
        assert_eq!(dog.read(0x08, &mut shared), 499);
    }
}
