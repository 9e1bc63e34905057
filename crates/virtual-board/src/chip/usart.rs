//! USART3, asynchronous: eight data bits, no parity, one stop bit, oversampling by 16.

use super::Peripheral;
use super::effect::{Effect, Request};
use super::interrupt::Interrupt;
use super::map::Unit;
use super::pin::Signal;
use super::register::{Register, merge, narrow};
use super::shared::Shared;
use crate::finding::FindingKind;
use crate::time::{Cycles, NEVER};

// Bits of SR.
bits! {
    ORE 3, IDLE 4, RXNE 5, TC 6, TXE 7
}
/// Flags that a read of SR followed by a read of DR clears.
const BY_READING: u32 = 0x1f;

// Bits of CR1.
bits! {
    SBK 0, RWU 1, RE 2, TE 3, IDLEIE 4, RXNEIE 5, TCIE 6, TXEIE 7, PCE 10, M 12, UE 13, OVER8 15
}
const CR1_BITS: u32 = 0xbfff;

/// Bits of CR2.
const CLKEN: u32 = 1 << 11;
const STOP: u32 = 3 << 12;
const LINEN: u32 = 1 << 14;
const CR2_BITS: u32 = 0x7f6f;

// Bits of CR3.
bits! {
    EIE 0, IREN 1, HDSEL 3, SCEN 5, DMAR 6, DMAT 7, RTSE 8, CTSE 9
}
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
#[derive(Clone, Default)]
pub(crate) struct Usart {
    /// Flags IDLE, ORE, RXNE, TC.
    sr: u32,
    brr: u32,
    cr1: u32,
    cr2: u32,
    cr3: u32,
    gtpr: u32,
    /// Flags that were set when SR was read.
    flags_read: u32,
    received: u8,
    waiting: Option<u8>,
    /// Byte on the line and the cycle of its frame's end. The byte is `None` in the idle frame of a transmitter just
    /// enabled.
    shift: Option<(Option<u8>, Cycles)>,
    /// Cycle at which the line counts as idle.
    idle: Cycles,
}

impl Usart {
    pub fn after_reset() -> Self {
        Self {
            sr: TC,
            idle: NEVER,
            ..Self::default()
        }
    }

    /// Receives a byte whose stop bit ends now.
    pub fn receive(&mut self, byte: u8, shared: &mut Shared) {
        if self.cr1 & (UE | RE) != UE | RE {
            return;
        }
        self.idle = shared.now + self.frame(shared);
        if self.sr & RXNE != 0 {
            self.sr |= ORE;
            shared.note(FindingKind::Lost, "USART3: overrun");
        } else {
            self.received = byte;
            self.sr |= RXNE;
            self.request_receive(shared);
        }
        self.plan(shared);
    }

    /// Length of a frame, core cycles: start bit, eight data bits, stop bit.
    fn frame(&self, shared: &Shared) -> Cycles {
        (10 * Cycles::from(self.brr) * shared.clocks.apb1).max(1)
    }

    fn status(&self) -> u32 {
        self.sr | if self.waiting.is_none() { TXE } else { 0 }
    }

    fn write_cr1(&mut self, value: u32, shared: &mut Shared) {
        let changed = self.cr1 ^ value;
        let features = [
            (SBK, "USART3: break"),
            (RWU, "USART3: mute mode"),
            (PCE, "USART3: parity"),
            (M, "USART3: nine bits"),
            (OVER8, "USART3: oversampling by 8"),
        ];
        shared.note_not_modelled(changed & value, &features);
        if self.shift.is_some() && changed & UE != 0 {
            shared.note(
                FindingKind::Forbidden,
                "USART3: CR1 changed during a transmission",
            );
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

    /// Handles enabling of the transmitter or the receiver.
    fn begin(&mut self, changed: u32, shared: &mut Shared) {
        if changed & (TE | RE) != 0 && self.cr1 & (TE | RE) != 0 && self.brr < 16 {
            shared.note(
                FindingKind::Forbidden,
                "USART3: enabled with a divider below 16",
            );
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
            return shared.note(FindingKind::Forbidden, "USART3: DR written while disabled");
        }
        if self.waiting.is_some() {
            shared.note(FindingKind::Lost, "USART3: DR written while it is full");
        }
        self.waiting = Some(value);
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

    /// Repeats the DMA requests that are still pending.
    pub fn request_dma(&self, shared: &mut Shared) {
        self.request_receive(shared);
        self.request_transmit(shared);
    }

    fn request_receive(&self, shared: &mut Shared) {
        if self.cr3 & DMAR != 0 && self.sr & RXNE != 0 {
            shared.effect(Effect::Dma(Request::Usart3Rx));
        }
    }

    fn write_cr3(&mut self, value: u32, shared: &mut Shared) {
        let old = std::mem::replace(&mut self.cr3, value);
        let features = [
            (IREN, "USART3: infrared"),
            (HDSEL, "USART3: half duplex"),
            (SCEN, "USART3: smartcard"),
            (RTSE, "USART3: RTS"),
            (CTSE, "USART3: CTS"),
        ];
        shared.note_not_modelled(value & !old, &features);
        if value & !old & DMAT != 0 {
            self.request_transmit(shared);
        }
        if !old & DMAR != 0 {
            self.request_receive(shared);
        }
    }

    fn write_cr2(&mut self, value: u32, shared: &mut Shared) {
        let features = [
            (LINEN, "USART3: LIN"),
            (CLKEN, "USART3: synchronous mode"),
            (STOP, "USART3: stop bits other than one"),
        ];
        shared.note_not_modelled(value & !self.cr2, &features);
        self.cr2 = value;
    }

    fn plan(&self, shared: &mut Shared) {
        let at = self.shift.map_or(NEVER, |(_, end)| end).min(self.idle);
        if shared.due(Unit::Usart3) != at {
            shared.schedule(Unit::Usart3, at);
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
                self.flags_read = self.sr & BY_READING;
                self.status()
            }
            0x04 => {
                self.sr &= !(RXNE | std::mem::take(&mut self.flags_read));
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
            // Writing zero clears RXNE and TC; all other flags are read-only.
            0x00 => self.sr &= value | !(mask & (RXNE | TC)),
            0x04 => self.write_data(value as u8, shared),
            0x08 => {
                if self.shift.is_some() {
                    shared.note(
                        FindingKind::Forbidden,
                        "USART3: BRR changed during a transmission",
                    );
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

    fn event(&mut self, shared: &mut Shared) {
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
                shared.circuit().serial(byte, at);
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
mod tests;
