//! The STM32F405 around the core: memories, clocks, peripherals.
//!
//! Each peripheral is a file: its registers as a table (name, place, bits), then what reads, writes
//! and the passing of time do. Peripherals know nothing of each other; what one tells another, a
//! trigger or the level of a pin, is an effect that [`Chip`] carries. Access to a peripheral whose
//! clock is off, reserved bits, widths and places without a register are judged here, once for all.

mod adc;
mod can;
mod debug;
mod dma;
mod exti;
mod flash;
mod gpio;
mod interrupt;
mod map;
mod part;
mod pin;
mod pwr;
mod rcc;
mod register;
mod shared;
mod spi;
mod surroundings;
mod timer;
mod usart;
mod watchdog;

#[cfg(test)]
mod testing;

pub use adc::Counts as Conversions;
pub use interrupt::Interrupt;
pub use part::Part;
pub use pin::{Drive, Pin, Signal};
pub use rcc::Cause;
pub use shared::{Clocks, Request, Trigger};
pub use surroundings::{Inputs, SpiMode, Surroundings};

use crate::core::{BusError, System, Width};
use crate::finding::{Findings, Kind};
use crate::time::{Cycles, NEVER, Time, Timebase};
use map::Unit;
use part::Random;
use register::Register;
use shared::{Effect, Shared, Source};

/// A peripheral.
pub(crate) trait Peripheral {
    /// Its registers, in the order of their places.
    fn registers(&self) -> &'static [Register];
    /// Reads the register at `offset`, with what that does.
    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32;
    /// Writes the bits in `mask` of the register at `offset`; the others are zero in `value`.
    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared);
    /// What it has due at `shared.now`; it is off the schedule until it puts itself there again.
    fn event(&mut self, source: Source, shared: &mut Shared) {
        let _ = (source, shared);
    }
    /// The clocks of the buses have changed; places in the schedule that follow other clocks move.
    fn clocks_changed(&mut self, old: &Timebase, shared: &mut Shared) {
        let _ = (old, shared);
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
struct Units {
    rcc: rcc::Rcc,
    pwr: pwr::Pwr,
    gpio: gpio::Gpio,
    exti: exti::Exti,
    syscfg: exti::Syscfg,
    tim1: timer::Timer,
    tim2: timer::Timer,
    tim3: timer::Timer,
    tim4: timer::Timer,
    tim5: timer::Timer,
    adc: adc::Adc,
    dma1: dma::Dma,
    dma2: dma::Dma,
    spi1: spi::Spi,
    can1: can::Can,
    usart3: usart::Usart,
    watchdog: watchdog::Watchdog,
    debug: debug::Debug,
}

impl Units {
    fn new() -> Self {
        use timer::{Kind, Timer};
        Self {
            rcc: rcc::Rcc::default(),
            pwr: pwr::Pwr::default(),
            gpio: gpio::Gpio::default(),
            exti: exti::Exti::default(),
            syscfg: exti::Syscfg::default(),
            tim1: Timer::new(Kind::Tim1),
            tim2: Timer::new(Kind::Tim2),
            tim3: Timer::new(Kind::Tim3),
            tim4: Timer::new(Kind::Tim4),
            tim5: Timer::new(Kind::Tim5),
            adc: adc::Adc::default(),
            dma1: dma::Dma::new(dma::Controller::Dma1),
            dma2: dma::Dma::new(dma::Controller::Dma2),
            spi1: spi::Spi::default(),
            can1: can::Can::default(),
            usart3: usart::Usart::default(),
            watchdog: watchdog::Watchdog::default(),
            debug: debug::Debug::default(),
        }
    }
}

/// Everything of the chip but its core.
pub struct Chip {
    shared: Shared,
    units: Units,
    flash: flash::Flash,
    sram: Vec<u8>,
    ccm: Vec<u8>,
    /// A reset that is due.
    reset: Option<Cause>,
    /// The supply is too low, and the chip held in reset: the lowest supply since.
    sagged: Option<f64>,
    longest_reaction: Cycles,
    /// The clock security system asks for the non-maskable interrupt.
    nmi: bool,
    /// The core's clock has changed since it looked up last, and before that.
    clock_changed: bool,
    must_pause: bool,
    /// How often memory has forgotten.
    scrambles: u64,
}

impl Chip {
    /// A chip with an erased flash, its power just on. Its clocks are fast by `fast_ppb` parts in 10⁹.
    pub fn new(surroundings: Box<dyn Surroundings>, fast_ppb: i64) -> Self {
        let mut chip = Self {
            shared: Shared::new(surroundings, fast_ppb),
            units: Units::new(),
            flash: flash::Flash::default(),
            sram: vec![0; SRAM_LENGTH],
            ccm: vec![0; CCM_LENGTH],
            reset: None,
            sagged: None,
            nmi: false,
            longest_reaction: 0,
            clock_changed: false,
            must_pause: false,
            scrambles: 0,
        };
        chip.power_off(0);
        chip
    }

    /// Has the chip be another than a typical one; to be called while its power is off.
    pub fn set_part(&mut self, part: Part) {
        self.shared.part = part;
        self.power_off(0);
    }

    /// What is around it.
    pub fn surroundings<T: Surroundings>(&mut self) -> Option<&mut T> {
        let any: &mut dyn std::any::Any = &mut *self.shared.surroundings;
        any.downcast_mut()
    }

    /// What was found so far.
    pub fn findings(&self) -> &Findings {
        &self.shared.findings
    }

    /// The time at which a cycle begins.
    pub fn time_of(&self, cycle: Cycles) -> Time {
        self.shared.base.time_of(cycle)
    }

    /// The first cycle that begins at a time or later.
    pub fn cycle_of(&self, time: Time) -> Cycles {
        self.shared.base.cycle_of(time)
    }

    /// Conversions of ADC1 since the latest reset.
    pub fn conversions(&self) -> Conversions {
        self.units.adc.counts()
    }

    /// The longest that it took from the trigger of ADC1's injected group to the compare values of TIM1's
    /// first two channels: the reaction of a current loop, cycles.
    pub fn longest_reaction(&self) -> Cycles {
        self.longest_reaction
    }

    /// The clocks in force.
    pub fn clocks(&self) -> Clocks {
        self.shared.clocks
    }

    /// The bytes of the flash.
    pub fn flash(&mut self) -> &mut Vec<u8> {
        self.flash.bytes_mut()
    }

    /// The bytes of SRAM1 and SRAM2.
    pub fn sram(&mut self) -> &mut [u8] {
        &mut self.sram
    }

    /// Takes the reset that is due.
    pub fn take_reset(&mut self) -> Option<Cause> {
        self.reset.take()
    }

    /// Begins anew after a reset at this cycle: peripherals as the manual says, memories as they were.
    /// The core is not let go at once, see [`Self::is_held`].
    pub fn restart(&mut self, cause: Cause, cycle: Cycles) {
        self.shared.now = self.shared.now.max(cycle);
        self.begin(cause);
    }

    /// The power goes: all pins are let go, memories forget, and an operation of the flash is cut short.
    pub fn power_off(&mut self, cycle: Cycles) {
        self.scramble();
        self.restart(Cause::PowerOn, cycle);
    }

    fn begin(&mut self, cause: Cause) {
        let power_on = cause == Cause::PowerOn;
        let before = std::mem::replace(&mut self.units, Units::new());
        self.units.can1 = before.can1;
        let shared = &mut self.shared;
        shared.lines = 0;
        shared.effects.clear();
        for source in Source::ALL {
            shared.schedule(source, NEVER);
        }
        self.flash.reset(power_on, shared);
        self.units.can1.reset(shared);
        shared.clocks = Clocks::RESET;
        self.set_frequency(Clocks::RESET.hclk_hz);
        let (units, shared) = (&mut self.units, &mut self.shared);
        units.rcc.begin(before.rcc.kept(cause), cause, shared);
        if !power_on {
            units.debug = before.debug;
        }
        units.gpio.begin(&before.gpio, shared);
        if self.flash.starts_watchdog() {
            units.watchdog.start(shared);
        }
        for line in 0..16 {
            units.exti.begin(line, units.gpio.level(Pin::of(0, line)));
        }
        shared.volts = shared.surroundings.supply(shared.time());
        units.adc.set_reference(shared.volts);
        let low = pwr::holds(shared.volts, self.flash.brown_out(), power_on);
        self.sagged = low.then_some(shared.volts);
        (self.reset, self.nmi) = (None, false);
        self.settle();
        self.refresh();
    }

    /// Whether the core stands still although it has power: the supply is too low, the reset is not let
    /// go yet, or the core's clock has failed.
    pub fn is_held(&self) -> bool {
        self.sagged.is_some() || self.units.rcc.is_held()
    }

    /// A debugger halts the core at this cycle, or lets it go on: peripherals stop that the program has
    /// chosen in DBGMCU.
    pub fn halt(&mut self, halted: bool, cycle: Cycles) {
        self.shared.now = self.shared.now.max(cycle);
        if !halted || self.units.debug.stops_watchdog() {
            self.units.watchdog.freeze(halted, &mut self.shared);
        }
    }

    /// What static memory shows after power came on: nothing that a program may rely on.
    fn scramble(&mut self) {
        self.scrambles += 1;
        let mut random = Random::new(self.shared.part.seed ^ self.scrambles << 48);
        for byte in self.sram.iter_mut().chain(&mut self.ccm) {
            *byte = random.next() as u8;
        }
    }

    /// Looks anew when something around the chip changes; to be called after it was changed from
    /// outside.
    pub fn refresh(&mut self) {
        let at = self.shared.surroundings.next();
        let cycle = self.shared.base.cycle_of(at);
        self.shared.schedule(Source::Surroundings, cycle);
    }

    fn set_frequency(&mut self, hz: u64) {
        let now = self.shared.now;
        self.shared.base.set_frequency(now, hz);
        self.shared.clocks.hclk_hz = hz;
    }

    /// Calls what is around the chip for what is due now.
    fn advance_surroundings(&mut self) {
        let mut inputs = Inputs::default();
        let at = self.shared.time();
        self.shared.surroundings.advance(at, &mut inputs);
        for (pin, drive) in inputs.pins {
            self.units.gpio.external(pin, drive, &mut self.shared);
        }
        for byte in inputs.serial {
            self.units.usart3.receive(byte, &mut self.shared);
        }
        if let Some(works) = inputs.crystal {
            self.units.rcc.crystal(works, &mut self.shared);
        }
        if inputs.supply {
            self.supply(at);
        }
        self.settle();
        self.refresh();
    }

    /// The supply has changed.
    fn supply(&mut self, at: Time) {
        let volts = self.shared.surroundings.supply(at);
        let before = std::mem::replace(&mut self.shared.volts, volts);
        if before >= pwr::RETENTION_V && !(volts >= pwr::RETENTION_V) {
            self.scramble();
        }
        let level = self.flash.brown_out();
        self.units.adc.set_reference(volts);
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
                self.judge_clock(false);
            }
        }
        if self.sagged.is_some_and(pwr::is_off) {
            self.flash.power_failed();
        }
        self.shared.limit = 0;
    }

    /// Carries effects to those they concern until there are none.
    fn settle(&mut self) {
        while let Some(effect) = self.shared.effects.pop_front() {
            let (units, shared) = (&mut self.units, &mut self.shared);
            match effect {
                Effect::Trigger(trigger) => units.adc.trigger(trigger, shared),
                Effect::Dma(request) => self.serve(request),
                Effect::Uses(signal) => {
                    if units.gpio.pin_of(signal).is_none() {
                        shared.note(Kind::Pin, format!("{signal:?} is on no pin"));
                    }
                }
                Effect::Output(signal, drive) => units.gpio.output(signal, drive, shared),
                Effect::Level(pin, level) => self.level(pin, level),
                Effect::Driven(pin, drive) => {
                    let at = shared.time();
                    shared.surroundings.pin(pin, drive, at);
                    self.refresh();
                }
                Effect::Frequency(hz) => {
                    let old = self.shared.base;
                    let before = self.shared.clocks.hclk_hz;
                    self.set_frequency(hz);
                    self.clock_changed = true;
                    self.shared.limit = 0;
                    self.judge_clock(hz > before);
                    self.clocks_changed(&old);
                }
                Effect::ClockFailure => {
                    self.nmi = true;
                    shared.limit = 0;
                    units.tim1.clock_failure(shared);
                }
                Effect::Sampled(pin) => {
                    if !units.gpio.is_analogue(pin) {
                        shared.note(Kind::Pin, format!("{pin} is converted and not analogue"));
                    }
                }
                Effect::VoltageDetector(low) => units.exti.level(16, low, shared),
                Effect::ResetUnit(register, bit) => self.reset_unit(register, bit),
                Effect::Reset(cause) => {
                    self.reset = Some(cause);
                    self.shared.limit = 0;
                }
            }
        }
    }

    /// The program resets a peripheral.
    fn reset_unit(&mut self, register: u32, bit: u32) {
        let Some((unit, sources)) = Unit::reset_by(register, bit) else {
            return;
        };
        for &source in sources {
            self.shared.schedule(source, NEVER);
        }
        for &interrupt in unit.interrupts() {
            self.shared.line(interrupt, false);
        }
        let new = Units::new();
        let units = &mut self.units;
        match unit {
            Unit::Tim1 => units.tim1 = new.tim1,
            Unit::Tim2 => units.tim2 = new.tim2,
            Unit::Tim3 => units.tim3 = new.tim3,
            Unit::Tim4 => units.tim4 = new.tim4,
            Unit::Tim5 => units.tim5 = new.tim5,
            Unit::Adc => units.adc = new.adc,
            Unit::Dma1 => units.dma1 = new.dma1,
            Unit::Dma2 => units.dma2 = new.dma2,
            Unit::Spi1 => units.spi1 = new.spi1,
            Unit::Can1 => units.can1.reset(&mut self.shared),
            Unit::Usart3 => units.usart3 = new.usart3,
            Unit::Syscfg => units.syscfg = new.syscfg,
            Unit::Pwr => {
                units.pwr = new.pwr;
                // The detector is off.
                self.shared.effect(Effect::VoltageDetector(false));
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
                self.shared.effect(Effect::Level(pin, level));
            }
        }
        self.route_lines();
    }

    /// Lines of the external interrupts hear the ports that they listen to.
    fn route_lines(&mut self) {
        let (units, shared) = (&mut self.units, &mut self.shared);
        for line in 0..16 {
            let port = units.syscfg.port_of(line);
            let level = port < pin::PORTS && units.gpio.level(Pin::of(port, line));
            units.exti.level(line, level, shared);
        }
    }

    /// Whether the flash and the regulator can follow the core's clock at this supply (RM0090, tables
    /// 10 and 11). Wait states that are not needed are judged where the clock gets faster: before, they
    /// are in place for the clock to come.
    fn judge_clock(&mut self, faster: bool) {
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
            self.shared.note(Kind::ClockLimit, text);
        }
    }

    fn clocks_changed(&mut self, old: &Timebase) {
        let (u, shared) = (&mut self.units, &mut self.shared);
        let units: [&mut dyn Peripheral; 14] = [
            &mut u.rcc,
            &mut u.watchdog,
            &mut u.tim1,
            &mut u.tim2,
            &mut u.tim3,
            &mut u.tim4,
            &mut u.tim5,
            &mut u.adc,
            &mut u.dma1,
            &mut u.dma2,
            &mut u.spi1,
            &mut u.can1,
            &mut u.usart3,
            &mut self.flash,
        ];
        for unit in units {
            unit.clocks_changed(old, shared);
        }
        self.refresh();
    }

    /// A pin has another level.
    fn level(&mut self, pin: Pin, level: bool) {
        let (units, shared) = (&mut self.units, &mut self.shared);
        let port = units.syscfg.port_of(pin.number());
        if port == pin.port() {
            units.exti.level(pin.number(), level, shared);
        }
        match units.gpio.signal_at(pin) {
            Some(signal @ Signal::Tim1Bkin) => units.tim1.input(signal, level, shared),
            Some(signal @ (Signal::Tim3Ch1 | Signal::Tim3Ch2)) => {
                units.tim3.input(signal, level, shared)
            }
            Some(signal @ (Signal::Tim4Ch1 | Signal::Tim4Ch2)) => {
                units.tim4.input(signal, level, shared)
            }
            _ => {}
        }
    }

    /// One transfer of a DMA controller: it says from where to where, the chip moves the datum.
    fn serve(&mut self, request: Request) {
        for controller in [dma::Controller::Dma1, dma::Controller::Dma2] {
            let dma = match controller {
                dma::Controller::Dma1 => &mut self.units.dma1,
                dma::Controller::Dma2 => &mut self.units.dma2,
            };
            let Some(transfer) = dma.begin(request) else {
                continue;
            };
            let value = self.dma_read(transfer.from, transfer.width);
            let written =
                value.and_then(|value| self.dma_write(transfer.to, transfer.width, value));
            let dma = match controller {
                dma::Controller::Dma1 => &mut self.units.dma1,
                dma::Controller::Dma2 => &mut self.units.dma2,
            };
            let last = dma.end(transfer, written.is_ok(), &mut self.shared);
            if last && request == Request::Adc1 {
                self.units.adc.block_ended();
            }
        }
    }

    fn dma_read(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        match Unit::at(address) {
            Some((unit, offset)) => self.read_unit(unit, offset, width),
            None => self.memory_read(address, width),
        }
    }

    fn dma_write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        match Unit::at(address) {
            Some((unit, offset)) => self.write_unit(unit, offset, width, value),
            // The core-coupled memory is the core's alone.
            None if address >= SRAM => self.memory_write(address, width, value),
            None => Err(BusError),
        }
    }

    fn memory(&mut self, address: u32) -> Option<(&mut Vec<u8>, usize)> {
        let at = address.wrapping_sub(SRAM) as usize;
        if at < SRAM_LENGTH {
            return Some((&mut self.sram, at));
        }
        let at = address.wrapping_sub(CCM) as usize;
        (at < CCM_LENGTH).then_some((&mut self.ccm, at))
    }

    fn memory_read(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        if let Some(value) = self.flash.peek(address, width) {
            return Ok(value);
        }
        let (bytes, at) = self.memory(address).ok_or(BusError)?;
        Ok(get(bytes, at, width))
    }

    fn memory_write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        let (bytes, at) = self.memory(address).ok_or(BusError)?;
        put(bytes, at, width, value);
        Ok(())
    }

    fn unit(&mut self, unit: Unit) -> (&mut dyn Peripheral, &mut Shared) {
        let u = &mut self.units;
        let peripheral: &mut dyn Peripheral = match unit {
            Unit::Rcc => &mut u.rcc,
            Unit::Pwr => &mut u.pwr,
            Unit::Gpio => &mut u.gpio,
            Unit::Exti => &mut u.exti,
            Unit::Syscfg => &mut u.syscfg,
            Unit::Tim1 => &mut u.tim1,
            Unit::Tim2 => &mut u.tim2,
            Unit::Tim3 => &mut u.tim3,
            Unit::Tim4 => &mut u.tim4,
            Unit::Tim5 => &mut u.tim5,
            Unit::Adc => &mut u.adc,
            Unit::Dma1 => &mut u.dma1,
            Unit::Dma2 => &mut u.dma2,
            Unit::Spi1 => &mut u.spi1,
            Unit::Can1 => &mut u.can1,
            Unit::Usart3 => &mut u.usart3,
            Unit::Watchdog => &mut u.watchdog,
            Unit::Debug => &mut u.debug,
            Unit::Flash => &mut self.flash,
        };
        (peripheral, &mut self.shared)
    }

    /// Judges an access; whether it may go on.
    fn judge(
        &mut self,
        unit: Unit,
        offset: u32,
        width: Width,
        write: Option<u32>,
    ) -> Option<Register> {
        let name = unit.name_at(offset);
        if let Some((register, bit)) = unit.gate(offset)
            && !self.units.rcc.is_enabled(register, bit)
        {
            self.shared
                .note(Kind::ClockGated, format!("{name}: its clock is off"));
            return None;
        }
        if let Some((register, bit)) = unit.gate(offset)
            && self.units.rcc.is_in_reset(register, bit)
        {
            let text = format!("{name}: the program holds it in reset");
            self.shared.note(Kind::Forbidden, text);
            return None;
        }
        let place = unit.register_offset(offset) & !3;
        let (peripheral, shared) = self.unit(unit);
        let registers = peripheral.registers();
        let Ok(found) = registers.binary_search_by_key(&place, |register| register.offset) else {
            shared.note(Kind::Unmapped, format!("{name}: no register at {place:#x}"));
            return None;
        };
        let register = registers[found];
        if width != Width::Word && !register.narrow {
            let text = format!(
                "{name}_{}: {} bits wide access",
                register.name,
                8 * width.bytes()
            );
            shared.note(Kind::Alignment, text);
        }
        if let Some(value) = write
            && value & !register.bits != 0
        {
            let extra = value & !register.bits;
            let text = format!(
                "{name}_{}: reserved bits {extra:#010x} written",
                register.name
            );
            shared.note(Kind::ReservedBit, text);
        }
        Some(register)
    }

    fn read_unit(&mut self, unit: Unit, offset: u32, width: Width) -> Result<u32, BusError> {
        let shift = 8 * (offset & 3);
        if self.judge(unit, offset, width, None).is_none() {
            return Ok(0);
        }
        let (peripheral, shared) = self.unit(unit);
        let value = peripheral.read(offset & !3, shared) >> shift;
        self.settle();
        Ok(match width {
            Width::Byte => value & 0xff,
            Width::Half => value & 0xffff,
            Width::Word => value,
        })
    }

    fn write_unit(
        &mut self,
        unit: Unit,
        offset: u32,
        width: Width,
        value: u32,
    ) -> Result<(), BusError> {
        let shift = 8 * (offset & 3);
        let mask = match width {
            Width::Byte => 0xff << shift,
            Width::Half => 0xffff << shift,
            Width::Word => !0,
        };
        let value = value << shift & mask;
        if self.judge(unit, offset, width, Some(value)).is_none() {
            return Ok(());
        }
        if unit == Unit::Rcc && offset & !3 == rcc::BDCR && !self.units.pwr.is_backup_open() {
            let text = "RCC_BDCR written while PWR_CR.DBP is clear";
            self.shared.note(Kind::Forbidden, text);
            return Ok(());
        }
        let (peripheral, shared) = self.unit(unit);
        peripheral.write(offset & !3, value, mask, shared);
        if unit == Unit::Tim1 && (0x34..=0x38).contains(&offset) && self.units.adc.started() > 0 {
            let took = self.shared.now.saturating_sub(self.units.adc.started());
            self.longest_reaction = self.longest_reaction.max(took);
        }
        self.settle();
        match unit {
            Unit::Flash | Unit::Pwr => self.judge_clock(false),
            Unit::Syscfg => self.route_lines(),
            Unit::Exti => self.judge_lines(),
            // A stream that was just switched on finds the request that waits.
            Unit::Dma1 | Unit::Dma2 => {
                self.units.adc.ask(&mut self.shared);
                self.settle();
            }
            _ => {}
        }
        if std::mem::take(&mut self.shared.bus_error) {
            return Err(BusError);
        }
        Ok(())
    }

    /// Whether pins float that the program waits for as external interrupts.
    fn judge_lines(&mut self) {
        let units = &self.units;
        for line in (0..16).filter(|&line| units.exti.listens(line)) {
            let port = units.syscfg.port_of(line);
            if port < pin::PORTS {
                units.gpio.judge(Pin::of(port, line), &mut self.shared);
            }
        }
    }

    /// Brings everything up to the moment of an access.
    fn arrive(&mut self, pc: u32, cycle: Cycles) {
        if self.shared.next().1 <= cycle {
            self.advance(cycle, cycle);
            self.shared.limit = 0;
        }
        (self.shared.now, self.shared.pc) = (cycle, pc);
    }

    /// Notes an access to a peripheral that the chip has but the model has not.
    fn is_not_modelled(&mut self, address: u32) -> bool {
        let name = map::not_modelled(address);
        if let Some(name) = name {
            self.shared.note(Kind::NotModelled, name);
        }
        name.is_some()
    }

    #[cold]
    #[inline(never)]
    fn read_cold(
        &mut self,
        address: u32,
        width: Width,
        pc: u32,
        cycle: &mut Cycles,
    ) -> Result<u32, BusError> {
        if let Some((unit, offset)) = Unit::at(address) {
            self.arrive(pc, *cycle);
            *cycle += unit.bus_cycles(&self.shared.clocks);
            return self.read_unit(unit, offset, width);
        }
        if let Some(value) = self.flash.load(address, width, cycle, &mut self.shared) {
            return value;
        }
        let found = self.memory_read(address, width);
        if found.is_err() {
            self.arrive(pc, *cycle);
            if self.is_not_modelled(address) {
                return Ok(0);
            }
            self.shared
                .note(Kind::Unmapped, format!("read at {address:#010x}"));
        }
        found
    }

    #[cold]
    #[inline(never)]
    fn write_cold(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        pc: u32,
        cycle: &mut Cycles,
    ) -> Result<(), BusError> {
        self.arrive(pc, *cycle);
        if let Some((unit, offset)) = Unit::at(address) {
            *cycle += unit.bus_cycles(&self.shared.clocks);
            let done = self.write_unit(unit, offset, width, value);
            *cycle = (*cycle).max(std::mem::take(&mut self.shared.held_until));
            return done;
        }
        if let Some(done) = self
            .flash
            .program(address, width, value, cycle, &mut self.shared)
        {
            self.settle();
            return done;
        }
        let done = self.memory_write(address, width, value);
        if done.is_err() {
            if self.is_not_modelled(address) {
                return Ok(());
            }
            self.shared
                .note(Kind::Unmapped, format!("write at {address:#010x}"));
        }
        done
    }
}

fn get(bytes: &[u8], at: usize, width: Width) -> u32 {
    match width {
        Width::Byte => bytes.get(at).copied().unwrap_or(0).into(),
        Width::Half => bytes
            .get(at..at + 2)
            .map_or(0, |b| u16::from_le_bytes([b[0], b[1]]).into()),
        Width::Word => bytes
            .get(at..at + 4)
            .map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
    }
}

fn put(bytes: &mut [u8], at: usize, width: Width, value: u32) {
    let value = value.to_le_bytes();
    let length = width.bytes() as usize;
    if let Some(place) = bytes.get_mut(at..at + length) {
        place.copy_from_slice(&value[..length]);
    }
}

impl System for Chip {
    fn fetch(&mut self, address: u32) -> Result<u16, BusError> {
        self.memory_read(address, Width::Half)
            .map(|value| value as u16)
    }

    #[inline]
    fn enter_line(&mut self, address: u32, cycle: &mut Cycles) {
        self.flash.enter_line(address, cycle, &mut self.shared);
    }

    #[inline]
    fn read(
        &mut self,
        address: u32,
        width: Width,
        pc: u32,
        cycle: &mut Cycles,
    ) -> Result<u32, BusError> {
        let at = address.wrapping_sub(SRAM) as usize;
        if at < SRAM_LENGTH {
            return Ok(get(&self.sram, at, width));
        }
        if address.wrapping_sub(FLASH) < 1 << 20
            && let Some(value) = self.flash.load(address, width, cycle, &mut self.shared)
        {
            return value;
        }
        self.read_cold(address, width, pc, cycle)
    }

    #[inline]
    fn write(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        pc: u32,
        cycle: &mut Cycles,
    ) -> Result<(), BusError> {
        let at = address.wrapping_sub(SRAM) as usize;
        if at < SRAM_LENGTH {
            put(&mut self.sram, at, width, value);
            return Ok(());
        }
        self.write_cold(address, width, value, pc, cycle)
    }

    #[inline]
    fn limit(&self) -> Cycles {
        self.shared.limit
    }

    fn advance(&mut self, cycle: Cycles, until: Cycles) -> Cycles {
        self.must_pause = std::mem::take(&mut self.clock_changed);
        loop {
            let (source, at) = self.shared.next();
            if at > cycle || self.reset.is_some() {
                self.shared.limit = at.min(until);
                return at;
            }
            self.shared.now = at;
            self.shared.schedule(source, NEVER);
            let (units, shared) = (&mut self.units, &mut self.shared);
            match source {
                Source::Surroundings => self.advance_surroundings(),
                Source::Rcc => units.rcc.event(source, shared),
                Source::Flash => self.flash.event(source, shared),
                Source::Watchdog => units.watchdog.event(source, shared),
                Source::Tim1 => units.tim1.event(source, shared),
                Source::Tim2 => units.tim2.event(source, shared),
                Source::Tim3 => units.tim3.event(source, shared),
                Source::Tim4 => units.tim4.event(source, shared),
                Source::Tim5 => units.tim5.event(source, shared),
                Source::Adc | Source::AdcInjected => units.adc.event(source, shared),
                Source::Dma1 => units.dma1.event(source, shared),
                Source::Dma2 => units.dma2.event(source, shared),
                Source::Spi1 => units.spi1.event(source, shared),
                Source::Can1 => units.can1.event(source, shared),
                Source::Usart3 => units.usart3.event(source, shared),
            }
            self.settle();
        }
    }

    fn lines(&self) -> u128 {
        self.shared.lines
    }

    fn take_nmi(&mut self) -> bool {
        std::mem::take(&mut self.nmi)
    }

    fn take_changed_code(&mut self) -> Option<(u32, u32)> {
        self.flash.take_changed()
    }

    fn must_stop(&self) -> bool {
        // With another clock it is another cycle at which the core has come far enough.
        self.reset.is_some() || self.must_pause || self.clock_changed || self.sagged.is_some()
    }

    fn request_reset(&mut self) {
        self.shared.note(Kind::Reset, "by the program");
        self.reset = Some(Cause::Software);
        self.shared.limit = 0;
    }

    fn note(&mut self, kind: Kind, pc: u32, cycle: Cycles, text: String) {
        let at = self.shared.base.time_of(cycle);
        self.shared.findings.note(kind, pc, at, text);
    }
}
