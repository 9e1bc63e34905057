//! The STM32F405 around the core: memories, clocks, peripherals.
//!
//! Each peripheral is a file: a table of its registers (name, offset, bits), then the behaviour on reads, on writes and
//! over time. Peripherals do not depend on each other: a signal between two peripherals, such as a trigger or a pin
//! level, is an effect that [`Chip`] delivers. Checks common to all peripherals are here: clock off, reserved bits,
//! access width, offsets without a register.

mod adc;
mod bus;
mod can;
mod cause;
mod chip_variation;
mod circuit;
mod debug;
mod dma;
mod effect;
mod enabled;
mod exti;
mod flash;
mod gpio;
mod injected_faults;
mod interrupt;
mod map;
mod net;
mod nonlinearity;
mod pin;
mod pwr;
mod rcc;
mod register;
mod reset;
mod schedule;
mod shared;
mod spi;
mod tim11;
mod timer;
mod transfer;
mod usart;
mod watchdog;
mod window_watchdog;

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

pub use adc::Counts as Conversions;
pub use cause::Cause;
pub use chip_variation::ChipVariation;
pub use circuit::{Bare, Circuit, Inputs};
pub use effect::{Clocks, Request};
pub use flash::FlashOperation;
pub use injected_faults::InjectedFaults;
pub use interrupt::Interrupt;
pub use net::{Net, Usable};
pub use nonlinearity::Nonlinearity;
pub use pin::{Drive, Pin, Signal};

use crate::finding::{FindingKind, Findings};
use crate::time::{Cycles, Time};
use effect::Effect;
use map::Unit;
use register::Register;
use shared::Shared;

pub(crate) trait Peripheral {
    /// Registers in the order of their offsets.
    fn registers(&self) -> &'static [Register];
    /// Reads the register at `offset`, with the side effects of the read.
    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32;
    /// Writes the bits in `mask` of the register at `offset`; the bits of `value` outside `mask` are zero.
    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared);
    /// Handles the event due at `shared.now`. The event has been removed from the schedule; the peripheral schedules
    /// its next one.
    fn event(&mut self, shared: &mut Shared) {
        let _ = shared;
    }
    /// Reschedules the events that depend on the bus clocks, which have changed.
    fn clocks_changed(&mut self, shared: &mut Shared) {
        let _ = shared;
    }
}

/// First address of SRAM1, and the length of SRAM1 and SRAM2 together.
const SRAM: u32 = 0x2000_0000;
const SRAM_LENGTH: usize = 128 << 10;
/// First address of the core-coupled memory, and its length.
const CCM: u32 = 0x1000_0000;
const CCM_LENGTH: usize = 64 << 10;
/// First address of the flash.
pub(crate) const FLASH: u32 = 0x0800_0000;

/// All peripherals in their state after a reset.
#[derive(Clone)]
struct Units {
    rcc: rcc::Rcc,
    pwr: pwr::Pwr,
    gpio: gpio::Gpio,
    exti: exti::Exti,
    /// TIM1 to TIM5.
    timers: [timer::Timer; 5],
    tim11: tim11::Tim11,
    adc: adc::Adc,
    dma1: dma::Dma,
    dma2: dma::Dma,
    spi1: spi::Spi,
    can1: can::Can,
    usart3: usart::Usart,
    watchdog: watchdog::Watchdog,
    window_watchdog: window_watchdog::WindowWatchdog,
    debug: debug::Debug,
}

impl Units {
    fn new() -> Self {
        Self {
            rcc: rcc::Rcc::default(),
            pwr: pwr::Pwr::default(),
            gpio: gpio::Gpio::default(),
            exti: exti::Exti::default(),
            timers: timer::TimerId::ALL.map(timer::Timer::new),
            tim11: tim11::Tim11::default(),
            adc: adc::Adc::default(),
            dma1: dma::Dma::new(dma::Controller::Dma1),
            dma2: dma::Dma::new(dma::Controller::Dma2),
            spi1: spi::Spi::after_reset(),
            can1: can::Can::after_reset(),
            usart3: usart::Usart::after_reset(),
            watchdog: watchdog::Watchdog::default(),
            window_watchdog: window_watchdog::WindowWatchdog::default(),
            debug: debug::Debug::default(),
        }
    }

    fn dma(&mut self, controller: dma::Controller) -> &mut dma::Dma {
        match controller {
            dma::Controller::Dma1 => &mut self.dma1,
            dma::Controller::Dma2 => &mut self.dma2,
        }
    }
}

/// The chip without its core.
#[derive(Clone)]
pub struct Chip {
    shared: Shared,
    units: Units,
    flash: flash::Flash,
    sram: Vec<u8>,
    ccm: Vec<u8>,
    inputs: Inputs,
    /// Cause of the pending reset; `None` if no reset is pending.
    reset: Option<Cause>,
    /// Lowest supply voltage since the supply fell too low, V; the chip is held in reset until this is `None`.
    sagged: Option<f64>,
    longest_reaction: Cycles,
    /// True if the clock security system requests the non-maskable interrupt.
    nmi: bool,
    /// True if the core clock has changed since the latest call of `advance` began.
    clock_changed: bool,
    /// True if the core clock changed between the latest two calls of `advance`.
    must_pause: bool,
    /// Number of times that the RAM lost its content.
    scrambles: u64,
    injected_faults: InjectedFaults,
    /// Peripheral clocks that were enabled recently.
    enabled: enabled::Enabled,
}

impl Chip {
    /// Creates a chip with an erased flash whose power has just come on. Its clocks run `fast_ppb` parts in 10⁹ too
    /// fast.
    pub fn new(circuit: Box<dyn Circuit>, fast_ppb: i64) -> Self {
        let mut chip = Self {
            shared: Shared::new(circuit, fast_ppb),
            units: Units::new(),
            flash: flash::Flash::default(),
            sram: vec![0; SRAM_LENGTH],
            ccm: vec![0; CCM_LENGTH],
            inputs: Inputs::default(),
            reset: None,
            sagged: None,
            nmi: false,
            longest_reaction: 0,
            clock_changed: false,
            must_pause: false,
            scrambles: 0,
            injected_faults: InjectedFaults::default(),
            enabled: enabled::Enabled::default(),
        };
        chip.power_off(0);
        chip
    }

    /// Replaces the properties of the typical chip; call it while the power is off.
    pub fn set_variation(&mut self, variation: ChipVariation) {
        self.shared.variation = variation;
        self.power_off(0);
    }

    /// The circuit around the chip; `None` if its type is not `T`.
    pub fn circuit<T: Circuit>(&mut self) -> Option<&mut T> {
        let any: &mut dyn std::any::Any = self.shared.circuit();
        any.downcast_mut()
    }

    /// Findings so far.
    pub fn findings(&self) -> &Findings {
        &self.shared.findings
    }

    /// Time at which a cycle begins.
    pub fn time_of(&self, cycle: Cycles) -> Time {
        self.shared.base.time_of(cycle)
    }

    /// First cycle that begins at `time` or later.
    pub fn cycle_of(&self, time: Time) -> Cycles {
        self.shared.base.cycle_of(time)
    }

    /// Conversions of ADC1 since the latest reset.
    pub fn conversions(&self) -> Conversions {
        self.units.adc.counts()
    }

    /// Longest time from a trigger of ADC1's injected group to a write of TIM1's first or second compare value, cycles:
    /// the reaction time of a current loop.
    pub fn longest_reaction(&self) -> Cycles {
        self.longest_reaction
    }

    /// Present clocks.
    pub fn clocks(&self) -> Clocks {
        self.shared.clocks
    }

    /// The bytes of the flash.
    pub fn flash(&mut self) -> &mut Vec<u8> {
        self.flash.bytes_mut()
    }

    /// Flash operations that the program has begun so far.
    pub fn flash_operations(&self) -> &[FlashOperation] {
        self.flash.begun()
    }

    /// The bytes of SRAM1 and SRAM2.
    pub fn sram(&mut self) -> &mut [u8] {
        &mut self.sram
    }

    /// Takes the cause of the pending reset; `None` if no reset is pending.
    pub fn take_reset(&mut self) -> Option<Cause> {
        self.reset.take()
    }

    /// Asks the circuit again for its next event; call it after changing the circuit from outside.
    pub fn refresh(&mut self) {
        let at = self.shared.circuit().next();
        let cycle = self.shared.base.cycle_of(at);
        self.shared.schedule(Unit::Circuit, cycle);
    }

    fn set_frequency(&mut self, hz: u64) {
        let now = self.shared.now;
        self.shared.take_sample_by(now);
        self.shared.base.set_frequency(now, hz);
        self.shared.clocks.hclk_hz = hz;
    }

    /// Lets the circuit handle its events due now.
    fn advance_circuit(&mut self) {
        // The vectors are kept to avoid an allocation on each call.
        let mut inputs = std::mem::take(&mut self.inputs);
        let at = self.shared.time();
        self.shared.circuit().advance(at, &mut inputs);
        for (pin, drive) in inputs.pins.drain(..) {
            self.units.gpio.external(pin, drive, &mut self.shared);
        }
        for byte in inputs.serial.drain(..) {
            self.units.usart3.receive(byte, &mut self.shared);
        }
        if let Some(works) = inputs.crystal.take() {
            self.units.rcc.crystal(works, &mut self.shared);
        }
        if std::mem::take(&mut inputs.supply) {
            self.supply(at);
        }
        self.inputs = inputs;
        self.settle();
        self.refresh();
    }

    /// Delivers effects until there are none; usually there are none.
    #[inline]
    fn settle(&mut self) {
        if !self.shared.effects.is_empty() {
            self.deliver_effects();
        }
    }

    #[inline(never)]
    fn deliver_effects(&mut self) {
        while let Some(effect) = self.shared.effects.pop_front() {
            let (units, shared) = (&mut self.units, &mut self.shared);
            match effect {
                Effect::Trigger { timer, rises } => {
                    if !(rises && self.injected_faults.loses_trigger()) {
                        units.adc.trigger(timer, rises, shared);
                    }
                }
                Effect::Dma(request) => self.serve(request),
                Effect::Uses(signal) => {
                    if units.gpio.pin_of(signal).is_none() {
                        shared.note(FindingKind::Pin, format!("{signal:?} is on no pin"));
                    }
                }
                Effect::Output(signal, drive) => units.gpio.output(signal, drive, shared),
                Effect::Level { pin, high } => self.level(pin, high),
                Effect::Driven(pin, drive) => {
                    let at = shared.time();
                    shared.circuit().pin(pin, drive, at);
                    self.refresh();
                }
                Effect::Frequency(hz) => {
                    let before = self.shared.clocks.hclk_hz;
                    self.set_frequency(hz);
                    self.clock_changed = true;
                    self.shared.limit = 0;
                    self.check_core_clock(hz > before);
                    self.clocks_changed();
                }
                Effect::ClockFailure => {
                    self.nmi = true;
                    shared.limit = 0;
                    units.timers[0].clock_failure(shared);
                }
                Effect::Sampled(pin) => {
                    if !units.gpio.is_analogue(pin) {
                        shared.note(
                            FindingKind::Pin,
                            format!("{pin} is converted but not in analogue mode"),
                        );
                    }
                }
                Effect::VoltageDetector { low } => units.exti.level(low, shared),
                Effect::ResetUnit { register, bit } => self.reset_unit(register, bit),
                Effect::Reset(cause) => {
                    self.reset = Some(cause);
                    self.shared.limit = 0;
                }
            }
        }
    }

    /// Checks wait states, prefetch and regulator scale against the core clock and the supply (RM0090, tables 10 and
    /// 11). Too many wait states are a finding only when the clock gets faster: a program sets the wait states of a
    /// faster clock before it switches.
    fn check_core_clock(&mut self, faster: bool) {
        let (hz, volts) = (self.shared.clocks.hclk_hz, self.shared.volts);
        let step = match volts {
            2.7.. => 30_000_000,
            2.4.. => 24_000_000,
            2.1.. => 22_000_000,
            _ => 20_000_000,
        };
        let needed = hz.saturating_sub(1) / step;
        let set = self.flash.wait_states();
        let mut found = Vec::new();
        if set < needed || faster && set > needed {
            found.push(format!(
                "{set} wait states at {hz} Hz and {volts:.1} V: must be {needed}"
            ));
        }
        if volts < 2.1 && self.flash.prefetches() {
            found.push(format!("prefetch at {volts:.1} V: must be off"));
        }
        if hz > 144_000_000 && !self.units.pwr.is_scale_1() {
            found.push(format!("regulator at scale 2 at {hz} Hz"));
        }
        for text in found {
            self.shared.note(FindingKind::ClockLimit, text);
        }
    }

    fn clocks_changed(&mut self) {
        for unit in Unit::SCHEDULED {
            let (peripheral, shared) = self.unit(unit);
            peripheral.clocks_changed(shared);
        }
        self.refresh();
    }

    /// Forwards a new pin level to the timer with this pin as its input.
    fn level(&mut self, pin: Pin, level: bool) {
        let (units, shared) = (&mut self.units, &mut self.shared);
        if let Some(signal) = units.gpio.signal_at(pin)
            && let Some(timer) = signal.timer()
        {
            units.timers[timer].input(signal, level, shared);
        }
    }

    /// Stops the timers, the converter and the window watchdog while their clocks are off.
    fn gate(&mut self) {
        let (units, shared) = (&mut self.units, &mut self.shared);
        let rcc = &units.rcc;
        let off = |unit: Unit| {
            let gate = unit.gate(0);
            gate.is_some_and(|(register, bit)| !rcc.is_enabled(register, bit))
        };
        let timers = [Unit::Tim1, Unit::Tim2, Unit::Tim3, Unit::Tim4, Unit::Tim5].map(off);
        let (adc, window) = (off(Unit::Adc), off(Unit::Wwdg));
        for (timer, off) in units.timers.iter_mut().zip(timers) {
            timer.gate(off, shared);
        }
        units.adc.gate(adc, shared);
        units.window_watchdog.gate(window, shared);
    }

    fn unit(&mut self, unit: Unit) -> (&mut dyn Peripheral, &mut Shared) {
        let u = &mut self.units;
        let peripheral: &mut dyn Peripheral = match unit {
            Unit::Rcc => &mut u.rcc,
            Unit::Pwr => &mut u.pwr,
            Unit::Gpio => &mut u.gpio,
            Unit::Exti => &mut u.exti,
            Unit::Tim1 | Unit::Tim2 | Unit::Tim3 | Unit::Tim4 | Unit::Tim5 => {
                &mut u.timers[unit.timer()]
            }
            Unit::Tim11 => &mut u.tim11,
            Unit::Adc => &mut u.adc,
            Unit::Dma1 => &mut u.dma1,
            Unit::Dma2 => &mut u.dma2,
            Unit::Spi1 => &mut u.spi1,
            Unit::Can1 => &mut u.can1,
            Unit::Usart3 => &mut u.usart3,
            Unit::Iwdg => &mut u.watchdog,
            Unit::Wwdg => &mut u.window_watchdog,
            // The circuit has no registers.
            Unit::Debug | Unit::Circuit => &mut u.debug,
            Unit::Flash => &mut self.flash,
        };
        (peripheral, &mut self.shared)
    }
}
