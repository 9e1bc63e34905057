//! Ports: modes, levels, alternate functions.
//!
//! Source: reference manual RM0090, chapter 8. A pin's level is that of the strongest side that drives
//! it: chip or world, then the resistors of either. An output and the world against each other is a
//! finding, and so is reading a pin that nobody drives.
//!
//! Not modelled: speeds (kept), analogue levels between the thresholds.

use super::Peripheral;
use super::pin::{ALTERNATE, Drive, PORTS, Pin, Signal};
use super::register::{Register, merge, narrow, word};
use super::shared::{Effect, Shared};
use crate::finding::Kind;

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    narrow(0x00, "MODER", !0), narrow(0x04, "OTYPER", 0xffff), narrow(0x08, "OSPEEDR", !0), narrow(0x0c, "PUPDR", !0),
    narrow(0x10, "IDR", 0xffff), narrow(0x14, "ODR", 0xffff), narrow(0x18, "BSRR", !0), word(0x1c, "LCKR", 0x1_ffff),
    narrow(0x20, "AFRL", !0), narrow(0x24, "AFRH", !0),
];

const PINS: usize = PORTS * 16;

/// Registers of a port.
#[derive(Clone, Copy, Debug, Default)]
struct Port {
    mode: u32,
    open_drain: u32,
    speed: u32,
    pull: u32,
    output: u32,
    alternate: [u32; 2],
}

impl Port {
    fn mode_of(&self, number: u32) -> u32 {
        self.mode >> (2 * number) & 3
    }

    fn alternate_of(&self, number: u32) -> u32 {
        self.alternate[number as usize / 8] >> (4 * (number % 8)) & 15
    }
}

/// How two drives meet.
fn meet(chip: Drive, world: Drive) -> Option<bool> {
    match (chip, world) {
        (Drive::Low, _) | (_, Drive::Low) => Some(false),
        (Drive::High, _) | (_, Drive::High) => Some(true),
        // The world's resistors are the stronger: those of the chip have 40 kΩ.
        (_, Drive::PullDown) => Some(false),
        (_, Drive::PullUp) => Some(true),
        (Drive::PullDown, Drive::Open) => Some(false),
        (Drive::PullUp, Drive::Open) => Some(true),
        (Drive::Open, Drive::Open) => None,
    }
}

/// All ports.
pub(crate) struct Gpio {
    ports: [Port; PORTS],
    /// How the world drives each pin; it outlives a reset.
    world: [Drive; PINS],
    /// How the chip does.
    chip: [Drive; PINS],
    level: [bool; PINS],
    /// How peripherals drive their outputs.
    signals: [Drive; Signal::COUNT],
}

impl Default for Gpio {
    fn default() -> Self {
        let mut ports = [Port::default(); PORTS];
        // The debug port's pins.
        (ports[0].mode, ports[0].speed, ports[0].pull) = (0xa800_0000, 0x0c00_0000, 0x6400_0000);
        (ports[1].mode, ports[1].speed, ports[1].pull) = (0x0000_0280, 0x0000_00c0, 0x0000_0100);
        Self {
            ports,
            world: [Drive::Open; PINS],
            chip: [Drive::Open; PINS],
            level: [false; PINS],
            signals: [Drive::Open; Signal::COUNT],
        }
    }
}

impl Gpio {
    /// After a reset of a chip whose pins were as `before`.
    pub fn begin(&mut self, before: &Self, shared: &mut Shared) {
        (self.world, self.chip, self.level) = (before.world, before.chip, before.level);
        for port in 0..PORTS {
            self.update(port, shared);
        }
    }

    /// The world drives a pin in another way.
    pub fn external(&mut self, pin: Pin, drive: Drive, shared: &mut Shared) {
        self.world[pin.index()] = drive;
        self.settle(pin, shared);
    }

    /// A peripheral drives its output in another way.
    pub fn output(&mut self, signal: Signal, drive: Drive, shared: &mut Shared) {
        self.signals[signal as usize] = drive;
        for &(pin, _, of) in ALTERNATE {
            if of == signal && self.signal_at(pin) == Some(signal) {
                self.drive(pin, shared);
            }
        }
    }

    /// The peripheral's signal that a pin is connected to.
    pub fn signal_at(&self, pin: Pin) -> Option<Signal> {
        let port = &self.ports[pin.port()];
        if port.mode_of(pin.number()) != 2 {
            return None;
        }
        let function = port.alternate_of(pin.number());
        let found = ALTERNATE
            .iter()
            .find(|(at, number, _)| *at == pin && *number == function);
        found.map(|(_, _, signal)| *signal)
    }

    /// The pin that a peripheral's signal is on.
    pub fn pin_of(&self, signal: Signal) -> Option<Pin> {
        let mut pins = ALTERNATE.iter().filter(|(_, _, of)| *of == signal);
        pins.find(|(pin, _, _)| self.signal_at(*pin) == Some(signal))
            .map(|(pin, _, _)| *pin)
    }

    /// Whether a pin is set to be analogue.
    pub fn is_analogue(&self, pin: Pin) -> bool {
        self.ports[pin.port()].mode_of(pin.number()) == 3
    }

    /// Level of a pin.
    pub fn level(&self, pin: Pin) -> bool {
        self.level[pin.index()]
    }

    /// How the chip drives a pin.
    pub fn driven(&self, pin: Pin) -> Drive {
        self.chip[pin.index()]
    }

    /// The pins of a port anew.
    fn update(&mut self, port: usize, shared: &mut Shared) {
        for number in 0..16 {
            self.drive(Pin::of(port, number), shared);
        }
    }

    /// How the chip drives a pin, anew.
    fn drive(&mut self, pin: Pin, shared: &mut Shared) {
        let (port, number) = (&self.ports[pin.port()], pin.number());
        let wanted = match port.mode_of(number) {
            1 => Drive::to(port.output >> number & 1 != 0),
            2 => self
                .signal_at(pin)
                .map_or(Drive::Open, |signal| self.signals[signal as usize]),
            _ => Drive::Open,
        };
        let pull = match (port.mode_of(number), port.pull >> (2 * number) & 3) {
            (3, _) => Drive::Open,
            (_, 1) => Drive::PullUp,
            (_, 2) => Drive::PullDown,
            _ => Drive::Open,
        };
        let open_drain = port.open_drain >> number & 1 != 0;
        let drive = match wanted {
            Drive::High if open_drain => pull,
            Drive::Open => pull,
            drive => drive,
        };
        if self.chip[pin.index()] != drive {
            self.chip[pin.index()] = drive;
            shared.effect(Effect::Driven(pin, drive));
        }
        self.settle(pin, shared);
    }

    /// The level of a pin anew.
    fn settle(&mut self, pin: Pin, shared: &mut Shared) {
        let (chip, world) = (self.chip[pin.index()], self.world[pin.index()]);
        if chip.is_strong() && world.is_strong() && chip != world {
            shared.note(
                Kind::Pin,
                format!("{pin} is driven against what is soldered to it"),
            );
        }
        let level = meet(chip, world).unwrap_or(false);
        if self.level[pin.index()] != level {
            self.level[pin.index()] = level;
            shared.effect(Effect::Level(pin, level));
        }
    }

    /// Levels of a port as its input register shows them.
    fn input(&self, port: usize) -> u32 {
        (0..16)
            .filter(|&number| self.ports[port].mode_of(number) != 3)
            .fold(0, |bits, number| {
                bits | u32::from(self.level(Pin::of(port, number))) << number
            })
    }
}

impl Peripheral for Gpio {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        let (index, offset) = (offset as usize / 0x400, offset % 0x400);
        let port = &self.ports[index];
        match offset {
            0x00 => port.mode,
            0x04 => port.open_drain,
            0x08 => port.speed,
            0x0c => port.pull,
            0x10 => self.input(index),
            0x14 => port.output,
            0x20 => port.alternate[0],
            0x24 => port.alternate[1],
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let (index, offset) = (offset as usize / 0x400, offset % 0x400);
        let port = &mut self.ports[index];
        let before = *port;
        let set = |register: &mut u32| *register = merge(*register, value, mask);
        match offset {
            0x00 => set(&mut port.mode),
            0x04 => set(&mut port.open_drain),
            0x08 => return set(&mut port.speed),
            0x0c => set(&mut port.pull),
            0x14 => set(&mut port.output),
            0x18 => {
                // Setting wins where both are asked for.
                port.output = port.output & !(value >> 16) | value & 0xffff;
                let mut changed = port.output ^ before.output;
                while changed != 0 {
                    let number = changed.trailing_zeros();
                    changed &= changed - 1;
                    self.drive(Pin::of(index, number), shared);
                }
                return;
            }
            0x1c => shared.note(Kind::NotModelled, "GPIO_LCKR"),
            0x20 => set(&mut port.alternate[0]),
            0x24 => set(&mut port.alternate[1]),
            _ => shared.note(Kind::Forbidden, "GPIO_IDR is read only"),
        }
        self.update(index, shared);
        // An input that a peripheral listens to now hears the level that is there.
        for number in 0..16 {
            let pin = Pin::of(index, number);
            let was = (before.mode_of(number), before.alternate_of(number));
            let is = (
                self.ports[index].mode_of(number),
                self.ports[index].alternate_of(number),
            );
            if was != is && is.0 == 2 {
                shared.effect(Effect::Level(pin, self.level(pin)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    const PB13: Pin = Pin::new('B', 13);
    const PORT_B: u32 = 0x400;

    #[test]
    fn an_output_drives_its_pin_and_the_world_hears_of_it() {
        let (mut gpio, mut shared) = (Gpio::default(), shared());
        gpio.begin(&Gpio::default(), &mut shared);
        shared.effects.clear();
        gpio.write(PORT_B + 0x18, 1 << 13, !0, &mut shared);
        assert!(shared.effects.is_empty(), "still an input");
        gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
        let effects: Vec<_> = shared.effects.drain(..).collect();
        assert_eq!(
            effects,
            [Effect::Driven(PB13, Drive::High), Effect::Level(PB13, true)]
        );
        // The half that resets.
        gpio.write(PORT_B + 0x18, 1 << 29, 0xffff_0000, &mut shared);
        assert_eq!(gpio.read(PORT_B + 0x10, &mut shared) >> 13 & 1, 0);
        assert_eq!(gpio.read(PORT_B + 0x14, &mut shared), 0);
    }

    #[test]
    fn pulls_give_way_to_what_is_soldered_and_conflicts_are_found() {
        let (mut gpio, mut shared) = (Gpio::default(), shared());
        gpio.write(PORT_B + 0x0c, 0x100 | 1 << 26, !0, &mut shared);
        assert!(gpio.level(PB13));
        gpio.external(PB13, Drive::PullDown, &mut shared);
        assert!(!gpio.level(PB13));
        gpio.external(PB13, Drive::High, &mut shared);
        assert!(gpio.level(PB13) && shared.findings.list().is_empty());
        gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
        assert_eq!(shared.findings.list().len(), 1);
    }

    #[test]
    fn a_signal_reaches_the_pin_that_has_its_function() {
        let (mut gpio, mut shared) = (Gpio::default(), shared());
        gpio.output(Signal::Tim1Ch1, Drive::High, &mut shared);
        gpio.write(0x24, 1, 0xf, &mut shared);
        gpio.write(0x00, 0xa800_0000 | 2 << 16, !0, &mut shared);
        assert_eq!(gpio.pin_of(Signal::Tim1Ch1), Some(Pin::new('A', 8)));
        assert!(gpio.level(Pin::new('A', 8)));
        gpio.output(Signal::Tim1Ch1, Drive::Low, &mut shared);
        assert!(!gpio.level(Pin::new('A', 8)));
    }

    #[test]
    fn a_reset_lets_the_chips_pins_go_and_the_worlds_stay() {
        let (mut gpio, mut shared) = (Gpio::default(), shared());
        gpio.external(Pin::new('C', 13), Drive::Low, &mut shared);
        gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
        gpio.write(PORT_B + 0x18, 1 << 13, !0, &mut shared);
        shared.effects.clear();
        let mut after = Gpio::default();
        after.begin(&gpio, &mut shared);
        assert!(shared.effects.contains(&Effect::Driven(PB13, Drive::Open)));
        assert_eq!(after.world[Pin::new('C', 13).index()], Drive::Low);
    }
}
