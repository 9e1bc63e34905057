//! DMA controllers.
//!
//! Source: reference manual RM0090, chapter 10. Requests of ADC1 and USART3 are connected. A
//! request is served at once: what arbitration and the buses take, some ten cycles, is left out, so that
//! the memory port is never late. An item for a peripheral is read at the request, where the chip has it
//! one request earlier. A stream that is switched off stops at once and says so by TCIF.
//!
//! A stream that is switched on with flags of its own up does not start (the manual forbids it): that
//! and setting up a stream that runs are findings and change nothing.
//!
//! Not modelled: the FIFO, double buffers, transfers from memory to memory, addresses of peripherals that
//! go on, the peripheral as flow controller, bursts; a stream that is to do one is a finding and does not
//! start.

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
const REQUESTS: [(Controller, usize, u32, Request); 5] = [
    (Controller::Dma1, 1, 4, Request::Usart3Rx), (Controller::Dma1, 3, 4, Request::Usart3Tx),
    (Controller::Dma1, 4, 7, Request::Usart3Tx), (Controller::Dma2, 0, 0, Request::Adc1),
    (Controller::Dma2, 4, 0, Request::Adc1),
];

/// First bit of a stream's flags in its status register.
fn shift(stream: usize) -> u32 {
    [0, 6, 16, 22][stream % 4]
}

/// A controller.
#[derive(Clone)]
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

    /// The next item of a stream: from where, to where.
    pub fn item(&self, stream: usize) -> (u32, u32, Width) {
        self.streams[stream].item()
    }

    /// An item was moved, or met a bus error. True if a block ended.
    pub fn moved(&mut self, stream: usize, done: bool, shared: &mut Shared) -> bool {
        let s = &mut self.streams[stream];
        let ended = done && s.moved();
        if !done {
            s.fail();
            let (from, to, _) = s.item();
            let text = format!(
                "{}: bus error from {from:#010x} to {to:#010x}",
                self.name(stream)
            );
            shared.note(Kind::Fault, text);
        }
        if ended || !done {
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
            // Only the interrupts may be changed, and the stream switched off.
            if (value ^ s.cr) & !(EN | interrupts) != 0 {
                self.refuse(k, "set up while it runs", shared);
            }
            let s = &mut self.streams[k];
            s.cr = s.cr & !(EN | interrupts) | value & (EN | interrupts);
            if value & EN == 0 {
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
        let unknown = PFCTRL | PINC | DBM | BURSTS;
        if s.cr & DIR > TO_PERIPHERAL || s.cr & unknown != 0 || s.fcr & DMDIS != 0 {
            let what = "FIFO, double buffers, memory to memory, PINC, flow control, bursts";
            shared.note(Kind::NotModelled, format!("{}: {what}", self.name(k)));
            return false;
        }
        if s.ndtr == 0 {
            self.refuse(k, "switched on without data", shared);
        }
        let width = s.width().bytes();
        if !s.peripheral.is_multiple_of(width) || !s.memory[0].is_multiple_of(width) {
            let text = format!("{}: an address is not aligned to its width", self.name(k));
            shared.note(Kind::Alignment, text);
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
            // The FIFO is empty.
            _ => s.fcr & !0x38 | 4 << 3,
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
            0x04..=0x10 if on => self.refuse(k, "set up while it runs", shared),
            0x04 => self.streams[k].ndtr = value & 0xffff,
            0x08 => self.streams[k].peripheral = value,
            0x0c => self.streams[k].memory[0] = value,
            0x10 => self.streams[k].memory[1] = value,
            _ => self.write_fcr(k, value, shared),
        }
    }
}
