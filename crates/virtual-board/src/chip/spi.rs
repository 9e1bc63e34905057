//! SPI1 as a master, full duplex, without DMA.
//!
//! While a word is shifted, the next one waits in the transmit buffer. The last bit is sampled half a clock period
//! before the end of the word, when the word enters the receive buffer.
//!
//! Not modelled: polarity and phase of the clock, which the devices ignore.

use super::Peripheral;
use super::effect::Effect;
use super::interrupt::Interrupt;
use super::map::Unit;
use super::pin::Signal;
use super::register::{Register, merge, narrow};
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::{Cycles, NEVER};

// Bits of CR1.
bits! {
    CPHA 0, CPOL 1, MSTR 2, SPE 6, LSBFIRST 7, SSI 8, SSM 9, RXONLY 10, DFF 11, CRCEN 13,
    BIDIMODE 15
}
/// Bits that must not change while a word is shifted.
const SHAPE: u32 = CPHA | CPOL | MSTR | 7 << 3 | LSBFIRST | DFF;

// Bits of CR2.
bits! {
    RXDMAEN 0, TXDMAEN 1, SSOE 2, FRF 4, ERRIE 5, RXNEIE 6, TXEIE 7
}

// Bits of SR.
bits! {
    RXNE 0, TXE 1, MODF 5, OVR 6, BSY 7
}

/// Highest frequency of the clock (data sheet, SPI1 as a master), Hz.
const CLOCK_LIMIT: u64 = 42_000_000;

const REGISTERS: [Register; 9] = [
    narrow(0x00, "CR1", 0xffff),
    narrow(0x04, "CR2", 0xf7),
    narrow(0x08, "SR", 0x1ff),
    narrow(0x0c, "DR", 0xffff),
    narrow(0x10, "CRCPR", 0xffff),
    narrow(0x14, "RXCRCR", 0xffff),
    narrow(0x18, "TXCRCR", 0xffff),
    narrow(0x1c, "I2SCFGR", 0xfbf),
    narrow(0x20, "I2SPR", 0x3ff),
];

/// A word being shifted.
#[derive(Clone, Copy, Debug)]
struct Shift {
    word: u16,
    /// Cycle at which the last bit is sampled; `NEVER` once the bit was sampled.
    sampled: Cycles,
    end: Cycles,
}

/// SPI1 as a master.
#[derive(Clone, Default)]
pub(crate) struct Spi {
    cr1: u32,
    cr2: u32,
    /// Flags RXNE, OVR, MODF.
    sr: u32,
    /// True if the data register was read while OVR was set; a read of SR then clears OVR.
    overrun_read: bool,
    received: u16,
    waiting: Option<u16>,
    shift: Option<Shift>,
    polynomial: u32,
    /// True if the signals were checked for a route to a pin.
    placed: bool,
}

impl Spi {
    pub fn after_reset() -> Self {
        Self {
            polynomial: 7,
            ..Self::default()
        }
    }

    fn bits(&self) -> u32 {
        if self.cr1 & DFF != 0 { 16 } else { 8 }
    }

    /// Period of the SPI clock, core cycles.
    fn period(&self, shared: &Shared) -> Cycles {
        shared.clocks.apb2 << ((self.cr1 >> 3 & 7) + 1)
    }

    fn status(&self) -> u32 {
        let empty = if self.waiting.is_none() { TXE } else { 0 };
        let busy = if self.shift.is_some() { BSY } else { 0 };
        self.sr | empty | busy
    }

    fn write_cr1(&mut self, value: u32, shared: &mut Shared) {
        let changed = self.cr1 ^ value;
        let features = [
            (BIDIMODE, "SPI1: one bidirectional line"),
            (CRCEN, "SPI1: checksums"),
            (RXONLY, "SPI1: receive only"),
            (LSBFIRST, "SPI1: the lowest bit first"),
        ];
        shared.note_not_modelled(changed & value, &features);
        if self.shift.is_some() && changed & (SHAPE | SPE) != 0 {
            let text = "SPI1: CR1 changed during a transfer (BSY)";
            shared.note(FindingKind::Forbidden, text);
        } else if self.cr1 & value & SPE != 0 && changed & DFF != 0 {
            shared.note(
                FindingKind::Forbidden,
                "SPI1: length of words changed while enabled",
            );
        }
        self.cr1 = value;
        if changed & SPE != 0 {
            if value & SPE != 0 {
                self.enable(shared);
            } else {
                (self.shift, self.waiting) = (None, None);
            }
        }
        self.check_master(shared);
    }

    fn enable(&mut self, shared: &mut Shared) {
        if self.cr1 & MSTR == 0 {
            return shared.note(FindingKind::NotModelled, "SPI1: as a slave");
        }
        if !std::mem::replace(&mut self.placed, true) {
            for signal in [Signal::Spi1Sck, Signal::Spi1Miso, Signal::Spi1Mosi] {
                shared.effect(Effect::Uses(signal));
            }
        }
        let hz = shared.clocks.hclk_hz / self.period(shared);
        if hz > CLOCK_LIMIT {
            let text = format!("SPI1: {hz} Hz: must be at most {CLOCK_LIMIT} Hz");
            shared.note(FindingKind::ClockLimit, text);
        }
    }

    /// Handles a low select input: the master is disabled with a mode fault.
    fn check_master(&mut self, shared: &mut Shared) {
        if self.cr1 & (SPE | MSTR) != SPE | MSTR {
            return;
        }
        if self.cr1 & SSM == 0 {
            if self.cr2 & SSOE == 0 {
                shared.note(FindingKind::NotModelled, "SPI1: NSS as an input");
            }
        } else if self.cr1 & SSI == 0 {
            self.sr |= MODF;
            self.cr1 &= !(SPE | MSTR);
            (self.shift, self.waiting) = (None, None);
        }
    }

    fn write_data(&mut self, value: u16, shared: &mut Shared) {
        if self.cr1 & SPE == 0 {
            shared.note(FindingKind::Forbidden, "SPI1: DR written while disabled");
        }
        if self.waiting.is_some() {
            shared.note(
                FindingKind::Lost,
                "SPI1: DR written while the transmit buffer is full",
            );
        }
        self.waiting = Some(value);
    }

    /// Starts to shift the waiting word if the shift register is free.
    fn load(&mut self, shared: &mut Shared) {
        let enabled = self.cr1 & (SPE | MSTR) == SPE | MSTR;
        if !enabled || self.shift.is_some() {
            return;
        }
        if let Some(word) = self.waiting.take() {
            let period = self.period(shared);
            let end = shared.now + period * Cycles::from(self.bits());
            self.shift = Some(Shift {
                word,
                sampled: end - period / 2,
                end,
            });
        }
    }

    fn sample(&mut self, shift: Shift, shared: &mut Shared) {
        let bits = self.bits();
        let mask = if bits == 8 { 0xff } else { 0xffff };
        let end = shared.base.time_of(shift.end);
        let word = shared.circuit().spi(shift.word & mask, bits, end) & mask;
        if self.sr & RXNE != 0 {
            self.sr |= OVR;
            self.overrun_read = false;
            shared.note(FindingKind::Lost, "SPI1: overrun");
            return;
        }
        self.received = word;
        self.sr |= RXNE;
    }

    fn plan(&self, shared: &mut Shared) {
        let at = self.shift.map_or(NEVER, |s| s.sampled.min(s.end));
        if shared.due(Unit::Spi1) != at {
            shared.schedule(Unit::Spi1, at);
        }
        let status = self.status();
        let level = self.cr2 & TXEIE != 0 && status & TXE != 0
            || self.cr2 & RXNEIE != 0 && status & RXNE != 0
            || self.cr2 & ERRIE != 0 && status & (OVR | MODF) != 0;
        shared.line(Interrupt::Spi1, level);
    }
}

impl Peripheral for Spi {
    fn registers(&self) -> &'static [Register] {
        &REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x08 => {
                let status = self.status();
                // DR was read before SR: the sequence that clears OVR.
                if std::mem::take(&mut self.overrun_read) {
                    self.sr &= !OVR;
                }
                status
            }
            0x0c => {
                self.sr &= !RXNE;
                self.overrun_read = self.sr & OVR != 0;
                self.plan(shared);
                self.received.into()
            }
            0x10 => self.polynomial,
            0x20 => 2,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            0x00 => {
                // A write of CR1 is the second step of clearing a mode fault.
                self.sr &= !MODF;
                self.write_cr1(merge(self.cr1, value, mask) & 0xffff, shared);
            }
            0x04 => {
                self.cr2 = merge(self.cr2, value, mask) & 0xf7;
                let features = [
                    (FRF, "SPI1: TI frame format"),
                    (RXDMAEN | TXDMAEN, "SPI1: streams"),
                ];
                shared.note_not_modelled(self.cr2, &features);
            }
            // Only CRCERR is writable; checksums are not modelled.
            0x08 => {}
            0x0c => self.write_data(value as u16, shared),
            0x10 => self.polynomial = value & 0xffff,
            0x1c if value & 0xc00 != 0 => shared.note(FindingKind::NotModelled, "SPI1: I2S"),
            0x1c | 0x20 => {}
            _ => shared.note(FindingKind::Forbidden, "SPI1: a read-only register written"),
        }
        self.load(shared);
        self.plan(shared);
    }

    fn event(&mut self, shared: &mut Shared) {
        let Some(mut shift) = self.shift else {
            return;
        };
        if shift.sampled <= shared.now {
            self.sample(shift, shared);
            shift.sampled = NEVER;
            self.shift = Some(shift);
        }
        if shift.end <= shared.now {
            self.shift = None;
            self.load(shared);
        }
        self.plan(shared);
    }
}

#[cfg(test)]
mod tests;
