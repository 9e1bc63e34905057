//! 16-bit instructions (ARMv7-M Architecture Reference Manual, A5.2).

use super::instruction::{
    self, Alu, Dsp, Insn, Mode, Op, Shift, Size, Special, Test, UNDEFINED, UNPREDICTABLE, directed,
    literal,
};

/// Conditional branches; each odd condition inverts the even one before it.
const CONDITIONAL: [Op; 7] = [
    Op::BranchZero,
    Op::BranchCarry,
    Op::BranchNegative,
    Op::BranchOverflow,
    Op::BranchHigher,
    Op::BranchGreaterEqual,
    Op::BranchGreater,
];

/// Bit of an instruction's `x` that inverts the condition of a branch.
pub(super) const INVERT: u32 = 0x80;

/// A branch with a condition; condition 14 is always.
pub(super) fn branch(condition: u32, target: u32) -> Insn {
    let insn = match CONDITIONAL.get(condition as usize / 2) {
        Some(&op) => Insn::new(op).with_x((condition & 1) * INVERT),
        None => Insn::new(Op::B),
    };
    insn.with_imm(target)
}

/// The low `bits` of a value as a signed number.
pub(super) const fn signed(value: u32, bits: u32) -> u32 {
    (((value << (32 - bits)) as i32) >> (32 - bits)) as u32
}

/// Decodes a 16-bit instruction.
pub(super) fn decode(pc: u32, h: u32) -> Insn {
    match h >> 12 {
        0 | 1 => shift_add(h),
        2 | 3 => immediate(h),
        4 if h >> 10 == 0b01_0000 => data_processing(h),
        4 if h >> 10 == 0b01_0001 => high_registers(pc, h),
        4 => Insn::regs(Op::LdrLit, h >> 8 & 7, 15, 0).with_imm(literal(pc, (h & 0xff) << 2)),
        5 => register_offset(h),
        6..=8 => immediate_offset(h),
        9 => {
            let op = if h & 0x800 != 0 {
                Op::LdrImm
            } else {
                Op::StrImm
            };
            Insn::regs(op, h >> 8 & 7, 13, 0).with_imm((h & 0xff) << 2)
        }
        10 => {
            let (d, imm) = (h >> 8 & 7, (h & 0xff) << 2);
            if h & 0x800 != 0 {
                Insn::regs(Op::AddImm, d, 13, 0).with_imm(imm)
            } else {
                Insn::regs(Op::MovImm, d, 0, 0).with_imm(literal(pc, imm))
            }
        }
        11 => miscellaneous(pc, h),
        12 => multiple(h),
        13 => match h >> 8 & 15 {
            14 => UNDEFINED,
            15 => Insn::new(Op::Special(Special::Svc)).with_imm(h & 0xff),
            condition => branch(
                condition,
                pc.wrapping_add(4).wrapping_add(signed(h & 0xff, 8) << 1),
            ),
        },
        14 => branch(
            14,
            pc.wrapping_add(4).wrapping_add(signed(h & 0x7ff, 11) << 1),
        ),
        _ => UNDEFINED,
    }
}

fn shift_add(h: u32) -> Insn {
    let (d, n) = (h & 7, h >> 3 & 7);
    let (m, amount) = (h >> 6 & 7, h >> 6 & 31);
    let whole = if amount == 0 { 32 } else { amount };
    match h >> 11 & 3 {
        0 if amount == 0 => Insn::regs(Op::MovRegS, d, 0, n),
        0 => Insn::regs(Op::LslImmS, d, 0, n).with_imm(amount),
        1 => Insn::regs(Op::LsrImmS, d, 0, n).with_imm(whole),
        2 => Insn::regs(Op::AsrImmS, d, 0, n).with_imm(whole),
        _ => match h >> 9 & 3 {
            0 => Insn::regs(Op::AddRegS, d, n, m),
            1 => Insn::regs(Op::SubRegS, d, n, m),
            2 => Insn::regs(Op::AddImmS, d, n, 0).with_imm(m),
            _ => Insn::regs(Op::SubImmS, d, n, 0).with_imm(m),
        },
    }
}

fn immediate(h: u32) -> Insn {
    let (d, imm) = (h >> 8 & 7, h & 0xff);
    let op = match h >> 11 & 3 {
        0 => Op::MovImmS,
        1 => Op::CmpImm,
        2 => Op::AddImmS,
        _ => Op::SubImmS,
    };
    Insn::regs(op, d, d, 0).with_imm(imm)
}

fn data_processing(h: u32) -> Insn {
    let (d, m) = (h & 7, h >> 3 & 7);
    let alu = |alu| Insn::regs(Op::AluRegS(alu), d, d, m);
    let shift = |shift| Insn::regs(Op::ShiftRegS(shift), d, d, m);
    match h >> 6 & 15 {
        0 => alu(Alu::And),
        1 => alu(Alu::Eor),
        2 => shift(Shift::Lsl),
        3 => shift(Shift::Lsr),
        4 => shift(Shift::Asr),
        5 => alu(Alu::Adc),
        6 => alu(Alu::Sbc),
        7 => shift(Shift::Ror),
        8 => Insn::regs(Op::TestReg(Test::Tst), 0, d, m),
        9 => Insn::regs(Op::AluImmS(Alu::Rsb), d, m, 0),
        10 => Insn::regs(Op::CmpReg, 0, d, m),
        11 => Insn::regs(Op::TestReg(Test::Cmn), 0, d, m),
        12 => alu(Alu::Orr),
        13 => Insn::regs(Op::MulS, d, m, d),
        14 => alu(Alu::Bic),
        _ => alu(Alu::Mvn),
    }
}

fn high_registers(pc: u32, h: u32) -> Insn {
    let (d, m) = (h >> 4 & 8 | h & 7, h >> 3 & 15);
    let here = pc.wrapping_add(4);
    match h >> 8 & 3 {
        0 => match (d, m) {
            (15, 15) => UNPREDICTABLE,
            (15, _) => Insn::regs(Op::AddPc, 15, 15, m).with_imm(here),
            (13, 15) => Insn::regs(Op::SpImm, 13, 13, 0).with_imm(here),
            (13, _) => Insn::regs(Op::SpShift(Alu::Add), 13, 13, m),
            (_, 15) => Insn::regs(Op::AddImm, d, d, 0).with_imm(here),
            _ => Insn::regs(Op::AddReg, d, d, m),
        },
        1 if d == 15 || m == 15 || (d < 8 && m < 8) => UNPREDICTABLE,
        1 => Insn::regs(Op::CmpReg, 0, d, m),
        2 => match (d, m) {
            (15, 15) => Insn::new(Op::B).with_imm(here),
            (15, _) => Insn::regs(Op::MovPc, 15, 0, m),
            (13, 15) => UNPREDICTABLE,
            (13, _) => Insn::regs(Op::SpMov, 13, 0, m),
            (_, 15) => Insn::regs(Op::MovImm, d, 0, 0).with_imm(here),
            _ => Insn::regs(Op::MovReg, d, 0, m),
        },
        _ if h & 7 != 0 => UNPREDICTABLE,
        _ if h & 0x80 != 0 && m == 15 => UNPREDICTABLE,
        _ if h & 0x80 != 0 => Insn::regs(Op::Blx, 0, 0, m),
        // BX to the program counter, whose bit 0 is clear, would leave Thumb state.
        _ if m == 15 => UNPREDICTABLE,
        _ => Insn::regs(Op::Bx, 0, 0, m),
    }
}

fn register_offset(h: u32) -> Insn {
    let op = match h >> 9 & 7 {
        0 => Op::StrReg,
        1 => Op::StrhReg,
        2 => Op::StrbReg,
        3 => Op::LdrsbReg,
        4 => Op::LdrReg,
        5 => Op::LdrhReg,
        6 => Op::LdrbReg,
        _ => Op::LdrshReg,
    };
    Insn::regs(op, h & 7, h >> 3 & 7, h >> 6 & 7)
}

fn immediate_offset(h: u32) -> Insn {
    let imm = h >> 6 & 31;
    let (op, imm) = match h >> 11 & 0x1f {
        0b01100 => (Op::StrImm, imm << 2),
        0b01101 => (Op::LdrImm, imm << 2),
        0b01110 => (Op::StrbImm, imm),
        0b01111 => (Op::LdrbImm, imm),
        0b10000 => (Op::StrhImm, imm << 1),
        _ => (Op::LdrhImm, imm << 1),
    };
    Insn::regs(op, h & 7, h >> 3 & 7, 0).with_imm(imm)
}

fn multiple(h: u32) -> Insn {
    let (n, list) = (h >> 8 & 7, h & 0xff);
    if list == 0 {
        return UNPREDICTABLE;
    }
    let first = list & list.wrapping_neg();
    if h & 0x800 == 0 {
        // The base register may only be stored if it is the first in the list.
        if list >> n & 1 != 0 && first != 1 << n {
            return UNPREDICTABLE;
        }
        return Insn::regs(Op::Stm, 0, n, 0).with(list, 1);
    }
    let write_back = u32::from(list >> n & 1 == 0);
    Insn::regs(Op::Ldm, 0, n, 0).with(list, write_back)
}

fn miscellaneous(pc: u32, h: u32) -> Insn {
    let (d, m) = (h & 7, h >> 3 & 7);
    match h >> 8 & 15 {
        0 => {
            let imm = directed(h & 0x80 == 0, (h & 0x7f) << 2);
            Insn::regs(Op::SpImm, 13, 13, 0).with_imm(imm)
        }
        1 | 3 | 9 | 11 => {
            let offset = (h >> 9 & 1) << 6 | (h >> 3 & 31) << 1;
            Insn::regs(Op::BranchRegister, 0, d, 0).with(
                pc.wrapping_add(4).wrapping_add(offset),
                (h >> 11 & 1) * INVERT,
            )
        }
        2 => {
            let (op, mask) = match h >> 6 & 3 {
                0 => (Op::Sxth, 0),
                1 => (Op::Sxtb, 0),
                2 => (Op::Mask, 0xffff),
                _ => (Op::Mask, 0xff),
            };
            Insn::regs(op, d, 15, m).with_imm(mask)
        }
        4 | 5 => {
            let list = h & 0xff | (h >> 8 & 1) << 14;
            if list == 0 {
                return UNPREDICTABLE;
            }
            Insn::regs(Op::Push, 0, 13, 0).with_imm(list)
        }
        6 if h & 0xe0 == 0x60 => {
            // Bit 2 is the A bit, which ARMv7-M does not have.
            if h & 0x0c != 0 || h & 3 == 0 {
                return UNPREDICTABLE;
            }
            Insn::new(Op::Special(Special::Cps)).with(h & 3, h >> 4 & 1)
        }
        10 => match h >> 6 & 3 {
            0 => Insn::regs(Op::Rev, d, 0, m),
            1 => Insn::regs(Op::Dsp(Dsp::Rev16), d, 0, m),
            3 => Insn::regs(Op::Dsp(Dsp::Revsh), d, 0, m),
            _ => UNDEFINED,
        },
        12 => {
            if h & 0xff == 0 {
                return UNPREDICTABLE;
            }
            Insn::regs(Op::Pop, 0, 13, 0).with_imm(h & 0xff)
        }
        13 => Insn::regs(Op::PopPc, 0, 13, 0).with_imm(h & 0xff),
        14 => Insn::new(Op::Special(Special::Bkpt)).with_imm(h & 0xff),
        15 => hint(h),
        _ => UNDEFINED,
    }
}

fn hint(h: u32) -> Insn {
    let (condition, mask) = (h >> 4 & 15, h & 15);
    if mask == 0 {
        return instruction::hint(condition);
    }
    if condition == 15 || (condition == 14 && mask.count_ones() != 1) {
        return UNPREDICTABLE;
    }
    Insn::new(Op::It).with_imm(h & 0xff)
}

/// Load of a size with a constant offset; signed sizes have no 16-bit encoding.
pub(super) const fn load_offset(size: Size) -> Op {
    [
        Op::LdrImm,
        Op::LdrhImm,
        Op::LdrbImm,
        Op::LdrshImm,
        Op::LdrsbImm,
    ][size as usize]
}

/// Load of a size with a register offset.
pub(super) const fn load_register(size: Size) -> Op {
    [
        Op::LdrReg,
        Op::LdrhReg,
        Op::LdrbReg,
        Op::LdrshReg,
        Op::LdrsbReg,
    ][size as usize]
}

/// Load into the stack pointer or the program counter.
pub(super) const fn load_to(mode: Mode, d: u32, n: u32, m: u32) -> Insn {
    Insn::regs(Op::LoadTo(mode), d, n, m)
}
