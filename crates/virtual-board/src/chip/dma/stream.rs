//! A stream: registers and item addresses.

use crate::core::Width;

// Bits of SxCR.
bits! { pub(super):
    EN 0, DMEIE 1, TEIE 2, HTIE 3, TCIE 4, PFCTRL 5
}
pub(super) const DIR: u32 = 3 << 6;
bits! { pub(super):
    TO_PERIPHERAL 6, CIRC 8, PINC 9, MINC 10, DBM 18
}
pub(super) const BURSTS: u32 = 15 << 21;
// Bits of SxFCR.
pub(super) const DMDIS: u32 = 1 << 2;
pub(super) const FEIE: u32 = 1 << 7;
// Flags of a stream.
bits! { pub(super):
    TEIF 3, HTIF 4, TCIF 5
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stream {
    pub cr: u32,
    pub ndtr: u32,
    pub peripheral: u32,
    pub memory: [u32; 2],
    pub fcr: u32,
    pub flags: u32,
    /// Number of items in a block: NDTR when the stream was enabled.
    block: u32,
    /// Increment of the memory address since the start of the block, bytes.
    byte_offset: u32,
}

impl Stream {
    /// A stream after a reset.
    pub fn new() -> Self {
        Self {
            fcr: 0x21,
            ..Self::default()
        }
    }

    pub fn is_on(&self) -> bool {
        self.cr & EN != 0
    }

    pub fn channel(&self) -> u32 {
        self.cr >> 25 & 7
    }

    /// Width of an item: without FIFO, the peripheral's width on both sides.
    pub fn width(&self) -> Width {
        match self.cr >> 11 & 3 {
            0 => Width::Byte,
            1 => Width::Half,
            _ => Width::Word,
        }
    }

    /// True if a flag is set whose interrupt is enabled.
    pub fn active(&self) -> bool {
        let on = |flag: u32, enable: u32| self.flags & flag != 0 && self.cr & enable != 0;
        on(TCIF, TCIE) || on(HTIF, HTIE) || on(TEIF, TEIE)
    }

    /// Starts a block when the stream is enabled.
    pub fn begin(&mut self) {
        (self.block, self.byte_offset) = (self.ndtr, 0);
    }

    /// Next transfer: source address, destination address, width.
    pub fn item(&self) -> (u32, u32, Width) {
        let memory = self.memory[0].wrapping_add(self.byte_offset);
        match self.cr & DIR {
            TO_PERIPHERAL => (memory, self.peripheral, self.width()),
            _ => (self.peripheral, memory, self.width()),
        }
    }

    /// Records that an item was transferred. True if the block ended.
    pub fn moved(&mut self) -> bool {
        self.ndtr -= 1;
        if self.cr & MINC != 0 {
            self.byte_offset += self.width().bytes();
        }
        if self.ndtr == self.block / 2 {
            self.flags |= HTIF;
        }
        if self.ndtr > 0 {
            return false;
        }
        self.flags |= TCIF;
        if self.cr & CIRC != 0 {
            (self.ndtr, self.byte_offset) = (self.block, 0);
        } else {
            self.cr &= !EN;
        }
        true
    }

    /// Stops the stream after a bus error.
    pub fn fail(&mut self) {
        self.flags |= TEIF;
        self.cr &= !EN;
    }
}
