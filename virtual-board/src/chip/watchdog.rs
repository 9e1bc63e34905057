//! Independent watchdog.
//!
//! Source: reference manual RM0090, chapter 21. It counts the slow oscillator, 32 kHz typically and 17
//! to 47 kHz by the data sheet. Changes of prescaler and reload take effect at once; the busy flags
//! never show.

use super::Peripheral;
use super::rcc::Cause;
use super::register::{Register, narrow};
use super::shared::{Effect, Shared, Source};
use crate::finding::Kind;
use crate::time::{Time, Timebase};

const REGISTERS: &[Register] = &[
    narrow(0x00, "KR", 0xffff),
    narrow(0x04, "PR", 7),
    narrow(0x08, "RLR", 0xfff),
    narrow(0x0c, "SR", 3),
];

/// Period of the slow oscillator, ps.
const SLOW_PS: u64 = 1_000_000_000_000 / 32_000;

/// The independent watchdog.
pub(crate) struct Watchdog {
    prescaler: u32,
    reload: u32,
    open: bool,
    /// When it bites, once it was started.
    bites: Option<Time>,
    /// Times it was fed.
    fed: u64,
}

impl Default for Watchdog {
    fn default() -> Self {
        Self {
            prescaler: 0,
            reload: 0xfff,
            open: false,
            bites: None,
            fed: 0,
        }
    }
}

impl Watchdog {
    /// Time from being fed to the bite.
    fn span(&self) -> Time {
        let divider = 4u64 << self.prescaler.min(6);
        Time(divider * u64::from(self.reload + 1) * SLOW_PS)
    }

    fn feed(&mut self, shared: &mut Shared) {
        self.fed += 1;
        self.bites = Some(shared.time() + self.span());
        self.plan(shared);
    }

    fn plan(&self, shared: &mut Shared) {
        if let Some(at) = self.bites {
            let cycle = shared.base.cycle_of(at);
            shared.schedule(Source::Watchdog, cycle);
        }
    }
}

impl Peripheral for Watchdog {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        match offset {
            0x04 => self.prescaler,
            0x08 => self.reload,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, _mask: u32, shared: &mut Shared) {
        match (offset, value) {
            (0x00, 0xaaaa) => {
                self.open = false;
                if self.bites.is_some() {
                    self.feed(shared);
                }
            }
            (0x00, 0xcccc) => {
                self.open = false;
                self.feed(shared);
            }
            (0x00, _) => self.open = value == 0x5555,
            (0x04 | 0x08, _) if !self.open => {
                shared.note(Kind::Forbidden, "IWDG written without its key");
            }
            (0x04, _) => self.prescaler = value & 7,
            (0x08, _) => self.reload = value & 0xfff,
            _ => {}
        }
    }

    fn event(&mut self, _source: Source, shared: &mut Shared) {
        shared.effect(Effect::Reset(Cause::Watchdog));
    }

    fn clocks_changed(&mut self, _old: &Timebase, shared: &mut Shared) {
        self.plan(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    #[test]
    fn it_bites_when_it_was_not_fed_for_its_time() {
        let (mut dog, mut shared) = (Watchdog::default(), shared());
        // Prescaler 32, 500 counts: 500 ms.
        for (offset, value) in [(0x00, 0x5555), (0x04, 3), (0x08, 499), (0x00, 0xcccc)] {
            dog.write(offset, value, !0, &mut shared);
        }
        assert_eq!(shared.due(Source::Watchdog), 8_000_000);
        shared.now = 4_000_000;
        dog.write(0x00, 0xaaaa, !0, &mut shared);
        assert_eq!(shared.due(Source::Watchdog), 12_000_000);
        let old = shared.base;
        shared.base.set_frequency(4_000_000, 168_000_000);
        dog.clocks_changed(&old, &mut shared);
        let bites = shared.due(Source::Watchdog);
        assert!(bites.abs_diff(4_000_000 + 84_000_000) <= 1, "{bites}");
        dog.event(Source::Watchdog, &mut shared);
        assert_eq!(shared.effects.back(), Some(&Effect::Reset(Cause::Watchdog)));
        dog.write(0x08, 1, !0, &mut shared);
        assert_eq!(shared.findings.list().len(), 1);
    }
}
