//! Floating point (ARMv7-M Architecture Reference Manual, A6.4 to A6.7): single precision, and moves of
//! double-precision registers.

use super::instruction::{Float, Insn, Op, UNDEFINED, UNPREDICTABLE, bad, directed, literal};

const fn float(op: Float, d: u32, n: u32, m: u32) -> Insn {
    Insn::regs(Op::Float(op), d, n, m)
}

/// Register numbers of an instruction; a double-precision register is given by its lower single-precision register.
struct Registers {
    d: u32,
    n: u32,
    m: u32,
}

fn registers(h: u32, g: u32, double: bool) -> Registers {
    let (d, n, m) = (h >> 6 & 1, g >> 7 & 1, g >> 5 & 1);
    let join = |four: u32, one: u32| {
        if double {
            (one << 4 | four) << 1
        } else {
            four << 1 | one
        }
    };
    Registers {
        d: join(g >> 12 & 15, d),
        n: join(h & 15, n),
        m: join(g & 15, m),
    }
}

/// Decodes an instruction of coprocessor 10 or 11.
pub(super) fn decode(pc: u32, h: u32, g: u32) -> Insn {
    let double = g & 0x100 != 0;
    if h & 0x1000 != 0 {
        // ARMv7-M has no instructions in the second coprocessor space.
        return UNDEFINED;
    }
    if h & 0x200 == 0 {
        if h & 0x1e0 == 0x40 {
            return move_two(h, g, double);
        }
        return load_store(pc, h, g, double);
    }
    if g & 0x10 != 0 {
        return transfer(h, g, double);
    }
    if double {
        return UNDEFINED;
    }
    data_processing(h, g)
}

fn move_two(h: u32, g: u32, double: bool) -> Insn {
    let (low, high) = (g >> 12, h & 15);
    let r = registers(h, g, double);
    if g & 0xd0 != 0x10 {
        return UNDEFINED;
    }
    let to_core = h >> 4 & 1;
    if bad(low) || bad(high) || (to_core != 0 && low == high) || r.m >= 31 {
        return UNPREDICTABLE;
    }
    float(Float::MovTwo, low, high, r.m).with_x(to_core)
}

fn load_store(pc: u32, h: u32, g: u32, double: bool) -> Insn {
    let (decrement, up) = (h >> 8 & 1, h & 0x80 != 0);
    let (write_back, load) = (h >> 5 & 1, h & 0x10 != 0);
    let (n, count) = (h & 15, g & 0xff);
    let d = registers(h, g, double).d;
    if decrement != 0 && write_back == 0 {
        return offset(pc, h, g, d);
    }
    // A multiple transfer must either increment or decrement the address.
    if decrement == u32::from(up) {
        return UNDEFINED;
    }
    let count = if double { count & !1 } else { count };
    if n == 15 || count == 0 || d + count > 32 || (double && (count > 32 || g & 1 != 0)) {
        return UNPREDICTABLE;
    }
    let op = if load {
        Float::LoadMultiple
    } else {
        Float::StoreMultiple
    };
    let x = write_back | decrement << 1 | u32::from(double) << 2;
    float(op, d, n, 0).with(count, x)
}

/// VLDR and VSTR.
fn offset(pc: u32, h: u32, g: u32, d: u32) -> Insn {
    let (n, load, double) = (h & 15, h & 0x10 != 0, g & 0x100 != 0);
    let mut imm = directed(h & 0x80 != 0, (g & 0xff) << 2);
    if n == 15 {
        if !load {
            return UNPREDICTABLE;
        }
        imm = literal(pc, imm);
    }
    if double && d >= 32 {
        return UNDEFINED;
    }
    let op = match (load, double) {
        (true, false) => Op::Vldr,
        (false, false) => Op::Vstr,
        (true, true) => Op::Float(Float::LoadDouble),
        (false, true) => Op::Float(Float::StoreDouble),
    };
    Insn::regs(op, d, n, 0).with_imm(imm)
}

/// Moves between a core register and a single-precision register, half a double-precision register, or the status
/// register.
fn transfer(h: u32, g: u32, double: bool) -> Insn {
    let (t, to_core, operation) = (g >> 12, h & 0x10 != 0, h >> 5 & 7);
    let n = registers(h, g, double).n;
    let mov = if to_core {
        Op::VmovToCore
    } else {
        Op::VmovFromCore
    };
    if double {
        if g & 0x60 != 0 || operation > 1 || n >= 32 {
            return UNDEFINED;
        }
        if bad(t) || g & 15 != 0 {
            return UNPREDICTABLE;
        }
        return Insn::regs(mov, t, n + operation, 0);
    }
    match operation {
        0 if bad(t) || g & 0x6f != 0 => UNPREDICTABLE,
        0 => Insn::regs(mov, t, n, 0),
        7 if h & 15 != 1 => UNDEFINED,
        7 if g & 0xef != 0 || t == 13 || (t == 15 && !to_core) => UNPREDICTABLE,
        7 if to_core && t == 15 => Insn::new(Op::VmrsFlags),
        7 if to_core => float(Float::ReadStatus, t, 0, 0),
        7 => float(Float::WriteStatus, t, 0, 0),
        _ => UNDEFINED,
    }
}

fn data_processing(h: u32, g: u32) -> Insn {
    let Registers { d, n, m } = registers(h, g, false);
    let (op1, op3) = ((h >> 7 & 1) << 2 | h >> 4 & 3, g >> 6 & 1);
    let insn = |op| Insn::regs(op, d, n, m);
    match (op1, op3) {
        (0, 0) => insn(Op::Vmla),
        (0, _) => insn(Op::Vmls),
        (1, 0) => float(Float::Nmls, d, n, m),
        (1, _) => float(Float::Nmla, d, n, m),
        (2, 0) => insn(Op::Vmul),
        (2, _) => float(Float::Nmul, d, n, m),
        (3, 0) => insn(Op::Vadd),
        (3, _) => insn(Op::Vsub),
        (4, 0) => insn(Op::Vdiv),
        (5, 0) => float(Float::Fnms, d, n, m),
        (5, _) => float(Float::Fnma, d, n, m),
        (6, 0) => insn(Op::Vfma),
        (6, _) => insn(Op::Vfms),
        (7, 0) if g & 0xa0 != 0 => UNPREDICTABLE,
        (7, 0) => Insn::regs(Op::VmovImm, d, 0, 0).with_imm(constant((h & 15) << 4 | g & 15)),
        (7, _) => other(h, g, d, m),
        _ => UNDEFINED,
    }
}

/// Single-precision value of an 8-bit constant (VFPExpandImm).
fn constant(imm8: u32) -> u32 {
    let exponent = if imm8 & 0x40 != 0 { 0x1f } else { 0x20 };
    imm8 >> 7 << 31 | exponent << 25 | (imm8 & 0x3f) << 19
}

fn other(h: u32, g: u32, d: u32, m: u32) -> Insn {
    let top = g >> 7 & 1;
    match (h & 15, top) {
        (0, 0) => Insn::regs(Op::VmovReg, d, 0, m),
        (0, _) => Insn::regs(Op::Vabs, d, 0, m),
        (1, 0) => Insn::regs(Op::Vneg, d, 0, m),
        (1, _) => float(Float::Sqrt, d, 0, m),
        (2, _) => float(Float::FromHalf, d, 0, m).with_imm(top),
        (3, _) => float(Float::ToHalf, d, 0, m).with_imm(top),
        (4, _) => Insn::regs(Op::Vcmp, d, 0, m).with_imm(top),
        (5, _) if g & 0x2f != 0 => UNPREDICTABLE,
        (5, _) => Insn::regs(Op::Vcmp, d, 0, 0).with_imm(top | 2),
        (8, signed) => float(Float::FromInteger, d, 0, m).with_imm(signed ^ 1),
        (kind @ (12 | 13), towards_zero) => {
            let imm = (kind & 1 ^ 1) | (towards_zero ^ 1) << 1;
            float(Float::ToInteger, d, 0, m).with_imm(imm)
        }
        (kind @ (10 | 11 | 14 | 15), long) => {
            let size = if long != 0 { 32 } else { 16 };
            let complement = (g & 15) << 1 | g >> 5 & 1;
            if complement > size {
                return UNPREDICTABLE;
            }
            let op = if kind >= 14 {
                Float::ToFixed
            } else {
                Float::FromFixed
            };
            float(op, d, 0, 0).with(size - complement, kind & 1 | long << 1)
        }
        _ => UNDEFINED,
    }
}
