//! A stream: its registers, its FIFO, and the steps of which its transfers consist.

use crate::core::Width;

// Bits of SxCR.
bits! { pub(super):
    EN 0, DMEIE 1, TEIE 2, HTIE 3, TCIE 4, PFCTRL 5
}
pub(super) const DIR: u32 = 3 << 6;
bits! { pub(super):
    TO_PERIPHERAL 6, CIRC 8, PINC 9, MINC 10, PINCOS 15, DBM 18, CT 19
}
pub(super) const BURSTS: u32 = 15 << 21;
// Bits of SxFCR.
pub(super) const DMDIS: u32 = 1 << 2;
pub(super) const FEIE: u32 = 1 << 7;
// Flags of a stream.
bits! { pub(super):
    FEIF 0, DMEIF 2, TEIF 3, HTIF 4, TCIF 5
}

/// Bytes of the FIFO.
const DEPTH: u32 = 16;

/// One access of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Reads a place.
    Read(u32, Width),
    /// Writes a value to a place.
    Write(u32, Width, u32),
}

/// What an access belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Peripheral,
    Memory,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stream {
    pub cr: u32,
    pub ndtr: u32,
    pub peripheral: u32,
    pub memory: [u32; 2],
    pub fcr: u32,
    pub flags: u32,
    /// Items of a block.
    pub block: u32,
    /// Bytes that the block's addresses have come along.
    along: [u32; 2],
    /// Bytes of the block that were not read from memory yet.
    unread: u32,
    /// Bytes that wait, the first in the lowest place, and how many.
    fifo: u128,
    level: u32,
    /// The peripheral has asked for an item.
    wanted: bool,
    /// The FIFO is being emptied to memory, or filled from there.
    moving: bool,
    side: Option<Side>,
}

fn width(code: u32) -> Width {
    match code & 3 {
        0 => Width::Byte,
        1 => Width::Half,
        _ => Width::Word,
    }
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

    pub fn is_direct(&self) -> bool {
        self.fcr & DMDIS == 0
    }

    pub fn peripheral_width(&self) -> Width {
        width(self.cr >> 11)
    }

    /// Without FIFO both sides have the peripheral's width.
    pub fn memory_width(&self) -> Width {
        width(self.cr >> if self.is_direct() { 11 } else { 13 })
    }

    pub fn goes_out(&self) -> bool {
        self.cr & DIR == TO_PERIPHERAL
    }

    /// Whether an interrupt is asked for.
    pub fn active(&self) -> bool {
        let on = |flag: u32, enable: u32| self.flags & flag != 0 && self.cr & enable != 0;
        on(TCIF, TCIE)
            || on(HTIF, HTIE)
            || on(TEIF, TEIE)
            || on(DMEIF, DMEIE)
            || self.flags & FEIF != 0 && self.fcr & FEIE != 0
    }

    /// SxFCR with the FIFO's level.
    pub fn fifo_control(&self) -> u32 {
        let level = match self.level {
            0 => 4,
            DEPTH => 5,
            level => level / (DEPTH / 4),
        };
        self.fcr & !0x38 | level << 3
    }

    /// Bytes in the FIFO from which on it is emptied, or down to which it is filled.
    fn threshold(&self) -> u32 {
        ((self.fcr & 3) + 1) * (DEPTH / 4)
    }

    /// Is switched on: a block begins.
    pub fn begin(&mut self) {
        self.block = self.ndtr;
        (self.fifo, self.level) = (0, 0);
        self.wanted = false;
        self.begin_block();
        self.moving = self.goes_out();
    }

    fn begin_block(&mut self) {
        self.ndtr = self.block;
        self.along = [0; 2];
        self.unread = self.block * self.peripheral_width().bytes();
    }

    /// Is switched off: what waits for memory goes there.
    pub fn end(&mut self) {
        self.moving = !self.goes_out();
        if self.goes_out() {
            (self.fifo, self.level) = (0, 0);
        }
    }

    /// The peripheral asks for an item.
    pub fn ask(&mut self) {
        self.wanted = self.ndtr > 0;
    }

    fn place(&self, side: Side) -> u32 {
        match side {
            Side::Peripheral => self.peripheral.wrapping_add(self.along[0]),
            Side::Memory => {
                let base = self.memory[usize::from(self.cr & CT != 0)];
                base.wrapping_add(self.along[1])
            }
        }
    }

    fn pop(&mut self, width: Width) -> u32 {
        let bits = 8 * width.bytes();
        let value = self.fifo as u64 & ((1u64 << bits) - 1);
        self.fifo >>= bits;
        self.level -= width.bytes().min(self.level);
        value as u32
    }

    fn push(&mut self, value: u32, width: Width) {
        let bits = 8 * width.bytes();
        let value = u128::from(value) & ((1u128 << bits) - 1);
        self.fifo |= value << (8 * self.level);
        self.level += width.bytes();
    }

    /// The accesses that serve a request of a stream without FIFO towards memory: from where, to where.
    /// Both are then to be made, and [`Self::moved`] is to be called.
    pub fn direct(&self) -> Option<(u32, u32, Width)> {
        let direct = self.is_direct() && !self.goes_out() && self.ndtr > 0;
        let width = self.peripheral_width();
        direct.then(|| {
            (
                self.place(Side::Peripheral),
                self.place(Side::Memory),
                width,
            )
        })
    }

    /// An item went to memory without FIFO.
    pub fn moved(&mut self) {
        self.count_item();
        self.count_memory(self.peripheral_width());
    }

    /// The next access, if there is one to be made.
    pub fn step(&mut self) -> Option<Step> {
        let (goes_out, peripheral) = (self.goes_out(), self.peripheral_width());
        if self.wanted && !goes_out {
            self.side = Some(Side::Peripheral);
            return Some(Step::Read(self.place(Side::Peripheral), peripheral));
        }
        if self.wanted && self.level >= peripheral.bytes() {
            self.side = Some(Side::Peripheral);
            let value = self.pop(peripheral);
            let place = self.place(Side::Peripheral);
            return Some(Step::Write(place, peripheral, value));
        }
        if !self.moving {
            return None;
        }
        let memory = self.memory_width();
        self.side = Some(Side::Memory);
        let place = self.place(Side::Memory);
        if goes_out {
            let most = if self.is_direct() {
                memory.bytes()
            } else {
                DEPTH
            };
            if self.unread > 0 && self.level + memory.bytes() <= most {
                return Some(Step::Read(place, memory));
            }
        } else if self.level > 0 {
            let value = self.pop(memory);
            return Some(Step::Write(place, memory, value));
        }
        self.moving = false;
        None
    }

    /// An access was made; `value` is what was read.
    pub fn done(&mut self, value: u32) {
        match self.side.take() {
            Some(Side::Peripheral) => self.peripheral_done(value),
            Some(Side::Memory) => {
                let width = self.memory_width();
                self.count_memory(width);
                if self.goes_out() {
                    self.unread = self.unread.saturating_sub(width.bytes());
                    self.push(value, width);
                }
            }
            None => {}
        }
    }

    /// The address of memory goes on.
    fn count_memory(&mut self, width: Width) {
        if self.cr & MINC != 0 {
            self.along[1] += width.bytes();
        }
    }

    /// An item has come from or gone to the peripheral.
    fn count_item(&mut self) {
        self.ndtr -= 1;
        if self.ndtr == self.block / 2 {
            self.flags |= HTIF;
        }
        if self.cr & PINC != 0 {
            self.along[0] += if self.cr & PINCOS != 0 {
                4
            } else {
                self.peripheral_width().bytes()
            };
        }
    }

    fn peripheral_done(&mut self, value: u32) {
        let width = self.peripheral_width();
        self.wanted = false;
        self.count_item();
        let ends = self.ndtr == 0;
        if self.goes_out() {
            self.moving = self.level <= self.threshold() || self.is_direct();
        } else {
            self.push(value, width);
            self.moving = ends || self.is_direct() || self.level >= self.threshold();
        }
    }

    /// All accesses of a request are made: flags, and what follows at a block's end. Whether it ended.
    pub fn settle(&mut self) -> bool {
        let ends = self.ndtr == 0 && self.is_on();
        if ends {
            self.flags |= TCIF;
            if self.cr & DBM != 0 {
                self.cr ^= CT;
            }
            if self.cr & (CIRC | DBM) != 0 {
                self.begin_block();
                self.moving = self.goes_out();
            } else {
                self.cr &= !EN;
            }
        }
        ends
    }

    /// An access met a bus error: the stream stops.
    pub fn fail(&mut self) {
        self.flags |= TEIF;
        self.cr &= !EN;
        (self.wanted, self.moving, self.side) = (false, false, None);
    }
}
