//! Private peripheral bus, 0xE000_0000 to 0xE00F_FFFF: registers of NVIC, SCB, SysTick, DWT, MPU and floating point;
//! stubs of ITM, flash patch and debug.

use super::nvic::{Nvic, exception as number};
use super::scb::{CPUID, IDENTIFICATION, MEDIA, VECTKEY, VECTKEYSTAT, ccr, fpccr};
use super::{BusError, Core, Stop, System, Transfer};
use crate::finding::FindingKind;

/// Exceptions enabled in SHCSR, and their bits: memory management, bus and usage fault.
const FAULTS: [(u16, u32); 3] = [
    (number::MEM_MANAGE, 16),
    (number::BUS_FAULT, 17),
    (number::USAGE_FAULT, 18),
];

/// Active exceptions in SHCSR, and their bits.
const ACTIVE: [(u16, u32); 7] = [
    (number::MEM_MANAGE, 0),
    (number::BUS_FAULT, 1),
    (number::USAGE_FAULT, 3),
    (number::SVCALL, 7),
    (number::DEBUG_MONITOR, 8),
    (number::PENDSV, 10),
    (number::SYSTICK, 11),
];

/// Pending exceptions in SHCSR, and their bits.
const PENDED: [(u16, u32); 4] = [
    (number::USAGE_FAULT, 12),
    (number::MEM_MANAGE, 13),
    (number::BUS_FAULT, 14),
    (number::SVCALL, 15),
];

/// Bit of an exception in a set, moved to the position `bit`.
const fn moved(set: u128, (exception, bit): (u16, u32)) -> u32 {
    ((set >> exception & 1) as u32) << bit
}

/// Bit of DEMCR that enables the DWT.
const TRCENA: u32 = 1 << 24;

impl Core {
    /// Cycles in which the core was not asleep.
    fn awake(&self) -> u64 {
        self.cycles - self.asleep
    }

    pub(super) fn private_load(
        &mut self,
        system: &mut impl System,
        at: Transfer,
    ) -> Result<u32, BusError> {
        if !self.privileged() {
            return Err(BusError);
        }
        self.refresh(system);
        let word = self.private_read(system, at.address & !3, at.pc);
        Ok(at.part_of(word))
    }

    pub(super) fn private_store(
        &mut self,
        system: &mut impl System,
        at: Transfer,
        value: u32,
    ) -> Result<(), BusError> {
        let Transfer { address, pc, .. } = at;
        let user_trigger = address & !3 == 0xe000_ef00 && self.scb.ccr & ccr::USERSETMPEND != 0;
        if !self.privileged() && !user_trigger {
            return Err(BusError);
        }
        self.refresh(system);
        self.check_needed = true;
        let (value, mask) = at.in_word(value);
        let address = address & !3;
        match address {
            0xe000_e400..0xe000_e4f0 => {
                let first = 16 + (address & 0xff);
                self.nvic.set_priority_word(first, value, mask);
            }
            0xe000_ed18..=0xe000_ed20 => {
                let first = 4 + (address - 0xe000_ed18);
                self.nvic.set_priority_word(first, value, mask);
            }
            // Bits written as one are cleared, so the rest of the word is not needed.
            0xe000_ed28 => self.scb.cfsr &= !value,
            _ => {
                let old = if mask == u32::MAX {
                    0
                } else {
                    self.note_private(system, FindingKind::Alignment, address, pc);
                    self.private_read(system, address, pc) & !mask
                };
                self.private_write(system, address, old | value, pc);
            }
        }
        Ok(())
    }

    fn note_private(&self, system: &mut impl System, kind: FindingKind, address: u32, pc: u32) {
        let text = format!("private peripheral {address:#010x}");
        system.note(kind, pc, self.cycles, text);
    }

    fn private_read(&mut self, system: &mut impl System, address: u32, pc: u32) -> u32 {
        let array = (address & 0x7f) >> 2;
        match address {
            // Stimulus ports of the ITM are always ready; the other registers of the ITM read as 0.
            0xe000_0000..0xe000_0080 => 1,
            0xe000_0e00..0xe000_1000 => 0,
            0xe000_1000..0xe000_1060 => self.dwt.read(address & 0xff, self.awake()),
            0xe000_2000..0xe000_2030 => 0,
            0xe000_e004 => super::LINES.div_ceil(32) - 1,
            0xe000_e008 => self.scb.actlr,
            0xe000_e010..=0xe000_e01c => self.systick.read(address & 15, self.cycles),
            0xe000_e100..0xe000_e200 => Nvic::word(self.nvic.enabled, array),
            0xe000_e200..0xe000_e300 => Nvic::word(self.nvic.pending, array),
            0xe000_e300..0xe000_e380 => Nvic::word(self.nvic.active, array),
            0xe000_e400..0xe000_e4f0 => self.nvic.priority_word(16 + (address & 0xff)),
            0xe000_ed00..0xe000_ed90 => self.read_system(address),
            0xe000_ed90..=0xe000_edb8 => self.mpu.read(address - 0xe000_ed90),
            0xe000_edf0 => u32::from(self.debug.attached),
            0xe000_edf4 | 0xe000_edf8 => 0,
            0xe000_edfc => self.scb.demcr | if self.dwt.enabled { TRCENA } else { 0 },
            0xe000_ef00 => 0,
            0xe000_ef34 => self.scb.fpccr,
            0xe000_ef38 => self.scb.fpcar,
            0xe000_ef3c => self.scb.fpdscr,
            0xe000_ef40 | 0xe000_ef44 => MEDIA[(address >> 2 & 1) as usize],
            0xe000_efd0..0xe000_f000 | 0xe000_1fb0..0xe000_2000 | 0xe004_0000..0xe004_2000 => 0,
            0xe00f_f000.. => 0,
            _ => {
                self.note_private(system, FindingKind::Unmapped, address, pc);
                0
            }
        }
    }

    fn read_system(&mut self, address: u32) -> u32 {
        match address & 0xff {
            0x00 => CPUID,
            0x04 => self.interrupt_control(),
            0x08 => self.scb.vtor,
            0x0c => VECTKEYSTAT | self.nvic.group << 8,
            0x10 => self.scb.scr,
            0x14 => self.scb.ccr,
            offset @ (0x18 | 0x1c | 0x20) => self.nvic.priority_word(4 + offset - 0x18),
            0x24 => {
                let set = |bits: &[(u16, u32)], set| bits.iter().fold(0, |v, &b| v | moved(set, b));
                set(&FAULTS, self.nvic.enabled)
                    | set(&ACTIVE, self.nvic.active)
                    | set(&PENDED, self.nvic.pending)
            }
            0x28 => self.scb.cfsr,
            0x2c => self.scb.hfsr,
            0x30 => self.scb.dfsr,
            0x34 => self.scb.mmfar,
            0x38 => self.scb.bfar,
            offset @ 0x40..0x74 => IDENTIFICATION[(offset as usize - 0x40) / 4],
            0x88 => self.scb.cpacr,
            _ => 0,
        }
    }

    /// Value of ICSR.
    fn interrupt_control(&self) -> u32 {
        let lines = self.nvic.pending >> number::FIRST_LINE != 0;
        let first = self.nvic.first().map_or(0, |(exception, _)| exception);
        let alone = self.nvic.active.count_ones() <= 1;
        moved(self.nvic.pending, (number::NMI, 31))
            | moved(self.nvic.pending, (number::PENDSV, 28))
            | moved(self.nvic.pending, (number::SYSTICK, 26))
            | u32::from(lines) << 22
            | u32::from(first) << 12
            | u32::from(alone) << 11
            | u32::from(self.ipsr)
    }

    fn private_write(&mut self, system: &mut impl System, address: u32, value: u32, pc: u32) {
        let set = Nvic::set_of(value, (address & 0x7f) >> 2);
        let awake = self.awake();
        match address {
            0xe000_0000..0xe000_1000 => {}
            0xe000_1000..0xe000_1060 => {
                if !self.dwt.write(address & 0xff, value, awake) {
                    self.note_private(system, FindingKind::NotModelled, address, pc);
                }
            }
            0xe000_2000..0xe000_2030 => {}
            0xe000_e008 => self.scb.actlr = value & 0x307,
            0xe000_e010..=0xe000_e01c => self.systick.write(address & 15, value, self.cycles),
            0xe000_e100..0xe000_e180 => self.nvic.enabled |= set,
            0xe000_e180..0xe000_e200 => self.nvic.enabled &= !set,
            0xe000_e200..0xe000_e280 => self.nvic.pend_all(set, self.cycles),
            0xe000_e280..0xe000_e300 => self.nvic.pending &= !set,
            0xe000_ed00..0xe000_ed90 => self.write_system(system, address, value, pc),
            0xe000_ed90..=0xe000_edb8 => {
                self.mpu.write(address - 0xe000_ed90, value);
                self.update_view(true);
            }
            0xe000_edf0..=0xe000_edf8 => {}
            0xe000_edfc => {
                self.scb.demcr = value & 0x000f_07f1;
                self.dwt.enable(value & TRCENA != 0, awake);
            }
            0xe000_ef00 => {
                let line = value & 0x1ff;
                if line < super::LINES {
                    self.nvic.pend((16 + line) as u16, self.cycles);
                }
            }
            0xe000_ef34 => {
                let bits = fpccr::ASPEN | fpccr::LSPEN | fpccr::STATE;
                self.scb.fpccr = value & bits;
                self.fp_ready = false;
            }
            0xe000_ef38 => self.scb.fpcar = value & !7,
            0xe000_ef3c => self.scb.fpdscr = value & 0x07c0_0000,
            0xe000_1fb0 | 0xe004_0000..0xe004_2000 => {}
            _ => self.note_private(system, FindingKind::Unmapped, address, pc),
        }
    }

    fn write_system(&mut self, system: &mut impl System, address: u32, value: u32, pc: u32) {
        match address & 0xff {
            0x04 => self.write_interrupt_control(value),
            0x08 => self.scb.vtor = value & 0xffff_ff80,
            0x0c => self.write_reset_control(system, value),
            0x10 => self.scb.scr = value & 0x16,
            0x14 => self.scb.ccr = value & ccr::WRITABLE,
            0x24 => self.write_handlers(value),
            0x2c => self.scb.hfsr &= !value,
            0x30 => self.scb.dfsr &= !value,
            0x34 => self.scb.mmfar = value,
            0x38 => self.scb.bfar = value,
            0x88 => {
                self.scb.cpacr = value & 0x00f0_0000;
                self.fp_ready = false;
            }
            // These registers are read-only.
            0x00 | 0x3c | 0x40..0x74 => {}
            _ => self.note_private(system, FindingKind::Unmapped, address, pc),
        }
    }

    fn write_interrupt_control(&mut self, value: u32) {
        let cycles = self.cycles;
        if value >> 31 != 0 {
            self.nvic.pend(number::NMI, cycles);
        }
        if value >> 28 & 1 != 0 {
            self.nvic.pend(number::PENDSV, cycles);
        } else if value >> 27 & 1 != 0 {
            self.nvic.unpend(number::PENDSV);
        }
        if value >> 26 & 1 != 0 {
            self.nvic.pend(number::SYSTICK, cycles);
        } else if value >> 25 & 1 != 0 {
            self.nvic.unpend(number::SYSTICK);
        }
    }

    /// Writes AIRCR; without the key, the write is ignored.
    fn write_reset_control(&mut self, system: &mut impl System, value: u32) {
        if value >> 16 != VECTKEY {
            return;
        }
        self.nvic.group = value >> 8 & 7;
        if value & 4 != 0 {
            system.request_reset();
            self.stop = Some(Stop::Reset);
        }
    }

    /// Writes SHCSR.
    fn write_handlers(&mut self, value: u32) {
        let put = |set: &mut u128, bits: &[(u16, u32)]| {
            for &(exception, bit) in bits {
                let there = u128::from(value >> bit & 1);
                *set = *set & !(1 << exception) | there << exception;
            }
        };
        put(&mut self.nvic.enabled, &FAULTS);
        put(&mut self.nvic.active, &ACTIVE);
        put(&mut self.nvic.pending, &PENDED);
    }
}
