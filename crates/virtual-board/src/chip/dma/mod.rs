//! DMA controllers.
//!
//! Source: reference manual RM0090, chapter 10. Requests of ADC1 and USART3 are connected. A request is served at once:
//! the time of arbitration and buses, about ten cycles, is omitted, so the memory port is never late. An item for a
//! peripheral is read from memory when the peripheral requests the item; the chip reads the item one request earlier. A
//! stream that is disabled stops at once and sets TCIF.
//!
//! A stream does not start while one of its flags is set (forbidden by the manual). Such a start is a finding; so is
//! writing the setup of a running stream, which has no effect.
//!
//! Not modelled: FIFO, double buffers, memory-to-memory transfers, incremented peripheral addresses, the peripheral as
//! flow controller, bursts. Enabling a stream that needs one of these is a finding, and the stream does not start.

mod stream;
#[cfg(test)]
mod tests;

use super::Peripheral;
use super::effect::Request;
use super::interrupt::Interrupt;
use super::register::{Register, word};
use super::shared::Shared;
use crate::core::Width;
use crate::finding::FindingKind;
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

/// DMA controller of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Controller {
    Dma1,
    Dma2,
}

/// Stream and channel of each request (RM0090, tables of the request mapping).
#[rustfmt::skip]
const REQUESTS: [(Controller, usize, u32, Request); 5] = [
    (Controller::Dma1, 1, 4, Request::Usart3Rx), (Controller::Dma1, 3, 4, Request::Usart3Tx),
    (Controller::Dma1, 4, 7, Request::Usart3Tx), (Controller::Dma2, 0, 0, Request::Adc1),
    (Controller::Dma2, 4, 0, Request::Adc1),
];

/// Position of a stream's lowest flag in the status register.
fn shift(stream: usize) -> u32 {
    [0, 6, 16, 22][stream % 4]
}

#[derive(Clone)]
pub(crate) struct Dma {
    controller: Controller,
    streams: [Stream; 8],
    /// Enabled stream that serves each request; `None` if there is no such stream.
    assigned_streams: [Option<usize>; Request::COUNT],
}

impl Dma {
    /// A controller after a reset.
    pub fn new(controller: Controller) -> Self {
        Self {
            controller,
            streams: [Stream::new(); 8],
            assigned_streams: [None; Request::COUNT],
        }
    }

    fn name(&self, stream: usize) -> String {
        format!("DMA{} stream {stream}", self.controller as usize + 1)
    }

    /// Enabled stream that serves a request; `None` if there is no such stream.
    pub fn assigned_stream(&self, request: Request) -> Option<usize> {
        self.assigned_streams[request as usize]
    }

    /// Next transfer of a stream: source address, destination address, width.
    pub fn item(&self, stream: usize) -> (u32, u32, Width) {
        self.streams[stream].item()
    }

    /// Records that an item was transferred, or a bus error if not `done`. True if a block ended.
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
            shared.note(FindingKind::Fault, text);
        }
        if ended || !done {
            self.assign_streams();
        }
        if self.streams[stream].flags != 0 {
            self.line(stream, shared);
        }
        ended
    }

    /// Finds the stream that serves each request.
    fn assign_streams(&mut self) {
        self.assigned_streams = [None; Request::COUNT];
        for &(controller, stream, channel, request) in REQUESTS.iter().rev() {
            let s = &self.streams[stream];
            if controller == self.controller && s.is_on() && s.channel() == channel && s.ndtr > 0 {
                self.assigned_streams[request as usize] = Some(stream);
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
            // While the stream runs, only the interrupt enables and EN may change.
            if (value ^ s.cr) & !(EN | interrupts) != 0 {
                self.refuse(k, "set up while it runs", shared);
            }
            let s = &mut self.streams[k];
            s.cr = s.cr & !(EN | interrupts) | value & (EN | interrupts);
            if value & EN == 0 {
                // According to the manual, TCIF shows that the last transfer has ended.
                s.flags |= TCIF;
                self.assign_streams();
            }
        } else {
            s.cr = value & !EN;
            if value & EN != 0 && self.may_start(k, shared) {
                let s = &mut self.streams[k];
                s.cr |= EN;
                s.begin();
                self.assign_streams();
            }
        }
        self.line(k, shared);
    }

    fn refuse(&self, k: usize, why: &str, shared: &mut Shared) {
        shared.note(FindingKind::Forbidden, format!("{}: {why}", self.name(k)));
    }

    /// Checks the setup of a stream; true if the stream starts.
    fn may_start(&self, k: usize, shared: &mut Shared) -> bool {
        let s = &self.streams[k];
        if s.flags != 0 {
            self.refuse(k, "switched on with flags set", shared);
            return false;
        }
        let unknown = PFCTRL | PINC | DBM | BURSTS;
        if s.cr & DIR > TO_PERIPHERAL || s.cr & unknown != 0 || s.fcr & DMDIS != 0 {
            let what = "FIFO, double buffers, memory to memory, PINC, flow control, bursts";
            shared.note(
                FindingKind::NotModelled,
                format!("{}: {what}", self.name(k)),
            );
            return false;
        }
        if s.ndtr == 0 {
            self.refuse(k, "switched on with NDTR = 0", shared);
        }
        let width = s.width().bytes();
        if !s.peripheral.is_multiple_of(width) || !s.memory[0].is_multiple_of(width) {
            let text = format!("{}: an address is not aligned to its width", self.name(k));
            shared.note(FindingKind::Alignment, text);
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
            // The FIFO is always empty.
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
