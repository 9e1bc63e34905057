//! Cortex-M4F (ARMv7E-M with FPv4-SP): instructions, exceptions and the private peripherals.
//!
//! [`Core`] executes an image from the memories of a [`System`]. Everything from 0xE000_0000 to 0xE00F_FFFF is inside
//! the core, except DBGMCU: NVIC, SCB, SysTick, DWT, MPU, floating-point registers.
//!
//! # Instructions
//!
//! An instruction is decoded at its first execution and cached by address. The cache is invalidated when code in flash
//! changes ([`System::take_changed_code`]); code in RAM is compared with the decoded code at each execution. All of
//! Thumb-2, DSP and FPv4-SP is implemented. An instruction that the architecture calls UNPREDICTABLE is a finding, then
//! executes as undefined.
//!
//! # Accuracy
//!
//! Results, flags, floating-point status and faults are exact, with these differences to silicon:
//!
//! - Multiple loads and stores and divisions are not interrupted: an exception is taken up to 16 cycles later.
//! - A bus error on a store is precise; on silicon the write buffer makes most of them imprecise.
//! - The write buffer has no other effect either: a store is complete when the next instruction begins.
//! - An exception that arrives during the entry of another one is taken first (late arrival). An exception that arrives
//!   while registers are restored is taken after the return, not during it.
//! - The cycle counter of the DWT stops during sleep. Other counters, comparators, trace and flash patch only store the
//!   written values.
//!
//! Cycles are those of the Cortex-M4 Technical Reference Manual, table 3-1 and section 3.3, as applied by `timing`: a
//! time for each instruction, adjustments for pairs of adjacent instructions, plus the time added by the chip (wait
//! states, bus). Where the manual gives a range the model uses one number. A taken branch costs 2 cycles (by register:
//! 3), and one more if its target is an unaligned 32-bit instruction. A division costs 2 to 12 cycles, by the lengths
//! of its operands. Loops of ordinary code are within about 5 % of the manual's numbers; a single instruction may be
//! off by one cycle.

mod debug;
mod decode16;
mod decode32;
mod decode_data;
mod decode_fp;
mod dwt;
mod exception;
mod execute;
mod execute_data;
mod execute_dsp;
mod execute_fp;
mod execute_memory;
mod execute_special;
mod fetch;
pub mod float;
mod instruction;
mod memory;
mod mpu;
mod nvic;
mod private;
mod profile;
mod registers;
mod run;
mod scb;
mod stack;
mod system;
mod systick;
mod timing;

#[cfg(test)]
mod tests;

pub use nvic::{LINES, exception as exceptions};
pub use profile::{ExceptionProfile, Profile};
pub use system::{BusError, System, Transfer, Width};

use self::debug::Debug;
use self::dwt::Dwt;
use self::fetch::Cached;
use self::instruction::Insn;
use self::mpu::Mpu;
use self::nvic::Nvic;
use self::scb::Scb;
use self::systick::SysTick;
use crate::time::Cycles;

/// Reason why [`Core::run`] returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The given cycle was reached.
    Until,
    /// The program requested a reset; [`System::request_reset`] was called.
    Reset,
    /// The core locked up: a fault occurred while no fault can be taken. Reported once; afterwards only time passes
    /// until a reset or a non-maskable interrupt.
    LockUp,
    /// The core is about to execute the instruction at this address, a breakpoint or BKPT.
    Breakpoint(u32),
    /// The previous instruction accessed a watched address.
    Watchpoint {
        /// Watched address.
        address: u32,
        /// Address of the instruction.
        pc: u32,
        /// True for a store.
        write: bool,
    },
    /// The requested single step is done.
    Step,
}

/// Sleep state of the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sleep {
    Awake,
    /// WFI.
    Interrupt,
    /// WFE.
    Event,
    LockedUp,
}

/// Marks that no line of 16 bytes is current.
const NO_LINE: u32 = u32::MAX;

/// A Cortex-M4F.
#[derive(Clone)]
pub struct Core {
    r: [u32; 16],
    pc: u32,
    cycles: Cycles,
    /// Current line of 16 bytes from which instructions are fetched.
    line: u32,
    /// ITSTATE.
    it: u8,
    /// True if interrupts, sleep or debugging must be checked before the next instruction.
    check_needed: bool,
    /// Cycle at which [`Core::run`] returns.
    until: Cycles,
    /// Flags: N is the highest bit of `n`; Z is set if `z` is 0.
    n: u32,
    z: u32,
    c: bool,
    v: bool,
    q: bool,
    /// GE flags, one bit each.
    ge: u32,
    /// True if floating-point instructions may execute without further checks.
    fp_ready: bool,
    fpscr: u32,
    s: [u32; 32],
    /// Cycle until which the floating-point unit is busy with a division.
    fp_busy: Cycles,
    /// Decoded instructions in flash, by halfword.
    decoded: Vec<Insn>,
    /// Decoded instructions outside of flash.
    cached: Vec<Cached>,
    /// Pages of 16 MiB whose accesses need no check.
    plain: [bool; 256],
    /// True if the whole flash is executable.
    flash_executes: bool,
    /// Mode for which `plain` was computed.
    view: mpu::Mode,
    /// The stack pointer, MSP or PSP, that is not in `r`.
    other_sp: u32,
    /// True if thread mode uses the process stack (CONTROL.SPSEL).
    process_stack: bool,
    /// CONTROL.nPRIV: true if thread mode is unprivileged.
    user_thread: bool,
    /// CONTROL.FPCA: true if the present context uses floating point.
    fp_active: bool,
    thumb: bool,
    ipsr: u16,
    primask: bool,
    faultmask: bool,
    basepri: u8,
    event: bool,
    exclusive: bool,
    sleep: Sleep,
    /// True if the present sleep began with SLEEPDEEP set.
    deep_sleep: bool,
    stop: Option<Stop>,
    /// Value of a trap: the address of a fault, or the value of an exception return.
    trap_value: u32,
    nvic: Nvic,
    scb: Scb,
    systick: SysTick,
    dwt: Dwt,
    mpu: Mpu,
    debug: Debug,
    profile: Option<Box<Profile>>,
    instructions: u64,
    asleep: Cycles,
    taken: Box<[u64; 128]>,
    lowest_msp: u32,
}

impl Default for Core {
    fn default() -> Self {
        Self::new()
    }
}

impl Core {
    /// Creates a core before its first reset.
    pub fn new() -> Self {
        Self {
            r: [0; 16],
            pc: 0,
            cycles: 0,
            line: NO_LINE,
            it: 0,
            check_needed: true,
            until: 0,
            n: 0,
            z: 1,
            c: false,
            v: false,
            q: false,
            ge: 0,
            fp_ready: false,
            fpscr: 0,
            s: [0; 32],
            fp_busy: 0,
            decoded: Vec::new(),
            cached: Vec::new(),
            plain: [false; 256],
            flash_executes: false,
            view: mpu::Mode::Privileged,
            other_sp: 0,
            process_stack: false,
            user_thread: false,
            fp_active: false,
            thumb: true,
            ipsr: 0,
            primask: false,
            faultmask: false,
            basepri: 0,
            event: false,
            exclusive: false,
            sleep: Sleep::Awake,
            deep_sleep: false,
            stop: None,
            trap_value: 0,
            nvic: Nvic::default(),
            scb: Scb::after_reset(),
            systick: SysTick::default(),
            dwt: Dwt::default(),
            mpu: Mpu::default(),
            debug: Debug::default(),
            profile: None,
            instructions: 0,
            asleep: 0,
            taken: Box::new([0; 128]),
            lowest_msp: u32::MAX,
        }
    }

    /// Resets the core: stack pointer and program counter come from the vectors at 0, private peripherals start as
    /// after power-on. Cycles, counters, breakpoints and decoded instructions are kept.
    pub fn reset(&mut self, system: &mut impl System) {
        let old = std::mem::take(self);
        self.cycles = old.cycles;
        self.instructions = old.instructions;
        self.asleep = old.asleep;
        self.taken = old.taken;
        self.lowest_msp = old.lowest_msp;
        self.decoded = old.decoded;
        self.cached = old.cached;
        self.debug = old.debug;
        self.profile = old.profile;
        if let Some(profile) = &mut self.profile {
            profile.reset();
        }
        self.update_view(true);
        let mut vector = |address| system.read(Transfer::word(address, 0), &mut self.cycles);
        let (sp, pc) = (vector(0), vector(4));
        self.r[14] = u32::MAX;
        match (sp, pc) {
            (Ok(sp), Ok(pc)) => {
                self.r[13] = sp & !3;
                self.pc = pc & !1;
                self.thumb = pc & 1 != 0;
            }
            _ => self.lock_up(system, "the reset vector cannot be read"),
        }
        self.note_stack();
    }
}
