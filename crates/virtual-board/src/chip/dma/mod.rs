//! DMA controllers.
//!
//! Source: reference manual RM0090, chapter 10. Requests of ADC1, SPI1 and USART3 are connected. A
//! request is served at once: what arbitration and the buses take, some ten cycles, is left out, so that
//! the memory port is never late and neither FIFO nor direct mode errors come up. A stream that is
//! switched off stops at once and says so by TCIF.
//!
//! A stream that is switched on with flags of its own up does not start (the manual forbids it): that
//! and setting up a stream that runs are findings and change nothing.
//!
//! Not modelled: transfers from memory to memory, the peripheral as flow controller, bursts; a stream
//! that is to do one is a finding and does not start.

mod stream;
#[cfg(test)]
mod tests;

use super::Peripheral;
use super::effect::Request;
use super::interrupt::Interrupt;
use super::register::{Register, word};
use super::shared::Shared;
use crate::core::Width;
use crate::finding::Kind;
pub(crate) use stream::Step;
use stream::*;

macro_rules! streams {
    ($($k:literal)*) => {
        &[
            word(0x00, "LISR", 0x0f7d_0f7d), word(0x04, "HISR", 0x0f7d_0f7d),
            word(0x08, "LIFCR", 0x0f7d_0f7d), word(0x0c, "HIFCR", 0x0f7d_0f7d),
            $(
                word(0x10 + 0x18 * $k, concat!("S", $k, "CR"), 0x0fef_ffff),
                word(0x14 + 0x18 * $k, concat!("S", $k, "NDTR"), 0xffff),
                word(0x18 + 0x18 * $k, concat!("S", $k, "PAR"), !0),
                word(0x1c + 0x18 * $k, concat!("S", $k, "M0AR"), !0),
                word(0x20 + 0x18 * $k, concat!("S", $k, "M1AR"), !0),
                word(0x24 + 0x18 * $k, concat!("S", $k, "FCR"), 0xbf),
            )*
        ]
    };
}

const REGISTERS: &[Register] = streams!(0 1 2 3 4 5 6 7);

/// Which controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Controller {
    Dma1,
    Dma2,
}

/// Stream and channel of a request (RM0090, tables of the requests' mapping).
#[rustfmt::skip]
const REQUESTS: [(Controller, usize, u32, Request); 9] = [
    (Controller::Dma1, 1, 4, Request::Usart3Rx), (Controller::Dma1, 3, 4, Request::Usart3Tx),
    (Controller::Dma1, 4, 7, Request::Usart3Tx), (Controller::Dma2, 0, 0, Request::Adc1),
    (Controller::Dma2, 4, 0, Request::Adc1), (Controller::Dma2, 0, 3, Request::Spi1Rx),
    (Controller::Dma2, 2, 3, Request::Spi1Rx), (Controller::Dma2, 3, 3, Request::Spi1Tx),
    (Controller::Dma2, 5, 3, Request::Spi1Tx),
];

/// First bit of a stream's flags in its status register.
fn shift(stream: usize) -> u32 {
    [0, 6, 16, 22][stream % 4]
}

/// A controller.
pub(crate) struct Dma {
    controller: Controller,
    streams: [Stream; 8],
    /// The stream that listens to each request.
    listeners: [Option<usize>; Request::COUNT],
}

impl Dma {
    /// A controller after a reset.
    pub fn new(controller: Controller) -> Self {
        Self {
            controller,
            streams: [Stream::new(); 8],
            listeners: [None; Request::COUNT],
        }
    }

    fn name(&self, stream: usize) -> String {
        format!("DMA{} stream {stream}", self.controller as usize + 1)
    }

    /// The stream that listens to a request.
    pub fn listener(&self, request: Request) -> Option<usize> {
        self.listeners[request as usize]
    }

    /// How a stream without FIFO serves a request of a peripheral towards memory: from where, to where.
    pub fn direct(&self, stream: usize) -> Option<(u32, u32, Width)> {
        self.streams[stream].direct()
    }

    /// An item went that way, or met a bus error. Whether a block ended.
    pub fn moved(&mut self, stream: usize, done: bool, shared: &mut Shared) -> bool {
        if !done {
            let (from, _, width) = self.direct(stream).unwrap_or((0, 0, Width::Byte));
            self.done(stream, Step::Read(from, width), None, shared);
        } else {
            self.streams[stream].moved();
        }
        self.end(stream, shared)
    }

    /// A peripheral asks a stream for a transfer: its steps are then to be made.
    pub fn begin(&mut self, stream: usize) {
        self.streams[stream].ask();
    }

    /// The next access that a stream makes.
    pub fn step(&mut self, stream: usize) -> Option<Step> {
        self.streams[stream].step()
    }

    /// An access was made, with what was read; or it met a bus error.
    pub fn done(&mut self, stream: usize, step: Step, result: Option<u32>, shared: &mut Shared) {
        if let Some(value) = result {
            return self.streams[stream].done(value);
        }
        self.streams[stream].fail();
        let (verb, place) = match step {
            Step::Read(place, _) => ("reading", place),
            Step::Write(place, ..) => ("writing", place),
        };
        let text = format!("{}: bus error {verb} {place:#010x}", self.name(stream));
        shared.note(Kind::Fault, text);
        self.listen();
    }

    /// All accesses that belong to a request are made. Whether a block ended.
    pub fn end(&mut self, stream: usize, shared: &mut Shared) -> bool {
        let ended = self.streams[stream].settle();
        if ended {
            self.listen();
        }
        if self.streams[stream].flags != 0 {
            self.line(stream, shared);
        }
        ended
    }

    /// Which stream listens to what.
    fn listen(&mut self) {
        self.listeners = [None; Request::COUNT];
        for &(controller, stream, channel, request) in REQUESTS.iter().rev() {
            let s = &self.streams[stream];
            if controller == self.controller && s.is_on() && s.channel() == channel && s.ndtr > 0 {
                self.listeners[request as usize] = Some(stream);
            }
        }
    }

    fn line(&self, stream: usize, shared: &mut Shared) {
        let line = Interrupt::OF_STREAMS[self.controller as usize][stream];
        shared.line(line, self.streams[stream].active());
    }

    fn status(&self, high: usize) -> u32 {
        let streams = self.streams.iter().enumerate().skip(4 * high).take(4);
        streams.fold(0, |bits, (k, stream)| bits | stream.flags << shift(k))
    }

    fn clear(&mut self, high: usize, value: u32, shared: &mut Shared) {
        for k in 4 * high..4 * high + 4 {
            self.streams[k].flags &= !(value >> shift(k) & 0x3d);
            self.line(k, shared);
        }
    }

    fn write_cr(&mut self, k: usize, value: u32, shared: &mut Shared) {
        let s = &mut self.streams[k];
        let interrupts = TCIE | HTIE | TEIE | DMEIE;
        if s.is_on() {
            // Only the interrupts may be changed, and the stream switched off. CT shows a state.
            if (value ^ s.cr) & !(EN | interrupts | CT) != 0 {
                self.refuse(k, "set up while it runs", shared);
            }
            let s = &mut self.streams[k];
            s.cr = s.cr & !(EN | interrupts) | value & (EN | interrupts);
            if value & EN == 0 {
                s.end();
                // The manual's way to tell that the last transfer has ended.
                s.flags |= TCIF;
                self.listen();
            }
        } else {
            s.cr = value & !EN;
            if value & EN != 0 && self.may_start(k, shared) {
                let s = &mut self.streams[k];
                s.cr |= EN;
                s.begin();
                self.listen();
            }
        }
        self.line(k, shared);
    }

    fn refuse(&self, k: usize, why: &str, shared: &mut Shared) {
        shared.note(Kind::Forbidden, format!("{}: {why}", self.name(k)));
    }

    /// Judges how a stream is set up; whether it starts.
    fn may_start(&self, k: usize, shared: &mut Shared) -> bool {
        let s = &self.streams[k];
        if s.flags != 0 {
            self.refuse(k, "switched on with flags up", shared);
            return false;
        }
        let unknown = s.cr & DIR > TO_PERIPHERAL || s.cr & (PFCTRL | BURSTS) != 0;
        if unknown {
            let what = "memory to memory, flow control, bursts";
            shared.note(Kind::NotModelled, format!("{}: {what}", self.name(k)));
            return false;
        }
        if s.ndtr == 0 {
            self.refuse(k, "switched on without data", shared);
        }
        let (peripheral, memory) = (s.peripheral_width().bytes(), s.memory_width().bytes());
        let double = s.cr & DBM != 0;
        if !s.peripheral.is_multiple_of(peripheral)
            || !s.memory[0].is_multiple_of(memory)
            || double && !s.memory[1].is_multiple_of(memory)
        {
            let text = format!("{}: an address is not aligned to its width", self.name(k));
            shared.note(Kind::Alignment, text);
        }
        if !(s.ndtr * peripheral).is_multiple_of(memory) {
            self.refuse(k, "a block is not whole memory items", shared);
        }
        true
    }

    fn write_fcr(&mut self, k: usize, value: u32, shared: &mut Shared) {
        let s = &mut self.streams[k];
        if s.is_on() && (value ^ s.fcr) & (DMDIS | 3) != 0 {
            s.fcr = s.fcr & !FEIE | value & FEIE;
            self.refuse(k, "set up while it runs", shared);
        } else {
            s.fcr = value & (FEIE | DMDIS | 3);
        }
        self.line(k, shared);
    }

    /// Writes an address of memory. The buffer that is not in use may be changed at any time; changing
    /// the other is an error of the transfer.
    fn write_memory(&mut self, k: usize, which: usize, value: u32, shared: &mut Shared) {
        let s = &mut self.streams[k];
        let in_use = usize::from(s.cr & CT != 0) == which;
        if !s.is_on() || s.cr & DBM != 0 && !in_use {
            s.memory[which] = value;
            return;
        }
        if s.cr & DBM != 0 {
            s.fail();
            self.listen();
        }
        self.refuse(k, "set up while it runs", shared);
        self.line(k, shared);
    }
}

impl Peripheral for Dma {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, _shared: &mut Shared) -> u32 {
        let Some(within) = offset.checked_sub(0x10) else {
            return if offset < 8 {
                self.status(offset as usize / 4)
            } else {
                0
            };
        };
        let s = &self.streams[within as usize / 0x18];
        match within % 0x18 {
            0x00 => s.cr,
            0x04 => s.ndtr,
            0x08 => s.peripheral,
            0x0c => s.memory[0],
            0x10 => s.memory[1],
            _ => s.fifo_control(),
        }
    }

    fn write(&mut self, offset: u32, value: u32, _mask: u32, shared: &mut Shared) {
        let Some(within) = offset.checked_sub(0x10) else {
            if offset >= 8 {
                self.clear((offset as usize - 8) / 4, value, shared);
            }
            return;
        };
        let k = within as usize / 0x18;
        let on = self.streams[k].is_on();
        match within % 0x18 {
            0x00 => self.write_cr(k, value, shared),
            0x04 | 0x08 if on => self.refuse(k, "set up while it runs", shared),
            0x04 => self.streams[k].ndtr = value & 0xffff,
            0x08 => self.streams[k].peripheral = value,
            0x0c => self.write_memory(k, 0, value, shared),
            0x10 => self.write_memory(k, 1, value, shared),
            _ => self.write_fcr(k, value, shared),
        }
    }
}
