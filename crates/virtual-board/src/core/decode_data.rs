//! 32-bit data processing (ARMv7-M Architecture Reference Manual, A5.3.1 to A5.3.17).

use super::instruction::{
    Alu, Dsp, Insn, Op, RRX, Shift, Test, UNDEFINED, UNPREDICTABLE, bad, literal,
};

/// Operation of a data-processing instruction.
enum DataOperation {
    Alu(Alu),
    Test(Test),
}

/// Operation from its code and registers; `None` for an undefined code. With destination 15 and flags set, AND, EOR,
/// ADD and SUB are the tests TST, TEQ, CMN and CMP.
fn data_operation(operation: u32, d: u32, n: u32, s: bool) -> Option<DataOperation> {
    let or_test = |alu, test| {
        if d == 15 && s {
            DataOperation::Test(test)
        } else {
            DataOperation::Alu(alu)
        }
    };
    Some(match operation {
        0 => or_test(Alu::And, Test::Tst),
        1 => DataOperation::Alu(Alu::Bic),
        2 if n == 15 => DataOperation::Alu(Alu::Mov),
        2 => DataOperation::Alu(Alu::Orr),
        3 if n == 15 => DataOperation::Alu(Alu::Mvn),
        3 => DataOperation::Alu(Alu::Orn),
        4 => or_test(Alu::Eor, Test::Teq),
        8 => or_test(Alu::Add, Test::Cmn),
        10 => DataOperation::Alu(Alu::Adc),
        11 => DataOperation::Alu(Alu::Sbc),
        13 => or_test(Alu::Sub, Test::Cmp),
        14 => DataOperation::Alu(Alu::Rsb),
        _ => return None,
    })
}

/// True if registers d and n are allowed; the stack pointer is allowed only where the manual says so.
fn allowed(operation: &DataOperation, d: u32, n: u32) -> bool {
    match operation {
        DataOperation::Alu(Alu::Add | Alu::Sub) if n == 13 => d != 15,
        DataOperation::Alu(Alu::Mov | Alu::Mvn) => !bad(d),
        DataOperation::Alu(_) => !bad(d) && !bad(n),
        DataOperation::Test(Test::Cmp | Test::Cmn) => n != 15,
        DataOperation::Test(_) => !bad(n),
    }
}

/// A modified constant and its effect on the carry (0 none, 1 clears, 2 sets); `None` for an unpredictable encoding.
fn expand(h: u32, g: u32) -> Option<(u32, u32)> {
    let byte = g & 0xff;
    let code = (h >> 10 & 1) << 4 | (g >> 12 & 7) << 1 | byte >> 7;
    if code < 8 {
        if code >= 2 && byte == 0 {
            return None;
        }
        return Some(match code >> 1 {
            0 => (byte, 0),
            1 => (byte << 16 | byte, 0),
            2 => (byte << 24 | byte << 8, 0),
            _ => (byte * 0x0101_0101, 0),
        });
    }
    let value = (0x80 | byte).rotate_right(code);
    Some((value, 1 + (value >> 31)))
}

/// Decodes data processing with a modified constant.
pub(super) fn modified_immediate(h: u32, g: u32) -> Insn {
    let (n, d, s) = (h & 15, g >> 8 & 15, h & 0x10 != 0);
    let Some(operation) = data_operation(h >> 5 & 15, d, n, s) else {
        return UNDEFINED;
    };
    let Some((imm, carry)) = expand(h, g).filter(|_| allowed(&operation, d, n)) else {
        return UNPREDICTABLE;
    };
    let alu = match operation {
        DataOperation::Alu(alu) => alu,
        DataOperation::Test(Test::Cmp) => return Insn::regs(Op::CmpImm, 0, n, 0).with_imm(imm),
        DataOperation::Test(Test::Tst) => {
            return Insn::regs(Op::TstImm, 0, n, 0).with(imm, carry);
        }
        DataOperation::Test(test) => {
            return Insn::regs(Op::TestImm(test), 0, n, 0).with(imm, carry);
        }
    };
    let op = match (alu, s) {
        (Alu::Add, false) => return add(d, n, imm),
        (Alu::Sub, false) => return add(d, n, imm.wrapping_neg()),
        // The stack pointer may be the destination with flags only in the encoding with a shifted register.
        (Alu::Add | Alu::Sub, true) if d == 13 => return UNPREDICTABLE,
        (Alu::Add, true) => Op::AddImmS,
        (Alu::Sub, true) => Op::SubImmS,
        (Alu::Mov, false) => Op::MovImm,
        (alu, false) => Op::AluImm(alu),
        (alu, true) => Op::AluImmS(alu),
    };
    Insn::regs(op, d, n, 0).with(imm, carry)
}

fn add(d: u32, n: u32, imm: u32) -> Insn {
    let op = if d == 13 { Op::SpImm } else { Op::AddImm };
    Insn::regs(op, d, n, 0).with_imm(imm)
}

/// Decodes data processing with a plain constant: 12 and 16 bits, saturation, bit fields.
pub(super) fn plain_immediate(pc: u32, h: u32, g: u32) -> Insn {
    let (n, d) = (h & 15, g >> 8 & 15);
    let imm12 = (h >> 10 & 1) << 11 | (g >> 12 & 7) << 8 | g & 0xff;
    let imm16 = n << 12 | imm12;
    let (low, width) = ((g >> 12 & 7) << 2 | g >> 6 & 3, g & 31);
    let operation = h >> 4 & 31;
    if operation >= 16 && (h & 0x400 != 0 || g & 0x20 != 0) {
        return UNPREDICTABLE;
    }
    if bad(d) && !(d == 13 && n == 13 && matches!(operation, 0 | 10)) {
        return UNPREDICTABLE;
    }
    match operation {
        0 if n == 15 => Insn::regs(Op::MovImm, d, 0, 0).with_imm(literal(pc, imm12)),
        0 => add(d, n, imm12),
        10 if n == 15 => {
            Insn::regs(Op::MovImm, d, 0, 0).with_imm(literal(pc, imm12.wrapping_neg()))
        }
        10 => add(d, n, imm12.wrapping_neg()),
        4 => Insn::regs(Op::MovImm, d, 0, 0).with_imm(imm16),
        12 => Insn::regs(Op::MovTop, d, 0, 0).with_imm(imm16 << 16),
        22 if n == 15 && width >= low => field(Dsp::Bfc, d, n, low, width + 1 - low),
        22 if n != 13 && width >= low => field(Dsp::Bfi, d, n, low, width + 1 - low),
        _ if bad(n) => UNPREDICTABLE,
        18 | 26 if low == 0 => {
            if g & 0x10 != 0 {
                return UNPREDICTABLE;
            }
            let (op, bits) = if operation == 18 {
                (Dsp::Ssat16, width + 1)
            } else {
                (Dsp::Usat16, width)
            };
            Insn::regs(Op::Dsp(op), d, n, 0).with_imm(bits)
        }
        16 | 18 | 24 | 26 => {
            let (op, bits) = if operation < 24 {
                (Dsp::Ssat, width + 1)
            } else {
                (Dsp::Usat, width)
            };
            let right = operation & 2 != 0;
            Insn::regs(Op::Dsp(op), d, n, 0).with(bits | u32::from(right) << 8, low)
        }
        20 | 28 if low + width < 32 => {
            let op = if operation == 20 { Op::Sbfx } else { Op::Ubfx };
            Insn::regs(op, d, n, 0).with(width + 1, low)
        }
        20 | 22 | 28 => UNPREDICTABLE,
        _ => UNDEFINED,
    }
}

fn field(op: Dsp, d: u32, n: u32, low: u32, width: u32) -> Insn {
    Insn::regs(Op::Dsp(op), d, n, 0).with(width, low)
}

/// Decodes data processing with a shifted register.
pub(super) fn shifted_register(h: u32, g: u32) -> Insn {
    let (n, d) = (h & 15, g >> 8 & 15);
    let (m, s) = (g & 15, h & 0x10 != 0);
    let (kind_bits, amount) = (g >> 4 & 3, (g >> 12 & 7) << 2 | g >> 6 & 3);
    let operation = h >> 5 & 15;
    if operation == 6 {
        return pack(h, g, amount);
    }
    let Some(operation) = data_operation(operation, d, n, s) else {
        return UNDEFINED;
    };
    if g & 0x8000 != 0 {
        return UNPREDICTABLE;
    }
    let (shift, amount) = match (kind_bits, amount) {
        (0, _) => (0, amount),
        (1 | 2, 0) => (kind_bits as u8, 32),
        (3, 0) => (RRX, 1),
        _ => (kind_bits as u8, amount),
    };
    let plain = shift == 0 && amount == 0;
    if let DataOperation::Alu(Alu::Mov) = operation
        && (d == 13 || m == 13)
    {
        return match (plain && !s && d != 15 && m != 15, d, m) {
            (true, 13, 13) => UNPREDICTABLE,
            (true, 13, _) => Insn::regs(Op::SpMov, 13, 0, m),
            (true, ..) => Insn::regs(Op::MovReg, d, 0, m),
            _ => UNPREDICTABLE,
        };
    }
    if !allowed(&operation, d, n) || bad(m) {
        return UNPREDICTABLE;
    }
    let alu = match operation {
        DataOperation::Alu(alu) => alu,
        DataOperation::Test(Test::Cmp) if plain => return Insn::regs(Op::CmpReg, 0, n, m),
        DataOperation::Test(test) if plain => return Insn::regs(Op::TestReg(test), 0, n, m),
        DataOperation::Test(test) => {
            return Insn::regs(Op::TestShift(test), 0, n, m).with(amount, u32::from(shift));
        }
    };
    if d == 13 {
        if shift != 0 || amount > 3 {
            return UNPREDICTABLE;
        }
        let x = u32::from(s) << 7;
        return Insn::regs(Op::SpShift(alu), d, n, m).with(amount, x);
    }
    let op = match (alu, s) {
        (Alu::Mov, _) if plain => {
            if s {
                Op::MovRegS
            } else {
                Op::MovReg
            }
        }
        (Alu::Mov, false) if shift < 3 => [Op::LslImm, Op::LsrImm, Op::AsrImm][shift as usize],
        (Alu::Mov, true) if shift < 3 => [Op::LslImmS, Op::LsrImmS, Op::AsrImmS][shift as usize],
        (Alu::Add, false) if plain => Op::AddReg,
        (Alu::Add, true) if plain => Op::AddRegS,
        (Alu::Sub, false) if plain => Op::SubReg,
        (Alu::Sub, true) if plain => Op::SubRegS,
        (Alu::Add, false) if shift == 0 => Op::AddLsl,
        (alu, false) if plain => Op::AluReg(alu),
        (alu, true) if plain => Op::AluRegS(alu),
        (alu, false) => Op::AluShift(alu),
        (alu, true) => Op::AluShiftS(alu),
    };
    Insn::regs(op, d, n, m).with(amount, u32::from(shift))
}

fn pack(h: u32, g: u32, amount: u32) -> Insn {
    let (n, d, m) = (h & 15, g >> 8 & 15, g & 15);
    if h & 0x10 != 0 || g & 0x10 != 0 {
        return UNDEFINED;
    }
    if bad(n) || bad(d) || bad(m) || g & 0x8000 != 0 {
        return UNPREDICTABLE;
    }
    // PKHTB with amount 0 shifts by 32.
    let top = g >> 5 & 1;
    let amount = if top != 0 && amount == 0 { 32 } else { amount };
    Insn::regs(Op::Dsp(Dsp::Pkh), d, n, m).with(top, amount)
}

/// Decodes data processing of registers: shifts, extensions, parallel and miscellaneous operations.
pub(super) fn register(h: u32, g: u32) -> Insn {
    let (n, d, m) = (h & 15, g >> 8 & 15, g & 15);
    let (op1, op2) = (h >> 4 & 15, g >> 4 & 15);
    if g >> 12 != 15 {
        return UNDEFINED;
    }
    let insn = match (op1, op2) {
        (0..8, 0) => {
            let shift = Shift::of(op1 >> 1);
            let op = if op1 & 1 != 0 {
                Op::ShiftRegS(shift)
            } else {
                Op::ShiftReg(shift)
            };
            Insn::regs(op, d, n, m)
        }
        (0..6, 8..) => return extension(h, g),
        (8..15, 0..8) if parallel(op1 & 7, op2) => Insn::regs(Op::Dsp(Dsp::Parallel), d, n, m)
            .with_x(op1 & 7)
            .with_imm(op2),
        (8, 8..12) => Insn::regs(Op::Dsp(Dsp::Saturating), d, n, m).with_x(op2 & 3),
        (9, 8..12) | (11, 8) if n != m => return UNPREDICTABLE,
        (9, 8) => Insn::regs(Op::Rev, d, n, m),
        (9, 9) => Insn::regs(Op::Dsp(Dsp::Rev16), d, n, m),
        (9, 10) => Insn::regs(Op::Dsp(Dsp::Rbit), d, n, m),
        (9, 11) => Insn::regs(Op::Dsp(Dsp::Revsh), d, n, m),
        (10, 8) => Insn::regs(Op::Dsp(Dsp::Sel), d, n, m),
        (11, 8) => Insn::regs(Op::Clz, d, n, m),
        _ => return UNDEFINED,
    };
    if bad(d) || bad(n) || bad(m) {
        return UNPREDICTABLE;
    }
    insn
}

/// True for the parallel additions and subtractions that exist: six operations, six prefixes.
const fn parallel(operation: u32, prefix: u32) -> bool {
    matches!(operation, 0 | 1 | 2 | 4 | 5 | 6) && matches!(prefix, 0 | 1 | 2 | 4 | 5 | 6)
}

fn extension(h: u32, g: u32) -> Insn {
    let (n, d) = (h & 15, g >> 8 & 15);
    let (m, kind) = (g & 15, h >> 4 & 15);
    let rotation = (g >> 4 & 3) << 3;
    if bad(d) || bad(m) || n == 13 || g & 0x40 != 0 {
        return UNPREDICTABLE;
    }
    let (op, imm) = match (kind, n, rotation) {
        (0, 15, 0) => (Op::Sxth, 0),
        (1, 15, 0) => (Op::Mask, 0xffff),
        (4, 15, 0) => (Op::Sxtb, 0),
        (5, 15, 0) => (Op::Mask, 0xff),
        _ => (Op::Dsp(Dsp::Extend), rotation),
    };
    Insn::regs(op, d, n, m).with(imm, kind)
}

/// Decodes multiplications with a 32-bit result.
pub(super) fn multiply(h: u32, g: u32) -> Insn {
    let (n, d) = (h & 15, g >> 8 & 15);
    let (m, a) = (g & 15, g >> 12);
    let (op1, op2) = (h >> 4 & 7, g >> 4 & 15);
    let alone = a == 15;
    let either = |single, accumulating| Op::Dsp(if alone { single } else { accumulating });
    let (op, imm) = match (op1, op2) {
        (0, 0) if alone => (Op::Mul, 0),
        (0, 0) => (Op::Mla, 0),
        (0, 1) if alone => return UNDEFINED,
        (0, 1) => (Op::Mls, 0),
        (1, 0..4) => (either(Dsp::SmulHalf, Dsp::SmlaHalf), op2),
        (2, 0 | 1) => (either(Dsp::SmulDual, Dsp::SmlaDual), op2),
        (3, 0 | 1) => (either(Dsp::SmulWide, Dsp::SmlaWide), op2),
        (4, 0 | 1) => (either(Dsp::SmulDual, Dsp::SmlaDual), op2 | 2),
        (5, 0 | 1) => (either(Dsp::Smmul, Dsp::Smmla), op2),
        (6, 0 | 1) if alone => return UNPREDICTABLE,
        (6, 0 | 1) => (Op::Dsp(Dsp::Smmls), op2),
        (7, 0) => (Op::Dsp(Dsp::Usad), u32::from(!alone)),
        _ => return UNDEFINED,
    };
    if bad(d) || bad(n) || bad(m) || a == 13 {
        return UNPREDICTABLE;
    }
    Insn::regs(op, d, n, m).with(imm, a)
}

/// Decodes multiplications with a 64-bit result, and divisions.
pub(super) fn long_multiply(h: u32, g: u32) -> Insn {
    let (n, high) = (h & 15, g >> 8 & 15);
    let (m, low) = (g & 15, g >> 12);
    let (op1, op2) = (h >> 4 & 7, g >> 4 & 15);
    let (op, imm) = match (op1, op2) {
        (0, 0) => (Op::Smull, 0),
        (2, 0) => (Op::Umull, 0),
        (4, 0) => (Op::Smlal, 0),
        (4, 8..12) => (Op::Dsp(Dsp::SmlalHalf), op2 & 3),
        (4, 12 | 13) => (Op::Dsp(Dsp::SmlalDual), op2 & 1),
        (5, 12 | 13) => (Op::Dsp(Dsp::SmlalDual), op2 & 1 | 2),
        (6, 0) => (Op::Umlal, 0),
        (6, 6) => (Op::Dsp(Dsp::Umaal), 0),
        (1 | 3, 15) => {
            if bad(high) || bad(n) || bad(m) || low != 15 {
                return UNPREDICTABLE;
            }
            let op = if op1 == 1 { Op::Sdiv } else { Op::Udiv };
            return Insn::regs(op, high, n, m);
        }
        _ => return UNDEFINED,
    };
    if bad(high) || bad(low) || bad(n) || bad(m) || high == low {
        return UNPREDICTABLE;
    }
    Insn::regs(op, low, n, m).with(imm, high)
}
