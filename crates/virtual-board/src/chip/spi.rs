//! SPI1 as a master, full duplex.
//!
//! A word is shifted while the next waits in the transmit buffer. Its last bit is sampled half a clock
//! before its end: that is when it is in the receive buffer.

use super::Peripheral;
use super::interrupt::Interrupt;
use super::pin::Signal;
use super::register::{Register, merge, narrow};
use super::shared::{Effect, Request, Shared, Source};
use super::surroundings::SpiMode;
use crate::finding::Kind;
use crate::time::{Cycles, NEVER};

/// CR1.
const CPHA: u32 = 1;
const CPOL: u32 = 1 << 1;
const MSTR: u32 = 1 << 2;
const SPE: u32 = 1 << 6;
const LSBFIRST: u32 = 1 << 7;
const SSI: u32 = 1 << 8;
const SSM: u32 = 1 << 9;
const RXONLY: u32 = 1 << 10;
const DFF: u32 = 1 << 11;
const CRCEN: u32 = 1 << 13;
const BIDIMODE: u32 = 1 << 15;
/// What must not change while a word is on its way.
const SHAPE: u32 = CPHA | CPOL | MSTR | 7 << 3 | LSBFIRST | DFF;

/// CR2.
const RXDMAEN: u32 = 1;
const TXDMAEN: u32 = 1 << 1;
const SSOE: u32 = 1 << 2;
const FRF: u32 = 1 << 4;
const ERRIE: u32 = 1 << 5;
const RXNEIE: u32 = 1 << 6;
const TXEIE: u32 = 1 << 7;

/// SR.
const RXNE: u32 = 1;
const TXE: u32 = 1 << 1;
const MODF: u32 = 1 << 5;
const OVR: u32 = 1 << 6;
const BSY: u32 = 1 << 7;

/// The highest frequency of the clock (data sheet, SPI1 as a master), Hz.
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

/// A word on its way.
#[derive(Clone, Copy, Debug)]
struct Shift {
    word: u16,
    /// When its last bit is sampled; never, once that is done.
    sampled: Cycles,
    end: Cycles,
}

/// The serial interface, as a master.
pub(crate) struct Spi {
    cr1: u32,
    cr2: u32,
    /// RXNE, OVR, MODF.
    sr: u32,
    /// OVR was read since it was set, and the data register before that.
    overrun_read: bool,
    received: u16,
    waiting: Option<u16>,
    shift: Option<Shift>,
    polynomial: u32,
    mode: Option<SpiMode>,
}

impl Default for Spi {
    fn default() -> Self {
        Self {
            cr1: 0,
            cr2: 0,
            sr: 0,
            overrun_read: false,
            received: 0,
            waiting: None,
            shift: None,
            polynomial: 7,
            mode: None,
        }
    }
}

impl Spi {
    fn bits(&self) -> u32 {
        if self.cr1 & DFF != 0 { 16 } else { 8 }
    }

    /// A period of the clock, core cycles.
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
        for (bit, name) in [
            (BIDIMODE, "SPI1: one bidirectional line"),
            (CRCEN, "SPI1: checksums"),
            (RXONLY, "SPI1: receive only"),
        ] {
            if changed & value & bit != 0 {
                shared.note(Kind::NotModelled, name);
            }
        }
        if self.shift.is_some() && changed & (SHAPE | SPE) != 0 {
            let text = "SPI1: CR1 changed while a word is on its way (BSY)";
            shared.note(Kind::Forbidden, text);
        } else if self.cr1 & value & SPE != 0 && changed & DFF != 0 {
            shared.note(
                Kind::Forbidden,
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
            return shared.note(Kind::NotModelled, "SPI1: as a slave");
        }
        let mode = SpiMode {
            idles_high: self.cr1 & CPOL != 0,
            second_edge: self.cr1 & CPHA != 0,
            low_first: self.cr1 & LSBFIRST != 0,
            clock_hz: shared.clocks.hclk_hz / self.period(shared).max(1),
        };
        if self.mode != Some(mode) {
            self.mode = Some(mode);
            let at = shared.time();
            shared.world().spi_mode(mode, at);
            for signal in [Signal::Spi1Sck, Signal::Spi1Miso, Signal::Spi1Mosi] {
                shared.effect(Effect::Uses(signal));
            }
            if mode.clock_hz > CLOCK_LIMIT {
                let text = format!("SPI1: {} Hz, {CLOCK_LIMIT} Hz at most", mode.clock_hz);
                shared.note(Kind::ClockLimit, text);
            }
        }
    }

    /// A master whose select input is low gives up.
    fn check_master(&mut self, shared: &mut Shared) {
        if self.cr1 & (SPE | MSTR) != SPE | MSTR {
            return;
        }
        if self.cr1 & SSM == 0 {
            if self.cr2 & SSOE == 0 {
                shared.note(Kind::NotModelled, "SPI1: NSS as an input");
            }
        } else if self.cr1 & SSI == 0 {
            self.sr |= MODF;
            self.cr1 &= !(SPE | MSTR);
            (self.shift, self.waiting) = (None, None);
        }
    }

    fn write_data(&mut self, value: u16, shared: &mut Shared) {
        // A stream fills the buffer as soon as TXDMAEN is set, which is before SPE (RM0090, 28.3.9).
        if self.cr1 & SPE == 0 && self.cr2 & TXDMAEN == 0 {
            shared.note(Kind::Forbidden, "SPI1: DR written while disabled");
        }
        if self.waiting.is_some() {
            shared.note(
                Kind::Lost,
                "SPI1: DR written while the transmit buffer is full",
            );
        }
        self.waiting = Some(value);
    }

    /// The waiting word goes on its way, if it can.
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
            self.request_transmit(shared);
        }
    }

    fn request_transmit(&self, shared: &mut Shared) {
        if self.cr2 & TXDMAEN != 0 && self.waiting.is_none() {
            shared.effect(Effect::Dma(Request::Spi1Tx));
        }
    }

    /// Asks again for what no stream has done yet.
    pub fn ask(&self, shared: &mut Shared) {
        if self.cr2 & RXDMAEN != 0 && self.sr & RXNE != 0 {
            shared.effect(Effect::Dma(Request::Spi1Rx));
        }
        self.request_transmit(shared);
    }

    fn sample(&mut self, shift: Shift, shared: &mut Shared) {
        let bits = self.bits();
        let mask = if bits == 8 { 0xff } else { 0xffff };
        let end = shared.base.time_of(shift.end);
        let word = shared.world().spi(shift.word & mask, bits, end) & mask;
        if self.sr & RXNE != 0 {
            self.sr |= OVR;
            self.overrun_read = false;
            shared.note(Kind::Lost, "SPI1: overrun");
            return;
        }
        self.received = word;
        self.sr |= RXNE;
        if self.cr2 & RXDMAEN != 0 {
            shared.effect(Effect::Dma(Request::Spi1Rx));
        }
    }

    fn plan(&self, shared: &mut Shared) {
        let at = self.shift.map_or(NEVER, |s| s.sampled.min(s.end));
        if shared.due(Source::Spi1) != at {
            shared.schedule(Source::Spi1, at);
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
                // The data register was read before.
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
                // Writing CR1 is the second half of what clears a mode fault.
                self.sr &= !MODF;
                self.write_cr1(merge(self.cr1, value, mask) & 0xffff, shared);
            }
            0x04 => {
                let old = self.cr2;
                self.cr2 = merge(old, value, mask) & 0xf7;
                if self.cr2 & FRF != 0 {
                    shared.note(Kind::NotModelled, "SPI1: TI frame format");
                }
                if self.cr2 & !old & RXDMAEN != 0 && self.sr & RXNE != 0 {
                    shared.effect(Effect::Dma(Request::Spi1Rx));
                }
                if self.cr2 & !old & TXDMAEN != 0 {
                    self.request_transmit(shared);
                }
            }
            // Only CRCERR is writable, and there is none.
            0x08 => {}
            0x0c => self.write_data(value as u16, shared),
            0x10 => self.polynomial = value & 0xffff,
            0x1c if value & 0xc00 != 0 => shared.note(Kind::NotModelled, "SPI1: I2S"),
            0x1c | 0x20 => {}
            _ => shared.note(Kind::Forbidden, "SPI1: a read-only register written"),
        }
        self.load(shared);
        self.plan(shared);
    }

    fn event(&mut self, source: Source, shared: &mut Shared) {
        let _ = source;
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
mod tests {
    use super::*;
    use crate::chip::surroundings::Surroundings;
    use crate::time::Time;

    const CR1: u32 = 0;
    const CR2: u32 = 4;
    const SR: u32 = 8;
    const DR: u32 = 12;
    /// Master with its select input held high by software; a clock of PCLK2 / 8.
    const MASTER: u32 = MSTR | SSM | SSI | 2 << 3;
    /// Core cycles of a bit: APB2 at half the core's clock, divided by eight.
    const BIT: Cycles = 16;

    /// Answers each word with its complement and remembers.
    #[derive(Default)]
    struct Mirror {
        words: Vec<(u16, u32, Time)>,
        modes: Vec<SpiMode>,
    }

    impl Surroundings for Mirror {
        fn spi(&mut self, word: u16, bits: u32, at: Time) -> u16 {
            self.words.push((word, bits, at));
            !word
        }

        fn spi_mode(&mut self, mode: SpiMode, _at: Time) {
            self.modes.push(mode);
        }
    }

    struct Bench {
        spi: Spi,
        shared: Shared,
    }

    impl Bench {
        fn new() -> Self {
            let mut shared = Shared::new(Box::new(Mirror::default()), 0);
            shared.base.set_frequency(0, 168_000_000);
            shared.clocks.hclk_hz = 168_000_000;
            shared.clocks.apb2 = 2;
            Self {
                spi: Spi::default(),
                shared,
            }
        }

        fn enabled() -> Self {
            let mut bench = Self::new();
            bench.write(CR1, MASTER);
            bench.write(CR1, MASTER | SPE);
            bench.shared.effects.clear();
            bench
        }

        fn read(&mut self, offset: u32) -> u32 {
            self.spi.read(offset, &mut self.shared)
        }

        fn write(&mut self, offset: u32, value: u32) {
            self.spi.write(offset, value, !0, &mut self.shared);
        }

        fn run(&mut self, until: Cycles) {
            while self.shared.arrive(Source::Spi1, until) {
                self.spi.event(Source::Spi1, &mut self.shared);
            }
        }

        fn mirror(&mut self) -> &mut Mirror {
            let any: &mut dyn std::any::Any = self.shared.world();
            any.downcast_mut().expect("a mirror")
        }

        fn requests(&mut self) -> Vec<Request> {
            let effects = self.shared.effects.drain(..);
            effects
                .filter_map(|effect| match effect {
                    Effect::Dma(request) => Some(request),
                    _ => None,
                })
                .collect()
        }
    }

    #[test]
    fn a_word_takes_its_bits_and_is_received_half_a_bit_before_its_end() {
        let mut bench = Bench::enabled();
        assert_eq!(bench.read(SR), TXE);
        bench.write(DR, 0x5a);
        assert_eq!(bench.read(SR), TXE | BSY);
        bench.run(8 * BIT - BIT / 2 - 1);
        assert_eq!(bench.read(SR), TXE | BSY);
        bench.run(8 * BIT - BIT / 2);
        assert_eq!(bench.read(SR), TXE | BSY | RXNE);
        assert_eq!(bench.read(DR), 0xa5);
        assert_eq!(bench.read(SR), TXE | BSY);
        bench.run(8 * BIT);
        assert_eq!(bench.read(SR), TXE);
        let end = bench.shared.base.time_of(8 * BIT);
        assert_eq!(bench.mirror().words, [(0x5a, 8, end)]);
        assert!(bench.shared.kinds().is_empty());
    }

    #[test]
    fn waiting_words_follow_without_a_gap() {
        let mut bench = Bench::enabled();
        bench.write(CR2, RXNEIE);
        bench.write(DR, 1);
        bench.write(DR, 2);
        assert_eq!(bench.read(SR), BSY);
        let mut words = Vec::new();
        for _ in 0..2 {
            while bench.shared.lines == 0 {
                bench.run(bench.shared.now + 1);
            }
            words.push((bench.shared.now, bench.read(DR)));
            assert_eq!(bench.shared.lines, 0);
        }
        let half = BIT / 2;
        assert_eq!(words, [(8 * BIT - half, 0xfe), (16 * BIT - half, 0xfd)]);
    }

    #[test]
    fn words_of_sixteen_bits_and_the_clock_as_the_device_sees_it() {
        let mut bench = Bench::new();
        let cr1 = MASTER | DFF | CPOL | CPHA | LSBFIRST;
        bench.write(CR1, cr1);
        bench.write(CR1, cr1 | SPE);
        bench.write(DR, 0x1234);
        bench.run(16 * BIT);
        assert_eq!(bench.read(DR), 0xedcb);
        assert_eq!(bench.mirror().words[0].1, 16);
        let mode = SpiMode {
            idles_high: true,
            second_edge: true,
            low_first: true,
            clock_hz: 84_000_000 / 8,
        };
        assert_eq!(bench.mirror().modes, [mode]);
        // Once, not with each transfer.
        bench.write(CR1, cr1);
        bench.write(CR1, cr1 | SPE);
        let signals = [Signal::Spi1Sck, Signal::Spi1Miso, Signal::Spi1Mosi];
        assert_eq!(bench.shared.effects, signals.map(Effect::Uses));
    }

    #[test]
    fn what_is_not_read_in_time_is_an_overrun() {
        let mut bench = Bench::enabled();
        bench.write(CR2, ERRIE);
        bench.write(DR, 1);
        bench.write(DR, 2);
        bench.run(16 * BIT);
        assert_eq!(bench.read(SR), TXE | RXNE | OVR);
        assert_ne!(bench.shared.lines, 0);
        assert_eq!(bench.shared.kinds(), [Kind::Lost]);
        // The first word stays; reading it and then the status clears the flag.
        assert_eq!(bench.read(DR), 0xfe);
        assert_eq!(bench.read(SR), TXE | OVR);
        assert_eq!(bench.read(SR), TXE);
    }

    #[test]
    fn streams_are_asked_when_a_buffer_is_free_or_full() {
        let mut bench = Bench::enabled();
        bench.write(CR2, RXDMAEN);
        bench.write(CR2, RXDMAEN | TXDMAEN);
        assert_eq!(bench.requests(), [Request::Spi1Tx]);
        bench.write(DR, 1);
        assert_eq!(bench.requests(), [Request::Spi1Tx]);
        bench.write(DR, 2);
        assert_eq!(bench.requests(), []);
        bench.run(8 * BIT - BIT / 2);
        assert_eq!(bench.requests(), [Request::Spi1Rx]);
        bench.run(8 * BIT);
        assert_eq!(bench.requests(), [Request::Spi1Tx]);
    }

    #[test]
    fn a_stream_may_fill_the_buffer_before_the_interface_is_enabled() {
        let mut bench = Bench::new();
        bench.write(CR1, MASTER);
        bench.write(CR2, RXDMAEN | TXDMAEN);
        assert_eq!(bench.requests(), [Request::Spi1Tx]);
        bench.write(DR, 0x21);
        // The word waits; the stream is asked for the next as the first goes on its way.
        bench.run(100 * BIT);
        assert_eq!((bench.requests(), bench.read(SR)), (vec![], 0));
        bench.write(CR1, MASTER | SPE);
        assert_eq!(bench.requests(), [Request::Spi1Tx]);
        bench.run(108 * BIT);
        assert_eq!(bench.mirror().words[0].0, 0x21);
        assert_eq!(bench.shared.kinds(), []);
    }

    #[test]
    fn mistakes_are_found() {
        let mut bench = Bench::enabled();
        bench.write(DR, 1);
        bench.write(CR1, MASTER);
        assert_eq!(bench.shared.kinds(), [Kind::Forbidden]);
        bench.write(DR, 1);
        assert_eq!(bench.shared.kinds(), [Kind::Forbidden; 2]);
        // Without a level at its select input the master gives up.
        bench.write(CR1, (MASTER & !SSI) | SPE);
        assert_eq!(bench.read(SR) & MODF, MODF);
        assert_eq!(bench.read(CR1) & (SPE | MSTR), 0);
        bench.write(CR1, 0);
        assert_eq!(bench.read(SR) & MODF, 0);
        bench.write(CR1, SSM | SSI | SPE);
        assert_eq!(bench.shared.kinds().last(), Some(&Kind::NotModelled));
        // PCLK2 beyond its limit divided by two.
        let mut bench = Bench::new();
        bench.shared.clocks.apb2 = 1;
        bench.write(CR1, MSTR | SSM | SSI | SPE);
        assert_eq!(bench.shared.kinds(), [Kind::ClockLimit]);
    }
}
