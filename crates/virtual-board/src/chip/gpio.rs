//! Ports: modes, levels, alternate functions.
//!
//! Source: reference manual RM0090, chapter 8. A pin's level follows its strongest driver: an output of chip or circuit
//! first, then the circuit's resistors, then the chip's. Findings:
//!
//! - an output of the chip against a driver in the circuit
//! - a pin that the board itself uses ([`Net`])
//! - a floating pin that a peripheral uses as its input
//! - a floating pin in input mode that the circuit has driven before, when the port's input register is read: a read
//!   returns all pins of the port, so a pin that was never driven is assumed to be unused
//!
//! A floating pin reads low.
//!
//! Not modelled: speeds (stored only), analogue levels between the thresholds, locked settings (a finding).

use super::Peripheral;
use super::effect::Effect;
use super::net::{Net, Usable};
use super::pin::{ALTERNATE, Drive, PORTS, Pin, Signal};
use super::register::{Register, merge, narrow, word};
use super::shared::Shared;
use crate::finding::FindingKind;

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    narrow(0x00, "MODER", !0), narrow(0x04, "OTYPER", 0xffff), narrow(0x08, "OSPEEDR", !0), narrow(0x0c, "PUPDR", !0),
    narrow(0x10, "IDR", 0xffff), narrow(0x14, "ODR", 0xffff), narrow(0x18, "BSRR", !0), word(0x1c, "LCKR", 0x1_ffff),
    narrow(0x20, "AFRL", !0), narrow(0x24, "AFRH", !0),
];

const PINS: usize = PORTS * 16;

#[derive(Clone, Copy, Debug, Default)]
struct Port {
    mode: u32,
    open_drain: u32,
    speed: u32,
    pull: u32,
    output: u32,
    alternate: [u32; 2],
}

// Modes of a pin.
const INPUT: u32 = 0;
const OUTPUT: u32 = 1;
const ALTERNATE_FUNCTION: u32 = 2;
const ANALOGUE: u32 = 3;

impl Port {
    /// Registers after a reset; the debug port's pins are configured.
    fn new(index: usize) -> Self {
        let (mode, speed, pull) = match index {
            0 => (0xa800_0000, 0x0c00_0000, 0x6400_0000),
            1 => (0x0000_0280, 0x0000_00c0, 0x0000_0100),
            _ => (0, 0, 0),
        };
        Self {
            mode,
            speed,
            pull,
            ..Self::default()
        }
    }

    fn mode_of(&self, number: u32) -> u32 {
        self.mode >> (2 * number) & 3
    }

    fn alternate_of(&self, number: u32) -> u32 {
        self.alternate[number as usize / 8] >> (4 * (number % 8)) & 15
    }
}

/// Level of a pin driven by chip and circuit; `None` if the pin floats.
fn combined_level(chip: Drive, circuit: Drive) -> Option<bool> {
    match (chip, circuit) {
        (Drive::Low, _) | (_, Drive::Low) => Some(false),
        (Drive::High, _) | (_, Drive::High) => Some(true),
        // The circuit's resistors win: those of the chip have 40 kΩ.
        (_, Drive::PullDown) => Some(false),
        (_, Drive::PullUp) => Some(true),
        (Drive::PullDown, Drive::Open) => Some(false),
        (Drive::PullUp, Drive::Open) => Some(true),
        (Drive::Open, Drive::Open) => None,
    }
}

/// Marks an unused element of [`Routes::pins`].
const NOWHERE: u8 = u8::MAX;
/// Largest number of pins that one signal can be routed to.
const CHOICES: usize = 4;

/// Routing of signals to pins by modes and alternate functions.
#[derive(Clone)]
struct Routes {
    signals: [Option<Signal>; PINS],
    pins: [[u8; CHOICES]; Signal::COUNT],
}

impl Routes {
    fn of(ports: &[Port; PORTS]) -> Self {
        let mut routes = Self {
            signals: [None; PINS],
            pins: [[NOWHERE; CHOICES]; Signal::COUNT],
        };
        let is_on = |function: u32, pin: &&Pin| {
            let (port, number) = (&ports[pin.port()], pin.number());
            port.mode_of(number) == ALTERNATE_FUNCTION && port.alternate_of(number) == function
        };
        for &(signal, function, pins) in ALTERNATE {
            let chosen = pins.iter().filter(|pin| is_on(function, pin));
            for (place, pin) in routes.pins[signal as usize].iter_mut().zip(chosen) {
                routes.signals[pin.index()] = Some(signal);
                *place = pin.index() as u8;
            }
        }
        routes
    }
}

/// All ports.
#[derive(Clone)]
pub(crate) struct Gpio {
    ports: [Port; PORTS],
    routes: Routes,
    /// Drive of each pin by the circuit; outlives a reset.
    circuit: [Drive; PINS],
    /// Pins that the circuit has driven at least once.
    connected: [bool; PINS],
    /// Drive of each pin by the chip.
    chip: [Drive; PINS],
    level: [bool; PINS],
    /// Drive of each peripheral output.
    signals: [Drive; Signal::COUNT],
    /// Nets of the board.
    nets: [Option<&'static Net>; PINS],
}

impl Default for Gpio {
    fn default() -> Self {
        let ports = std::array::from_fn(Port::new);
        Self {
            ports,
            routes: Routes::of(&ports),
            circuit: [Drive::Open; PINS],
            connected: [false; PINS],
            chip: [Drive::Open; PINS],
            level: [false; PINS],
            signals: [Drive::Open; Signal::COUNT],
            nets: [None; PINS],
        }
    }
}

impl Gpio {
    /// Starts from the reset state; `before` holds the ports before the reset.
    pub fn begin(&mut self, before: &Self, shared: &mut Shared) {
        (self.circuit, self.connected) = (before.circuit, before.connected);
        (self.chip, self.level) = (before.chip, before.level);
        for net in shared.circuit().nets() {
            self.nets[net.pin.index()] = Some(net);
        }
        for port in 0..PORTS {
            self.update(port, shared);
        }
    }

    /// Resets a port by its bit in the RCC.
    pub fn reset(&mut self, port: usize, shared: &mut Shared) {
        self.ports[port] = Port::new(port);
        self.routes = Routes::of(&self.ports);
        self.update(port, shared);
    }

    /// Sets the circuit's drive of a pin.
    pub fn external(&mut self, pin: Pin, drive: Drive, shared: &mut Shared) {
        self.connected[pin.index()] |= drive != Drive::Open;
        if drive.is_strong() {
            self.check_net(pin, Usable::Input, "the circuit", shared);
        }
        self.circuit[pin.index()] = drive;
        self.settle(pin, shared);
    }

    /// Sets a peripheral's drive of its output.
    pub fn output(&mut self, signal: Signal, drive: Drive, shared: &mut Shared) {
        self.signals[signal as usize] = drive;
        for at in self.routes.pins[signal as usize] {
            if at == NOWHERE {
                return;
            }
            self.drive(Pin::at(at), shared);
        }
    }

    /// Peripheral signal routed to a pin; `None` if there is no such signal.
    pub fn signal_at(&self, pin: Pin) -> Option<Signal> {
        self.routes.signals[pin.index()]
    }

    /// First pin that a peripheral signal is routed to; `None` if the signal is routed to no pin.
    pub fn pin_of(&self, signal: Signal) -> Option<Pin> {
        let at = self.routes.pins[signal as usize][0];
        (at != NOWHERE).then(|| Pin::at(at))
    }

    pub fn is_analogue(&self, pin: Pin) -> bool {
        self.ports[pin.port()].mode_of(pin.number()) == ANALOGUE
    }

    /// Level of a pin at the chip's digital input.
    pub fn level(&self, pin: Pin) -> bool {
        self.level[pin.index()]
    }

    /// Drive of a pin by the chip.
    #[cfg(test)]
    pub fn driven(&self, pin: Pin) -> Drive {
        self.chip[pin.index()]
    }

    /// True if a pin is not analogue and neither chip nor circuit drives or pulls it.
    pub fn floats(&self, pin: Pin) -> bool {
        let drives = (self.chip[pin.index()], self.circuit[pin.index()]);
        !self.is_analogue(pin) && drives == (Drive::Open, Drive::Open)
    }

    /// Records a finding if the pin, which is read, floats.
    pub fn check_level(&self, pin: Pin, shared: &mut Shared) {
        if self.floats(pin) {
            shared.note(FindingKind::Pin, format!("{pin} floats and is read"));
        }
    }

    /// Records a finding if the pin's net is driven against its permitted use.
    fn check_net(&self, pin: Pin, usage: Usable, driver: &str, shared: &mut Shared) {
        if let Some(net) = self.nets[pin.index()]
            && net.usable != usage
        {
            let Net { name, part, .. } = net;
            let text = format!("{pin} is the board's net {name} ({part}), and {driver} drives it");
            shared.note(FindingKind::Pin, text);
        }
    }

    /// Recomputes all pins of a port.
    fn update(&mut self, port: usize, shared: &mut Shared) {
        for number in 0..16 {
            self.drive(Pin::of(port, number), shared);
        }
    }

    /// Recomputes the chip's drive of a pin.
    fn drive(&mut self, pin: Pin, shared: &mut Shared) {
        let (port, number) = (&self.ports[pin.port()], pin.number());
        let mode = port.mode_of(number);
        let wanted = match mode {
            OUTPUT => Drive::to(port.output >> number & 1 != 0),
            ALTERNATE_FUNCTION => self
                .signal_at(pin)
                .map_or(Drive::Open, |signal| self.signals[signal as usize]),
            _ => Drive::Open,
        };
        if wanted.is_strong() {
            self.check_net(pin, Usable::Output, "the program", shared);
        }
        let pull = match port.pull >> (2 * number) & 3 {
            1 if mode != ANALOGUE => Drive::PullUp,
            2 if mode != ANALOGUE => Drive::PullDown,
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

    /// Recomputes the level of a pin.
    fn settle(&mut self, pin: Pin, shared: &mut Shared) {
        let (chip, circuit) = (self.chip[pin.index()], self.circuit[pin.index()]);
        if chip.is_strong() && circuit.is_strong() && chip != circuit {
            let text = format!("{pin} and the circuit drive opposite levels");
            shared.note(FindingKind::Pin, text);
        }
        // An analogue pin has no digital input.
        let level = !self.is_analogue(pin) && combined_level(chip, circuit).unwrap_or(false);
        if self.level[pin.index()] != level {
            self.level[pin.index()] = level;
            shared.effect(Effect::Level { pin, high: level });
        }
    }

    /// Levels of a port in the input register.
    fn input(&self, port: usize, shared: &mut Shared) -> u32 {
        let mut bits = 0;
        for number in 0..16 {
            let pin = Pin::of(port, number);
            bits |= u32::from(self.level(pin)) << number;
            if self.connected[pin.index()] && self.ports[port].mode_of(number) == INPUT {
                self.check_level(pin, shared);
            }
        }
        bits
    }

    /// Sets and resets single outputs (BSRR); if both are requested, set wins.
    fn set_and_reset(&mut self, index: usize, value: u32, shared: &mut Shared) {
        let output = &mut self.ports[index].output;
        let before = *output;
        *output = before & !(value >> 16) | value & 0xffff;
        let mut changed = *output ^ before;
        while changed != 0 {
            let number = changed.trailing_zeros();
            changed &= changed - 1;
            self.drive(Pin::of(index, number), shared);
        }
    }

    /// Reports the present level of each pin whose mode or function has changed to an alternate function.
    fn emit_levels(&self, index: usize, before: &Port, shared: &mut Shared) {
        let now = &self.ports[index];
        for number in 0..16 {
            let setting = |port: &Port| (port.mode_of(number), port.alternate_of(number));
            if setting(before) != setting(now) && now.mode_of(number) == ALTERNATE_FUNCTION {
                let pin = Pin::of(index, number);
                shared.effect(Effect::Level {
                    pin,
                    high: self.level(pin),
                });
            }
        }
    }
}

impl Peripheral for Gpio {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        let (index, offset) = (offset as usize / 0x400, offset % 0x400);
        let port = &self.ports[index];
        match offset {
            0x00 => port.mode,
            0x04 => port.open_drain,
            0x08 => port.speed,
            0x0c => port.pull,
            0x10 => self.input(index, shared),
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
        let register = match offset {
            0x00 => &mut port.mode,
            0x04 => &mut port.open_drain,
            0x08 => &mut port.speed,
            0x0c => &mut port.pull,
            0x14 => &mut port.output,
            0x18 => return self.set_and_reset(index, value, shared),
            0x1c => return shared.note(FindingKind::NotModelled, "GPIO: locked settings"),
            0x20 => &mut port.alternate[0],
            0x24 => &mut port.alternate[1],
            _ => return shared.note(FindingKind::Forbidden, "GPIO_IDR is read only"),
        };
        *register = merge(*register, value, mask);
        if matches!(offset, 0x00 | 0x20 | 0x24) {
            self.routes = Routes::of(&self.ports);
        }
        self.update(index, shared);
        self.emit_levels(index, &before, shared);
    }
}

#[cfg(test)]
mod tests;
