//! A decoded instruction.
//!
//! Everything that depends on the address is resolved when decoding: branch targets and literal addresses are absolute,
//! and a program counter as an operand is a constant.

/// Arithmetic and logic operations on two operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Alu {
    And,
    Bic,
    Orr,
    Orn,
    Eor,
    Add,
    Adc,
    Sbc,
    Sub,
    Rsb,
    Mov,
    Mvn,
}

/// Comparisons: flags only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Test {
    Tst,
    Teq,
    Cmp,
    Cmn,
}

/// Shifts and rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Shift {
    Lsl,
    Lsr,
    Asr,
    Ror,
}

impl Shift {
    pub(super) const fn of(bits: u32) -> Self {
        match bits & 3 {
            0 => Self::Lsl,
            1 => Self::Lsr,
            2 => Self::Asr,
            _ => Self::Ror,
        }
    }
}

/// Value of `x` for rotate right with extend; the smaller values are the types of [`Shift`].
pub(super) const RRX: u8 = 4;

/// Size of a load or store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Size {
    Word,
    Half,
    Byte,
    SignedHalf,
    SignedByte,
}

/// Addressing mode. A decoded instruction stores the mode only if it loads the stack pointer or program counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Mode {
    Offset,
    Pre,
    Post,
    Register,
    Literal,
}

/// Instructions that are rare in control code: bit fields, saturation, DSP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Dsp {
    Bfi,
    Bfc,
    Rbit,
    Rev16,
    Revsh,
    /// `x`: 0 SXTAH, 1 UXTAH, 2 SXTAB16, 3 UXTAB16, 4 SXTAB, 5 UXTAB; n 15 adds nothing.
    Extend,
    Ssat,
    Usat,
    Ssat16,
    Usat16,
    /// `imm`: 0 PKHBT, 1 PKHTB; `x`: shift of m.
    Pkh,
    Sel,
    /// `x`: operation, `imm`: prefix, as encoded.
    Parallel,
    /// `x`: 0 QADD, 1 QDADD, 2 QSUB, 3 QDSUB.
    Saturating,
    Usad,
    /// `imm`: bit 1 top of n, bit 0 top of m.
    SmulHalf,
    SmlaHalf,
    /// `imm`: bit 0 top of m.
    SmulWide,
    SmlaWide,
    /// `imm`: bit 0 exchanges the halves of m, bit 1 subtracts.
    SmulDual,
    SmlaDual,
    SmlalDual,
    SmlalHalf,
    /// `imm`: bit 0 rounds.
    Smmul,
    Smmla,
    Smmls,
    Umaal,
}

/// Instructions that change the state of the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Special {
    Nop,
    Yield,
    Wfe,
    Wfi,
    Sev,
    Barrier,
    Dsb,
    Clrex,
    Svc,
    Bkpt,
    Mrs,
    Msr,
    /// `x`: bit 0 disables, `imm`: bit 0 FAULTMASK, bit 1 PRIMASK.
    Cps,
}

/// Less frequent floating-point operations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Float {
    Nmul,
    Nmla,
    Nmls,
    Fnma,
    Fnms,
    Sqrt,
    /// `imm` bit 0: unsigned; bit 1: rounding mode of FPSCR instead of towards zero.
    ToInteger,
    /// `imm` bit 0: unsigned.
    FromInteger,
    /// `imm`: fraction bits, `x` bit 0 unsigned, bit 1 32 bits.
    ToFixed,
    FromFixed,
    /// `imm` bit 0: upper half.
    FromHalf,
    ToHalf,
    /// Two core registers and two single-precision registers (m, m + 1); `x` bit 0: to the core.
    MovTwo,
    ReadStatus,
    WriteStatus,
    /// `imm` registers; `x` bit 0 writes back, bit 1 decrements before, bit 2 double-precision registers.
    LoadMultiple,
    StoreMultiple,
    LoadDouble,
    StoreDouble,
}

/// Operation. Names follow the manual; an `S` at the end means that the flags are set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Op {
    /// Not decoded yet.
    Empty,
    Undefined,
    Unpredictable,
    NoCoprocessor,
    MovImm,
    MovImmS,
    MovReg,
    MovRegS,
    MovTop,
    /// d = n + imm; a subtraction has a negated `imm`.
    AddImm,
    AddImmS,
    SubImmS,
    AddReg,
    AddRegS,
    SubReg,
    SubRegS,
    /// d = n + (m << imm).
    AddLsl,
    LslImm,
    LslImmS,
    LsrImm,
    LsrImmS,
    AsrImm,
    AsrImmS,
    CmpImm,
    CmpReg,
    /// `x`: carry, 0 unchanged, 1 cleared, 2 set.
    TstImm,
    AluImm(Alu),
    AluImmS(Alu),
    AluReg(Alu),
    AluRegS(Alu),
    /// `x`: type of the shift, `imm`: its amount.
    AluShift(Alu),
    AluShiftS(Alu),
    ShiftReg(Shift),
    ShiftRegS(Shift),
    TestImm(Test),
    TestReg(Test),
    TestShift(Test),
    /// SP = n + imm.
    SpImm,
    /// SP from a shifted operand; bit 7 of `x` sets the flags.
    SpShift(Alu),
    SpMov,
    Mul,
    MulS,
    Mla,
    Mls,
    Umull,
    Smull,
    Umlal,
    Smlal,
    Udiv,
    Sdiv,
    Ubfx,
    Sbfx,
    Clz,
    Rev,
    /// d = m & imm: UXTB and UXTH.
    Mask,
    Sxtb,
    Sxth,
    Dsp(Dsp),
    LdrImm,
    LdrbImm,
    LdrhImm,
    LdrsbImm,
    LdrshImm,
    LdrReg,
    LdrbReg,
    LdrhReg,
    LdrsbReg,
    LdrshReg,
    LdrLit,
    LoadLit(Size),
    LoadPre(Size),
    LoadPost(Size),
    /// Load into register 13 or 15.
    LoadTo(Mode),
    LoadUser(Size),
    StrImm,
    StrbImm,
    StrhImm,
    StrReg,
    StrbReg,
    StrhReg,
    StorePre(Size),
    StorePost(Size),
    StoreUser(Size),
    /// `x`: bit 0 indexes, bit 1 writes back. If n is 15, `imm` is the address.
    Ldrd,
    Strd,
    /// `x`: bit 0 writes back, bit 1 decrements before.
    Ldm,
    Stm,
    Push,
    Pop,
    PopPc,
    Ldrex(Size),
    Strex(Size),
    /// TBB and TBH. `x`: bit 0 selects halfwords. If n is 15, `imm` is the address of the table.
    Table,
    B,
    /// Branch if Z; bit 7 of `x` inverts the condition of this and the following branches.
    BranchZero,
    BranchCarry,
    BranchNegative,
    BranchOverflow,
    BranchHigher,
    BranchGreaterEqual,
    BranchGreater,
    Bl,
    Bx,
    Blx,
    MovPc,
    AddPc,
    /// Branch if n is 0 (CBZ).
    BranchRegister,
    It,
    Special(Special),
    Vldr,
    Vstr,
    VmovToCore,
    VmovFromCore,
    VmovReg,
    VmovImm,
    Vabs,
    Vneg,
    Vadd,
    Vsub,
    Vmul,
    Vdiv,
    Vmla,
    Vmls,
    Vfma,
    Vfms,
    /// `imm` bit 0: a quiet NaN is invalid; bit 1: compare with zero.
    Vcmp,
    /// Copies the flags of FPSCR to the flags of the core.
    VmrsFlags,
    Float(Float),
}

/// A decoded instruction: operation and operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Insn {
    pub(super) op: Op,
    /// Cycles without wait states; for a branch, if not taken.
    pub(super) cycles: u8,
    /// Length, bytes.
    pub(super) size: u8,
    /// d, n, m and x, one byte each; packed so that they stay in one register of the host.
    registers: u32,
    pub(super) imm: u32,
}

impl Insn {
    /// Stands for an instruction that is not decoded yet.
    pub(super) const EMPTY: Self = Self {
        op: Op::Empty,
        cycles: 0,
        size: 2,
        registers: 0,
        imm: 0,
    };

    /// An instruction without operands.
    pub(super) const fn new(op: Op) -> Self {
        Self { op, ..Self::EMPTY }
    }

    /// An instruction with registers as encoded.
    pub(super) const fn regs(op: Op, d: u32, n: u32, m: u32) -> Self {
        Self {
            op,
            registers: d | n << 8 | m << 16,
            ..Self::EMPTY
        }
    }

    pub(super) const fn with_imm(mut self, imm: u32) -> Self {
        self.imm = imm;
        self
    }

    /// Sets the constant `imm`, and `x`: the third source register or the variant.
    pub(super) const fn with(self, imm: u32, x: u32) -> Self {
        self.with_imm(imm).with_x(x)
    }

    /// Sets `x`: the third source register or the variant.
    pub(super) const fn with_x(mut self, x: u32) -> Self {
        self.registers = self.registers & 0xff_ffff | x << 24;
        self
    }

    /// Destination register.
    #[inline(always)]
    pub(super) const fn d(self) -> u8 {
        self.registers as u8
    }

    /// First source register.
    #[inline(always)]
    pub(super) const fn n(self) -> u8 {
        (self.registers >> 8) as u8
    }

    /// Second source register.
    #[inline(always)]
    pub(super) const fn m(self) -> u8 {
        (self.registers >> 16) as u8
    }

    /// Third source register, or the variant of the operation; for a branch, the cycles to refill the pipeline.
    #[inline(always)]
    pub(super) const fn x(self) -> u8 {
        (self.registers >> 24) as u8
    }

    /// The instruction as executed inside an IT block, where 16-bit instructions except comparisons set no flags.
    pub(super) fn in_block(mut self) -> Self {
        if self.size != 2 {
            return self;
        }
        self.op = match self.op {
            Op::MovImmS => Op::MovImm,
            Op::MovRegS => Op::MovReg,
            Op::AddImmS => Op::AddImm,
            Op::SubImmS => {
                self.imm = self.imm.wrapping_neg();
                Op::AddImm
            }
            Op::AddRegS => Op::AddReg,
            Op::SubRegS => Op::SubReg,
            Op::LslImmS => Op::LslImm,
            Op::LsrImmS => Op::LsrImm,
            Op::AsrImmS => Op::AsrImm,
            Op::AluImmS(alu) => Op::AluImm(alu),
            Op::AluRegS(alu) => Op::AluReg(alu),
            Op::ShiftRegS(shift) => Op::ShiftReg(shift),
            Op::MulS => Op::Mul,
            other => other,
        };
        self
    }
}

pub(super) const UNDEFINED: Insn = Insn::new(Op::Undefined);
pub(super) const UNPREDICTABLE: Insn = Insn::new(Op::Unpredictable);

/// True for a register that most instructions cannot use: stack pointer or program counter.
pub(super) const fn bad(register: u32) -> bool {
    register == 13 || register == 15
}

/// Address of a literal, relative to the aligned program counter.
pub(super) const fn literal(pc: u32, offset: u32) -> u32 {
    (pc.wrapping_add(4) & !3).wrapping_add(offset)
}

/// `offset` to be added to a base; negated if not `up`.
pub(super) const fn directed(up: bool, offset: u32) -> u32 {
    if up { offset } else { offset.wrapping_neg() }
}

/// Hints NOP, YIELD, WFE, WFI and SEV by their number.
pub(super) const fn hint(number: u32) -> Insn {
    Insn::new(Op::Special(match number {
        1 => Special::Yield,
        2 => Special::Wfe,
        3 => Special::Wfi,
        4 => Special::Sev,
        _ => Special::Nop,
    }))
}
