//! What happens at the pins of boards, in their interrupts and on their bus, as a Value Change Dump.
//!
//! A scope for each board: its pins (the ports of the 64-pin package), a level for each exception that
//! has a handler of its own, high from its entry to its return with what preempts it, and the name
//! of the one that runs. A scope for the bus: its level, 0 for dominant, and the frame that is sent.

use super::vcd::{Dump, Form, NOTHING, Signal, Value};
use crate::chip::Pin;
use crate::image::Image;
use crate::network::Network;
use crate::time::Time;
use crate::wire::{Id, Level, Record};
use std::io;

/// Changes are written so much later: by then all that came before is told.
const DELAY: Time = Time::from_micros(2_000);

/// An exception's handler.
struct Handler {
    number: u16,
    name: String,
    signal: Signal,
}

/// A board's signals.
struct BoardSignals {
    pins: Vec<(Pin, Signal)>,
    handlers: Vec<Handler>,
    running: Signal,
    /// Exceptions that have not returned, the one that runs last.
    active: Vec<u16>,
}

/// A dump of a network that is being written.
pub struct Waves<W: io::Write> {
    dump: Dump<W>,
    boards: Vec<BoardSignals>,
    level: Signal,
    frame: Signal,
}

/// The pins of a package with 64.
fn pins() -> impl Iterator<Item = Pin> {
    let ports = ['A', 'B', 'C'].into_iter();
    let pins = ports.flat_map(|port| (0..16).map(move |number| Pin::new(port, number)));
    pins.chain([Pin::new('D', 2)])
}

fn value(level: Option<bool>) -> Value {
    level.map_or(Value::HighZ, Value::Level)
}

impl<W: io::Write> Waves<W> {
    /// A dump of the boards of a network, each with its name and image, from now on.
    pub fn new(writer: W, network: &mut Network, boards: &[(&str, &Image)]) -> Self {
        let mut dump = Dump::new(writer);
        let mut signals = Vec::new();
        let now = network.now();
        for (&(name, image), board) in boards.iter().zip(network.boards()) {
            let scope = |part: &str| format!("{name}/{part}");
            let mut pin_signals = Vec::new();
            for pin in pins() {
                let signal = dump.register(&scope("pins"), &pin.to_string(), Form::Wire);
                dump.change(now, signal, value(board.chip().pin_level(pin)));
                pin_signals.push((pin, signal));
            }
            let mut handlers = Vec::new();
            for (number, name) in image.handlers() {
                let signal = dump.register(&scope("interrupts"), &name, Form::Wire);
                dump.change(now, signal, Value::Level(false));
                handlers.push(Handler {
                    number,
                    name,
                    signal,
                });
            }
            let running = dump.register(&scope("interrupts"), "exception", Form::Text);
            signals.push(BoardSignals {
                pins: pin_signals,
                handlers,
                running,
                active: Vec::new(),
            });
            board.chip().trace_pins();
            board.core_mut().trace_exceptions();
        }
        let level = dump.register("bus", "level", Form::Wire);
        let frame = dump.register("bus", "frame", Form::Text);
        dump.change(now, level, Value::Level(true));
        network.wire().trace();
        Self {
            dump,
            boards: signals,
            level,
            frame,
        }
    }

    /// A sending on the bus that has ended.
    pub fn frame(&mut self, record: &Record) {
        let id = match record.frame.id() {
            Id::Standard(id) => format!("{id:03x}"),
            Id::Extended(id) => format!("{id:08x}"),
        };
        let data: String = record
            .frame
            .data()
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        let error = record
            .error
            .map_or_else(String::new, |error| format!("!{error:?}"));
        let text = Value::Text(format!("{id}#{data}{error}"));
        self.dump.change(record.start, self.frame, text);
        self.dump
            .change(record.end, self.frame, Value::Text(NOTHING.to_owned()));
    }

    /// Writes what has happened since the last call.
    pub fn follow(&mut self, network: &mut Network) -> io::Result<()> {
        for (signals, board) in self.boards.iter_mut().zip(network.boards()) {
            for change in board.chip().take_pins() {
                let of_pin = |(pin, _): &&(Pin, Signal)| *pin == change.pin;
                if let Some(&(_, signal)) = signals.pins.iter().find(of_pin) {
                    self.dump.change(change.at, signal, value(change.level));
                }
            }
            for event in board.core_mut().take_exceptions() {
                let at = board.chip().time_of(event.cycle);
                signals.exception(&mut self.dump, at, event.exception, event.begins);
            }
        }
        for (at, level) in network.wire().take_levels() {
            let level = Value::Level(level == Level::Recessive);
            self.dump.change(at, self.level, level);
        }
        self.dump.flush(network.now() - DELAY)
    }

    /// Writes the rest and ends the file.
    pub fn finish(mut self, network: &mut Network) -> io::Result<()> {
        self.follow(network)?;
        self.dump.finish(network.now())
    }
}

impl BoardSignals {
    /// An exception begins or ends.
    fn exception<W: io::Write>(&mut self, dump: &mut Dump<W>, at: Time, number: u16, begins: bool) {
        let mut ended = Vec::new();
        match (number, begins) {
            (0, _) => ended = std::mem::take(&mut self.active),
            (_, true) => self.active.push(number),
            (_, false) => {
                self.active.retain(|other| *other != number);
                ended.push(number);
            }
        }
        let handler = |number: u16| self.handlers.iter().find(|h| h.number == number);
        let mut show = |number: u16, level: bool| {
            if let Some(handler) = handler(number) {
                dump.change(at, handler.signal, Value::Level(level));
            }
        };
        ended.into_iter().for_each(|number| show(number, false));
        if begins {
            show(number, true);
        }
        let running = self.active.last().copied();
        let name = running.map(|number| {
            handler(number).map_or_else(|| number.to_string(), |handler| handler.name.clone())
        });
        let name = name.unwrap_or_else(|| NOTHING.to_owned());
        dump.change(at, self.running, Value::Text(name));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Board;
    use crate::chip::Bare;
    use crate::image::tests::Builder;
    use crate::wire::Wire;
    use std::collections::BTreeMap;
    use vcd::{Command, Parser};

    /// Switches SysTick on, with interrupts, whose handler never returns:
    /// `ldr r1, =0xe000e010; movs r0, #100; str r0, [r1, #4]; movs r0, #7; str r0, [r1]; b .`
    fn image() -> Image {
        let code = [
            0x03, 0x49, 0x64, 0x20, 0x48, 0x60, 0x07, 0x20, 0x08, 0x60, 0xfe, 0xe7, 0xfe, 0xe7, 0,
            0, 0x10, 0xe0, 0x00, 0xe0,
        ];
        let mut builder = Builder::new(&code).function("SysTick", 0x0800_010c, 2);
        builder.segments[0].2[15 * 4..16 * 4].copy_from_slice(&0x0800_010du32.to_le_bytes());
        builder.image()
    }

    #[test]
    fn pins_have_the_levels_of_a_reset_and_exceptions_begin() {
        let image = image();
        assert_eq!(image.handlers(), [(15, "SysTick".to_owned())]);
        let mut board = Board::new(Box::new(Bare), 0);
        board.flash(&image);
        let quantum = Time::from_micros(40);
        let mut network = Network::new(vec![board], Wire::new(1, quantum, 1), quantum, 1);
        let mut file = Vec::new();
        let mut waves = Waves::new(&mut file, &mut network, &[("one", &image)]);
        if let Some(board) = network.board(0) {
            board.power(true);
        }
        for ms in 1..=5 {
            network.run_until(Time::from_micros(1000 * ms));
            waves.follow(&mut network).unwrap();
        }
        waves.finish(&mut network).unwrap();
        let mut parser = Parser::new(&file[..]);
        let header = parser.parse_header().unwrap();
        let mut last = BTreeMap::new();
        for command in parser {
            if let Command::ChangeScalar(id, value) = command.unwrap() {
                last.insert(id, value);
            }
        }
        let of = |path: &[&str]| last[&header.find_var(path).unwrap().code];
        // RM0090, 8.3.1: the debug port's pins are pulled up, but its clock down; the others float.
        for (pin, level) in [
            ("PA13", vcd::Value::V1),
            ("PA14", vcd::Value::V0),
            ("PA15", vcd::Value::V1),
            ("PB4", vcd::Value::V1),
            ("PC7", vcd::Value::Z),
        ] {
            assert_eq!(of(&["one", "pins", pin]), level, "{pin}");
        }
        assert_eq!(of(&["one", "interrupts", "SysTick"]), vcd::Value::V1);
        assert_eq!(of(&["bus", "level"]), vcd::Value::V1);
    }
}
