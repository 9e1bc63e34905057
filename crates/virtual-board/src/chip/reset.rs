//! Resets of the chip and of its peripherals, and the effect of the supply on them.

use super::cause::Cause;
use super::chip_variation::Random;
use super::effect::{Clocks, Effect};
use super::map::Unit;
use super::pin::Drive;
use super::{Chip, Units, pwr};
use crate::noise::Noise;
use crate::time::{Cycles, NEVER, Time};

impl Chip {
    /// Restarts after a reset at this cycle: peripherals are in their reset state, memories unchanged except by an
    /// interrupted flash operation. The core may still be held, see [`Self::is_held`].
    pub fn restart(&mut self, cause: Cause, cycle: Cycles) {
        self.shared.now = self.shared.now.max(cycle);
        self.begin(cause);
    }

    /// Switches the power off: all pins are released, the RAM loses its content, and a flash operation is interrupted.
    pub fn power_off(&mut self, cycle: Cycles) {
        self.scramble();
        self.restart(Cause::PowerOn, cycle);
    }

    pub(super) fn begin(&mut self, cause: Cause) {
        let power_on = cause == Cause::PowerOn;
        self.enabled.clear();
        let before = std::mem::replace(&mut self.units, Units::new());
        self.units.can1 = before.can1;
        let shared = &mut self.shared;
        shared.lines = 0;
        shared.effects.clear();
        for unit in Unit::SCHEDULED {
            shared.schedule(unit, NEVER);
        }
        self.flash.reset(shared);
        self.units.can1.reset(shared);
        shared.clocks = Clocks {
            hclk_hz: shared.variation.internal_hz,
            ..Clocks::RESET
        };
        self.set_frequency(self.shared.clocks.hclk_hz);
        let (units, shared) = (&mut self.units, &mut self.shared);
        units.rcc.begin(before.rcc.kept(cause), cause, shared);
        if !power_on {
            units.debug = before.debug;
        }
        let noise = match power_on {
            true => Noise::new(shared.variation.seed ^ self.scrambles << 48),
            false => before.adc.into_noise(),
        };
        units.adc.begin(noise);
        units.gpio.begin(&before.gpio, shared);
        let at = shared.time();
        shared.cancel_sample();
        shared.volts = shared.circuit().supply(at);
        let low = pwr::holds(shared.volts, shared.variation.brown_out, power_on);
        self.sagged = low.then_some(shared.volts);
        (self.reset, self.nmi) = (None, false);
        self.settle();
        self.refresh();
    }

    /// True while the core stands still with power on: the supply is too low, the reset is not yet released, or the
    /// core clock has failed.
    pub fn is_held(&self) -> bool {
        self.sagged.is_some() || self.units.rcc.is_held()
    }

    /// Stops the peripherals selected in DBGMCU while a debugger halts the core, or resumes them, at this cycle.
    pub fn halt(&mut self, halted: bool, cycle: Cycles) {
        self.shared.now = self.shared.now.max(cycle);
        if !halted || self.units.debug.stops_watchdog() {
            self.units.watchdog.freeze(halted, &mut self.shared);
        }
        let frozen = halted && self.units.debug.stops_window_watchdog();
        self.units.window_watchdog.freeze(frozen, &mut self.shared);
        for timer in 0..5 {
            let frozen = halted && self.units.debug.stops_timer(timer);
            self.units.timers[timer].freeze(frozen, &mut self.shared);
        }
        self.settle();
    }

    /// Fills the RAM with pseudo-random content, as after a power-on. No program may rely on this content.
    pub(super) fn scramble(&mut self) {
        self.scrambles += 1;
        let mut random = Random::new(self.shared.variation.seed ^ self.scrambles << 48);
        for byte in self.sram.iter_mut().chain(&mut self.ccm) {
            *byte = random.next() as u8;
        }
    }

    /// Handles a change of the supply.
    pub(super) fn supply(&mut self, at: Time) {
        let volts = self.shared.circuit().supply(at);
        let before = std::mem::replace(&mut self.shared.volts, volts);
        if pwr::is_remembered(before) && !pwr::is_remembered(volts) {
            self.scramble();
        }
        let level = self.shared.variation.brown_out;
        match (self.sagged, pwr::holds(volts, level, self.sagged.is_some())) {
            (None, true) => {
                self.begin(Cause::BrownOut);
                self.sagged = Some(volts);
            }
            (Some(lowest), true) => self.sagged = Some(lowest.min(volts)),
            (Some(lowest), false) => {
                self.sagged = None;
                self.reset = Some(if pwr::is_off(lowest) {
                    Cause::PowerOn
                } else {
                    Cause::BrownOut
                });
            }
            (None, false) => {
                self.units.pwr.detect(&mut self.shared);
                self.check_core_clock(false);
            }
        }
        self.shared.limit = 0;
    }

    /// Resets a peripheral by its bit in the RCC.
    pub(super) fn reset_unit(&mut self, register: u32, bit: u32) {
        let Some(unit) = Unit::reset_by(register, bit) else {
            return;
        };
        if Unit::SCHEDULED.contains(&unit) {
            self.shared.schedule(unit, NEVER);
        }
        for &interrupt in unit.interrupts() {
            self.shared.line(interrupt, false);
        }
        let mut new = Units::new();
        let units = &mut self.units;
        match unit {
            Unit::Tim1 | Unit::Tim2 | Unit::Tim3 | Unit::Tim4 | Unit::Tim5 => {
                let timer = unit.timer();
                std::mem::swap(&mut units.timers[timer], &mut new.timers[timer]);
            }
            Unit::Adc => units.adc.reset(),
            Unit::Tim11 => units.tim11 = new.tim11,
            Unit::Dma1 => units.dma1 = new.dma1,
            Unit::Dma2 => units.dma2 = new.dma2,
            Unit::Spi1 => units.spi1 = new.spi1,
            Unit::Can1 => units.can1.reset(&mut self.shared),
            Unit::Usart3 => units.usart3 = new.usart3,
            Unit::Wwdg => units.window_watchdog = new.window_watchdog,
            Unit::Pwr => {
                units.pwr = new.pwr;
                // A reset switches the voltage detector off, so its output falls.
                self.shared.effect(Effect::VoltageDetector { low: false });
            }
            Unit::Gpio => units.gpio.reset(bit as usize, &mut self.shared),
            _ => {}
        }
        for &signal in unit.outputs() {
            self.shared.effect(Effect::Output(signal, Drive::Open));
        }
        for &signal in unit.inputs() {
            if let Some(pin) = self.units.gpio.pin_of(signal) {
                let level = self.units.gpio.level(pin);
                self.shared.effect(Effect::Level { pin, high: level });
            }
        }
        self.gate();
    }
}
