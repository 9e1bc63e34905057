//! 32-bit instructions except data processing and floating point (ARMv7-M Architecture Reference Manual, A5.3): loads,
//! stores, branches, control.

use super::decode_data as data;
use super::decode_fp as fp;
use super::decode16::{branch, load_offset, load_register, load_to, signed};
use super::instruction::{
    Insn, Mode, Op, Size, Special, UNDEFINED, UNPREDICTABLE, bad, directed, hint, literal,
};

/// True for the first halfword of a 32-bit instruction.
pub(super) const fn is_wide(h: u16) -> bool {
    h >> 11 >= 0b11101
}

/// Decodes a 32-bit instruction from its two halfwords.
pub(super) fn decode(pc: u32, h: u32, g: u32) -> Insn {
    let op2 = h >> 4 & 0x7f;
    let mut insn = match h >> 11 & 3 {
        1 if op2 & 0x64 == 0 => multiple(h, g),
        1 if op2 & 0x64 == 4 => double_exclusive_table(pc, h, g),
        1 if op2 & 0x60 == 0x20 => data::shifted_register(h, g),
        1 => coprocessor(pc, h, g),
        2 if g >> 15 != 0 => branch_control(pc, h, g),
        2 if op2 & 0x20 == 0 => data::modified_immediate(h, g),
        2 => data::plain_immediate(pc, h, g),
        3 if op2 & 0x71 == 0 => store_single(h, g),
        3 if op2 & 0x61 == 1 => load_single(pc, h, g),
        3 if op2 & 0x70 == 0x20 => data::register(h, g),
        3 if op2 & 0x78 == 0x30 => data::multiply(h, g),
        3 if op2 & 0x78 == 0x38 => data::long_multiply(h, g),
        3 if op2 & 0x40 != 0 => coprocessor(pc, h, g),
        _ => UNDEFINED,
    };
    insn.size = 4;
    insn
}

fn coprocessor(pc: u32, h: u32, g: u32) -> Insn {
    match g >> 8 & 15 {
        // A first halfword of 111x 1111 xxxx xxxx is undefined for every coprocessor.
        _ if h >> 8 & 3 == 3 && h >> 9 & 7 == 7 => UNDEFINED,
        10 | 11 => fp::decode(pc, h, g),
        _ => Insn::new(Op::NoCoprocessor),
    }
}

fn multiple(h: u32, g: u32) -> Insn {
    let (n, load, write_back) = (h & 15, h & 0x10 != 0, h >> 5 & 1);
    let decrement = match h >> 7 & 3 {
        1 => 0,
        2 => 1,
        _ => return UNDEFINED,
    };
    let count = g.count_ones();
    if n == 15 || count < 2 || g & 0x2000 != 0 || (write_back != 0 && g >> n & 1 != 0) {
        return UNPREDICTABLE;
    }
    if load {
        if g >> 14 == 3 {
            return UNPREDICTABLE;
        }
        if n == 13 && write_back != 0 && decrement == 0 {
            let op = if g >> 15 != 0 { Op::PopPc } else { Op::Pop };
            return Insn::regs(op, 0, 13, 0).with_imm(g & 0x7fff);
        }
        return Insn::regs(Op::Ldm, 0, n, 0).with(g, write_back | decrement << 1);
    }
    if g >> 15 != 0 {
        return UNPREDICTABLE;
    }
    if n == 13 && write_back != 0 && decrement != 0 {
        return Insn::regs(Op::Push, 0, 13, 0).with_imm(g);
    }
    Insn::regs(Op::Stm, 0, n, 0).with(g, write_back | decrement << 1)
}

fn double_exclusive_table(pc: u32, h: u32, g: u32) -> Insn {
    let (n, t) = (h & 15, g >> 12);
    let (d, offset) = (g >> 8 & 15, (g & 0xff) << 2);
    let (index, up) = (h >> 8 & 1, h >> 7 & 1);
    let (write_back, load) = (h >> 5 & 1, h & 0x10 != 0);
    if index == 0 && write_back == 0 {
        return if up == 0 {
            exclusive_word(h, g)
        } else {
            exclusive_table(pc, h, g)
        };
    }
    if bad(t) || bad(d) || (write_back != 0 && (n == t || n == d)) {
        return UNPREDICTABLE;
    }
    let offset = directed(up != 0, offset);
    let x = index | write_back << 1;
    if load {
        if t == d || (n == 15 && write_back != 0) {
            return UNPREDICTABLE;
        }
        let imm = if n == 15 { literal(pc, offset) } else { offset };
        return Insn::regs(Op::Ldrd, t, n, d).with(imm, x);
    }
    if n == 15 {
        return UNPREDICTABLE;
    }
    Insn::regs(Op::Strd, t, n, d).with(offset, x)
}

fn exclusive_word(h: u32, g: u32) -> Insn {
    let (n, t) = (h & 15, g >> 12);
    let (d, offset) = (g >> 8 & 15, (g & 0xff) << 2);
    if bad(t) || n == 15 {
        return UNPREDICTABLE;
    }
    if h & 0x10 != 0 {
        if d != 15 {
            return UNPREDICTABLE;
        }
        return Insn::regs(Op::Ldrex(Size::Word), t, n, 0).with_imm(offset);
    }
    if bad(d) || d == n || d == t {
        return UNPREDICTABLE;
    }
    Insn::regs(Op::Strex(Size::Word), d, n, t).with_imm(offset)
}

fn exclusive_table(pc: u32, h: u32, g: u32) -> Insn {
    let (n, t, d) = (h & 15, g >> 12, g & 15);
    let size = match g >> 4 & 15 {
        4 => Size::Byte,
        5 => Size::Half,
        kind @ (0 | 1) if h & 0x10 != 0 => {
            if n == 13 || bad(d) || g >> 8 != 0xf0 {
                return UNPREDICTABLE;
            }
            return Insn::regs(Op::Table, 0, n, d).with(pc.wrapping_add(4), kind);
        }
        _ => return UNDEFINED,
    };
    if bad(t) || n == 15 || g >> 8 & 15 != 15 {
        return UNPREDICTABLE;
    }
    if h & 0x10 != 0 {
        if d != 15 {
            return UNPREDICTABLE;
        }
        return Insn::regs(Op::Ldrex(size), t, n, 0);
    }
    if bad(d) || d == n || d == t {
        return UNPREDICTABLE;
    }
    Insn::regs(Op::Strex(size), d, n, t)
}

fn store_single(h: u32, g: u32) -> Insn {
    let (n, t, m) = (h & 15, g >> 12, g & 15);
    let (size, offset, register) = match h >> 5 & 3 {
        0 => (Size::Byte, Op::StrbImm, Op::StrbReg),
        1 => (Size::Half, Op::StrhImm, Op::StrhReg),
        2 => (Size::Word, Op::StrImm, Op::StrReg),
        _ => return UNDEFINED,
    };
    if n == 15 {
        return UNDEFINED;
    }
    if t == 15 || (t == 13 && size != Size::Word) {
        return UNPREDICTABLE;
    }
    addressed(h, g, |mode| match mode {
        Some(Mode::Offset) => Insn::regs(offset, t, n, 0),
        Some(Mode::Register) => Insn::regs(register, t, n, m),
        Some(Mode::Pre) => Insn::regs(Op::StorePre(size), t, n, 0),
        Some(_) => Insn::regs(Op::StorePost(size), t, n, 0),
        None => Insn::regs(Op::StoreUser(size), t, n, 0),
    })
}

/// Decodes a load or store of one value with a base register and an offset. `insn` returns the instruction for an
/// addressing mode; `None` stands for an unprivileged access.
fn addressed(h: u32, g: u32, insn: impl Fn(Option<Mode>) -> Insn) -> Insn {
    let (n, t, m) = (h & 15, g >> 12, g & 15);
    if h & 0x80 != 0 {
        return insn(Some(Mode::Offset)).with_imm(g & 0xfff);
    }
    if g & 0x800 == 0 {
        return match (g & 0x7c0, bad(m)) {
            (0, false) => insn(Some(Mode::Register)).with_imm(g >> 4 & 3),
            (0, true) => UNPREDICTABLE,
            _ => UNDEFINED,
        };
    }
    let (index, up, write_back) = (g & 0x400 != 0, g & 0x200 != 0, g & 0x100 != 0);
    let mode = match (index, write_back) {
        (false, false) => return UNDEFINED,
        (true, false) if up && bad(t) => return UNPREDICTABLE,
        (true, false) if up => None,
        (_, true) if n == t => return UNPREDICTABLE,
        (true, false) => Some(Mode::Offset),
        (true, true) => Some(Mode::Pre),
        (false, true) => Some(Mode::Post),
    };
    insn(mode).with_imm(directed(up, g & 0xff))
}

fn load_single(pc: u32, h: u32, g: u32) -> Insn {
    let (n, t) = (h & 15, g >> 12);
    let size = match (h >> 5 & 3, h & 0x100 != 0) {
        (0, false) => Size::Byte,
        (0, true) => Size::SignedByte,
        (1, false) => Size::Half,
        (1, true) => Size::SignedHalf,
        (2, false) => Size::Word,
        _ => return UNDEFINED,
    };
    if t == 15 && size != Size::Word {
        return preload(size, h, g);
    }
    if t == 13 && size != Size::Word {
        return UNPREDICTABLE;
    }
    if n == 15 {
        let address = literal(pc, directed(h & 0x80 != 0, g & 0xfff));
        return match size {
            Size::Word if bad(t) => load_to(Mode::Literal, t, 15, 0).with_imm(address),
            Size::Word => Insn::regs(Op::LdrLit, t, 15, 0).with_imm(address),
            _ => Insn::regs(Op::LoadLit(size), t, 15, 0).with_imm(address),
        };
    }
    load_from_register(size, h, g)
}

fn load_from_register(size: Size, h: u32, g: u32) -> Insn {
    let (n, t, m) = (h & 15, g >> 12, g & 15);
    let to = |mode, ordinary| {
        if bad(t) {
            load_to(mode, t, n, m)
        } else {
            Insn::regs(ordinary, t, n, m)
        }
    };
    addressed(h, g, |mode| match mode {
        Some(Mode::Offset) => to(Mode::Offset, load_offset(size)),
        Some(Mode::Register) => to(Mode::Register, load_register(size)),
        Some(Mode::Pre) => to(Mode::Pre, Op::LoadPre(size)),
        Some(mode) => to(mode, Op::LoadPost(size)),
        None => Insn::regs(Op::LoadUser(size), t, n, 0),
    })
}

/// Decodes a load of less than a word into the program counter: a memory hint, without effect here.
fn preload(size: Size, h: u32, g: u32) -> Insn {
    let nop = Insn::new(Op::Special(Special::Nop));
    match size {
        Size::Byte | Size::SignedByte => {}
        // Halfword loads into the program counter are unallocated memory hints.
        _ => return UNPREDICTABLE,
    }
    if h & 15 == 15 || h & 0x80 != 0 {
        return nop;
    }
    match g >> 8 & 15 {
        12 => nop,
        0 if g & 0xc0 == 0 && !bad(g & 15) => nop,
        0 if g & 0xc0 == 0 => UNPREDICTABLE,
        8 | 10 => UNDEFINED,
        0..8 => UNDEFINED,
        _ => UNPREDICTABLE,
    }
}

fn branch_control(pc: u32, h: u32, g: u32) -> Insn {
    let (s, j1, j2) = (h >> 10 & 1, g >> 13 & 1, g >> 11 & 1);
    let here = pc.wrapping_add(4);
    match (g >> 14 & 1, g >> 12 & 1) {
        (0, 0) if h >> 7 & 7 != 7 => {
            let offset = s << 20 | j2 << 19 | j1 << 18 | (h & 0x3f) << 12 | (g & 0x7ff) << 1;
            branch(h >> 6 & 15, here.wrapping_add(signed(offset, 21)))
        }
        (0, 0) => control(h, g),
        (link, 1) => {
            let (i1, i2) = (1 ^ j1 ^ s, 1 ^ j2 ^ s);
            let offset = s << 24 | i1 << 23 | i2 << 22 | (h & 0x3ff) << 12 | (g & 0x7ff) << 1;
            let op = if link != 0 { Op::Bl } else { Op::B };
            Insn::new(op).with_imm(here.wrapping_add(signed(offset, 25)))
        }
        _ => UNDEFINED,
    }
}

fn control(h: u32, g: u32) -> Insn {
    match h >> 4 & 0x7f {
        0x38 | 0x39 => {
            let (n, mask) = (h & 15, g >> 10 & 3);
            let sysm = g & 0xff;
            let flags = sysm < 4;
            if bad(n) || h & 0x10 != 0 || g & 0x2300 != 0 {
                return UNPREDICTABLE;
            }
            if mask == 0 || (mask != 2 && !flags) || !special_register(sysm) {
                return UNPREDICTABLE;
            }
            Insn::regs(Op::Special(Special::Msr), 0, n, 0).with(sysm, mask)
        }
        0x3a if h & 15 != 15 || g & 0x2800 != 0 => UNPREDICTABLE,
        0x3a if g >> 8 & 7 != 0 => UNDEFINED,
        0x3a => hint(g & 0xff),
        0x3b if h & 15 != 15 || g & 0x2f00 != 0x0f00 => UNPREDICTABLE,
        0x3b => match g >> 4 & 15 {
            2 if g & 15 == 15 => Insn::new(Op::Special(Special::Clrex)),
            2 => UNPREDICTABLE,
            4 => Insn::new(Op::Special(Special::Dsb)),
            5 | 6 => Insn::new(Op::Special(Special::Barrier)),
            _ => UNDEFINED,
        },
        0x3e | 0x3f => {
            let d = g >> 8 & 15;
            if bad(d) || h & 0x1f != 0x0f || g & 0x2000 != 0 || !special_register(g & 0xff) {
                return UNPREDICTABLE;
            }
            Insn::regs(Op::Special(Special::Mrs), d, 0, 0).with_imm(g & 0xff)
        }
        _ => UNDEFINED,
    }
}

/// True for a special register that exists.
const fn special_register(number: u32) -> bool {
    matches!(number, 0..=3 | 5..=9 | 16..=20)
}
