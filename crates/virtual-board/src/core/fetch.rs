//! Instruction fetch: decoded instructions by address, lines of the flash interface.

use super::exception::{Done, Trap};
use super::instruction::Insn;
use super::{Core, NO_LINE, System, decode16, decode32, timing};

/// First address of the flash.
pub(super) const FLASH: u32 = 0x0800_0000;
/// Number of halfwords in the flash.
const FLASH_HALVES: u32 = 1 << 19;
/// Number of cache entries for code outside of the flash.
const CACHED: usize = 1024;

/// A decoded instruction outside of the flash, with its encoding.
#[derive(Clone, Copy)]
pub(super) struct Cached {
    pc: u32,
    halves: [u16; 2],
    insn: Insn,
}

impl Cached {
    const EMPTY: Self = Self {
        pc: u32::MAX,
        halves: [0; 2],
        insn: Insn::EMPTY,
    };
}

impl Core {
    /// Instruction at an address, without its cycles; `None` if the address cannot be read.
    fn decode_raw(system: &mut impl System, pc: u32) -> Option<(Insn, [u16; 2])> {
        let first = system.fetch(pc).ok()?;
        if !decode32::is_wide(first) {
            return Some((decode16::decode(pc, u32::from(first)), [first, 0]));
        }
        let second = system.fetch(pc.wrapping_add(2)).ok()?;
        let insn = decode32::decode(pc, u32::from(first), u32::from(second));
        Some((insn, [first, second]))
    }

    /// Instruction at an address with its cycles, which depend on the next instruction and on the branch target; `None`
    /// if the address cannot be read.
    fn decode(system: &mut impl System, pc: u32) -> Option<(Insn, [u16; 2])> {
        let (mut insn, halves) = Self::decode_raw(system, pc)?;
        let next = pc.wrapping_add(u32::from(insn.size));
        let follower = if timing::depends_on_follower(&insn) {
            Self::decode_raw(system, next).map(|(insn, _)| insn)
        } else {
            None
        };
        let unaligned = timing::is_direct_branch(&insn)
            && insn.imm & 2 != 0
            && system.fetch(insn.imm).is_ok_and(decode32::is_wide);
        timing::set_cycles(&mut insn, follower.as_ref(), unaligned);
        Some((insn, halves))
    }

    /// Decodes an instruction in flash and stores it in the table.
    #[cold]
    #[inline(never)]
    pub(super) fn decode_flash(&mut self, system: &mut impl System, pc: u32) -> Done {
        let (insn, _) = Self::decode(system, pc).ok_or(Trap::FetchBus)?;
        let index = (pc.wrapping_sub(FLASH) >> 1) as usize;
        if index >= self.decoded.len() {
            let length = (index + 1).next_multiple_of(4096);
            self.decoded.resize(length, Insn::EMPTY);
        }
        self.decoded[index] = insn;
        Ok(())
    }

    /// Instruction outside of the flash; [`Insn::EMPTY`] for flash beyond the table of decoded instructions.
    #[inline(never)]
    pub(super) fn fetch_elsewhere(&mut self, system: &mut impl System, pc: u32) -> Done<Insn> {
        if pc.wrapping_sub(FLASH) >> 1 < FLASH_HALVES {
            return Ok(Insn::EMPTY);
        }
        self.check_fetch(pc)?;
        if self.cached.is_empty() {
            self.cached.resize(CACHED, Cached::EMPTY);
        }
        let first = system.fetch(pc).map_err(|_| Trap::FetchBus)?;
        let second = if decode32::is_wide(first) {
            system
                .fetch(pc.wrapping_add(2))
                .map_err(|_| Trap::FetchBus)?
        } else {
            0
        };
        let entry = &mut self.cached[(pc >> 1) as usize % CACHED];
        if entry.pc != pc || entry.halves != [first, second] {
            let (insn, halves) = Self::decode(system, pc).ok_or(Trap::FetchBus)?;
            *entry = Cached { pc, halves, insn };
        }
        Ok(entry.insn)
    }

    /// Discards the decoded instructions of these addresses. A few instructions before them are also discarded: they
    /// may extend into the range, or their cycles may depend on it.
    pub(super) fn invalidate_code(&mut self, first: u32, last: u32) {
        let index = |address: u32| (address.saturating_sub(FLASH) >> 1) as usize;
        let end = (index(last) + 1).min(self.decoded.len());
        let begin = index(first).saturating_sub(4).min(end);
        self.decoded[begin..end].fill(Insn::EMPTY);
        self.line = NO_LINE;
    }

    /// Enters another line of 16 bytes; `last` is the address of the instruction's last halfword.
    #[inline(never)]
    pub(super) fn enter_line(&mut self, system: &mut impl System, pc: u32, last: u32) -> Done {
        let mut address = if pc >> 4 == self.line { last } else { pc };
        loop {
            self.check_fetch(address)?;
            self.line = address >> 4;
            system.enter_line(address, &mut self.cycles);
            if last >> 4 == self.line {
                return Ok(());
            }
            address = last;
        }
    }

    #[inline]
    fn check_fetch(&self, pc: u32) -> Done {
        let open = self.flash_executes && pc >> 24 == FLASH >> 24;
        if open || self.mpu.allows_fetch(pc, self.view) {
            Ok(())
        } else {
            Err(Trap::FetchMpu)
        }
    }
}
