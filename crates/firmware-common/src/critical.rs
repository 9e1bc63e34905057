//! Critical sections that do not delay the motor current loop.
//!
//! A critical section of the program (`critical_section::with`, used by all of embassy) raises BASEPRI to priority 1.
//! Every interrupt of priority 1 and below then waits. Two handlers have priority 0: the current loop and the voltage
//! detector.
//!
//! The current loop's handler starts within a dozen cycles at any time. It must therefore use no data guarded by a
//! critical section: it cannot wake a task, log or read the time. Data that it shares with the rest of the program
//! are exchanged under [`all`], which masks the current loop too and must be short.
//!
//! The voltage detector's handler masks all interrupts and does not return: it ends in a reset.
//!
//! # Short handlers
//!
//! Arm erratum 776924: an interrupted VDIV or VSQRT may give a wrong result. The error occurs only if the handler
//! uses no floating point and returns before the 14 cycles of the instruction are over. No handler of the images is
//! that short. The shortest handlers are those of the executors and the bus's status handler. An executor's handler
//! has two barriers and an exclusive access before it looks for a task. The bus's status handler has a write over
//! APB1 and a critical section.

use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::register::{basepri, basepri_max};
use critical_section::{CriticalSection, Impl, RawRestoreState};

/// Priority 1 of 16 in register format: the most urgent priority that a critical section holds off.
const BELOW: u8 = 1 << 4;

/// Runs `f` with all interrupts masked, for data shared with the current loop.
pub fn all<T>(f: impl FnOnce(CriticalSection<'_>) -> T) -> T {
    cortex_m::interrupt::free(|_| {
        // SAFETY: all interrupts are masked.
        f(unsafe { CriticalSection::new() })
    })
}

/// Gives every interrupt priority 1, which critical sections hold off; after a reset all have priority 0. Call it
/// before a driver enables an interrupt.
pub(crate) fn set_up() {
    // SAFETY: the drivers set the priorities of their own interrupts later.
    unsafe {
        let nvic = &*cortex_m::peripheral::NVIC::PTR;
        for priorities in &nvic.ipr[..INTERRUPTS] {
            priorities.write(BELOW);
        }
        let mut scb = cortex_m::Peripherals::steal().SCB;
        scb.set_priority(SystemHandler::SysTick, BELOW);
    }
}

/// Number of the chip's interrupts.
const INTERRUPTS: usize = 82;

struct BelowCurrentLoop;
critical_section::set_impl!(BelowCurrentLoop);

// SAFETY: while BASEPRI is raised, only handlers of priority 0 run. The current loop's handler uses no data of
// critical sections, and the voltage detector's handler never returns. `release` restores the former BASEPRI, so
// sections nest.
unsafe impl Impl for BelowCurrentLoop {
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        basepri_max::write(BELOW);
        before
    }

    unsafe fn release(before: RawRestoreState) {
        // SAFETY: `before` is the value that `acquire` read from the register.
        unsafe { basepri::write(before) };
    }
}
