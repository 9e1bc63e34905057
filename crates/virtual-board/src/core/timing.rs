//! Cycles of instructions (Cortex-M4 Technical Reference Manual r0p1, table 3-1 and section 3.3.2).
//!
//! The cycles of an instruction are set when it is decoded. Three effects depend on the next instruction and are
//! charged to the first of the pair:
//!
//! - a load of one register takes 1 cycle instead of 2 if a load or store follows whose address does not depend on the
//!   loaded value;
//! - a data-processing result that the next instruction uses as an address costs 1 cycle;
//! - a floating-point result that the next floating-point instruction uses costs 1 cycle.
//!
//! Refilling the pipeline, which the manual gives as 1 to 3 cycles, takes 1 cycle for a branch to a constant target, 2
//! for a branch to a register, 3 if the target comes from memory. A branch to a constant target takes one more cycle if
//! the target is a 32-bit instruction not aligned to 4.

use super::instruction::{Dsp, Float, Insn, Mode, Op, Special};

/// Cycles to refill the pipeline after a branch to a register.
pub(super) const REFILL_REGISTER: u64 = 2;
/// Cycles to refill the pipeline after a branch to an address from memory.
pub(super) const REFILL_LOADED: u64 = 3;
/// Cycles from taking an exception to its handler's first instruction, with memory without wait states.
pub(super) const ENTRY: u64 = 12;
/// Cycles of [`ENTRY`] that stacking takes.
pub(super) const STACKING: u64 = 8;
/// Cycles from an exception return to the interrupted instruction.
pub(super) const RETURN: u64 = 10;
/// Cycles from an exception return to the first instruction of the next exception.
pub(super) const TAIL_CHAIN: u64 = 6;
/// Cycles to save or restore 16 single-precision registers and the status register.
pub(super) const FP_CONTEXT: u64 = 17;
/// Cycles of division and square root.
pub(super) const FP_DIVISION: u64 = 14;

/// Class of an instruction for timing.
#[derive(PartialEq, Eq)]
enum Class {
    /// A branch whose target is a constant.
    Branch,
    /// A load of one register.
    Load,
    /// A store of one register.
    Store,
    /// An integer operation whose result is a core register d.
    Data,
    /// Floating-point arithmetic whose result is d.
    Float,
    Other,
}

fn class(insn: &Insn) -> Class {
    use Op::*;
    match insn.op {
        Op::Float(float) => float_class(float),
        B | Bl | BranchRegister | BranchZero | BranchCarry | BranchNegative | BranchOverflow
        | BranchHigher | BranchGreaterEqual | BranchGreater => Class::Branch,
        LdrImm | LdrbImm | LdrhImm | LdrsbImm | LdrshImm | LdrReg | LdrbReg | LdrhReg
        | LdrsbReg | LdrshReg | LdrLit | LoadLit(_) | LoadPre(_) | LoadPost(_) | LoadUser(_)
        | Ldrex(_) | Strex(_) => Class::Load,
        StrImm | StrbImm | StrhImm | StrReg | StrbReg | StrhReg | StorePre(_) | StorePost(_) => {
            Class::Store
        }
        MovImm | MovImmS | MovReg | MovRegS | MovTop | AddImm | AddImmS | SubImmS | AddReg
        | AddRegS | SubReg | SubRegS | AddLsl | LslImm | LslImmS | LsrImm | LsrImmS | AsrImm
        | AsrImmS | AluImm(_) | AluImmS(_) | AluReg(_) | AluRegS(_) | AluShift(_)
        | AluShiftS(_) | ShiftReg(_) | ShiftRegS(_) | Mul | MulS | Mla | Mls | Ubfx | Sbfx
        | Mask | Sxtb | Sxth | Dsp(_) => Class::Data,
        Vadd | Vsub | Vmul | Vmla | Vmls | Vfma | Vfms => Class::Float,
        _ => Class::Other,
    }
}

fn float_class(float: Float) -> Class {
    use Float::*;
    match float {
        Fnma | Fnms | Nmla | Nmls | Nmul | FromFixed | FromHalf | FromInteger | ToFixed
        | ToHalf | ToInteger => Class::Float,
        _ => Class::Other,
    }
}

pub(super) fn is_direct_branch(insn: &Insn) -> bool {
    class(insn) == Class::Branch
}

/// True if a floating-point instruction reads this single-precision register.
fn reads_single(insn: &Insn, register: u8) -> bool {
    use Float::{Fnma, Fnms, FromFixed, Nmla, Nmls, Nmul, ToFixed};
    let (d, n, m) = (insn.d(), insn.n(), insn.m());
    match insn.op {
        Op::Vadd | Op::Vsub | Op::Vmul | Op::Vdiv | Op::Float(Nmul) => {
            n == register || m == register
        }
        Op::Vmla | Op::Vmls | Op::Vfma | Op::Vfms | Op::Float(Fnma | Fnms | Nmla | Nmls) => {
            n == register || m == register || d == register
        }
        Op::Vabs | Op::Vneg | Op::VmovReg => m == register,
        Op::Vstr | Op::Float(ToFixed | FromFixed) => d == register,
        Op::VmovToCore => n == register,
        Op::Vcmp => d == register || m == register,
        Op::Float(Float::MovTwo) => insn.x() != 0 && (m == register || m + 1 == register),
        Op::Float(Float::StoreMultiple | Float::LoadMultiple | Float::LoadDouble) => false,
        Op::Float(Float::StoreDouble) => d == register || d + 1 == register,
        Op::Float(_) => m == register,
        _ => false,
    }
}

/// True if the address of a load or store depends on this register.
fn address_from(insn: &Insn, register: u8) -> bool {
    use Op::*;
    let by_register = match insn.op {
        LdrReg | LdrbReg | LdrhReg | LdrsbReg | LdrshReg => insn.m() == register,
        StrReg | StrbReg | StrhReg => insn.m() == register,
        _ => false,
    };
    let base = match insn.op {
        Ldrd | Strd | Ldm | Stm | Vldr | Vstr => true,
        _ => matches!(class(insn), Class::Load | Class::Store),
    };
    by_register || (base && insn.n() == register)
}

/// True if the cycles of an instruction depend on the next one.
pub(super) fn depends_on_follower(insn: &Insn) -> bool {
    matches!(class(insn), Class::Load | Class::Data | Class::Float)
}

/// Sets the cycles of an instruction, and for a branch those to refill the pipeline. `unaligned`: the target is a
/// 32-bit instruction not aligned to 4.
pub(super) fn set_cycles(insn: &mut Insn, follower: Option<&Insn>, unaligned: bool) {
    let mut cycles = alone(insn);
    if is_direct_branch(insn) {
        let refill = 1 + u32::from(unaligned);
        *insn = insn.with_x(u32::from(insn.x()) | refill);
        if matches!(insn.op, Op::B | Op::Bl) {
            cycles += refill;
        }
    }
    if let Some(follower) = follower {
        let on_address = address_from(follower, insn.d());
        let accesses = matches!(class(follower), Class::Load | Class::Store);
        match class(insn) {
            Class::Load if accesses && !on_address => cycles -= 1,
            Class::Data if on_address => cycles += 1,
            Class::Float if reads_single(follower, insn.d()) => cycles += 1,
            _ => {}
        }
    }
    insn.cycles = cycles.min(255) as u8;
}

/// Cycles of an instruction without the effects of adjacent instructions.
fn alone(insn: &Insn) -> u32 {
    let registers = insn.imm.count_ones();
    match insn.op {
        Op::Empty => 0,
        _ if class(insn) == Class::Load => 2,
        Op::StrReg | Op::StrbReg | Op::StrhReg => 2,
        Op::StoreUser(_) => 2,
        Op::LoadTo(Mode::Literal | Mode::Offset | Mode::Pre | Mode::Post | Mode::Register) => 2,
        Op::Ldrd | Op::Strd => 3,
        Op::Ldm | Op::Stm | Op::Push | Op::Pop => 1 + registers,
        // The list excludes the program counter, which takes one more cycle.
        Op::PopPc => 2 + registers,
        Op::Table => 2,
        Op::Mla | Op::Mls => 1,
        // A division takes at least 2 cycles; its execution adds those that depend on the operands.
        Op::Udiv | Op::Sdiv => 2,
        Op::Dsp(Dsp::Usad) => 1,
        Op::Special(Special::Mrs | Special::Msr) => 2,
        Op::Special(Special::Cps) => 2,
        Op::Vldr | Op::Vstr => 2,
        Op::Vmla | Op::Vmls | Op::Vfma | Op::Vfms => 3,
        Op::Float(float) => float_alone(insn, float),
        _ => 1,
    }
}

fn float_alone(insn: &Insn, float: Float) -> u32 {
    match float {
        Float::Nmla | Float::Nmls | Float::Fnma | Float::Fnms => 3,
        Float::MovTwo => 2,
        Float::LoadMultiple | Float::StoreMultiple => 1 + insn.imm,
        Float::LoadDouble | Float::StoreDouble => 3,
        _ => 1,
    }
}
