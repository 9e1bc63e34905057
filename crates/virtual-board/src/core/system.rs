//! What the core needs of the chip around it.

use crate::finding::Kind;
use crate::time::Cycles;

/// Width of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    Byte,
    /// 16 bits.
    Half,
    /// 32 bits.
    Word,
}

impl Width {
    /// Bytes.
    pub const fn bytes(self) -> u32 {
        match self {
            Self::Byte => 1,
            Self::Half => 2,
            Self::Word => 4,
        }
    }

    /// The bits of a word that it has.
    pub const fn mask(self) -> u32 {
        u32::MAX >> (32 - 8 * self.bytes())
    }
}

/// What an access moves where, and the instruction that makes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Address of the first byte.
    pub address: u32,
    /// Width.
    pub width: Width,
    /// Address of the instruction.
    pub pc: u32,
}

impl Transfer {
    /// A word.
    #[inline(always)]
    pub const fn word(address: u32, pc: u32) -> Self {
        let width = Width::Word;
        Self { address, width, pc }
    }

    /// The value of the word around it that it reads.
    pub const fn part_of(self, word: u32) -> u32 {
        word >> (8 * (self.address & 3)) & self.width.mask()
    }

    /// A value at its place in the word around it, and the bits of the word that it writes.
    pub const fn in_word(self, value: u32) -> (u32, u32) {
        let shift = 8 * (self.address & 3);
        let mask = self.width.mask() << shift;
        (value << shift & mask, mask)
    }

    /// True if the address is a multiple of the width.
    #[inline(always)]
    pub const fn is_aligned(self) -> bool {
        self.address & (self.width.bytes() - 1) == 0
    }
}

/// The bus answered with an error; the core takes a bus fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusError;

/// The chip as the core sees it: everything but the private peripheral bus (0xE000_0000 to
/// 0xE00F_FFFF), which is the core's own.
///
/// Accesses come aligned to their width: the core splits what is not. `cycle` is the core's clock;
/// what an access takes beyond the core's own time (wait states, the bus, a flash that is busy) is
/// added to it.
pub trait System {
    /// A halfword of program, without side effect and without time, for decoding.
    fn fetch(&mut self, address: u32) -> Result<u16, BusError>;
    /// The program enters another line of 16 bytes, by a jump or by going on.
    fn enter_line(&mut self, address: u32, cycle: &mut Cycles);
    /// A load.
    fn read(&mut self, at: Transfer, cycle: &mut Cycles) -> Result<u32, BusError>;
    /// A store.
    fn write(&mut self, at: Transfer, value: u32, cycle: &mut Cycles) -> Result<(), BusError>;
    /// The core looks up from its instructions at this cycle at the latest. An access that changes
    /// what is to come, an interrupt line for example, sets it to 0.
    fn limit(&self) -> Cycles;
    /// Does what is due at `cycle`, and sets the limit anew, to `until` at most. Gives when the next
    /// thing is due, which is what a sleeping core waits for.
    fn advance(&mut self, cycle: Cycles, until: Cycles) -> Cycles;
    /// Levels of the interrupt lines, line n at bit n.
    fn lines(&self) -> u128;
    /// Whether the non-maskable interrupt was asked for since the last call; looked at after
    /// [`Self::advance`].
    fn take_nmi(&mut self) -> bool {
        false
    }
    /// Addresses of program that changed since the last call, first and last: decoded instructions of
    /// these are forgotten.
    fn take_changed_code(&mut self) -> Option<(u32, u32)>;
    /// Whether the core must stop at once, because the chip is to be reset; looked at after
    /// [`Self::advance`].
    fn must_stop(&self) -> bool {
        false
    }
    /// The program waits for the end of all its accesses (DSB).
    fn synchronise(&mut self) {}
    /// The program asked for a reset (SYSRESETREQ).
    fn request_reset(&mut self);
    /// Notes what the program does wrong.
    fn note(&mut self, kind: Kind, pc: u32, cycle: Cycles, text: String);
}
