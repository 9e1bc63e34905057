//! Cortex-M4F (ARMv7E-M with FPv4-SP): instructions, exceptions and the private peripherals.
//!
//! [`Core`] executes an image out of the memories that a [`System`] offers. Everything from
//! 0xE000_0000 to 0xE00F_FFFF (NVIC, SCB, SysTick, DWT, MPU, floating-point registers; not DBGMCU)
//! is inside the core.
//!
//! # Instructions
//!
//! An instruction is decoded when it is executed first and kept by its address, so its operands need
//! no more decoding; code in flash that changes is forgotten ([`System::take_changed_code`]), code in
//! RAM is compared with what was decoded each time. All of Thumb-2, DSP and FPv4-SP is there. What
//! the architecture calls UNPREDICTABLE is a finding and is then taken as undefined.
//!
//! # Accuracy
//!
//! Results, flags, floating-point status and faults are exact, with these differences to silicon:
//!
//! - Loads and stores of several registers and divisions are not interrupted in the middle: an
//!   exception is taken up to 16 cycles later than there.
//! - A bus error on a store is precise; on silicon the write buffer makes most of them imprecise.
//! - The write buffer is not seen otherwise either: a store is done when the next instruction begins.
//! - An exception that arrives while another is entered is taken first (late arrival); one that
//!   arrives while registers are restored is taken after the return instead of in its middle.
//! - The cycle counter of the DWT stands still during sleep. Other counters, comparators, trace and
//!   flash patch hold what is written and do nothing.
//!
//! Cycles are those of the Cortex-M4 Technical Reference Manual, table 3-1 and section 3.3, as
//! `timing` applies them: each instruction by itself, pairs of neighbours where one
//! waits for the other, plus what the chip adds (wait states, bus). Where the manual gives a range
//! the model takes one number: a taken branch costs 2 cycles (register: 3), one more if it lands on
//! an unaligned 32-bit instruction, a division 2 to 12 by the lengths of its operands. Loops of
//! ordinary code are within about 5 % of that manual's numbers; a single instruction may be off by
//! a cycle.

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

/// Why [`Core::run`] came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The time is over.
    Until,
    /// The program asked for a reset; [`System::request_reset`] was called.
    Reset,
    /// The processor locked up: a fault while none can be taken. It comes once; afterwards the core
    /// only lets time pass, until a reset or a non-maskable interrupt.
    LockUp,
    /// The program is about to execute this address, or is at a BKPT there.
    Breakpoint(u32),
    /// The instruction before did an access that is watched.
    Watchpoint {
        /// Address that is watched.
        address: u32,
        /// The instruction.
        pc: u32,
        /// A store.
        write: bool,
    },
    /// One instruction was executed, as asked for.
    Step,
}

/// What the core waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sleep {
    Awake,
    /// WFI.
    Interrupt,
    /// WFE.
    Event,
    LockedUp,
}

/// No line of 16 bytes.
const NO_LINE: u32 = u32::MAX;

/// A Cortex-M4F.
#[derive(Clone)]
pub struct Core {
    r: [u32; 16],
    pc: u32,
    cycles: Cycles,
    /// Where instructions come from at present, in lines of 16 bytes.
    line: u32,
    /// ITSTATE.
    it: u8,
    /// Something is to be looked at before the next instruction.
    attend: bool,
    /// Until when [`Core::run`] is to run.
    until: Cycles,
    /// N is the highest bit of `n`, Z is that `z` is 0.
    n: u32,
    z: u32,
    c: bool,
    v: bool,
    q: bool,
    /// GE, a bit each.
    ge: u32,
    /// Floating-point instructions may execute without another look.
    fp_ready: bool,
    fpscr: u32,
    s: [u32; 32],
    /// Until when the floating-point unit divides.
    fp_busy: Cycles,
    /// Decoded instructions of the flash, by halfword.
    decoded: Vec<Insn>,
    /// Decoded instructions of elsewhere.
    cached: Vec<Cached>,
    /// Pages of 16 MiB whose accesses need no check.
    plain: [bool; 256],
    /// Whether all of the flash may be executed.
    flash_executes: bool,
    /// What `plain` was made for.
    view: mpu::Mode,
    /// The stack pointer that is not in `r`.
    other_sp: u32,
    /// Thread mode uses the process stack (CONTROL.SPSEL).
    process_stack: bool,
    /// CONTROL.nPRIV.
    user_thread: bool,
    /// CONTROL.FPCA.
    fp_active: bool,
    thumb: bool,
    ipsr: u16,
    primask: bool,
    faultmask: bool,
    basepri: u8,
    event: bool,
    exclusive: bool,
    sleep: Sleep,
    /// The sleep asks for SLEEPDEEP.
    deep_sleep: bool,
    stop: Option<Stop>,
    /// What a trap is about: the address of a fault, the value of an exception return.
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
    /// A core before its first reset.
    pub fn new() -> Self {
        Self {
            r: [0; 16],
            pc: 0,
            cycles: 0,
            line: NO_LINE,
            it: 0,
            attend: true,
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

    /// Reset: stack pointer and program counter from the vectors at 0, everything private as after
    /// power-on. Cycles, counters, breakpoints and decoded instructions stay.
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
