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
    fn read(
        &mut self,
        address: u32,
        width: Width,
        pc: u32,
        cycle: &mut Cycles,
    ) -> Result<u32, BusError>;
    /// A store.
    fn write(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        pc: u32,
        cycle: &mut Cycles,
    ) -> Result<(), BusError>;
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
    /// The program asked for a reset (SYSRESETREQ).
    fn request_reset(&mut self);
    /// Notes what the program does wrong.
    fn note(&mut self, kind: Kind, pc: u32, cycle: Cycles, text: String);
}
