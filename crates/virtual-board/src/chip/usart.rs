//! USART3, asynchronous.

use super::Peripheral;
use super::interrupt::Interrupt;
use super::pin::Signal;
use super::register::{Register, merge, narrow};
use super::shared::{Effect, Request, Shared, Source};
use crate::finding::Kind;
use crate::time::{Cycles, NEVER};

/// SR.
const ORE: u32 = 1 << 3;
const IDLE: u32 = 1 << 4;
const RXNE: u32 = 1 << 5;
const TC: u32 = 1 << 6;
const TXE: u32 = 1 << 7;
/// Flags that reading SR and then DR clears.
const BY_READING: u32 = 0x1f;

/// CR1.
const SBK: u32 = 1;
const RWU: u32 = 1 << 1;
const RE: u32 = 1 << 2;
const TE: u32 = 1 << 3;
const IDLEIE: u32 = 1 << 4;
const RXNEIE: u32 = 1 << 5;
const TCIE: u32 = 1 << 6;
const TXEIE: u32 = 1 << 7;
const PCE: u32 = 1 << 10;
const M: u32 = 1 << 12;
const UE: u32 = 1 << 13;
const OVER8: u32 = 1 << 15;
const CR1_BITS: u32 = 0xbfff;

/// CR2.
const CLKEN: u32 = 1 << 11;
const LINEN: u32 = 1 << 14;
const CR2_BITS: u32 = 0x7f6f;

/// CR3.
const EIE: u32 = 1;
const IREN: u32 = 1 << 1;
const HDSEL: u32 = 1 << 3;
const SCEN: u32 = 1 << 5;
const DMAR: u32 = 1 << 6;
const DMAT: u32 = 1 << 7;
const RTSE: u32 = 1 << 8;
const CTSE: u32 = 1 << 9;
const CR3_BITS: u32 = 0xfff;

const REGISTERS: [Register; 7] = [
    narrow(0x00, "SR", 0x3ff),
    narrow(0x04, "DR", 0x1ff),
    narrow(0x08, "BRR", 0xffff),
    narrow(0x0c, "CR1", CR1_BITS),
    narrow(0x10, "CR2", CR2_BITS),
    narrow(0x14, "CR3", CR3_BITS),
    narrow(0x18, "GTPR", 0xffff),
];

/// The asynchronous serial interface.
pub(crate) struct Usart {
    /// IDLE, ORE, RXNE, TC.
    sr: u32,
    brr: u32,
    cr1: u32,
    cr2: u32,
    cr3: u32,
    gtpr: u32,
    /// SR was read with these flags set.
    seen: u32,
    received: u8,
    waiting: Option<u8>,
    /// What is on the line, nothing for the idle frame of a transmitter that was just enabled, and
    /// when it ends.
    shift: Option<(Option<u8>, Cycles)>,
    /// When the line counts as idle.
    idle: Cycles,
}

impl Default for Usart {
    fn default() -> Self {
        Self {
            sr: TC,
            brr: 0,
            cr1: 0,
            cr2: 0,
            cr3: 0,
            gtpr: 0,
            seen: 0,
            received: 0,
            waiting: None,
            shift: None,
            idle: NEVER,
        }
    }
}

impl Usart {
    /// A byte has arrived; its stop bit ends now.
    pub fn receive(&mut self, byte: u8, shared: &mut Shared) {
        if self.cr1 & (UE | RE) != UE | RE {
            return;
        }
        self.idle = shared.now + self.frame(shared);
        if self.sr & RXNE != 0 {
            self.sr |= ORE;
            shared.note(Kind::Lost, "USART3: overrun");
        } else {
            self.received = byte & self.mask();
            self.sr |= RXNE;
            if self.cr3 & DMAR != 0 {
                shared.effect(Effect::Dma(Request::Usart3Rx));
            }
        }
        self.plan(shared);
    }

    /// Data bits, without parity.
    fn mask(&self) -> u8 {
        if self.cr1 & (M | PCE) == PCE {
            0x7f
        } else {
            0xff
        }
    }

    /// Length of a frame, core cycles.
    fn frame(&self, shared: &Shared) -> Cycles {
        let clocks = if self.cr1 & OVER8 != 0 {
            (self.brr >> 4) * 8 + (self.brr & 7)
        } else {
            self.brr
        };
        let data = if self.cr1 & M != 0 { 9 } else { 8 };
        let stop_halves = [2, 1, 4, 3][(self.cr2 >> 12 & 3) as usize];
        let halves = 2 * (1 + data) + stop_halves;
        (Cycles::from(clocks) * shared.clocks.apb1 * halves / 2).max(1)
    }

    fn status(&self) -> u32 {
        self.sr | if self.waiting.is_none() { TXE } else { 0 }
    }

    fn write_cr1(&mut self, value: u32, shared: &mut Shared) {
        let changed = self.cr1 ^ value;
        for (bit, name) in [(SBK, "break"), (RWU, "mute mode")] {
            if changed & value & bit != 0 {
                shared.note(Kind::NotModelled, format!("USART3: {name}"));
            }
        }
        if changed & (M | PCE) != 0 && value & (M | PCE) == M {
            shared.note(Kind::NotModelled, "USART3: nine data bits");
        }
        if self.shift.is_some() && changed & (M | PCE | OVER8 | UE) != 0 {
            shared.note(Kind::Forbidden, "USART3: CR1 changed during a transmission");
        }
        self.cr1 = value;
        if value & UE == 0 {
            (self.waiting, self.shift, self.idle) = (None, None, NEVER);
            self.sr |= TC;
        } else {
            self.begin(
                changed | if changed & UE != 0 { TE | RE } else { 0 },
                shared,
            );
        }
    }

    /// The transmitter or the receiver was switched.
    fn begin(&mut self, changed: u32, shared: &mut Shared) {
        if changed & (TE | RE) != 0 && self.cr1 & (TE | RE) != 0 && self.brr < 16 {
            shared.note(Kind::Forbidden, "USART3: enabled with a divider below 16");
        }
        if changed & self.cr1 & TE != 0 {
            shared.effect(Effect::Uses(Signal::Usart3Tx));
            self.shift = Some((None, shared.now + self.frame(shared)));
            self.request_transmit(shared);
        }
        if changed & self.cr1 & RE != 0 {
            shared.effect(Effect::Uses(Signal::Usart3Rx));
        }
    }

    fn write_data(&mut self, value: u8, shared: &mut Shared) {
        if self.cr1 & (UE | TE) != UE | TE {
            return shared.note(Kind::Forbidden, "USART3: DR written while disabled");
        }
        if self.waiting.is_some() {
            shared.note(Kind::Lost, "USART3: DR written while it is full");
        }
        self.waiting = Some(value & self.mask());
        self.sr &= !TC;
        self.load(shared);
    }

    fn load(&mut self, shared: &mut Shared) {
        if self.shift.is_none()
            && let Some(byte) = self.waiting.take()
        {
            self.shift = Some((Some(byte), shared.now + self.frame(shared)));
            self.request_transmit(shared);
        }
    }

    fn request_transmit(&self, shared: &mut Shared) {
        let on = self.cr1 & (UE | TE) == UE | TE && self.cr3 & DMAT != 0;
        if on && self.waiting.is_none() {
            shared.effect(Effect::Dma(Request::Usart3Tx));
        }
    }

    /// Asks again for what no stream has done yet.
    pub fn ask(&self, shared: &mut Shared) {
        if self.cr3 & DMAR != 0 && self.sr & RXNE != 0 {
            shared.effect(Effect::Dma(Request::Usart3Rx));
        }
        self.request_transmit(shared);
    }

    fn write_cr3(&mut self, value: u32, shared: &mut Shared) {
        let old = std::mem::replace(&mut self.cr3, value);
        for (bit, name) in [
            (IREN, "infrared"),
            (HDSEL, "half duplex"),
            (SCEN, "smartcard"),
            (RTSE, "RTS"),
            (CTSE, "CTS"),
        ] {
            if value & !old & bit != 0 {
                shared.note(Kind::NotModelled, format!("USART3: {name}"));
            }
        }
        if value & !old & DMAT != 0 {
            self.request_transmit(shared);
        }
        if value & !old & DMAR != 0 && self.sr & RXNE != 0 {
            shared.effect(Effect::Dma(Request::Usart3Rx));
        }
    }

    fn write_cr2(&mut self, value: u32, shared: &mut Shared) {
        for (bit, name) in [(LINEN, "LIN"), (CLKEN, "synchronous mode")] {
            if value & !self.cr2 & bit != 0 {
                shared.note(Kind::NotModelled, format!("USART3: {name}"));
            }
        }
        self.cr2 = value;
    }

    fn plan(&self, shared: &mut Shared) {
        let at = self.shift.map_or(NEVER, |(_, end)| end).min(self.idle);
        if shared.due(Source::Usart3) != at {
            shared.schedule(Source::Usart3, at);
        }
        let status = self.status();
        let by_cr1 = (self.cr1 & TXEIE != 0 && status & TXE != 0)
            || (self.cr1 & TCIE != 0 && status & TC != 0)
            || (self.cr1 & RXNEIE != 0 && status & (RXNE | ORE) != 0)
            || (self.cr1 & IDLEIE != 0 && status & IDLE != 0);
        let by_dma = self.cr3 & (EIE | DMAR) == EIE | DMAR && status & ORE != 0;
        shared.line(Interrupt::Usart3, by_cr1 || by_dma);
    }
}

impl Peripheral for Usart {
    fn registers(&self) -> &'static [Register] {
        &REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        match offset {
            0x00 => {
                self.seen = self.sr & BY_READING;
                self.status()
            }
            0x04 => {
                self.sr &= !(RXNE | std::mem::take(&mut self.seen));
                self.plan(shared);
                self.received.into()
            }
            0x08 => self.brr,
            0x0c => self.cr1,
            0x10 => self.cr2,
            0x14 => self.cr3,
            _ => self.gtpr,
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            // Written with zero these are cleared.
            0x00 => self.sr &= value | !(mask & (RXNE | TC)),
            0x04 => self.write_data(value as u8, shared),
            0x08 => {
                if self.shift.is_some() {
                    shared.note(Kind::Forbidden, "USART3: BRR changed during a transmission");
                }
                self.brr = merge(self.brr, value, mask) & 0xffff;
            }
            0x0c => self.write_cr1(merge(self.cr1, value, mask) & CR1_BITS, shared),
            0x10 => self.write_cr2(merge(self.cr2, value, mask) & CR2_BITS, shared),
            0x14 => self.write_cr3(merge(self.cr3, value, mask) & CR3_BITS, shared),
            _ => self.gtpr = merge(self.gtpr, value, mask) & 0xffff,
        }
        self.plan(shared);
    }

    fn event(&mut self, source: Source, shared: &mut Shared) {
        let _ = source;
        if self.idle <= shared.now {
            self.idle = NEVER;
            self.sr |= IDLE;
        }
        if let Some((byte, end)) = self.shift
            && end <= shared.now
        {
            self.shift = None;
            if let Some(byte) = byte {
                let at = shared.time();
                shared.world().serial(byte, at);
            }
            if self.waiting.is_none() && byte.is_some() {
                self.sr |= TC;
            }
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

    const SR: u32 = 0x00;
    const DR: u32 = 0x04;
    const BRR: u32 = 0x08;
    const CR1: u32 = 0x0c;
    const CR2: u32 = 0x10;
    const CR3: u32 = 0x14;
    /// 42 MHz / 42: 1 Mbit/s, a bit is 168 core cycles.
    const BIT: Cycles = 168;
    const FRAME: Cycles = 10 * BIT;

    #[derive(Default)]
    struct Line {
        bytes: Vec<(u8, Time)>,
    }

    impl Surroundings for Line {
        fn serial(&mut self, byte: u8, at: Time) {
            self.bytes.push((byte, at));
        }
    }

    struct Bench {
        usart: Usart,
        shared: Shared,
    }

    impl Bench {
        /// Enabled, the idle frame of the transmitter behind it.
        fn new(cr1: u32, brr: u32) -> Self {
            let mut shared = Shared::new(Box::new(Line::default()), 0);
            shared.base.set_frequency(0, 168_000_000);
            shared.clocks.apb1 = 4;
            let mut bench = Self {
                usart: Usart::default(),
                shared,
            };
            bench.write(BRR, brr);
            bench.write(CR1, UE | TE | RE | cr1);
            bench
        }

        fn idle() -> Self {
            let mut bench = Self::new(0, 42);
            bench.run(FRAME);
            bench.shared.effects.clear();
            bench
        }

        fn read(&mut self, offset: u32) -> u32 {
            self.usart.read(offset, &mut self.shared)
        }

        fn write(&mut self, offset: u32, value: u32) {
            self.usart.write(offset, value, !0, &mut self.shared);
        }

        fn receive(&mut self, byte: u8) {
            self.usart.receive(byte, &mut self.shared);
        }

        fn run(&mut self, until: Cycles) {
            while self.shared.arrive(Source::Usart3, until) {
                self.usart.event(Source::Usart3, &mut self.shared);
            }
        }

        fn sent(&mut self) -> Vec<(u8, Cycles)> {
            let base = self.shared.base;
            let any: &mut dyn std::any::Any = self.shared.world();
            let line: &mut Line = any.downcast_mut().expect("a line");
            let bytes = line.bytes.drain(..);
            bytes.map(|(byte, at)| (byte, base.cycle_of(at))).collect()
        }
    }

    #[test]
    fn bytes_follow_each_other_behind_the_idle_frame() {
        let mut bench = Bench::new(TCIE, 42);
        bench.write(DR, 0x12);
        assert_eq!(bench.read(SR) & (TXE | TC), 0);
        bench.run(FRAME);
        assert_eq!(bench.read(SR) & (TXE | TC), TXE);
        bench.write(DR, 0x34);
        assert_eq!(bench.shared.lines, 0);
        bench.run(3 * FRAME - 1);
        assert_eq!(bench.read(SR) & (TXE | TC), TXE);
        bench.run(3 * FRAME);
        assert_eq!(bench.read(SR) & (TXE | TC), TXE | TC);
        assert_eq!(bench.shared.lines, 1 << Interrupt::Usart3 as u32);
        let sent = bench.sent();
        assert_eq!(sent, [(0x12, 2 * FRAME), (0x34, 3 * FRAME)]);
        bench.write(SR, !TC);
        assert_eq!(bench.shared.lines, 0);
    }

    #[test]
    fn bits_last_as_the_divider_and_the_frame_say() {
        // Oversampling by 8: 5 and 2/8: 42 clocks as well. 16 bits a sample otherwise.
        for (cr1, cr2, brr, halves) in [
            (OVER8, 0, 5 << 4 | 2, 20),
            (0, 2 << 12, 42, 22),
            (0, 1 << 12, 42, 19),
            (M | PCE, 3 << 12, 42, 23),
            (PCE, 0, 42, 20),
        ] {
            let mut bench = Bench::new(cr1, brr);
            bench.write(CR2, cr2);
            bench.run(10 * FRAME);
            bench.write(DR, 0xff);
            bench.run(20 * FRAME);
            let sent = bench.sent();
            let data = if cr1 & (M | PCE) == PCE { 0x7f } else { 0xff };
            assert_eq!(sent, [(data, 10 * FRAME + halves * BIT / 2)]);
            assert!(bench.shared.kinds().is_empty());
        }
    }

    #[test]
    fn bytes_arrive_and_then_the_line_is_idle() {
        let mut bench = Bench::idle();
        bench.write(CR1, UE | TE | RE | RXNEIE | IDLEIE);
        bench.receive(0x41);
        assert_ne!(bench.shared.lines, 0);
        assert_eq!(bench.read(DR), 0x41);
        assert_eq!(bench.shared.lines, 0);
        let end = bench.shared.now + FRAME;
        bench.run(end - 1);
        assert_eq!(bench.read(SR) & IDLE, 0);
        bench.run(end);
        assert_eq!(bench.read(SR) & IDLE, IDLE);
        assert_ne!(bench.shared.lines, 0);
        bench.read(DR);
        assert_eq!((bench.read(SR) & IDLE, bench.shared.lines), (0, 0));
    }

    #[test]
    fn a_byte_that_is_not_fetched_is_an_overrun() {
        let mut bench = Bench::idle();
        bench.receive(1);
        bench.receive(2);
        assert_eq!(bench.read(SR) & (RXNE | ORE), RXNE | ORE);
        assert_eq!(bench.read(DR), 1);
        assert_eq!(bench.read(SR) & (RXNE | ORE), 0);
        assert_eq!(bench.shared.kinds(), [Kind::Lost]);
        // Disabled it hears nothing.
        bench.write(CR1, UE | TE);
        bench.receive(3);
        assert_eq!(bench.read(SR) & RXNE, 0);
    }

    #[test]
    fn streams_are_asked() {
        let mut bench = Bench::idle();
        bench.write(CR3, DMAT | DMAR);
        bench.write(DR, 1);
        bench.receive(1);
        let effects: Vec<_> = bench.shared.effects.drain(..).collect();
        let expected = [Request::Usart3Tx, Request::Usart3Tx, Request::Usart3Rx];
        assert_eq!(effects, expected.map(Effect::Dma));
    }

    #[test]
    fn what_is_not_modelled_and_mistakes_are_found() {
        let mut bench = Bench::idle();
        bench.write(CR3, HDSEL);
        bench.write(CR2, LINEN);
        assert_eq!(bench.shared.kinds(), [Kind::NotModelled; 2]);
        bench.write(DR, 1);
        bench.write(BRR, 43);
        assert_eq!(bench.shared.kinds()[2], Kind::Forbidden);
        bench.write(CR1, 0);
        bench.write(DR, 1);
        assert_eq!(bench.shared.kinds()[3..], [Kind::Forbidden; 2]);
    }
}
