//! DMA controllers.
//!
//! Source: reference manual RM0090, chapter 10. A request is served at once: what the bus takes, some
//! ten cycles, is left out, and the FIFO is taken to be emptied at once, so that data are packed as the
//! manual says and come a little early. The requests of ADC1, SPI1 and USART3 are connected.
//!
//! Not modelled: transfers from memory to memory, the peripheral as flow controller, bursts; asking for
//! one is a finding.

use super::Peripheral;
use super::interrupt::Interrupt;
use super::register::{Register, word};
use super::shared::{Request, Shared, Source};
use crate::core::Width;
use crate::finding::Kind;

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

/// Stream and channel of a request (RM0090, tables 42 and 43).
#[rustfmt::skip]
const REQUESTS: &[(Controller, usize, u32, Request)] = &[
    (Controller::Dma1, 1, 4, Request::Usart3Rx), (Controller::Dma1, 3, 4, Request::Usart3Tx),
    (Controller::Dma1, 4, 7, Request::Usart3Tx), (Controller::Dma2, 0, 0, Request::Adc1),
    (Controller::Dma2, 4, 0, Request::Adc1), (Controller::Dma2, 0, 3, Request::Spi1Rx),
    (Controller::Dma2, 2, 3, Request::Spi1Rx), (Controller::Dma2, 3, 3, Request::Spi1Tx),
    (Controller::Dma2, 5, 3, Request::Spi1Tx),
];

const LINES: [[Interrupt; 8]; 2] = {
    use Interrupt::*;
    [
        [
            Dma1Stream0,
            Dma1Stream1,
            Dma1Stream2,
            Dma1Stream3,
            Dma1Stream4,
            Dma1Stream5,
            Dma1Stream6,
            Dma1Stream7,
        ],
        [
            Dma2Stream0,
            Dma2Stream1,
            Dma2Stream2,
            Dma2Stream3,
            Dma2Stream4,
            Dma2Stream5,
            Dma2Stream6,
            Dma2Stream7,
        ],
    ]
};

// Bits of SxCR.
const EN: u32 = 1;
const TEIE: u32 = 1 << 2;
const HTIE: u32 = 1 << 3;
const TCIE: u32 = 1 << 4;
const DMEIE: u32 = 1 << 1;
const CIRC: u32 = 1 << 8;
const PINC: u32 = 1 << 9;
const MINC: u32 = 1 << 10;
const DBM: u32 = 1 << 18;
const CT: u32 = 1 << 19;
// Flags of a stream.
const DMEIF: u32 = 1 << 2;
const TEIF: u32 = 1 << 3;
const HTIF: u32 = 1 << 4;
const TCIF: u32 = 1 << 5;

/// First bit of a stream's flags in its status register.
fn shift(stream: usize) -> u32 {
    [0, 6, 16, 22][stream % 4]
}

/// One datum to be moved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transfer {
    pub stream: usize,
    pub from: u32,
    pub to: u32,
    pub width: Width,
}

#[derive(Clone, Copy, Debug, Default)]
struct Stream {
    cr: u32,
    ndtr: u32,
    peripheral: u32,
    memory: [u32; 2],
    fcr: u32,
    flags: u32,
    /// Items of a block, and of it those moved.
    block: u32,
    moved: u32,
}

impl Stream {
    fn width(&self) -> Width {
        [Width::Byte, Width::Half, Width::Word, Width::Word][(self.cr >> 11 & 3) as usize]
    }

    fn is_on(&self) -> bool {
        self.cr & EN != 0
    }

    fn active(&self) -> bool {
        let on = |flag: u32, enable: u32| self.flags & flag != 0 && self.cr & enable != 0;
        on(TCIF, TCIE) || on(HTIF, HTIE) || on(TEIF, TEIE) || on(DMEIF, DMEIE)
    }
}

/// A controller.
pub(crate) struct Dma {
    controller: Controller,
    streams: [Stream; 8],
}

impl Dma {
    /// A controller after a reset.
    pub fn new(controller: Controller) -> Self {
        let stream = Stream {
            fcr: 0x21,
            ..Stream::default()
        };
        Self {
            controller,
            streams: [stream; 8],
        }
    }

    /// A peripheral asks for a transfer: the one to be made, if a stream listens.
    pub fn begin(&mut self, request: Request) -> Option<Transfer> {
        let listens = |(controller, stream, channel, of): &&(Controller, usize, u32, Request)| {
            let s = &self.streams[*stream];
            *of == request
                && *controller == self.controller
                && s.is_on()
                && s.cr >> 25 & 7 == *channel
        };
        let &(_, stream, ..) = REQUESTS.iter().find(listens)?;
        let s = &self.streams[stream];
        let width = s.width();
        let along = s.moved * width.bytes();
        let peripheral = s.peripheral + if s.cr & PINC != 0 { along } else { 0 };
        let memory = s.memory[usize::from(s.cr & CT != 0)];
        let memory = memory + if s.cr & MINC != 0 { along } else { 0 };
        let (from, to) = match s.cr >> 6 & 3 {
            1 => (memory, peripheral),
            _ => (peripheral, memory),
        };
        Some(Transfer {
            stream,
            from,
            to,
            width,
        })
    }

    /// The transfer was made, or met a bus error. Whether it was the last of a block.
    pub fn end(&mut self, transfer: Transfer, done: bool, shared: &mut Shared) -> bool {
        let s = &mut self.streams[transfer.stream];
        if !done {
            s.flags |= TEIF;
            s.cr &= !EN;
            let (from, to) = (transfer.from, transfer.to);
            shared.note(
                Kind::Fault,
                format!("DMA: bus error from {from:#010x} to {to:#010x}"),
            );
            self.line(transfer.stream, shared);
            return false;
        }
        s.moved += 1;
        s.ndtr -= 1;
        if s.ndtr == s.block / 2 {
            s.flags |= HTIF;
        }
        let last = s.ndtr == 0;
        if last {
            s.flags |= TCIF;
            s.moved = 0;
            if s.cr & (CIRC | DBM) != 0 {
                s.ndtr = s.block;
                if s.cr & DBM != 0 {
                    s.cr ^= CT;
                }
            } else {
                s.cr &= !EN;
            }
        }
        if s.flags & s.cr << 1 & (TCIF | HTIF) != 0 {
            self.line(transfer.stream, shared);
        }
        last
    }

    fn line(&self, stream: usize, shared: &mut Shared) {
        let line = LINES[self.controller as usize][stream];
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
        if s.is_on() {
            // Only the interrupts may be changed, and the stream switched off.
            if (value ^ s.cr) & !(EN | TCIE | HTIE | TEIE | DMEIE | CT) != 0 {
                shared.note(
                    Kind::Forbidden,
                    format!("DMA stream {k} is set up while it runs"),
                );
            }
            s.cr = s.cr & !0x1f | value & 0x1f;
            if value & EN == 0 {
                // The manual's way to tell that the last transfer has ended.
                s.flags |= TCIF;
            }
        } else {
            s.cr = value;
            if value & EN != 0 {
                if s.flags != 0 {
                    shared.note(
                        Kind::Forbidden,
                        format!("DMA stream {k} is switched on with flags set"),
                    );
                }
                if value >> 6 & 3 > 1 || value & 1 << 5 != 0 || value & 0x01e0_0000 != 0 {
                    shared.note(
                        Kind::NotModelled,
                        "DMA: memory to memory, flow control, bursts",
                    );
                }
                if s.ndtr == 0 {
                    shared.note(
                        Kind::Forbidden,
                        format!("DMA stream {k} is switched on without data"),
                    );
                    s.cr &= !EN;
                }
                (s.block, s.moved) = (s.ndtr, 0);
            }
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
        let place = within % 0x18;
        if place == 0 {
            return self.write_cr(k, value, shared);
        }
        let s = &mut self.streams[k];
        let idle_half = place == 0x0c && s.cr & CT != 0 || place == 0x10 && s.cr & CT == 0;
        if s.is_on() && !(s.cr & DBM != 0 && idle_half) {
            shared.note(
                Kind::Forbidden,
                format!("DMA stream {k} is set up while it runs"),
            );
            return;
        }
        match place {
            0x04 => s.ndtr = value & 0xffff,
            0x08 => s.peripheral = value,
            0x0c => s.memory[0] = value,
            0x10 => s.memory[1] = value,
            _ => s.fcr = value & 0x87,
        }
    }

    fn event(&mut self, _source: Source, _shared: &mut Shared) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    fn ring(shared: &mut Shared, items: u32) -> Dma {
        let mut dma = Dma::new(Controller::Dma2);
        for (offset, value) in [
            (0x14, items),
            (0x18, 0x4001_204c),
            (0x1c, 0x2000_0100),
            (0x10, EN | HTIE | TCIE | CIRC | MINC | 1 << 11 | 1 << 13),
        ] {
            dma.write(offset, value, !0, shared);
        }
        dma
    }

    #[test]
    fn a_ring_goes_round_and_tells_of_its_halves() {
        let mut shared = shared();
        let mut dma = ring(&mut shared, 4);
        let mut seen = Vec::new();
        for _ in 0..6 {
            let transfer = dma.begin(Request::Adc1).unwrap();
            assert_eq!((transfer.from, transfer.width), (0x4001_204c, Width::Half));
            let last = dma.end(transfer, true, &mut shared);
            seen.push((transfer.to & 0xff, dma.read(0x00, &mut shared), last));
            dma.write(0x08, !0, !0, &mut shared);
        }
        let expected = [
            (0, 0, false),
            (2, HTIF, false),
            (4, 0, false),
            (6, TCIF, true),
            (0, 0, false),
            (2, HTIF, false),
        ];
        assert_eq!(seen, expected);
        assert_eq!(dma.begin(Request::Spi1Rx).map(|t| t.stream), None);
    }

    #[test]
    fn a_running_stream_must_not_be_set_up_and_stops_when_told() {
        let mut shared = shared();
        let mut dma = ring(&mut shared, 4);
        dma.write(0x14, 9, !0, &mut shared);
        assert_eq!(
            (dma.read(0x14, &mut shared), shared.findings.list().len()),
            (4, 1)
        );
        let cr = dma.read(0x10, &mut shared);
        dma.write(0x10, cr & !EN, !0, &mut shared);
        assert_eq!(dma.read(0x00, &mut shared), TCIF);
        assert!(dma.begin(Request::Adc1).is_none());
        dma.write(0x10, cr, !0, &mut shared);
        assert_eq!(shared.findings.list().len(), 2);
    }

    #[test]
    fn double_buffers_take_turns() {
        let mut shared = shared();
        let mut dma = Dma::new(Controller::Dma2);
        for (offset, value) in [
            (0x14, 2),
            (0x1c, 0x2000_0100),
            (0x20, 0x2000_0200),
            (0x10, EN | DBM | MINC | 1 << 11),
        ] {
            dma.write(offset, value, !0, &mut shared);
        }
        let mut places = Vec::new();
        for _ in 0..5 {
            let transfer = dma.begin(Request::Adc1).unwrap();
            dma.end(transfer, true, &mut shared);
            places.push(transfer.to & 0xfff);
        }
        assert_eq!(places, [0x100, 0x102, 0x200, 0x202, 0x100]);
    }
}
