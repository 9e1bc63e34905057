//! Critical sections that the current loop does not wait for.
//!
//! A critical section of the program (`critical_section::with`, so all of embassy's) raises BASEPRI to
//! priority 1: every interrupt of priority 1 and below waits. Two handlers have priority 0. The current
//! loop's starts within a dozen cycles whatever else goes on. It may therefore use nothing that
//! such a section guards, neither wake a task nor log nor ask for the time. What it shares with the
//! rest is exchanged under [`all`], which masks it too and is kept short. The handler of the voltage detector
//! masks all interrupts and does not return: it ends in a reset.
//!
//! # Short handlers
//!
//! Arm erratum 776924: a VDIV or VSQRT that is interrupted may give a wrong result if the handler uses no
//! floating point and returns before the instruction's 14 cycles are over. No handler of the images is that
//! short. The shortest are those of the executors, with two barriers and an exclusive access before a task is
//! looked for, and the bus's status handler, with a write over APB1 and a critical section.

use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::register::{basepri, basepri_max};
use critical_section::{CriticalSection, Impl, RawRestoreState};

/// Priority 1 of 16, as the registers have it: the most urgent one that a critical section holds off.
const BELOW: u8 = 1 << 4;

/// All interrupts masked; for data of the handler with priority 0.
pub fn all<T>(f: impl FnOnce(CriticalSection<'_>) -> T) -> T {
    cortex_m::interrupt::free(|_| {
        // SAFETY: no interrupt comes.
        f(unsafe { CriticalSection::new() })
    })
}

/// Gives every interrupt a priority that critical sections hold off: at reset all have 0. To be called
/// before anything asks for one of them.
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

/// Interrupts of the chip.
const INTERRUPTS: usize = 82;

struct BelowCurrentLoop;
critical_section::set_impl!(BelowCurrentLoop);

// SAFETY: while BASEPRI is raised only handlers of priority 0 come. The current loop's uses no critical section's data, and
// to the voltage detector's no section returns. What was there before is put back, so sections may lie within each other.
unsafe impl Impl for BelowCurrentLoop {
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        basepri_max::write(BELOW);
        before
    }

    unsafe fn release(before: RawRestoreState) {
        // SAFETY: the value that `acquire` found.
        unsafe { basepri::write(before) };
    }
}
