//! Interface of the chip to the core.

use crate::finding::FindingKind;
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
    /// Number of bytes of an access.
    pub const fn bytes(self) -> u32 {
        match self {
            Self::Byte => 1,
            Self::Half => 2,
            Self::Word => 4,
        }
    }

    /// Bits of a word that the width covers.
    pub const fn mask(self) -> u32 {
        u32::MAX >> (32 - 8 * self.bytes())
    }
}

/// An access: address, width, and the instruction that makes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Address of the first byte.
    pub address: u32,
    /// Width of the access.
    pub width: Width,
    /// Address of the instruction that makes the access.
    pub pc: u32,
}

impl Transfer {
    /// A word access.
    #[inline(always)]
    pub const fn word(address: u32, pc: u32) -> Self {
        let width = Width::Word;
        Self { address, width, pc }
    }

    /// Value of the access within its aligned word.
    pub const fn part_of(self, word: u32) -> u32 {
        word >> (8 * (self.address & 3)) & self.width.mask()
    }

    /// Value shifted to its position in the aligned word, and the bits that the access writes.
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

/// The bus reported an error; the core takes a bus fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusError;

/// The chip around the core: everything except the private peripheral bus (0xE000_0000 to 0xE00F_FFFF). In this range
/// only DBGMCU belongs to the chip, all else to the core.
///
/// Accesses are aligned to their width: the core splits unaligned ones. `cycle` is the clock of the core; an access
/// adds its time beyond the core's own (wait states, bus, busy flash).
pub trait System {
    /// Halfword of program, for decoding; no side effects, takes no time.
    fn fetch(&mut self, address: u32) -> Result<u16, BusError>;
    /// Fetches from another line of 16 bytes that the program enters, by a jump or sequentially.
    fn enter_line(&mut self, address: u32, cycle: &mut Cycles);
    /// Loads a value.
    fn read(&mut self, at: Transfer, cycle: &mut Cycles) -> Result<u32, BusError>;
    /// Stores a value.
    fn write(&mut self, at: Transfer, value: u32, cycle: &mut Cycles) -> Result<(), BusError>;
    /// Latest cycle at which the core must interrupt execution and call [`Self::advance`]. An access that needs such a
    /// call at once, for example because an interrupt line changed, sets the limit to 0.
    fn limit(&self) -> Cycles;
    /// Handles the events due at `cycle` and sets a new limit, at most `until`. Returns the cycle of the next event,
    /// for which a sleeping core waits.
    fn advance(&mut self, cycle: Cycles, until: Cycles) -> Cycles;
    /// Levels of the interrupt lines, line n at bit n.
    fn lines(&self) -> u128;
    /// True if the non-maskable interrupt was requested since the last call; called after [`Self::advance`].
    fn take_nmi(&mut self) -> bool {
        false
    }
    /// First and last address of code that changed since the last call, `None` without a change; the core discards the
    /// decoded instructions of this range.
    fn take_changed_code(&mut self) -> Option<(u32, u32)>;
    /// True if the core must stop at once, for a reset, a failed supply or a change of the clock; called after
    /// [`Self::advance`].
    fn must_stop(&self) -> bool {
        false
    }
    /// Executes a DSB: all accesses of the program are complete.
    fn synchronise(&mut self) {}
    /// Requests a reset by the program (SYSRESETREQ).
    fn request_reset(&mut self);
    /// Records a finding at the instruction `pc`.
    fn note(&mut self, kind: FindingKind, pc: u32, cycle: Cycles, text: String);
}
