//! Panics and processor faults: outputs made safe, the fault counted, kept and logged, the board
//! restarted.
//!
//! Counts and message stand in memory that a reset does not clear ([`kept`](crate::kept)), so that the
//! next start reports them.

use core::fmt::{Arguments, Write};
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, AtomicPtr, Ordering};

use cortex_m_rt::ExceptionFrame;

pub use crate::kept::Faults;
use crate::kept::{Record, Text};

#[unsafe(link_section = ".uninit.FAULTS")]
static mut RECORD: core::mem::MaybeUninit<Record> = core::mem::MaybeUninit::uninit();

/// Whether the program was started again because of a fault or by the watchdog.
static RESTARTED: AtomicBool = AtomicBool::new(false);

/// What to call to make the outputs safe; null before [`on_fault`].
static MAKE_SAFE: AtomicPtr<()> = AtomicPtr::new(core::ptr::null_mut());
static STOPPING: AtomicBool = AtomicBool::new(false);

/// Has `make_safe` called first thing on a panic or fault, with interrupts off. It must not panic
/// and must not rely on any state of the program: it writes the registers that switch outputs off.
pub fn on_fault(make_safe: fn()) {
    MAKE_SAFE.store(make_safe as *mut (), Ordering::Release);
}

/// Counts of faults since power came on.
pub fn counts() -> Faults {
    with_record(|record| record.faults)
}

/// Whether the program was started again because of a fault or by the watchdog.
pub fn restarted() -> bool {
    RESTARTED.load(Ordering::Relaxed)
}

/// Takes over the record at start: cleared after power-on, a watchdog reset counted. Gives the counts
/// and what the last fault said, once.
pub(crate) fn begin(power_on: bool, by_watchdog: bool) -> (Faults, Text) {
    with_record(|record| {
        if power_on {
            *record = Record::new();
        }
        record.faults.watchdog = record.faults.watchdog.saturating_add(by_watchdog.into());
        let message = core::mem::replace(&mut record.message, Text::EMPTY);
        let told = message.as_str().is_some_and(|text| !text.is_empty());
        RESTARTED.store(by_watchdog || told, Ordering::Relaxed);
        (record.faults, message)
    })
}

fn with_record<T>(f: impl FnOnce(&mut Record) -> T) -> T {
    critical_section::with(|_| {
        let place = addr_of_mut!(RECORD).cast::<Record>();
        // SAFETY: the critical section makes the access exclusive. The memory holds what it held
        // before the reset, of which every pattern is a record of integers; a volatile read keeps
        // the compiler from taking it as never written.
        let mut record = unsafe { place.read_volatile() }.or_new();
        let result = f(&mut record);
        // SAFETY: as above.
        unsafe { place.write_volatile(record.sealed()) };
        result
    })
}

/// Outputs safe, then `count`, keep and log `what`, then restart.
fn stop(count: impl FnOnce(&mut Faults) -> &mut u32, what: Arguments) -> ! {
    cortex_m::interrupt::disable();
    let make_safe = MAKE_SAFE.load(Ordering::Acquire);
    if !make_safe.is_null() {
        // SAFETY: the pointer was stored from a `fn()`.
        unsafe { core::mem::transmute::<*mut (), fn()>(make_safe)() };
    }
    // A fault while stopping, such as one inside the log, ends without another word.
    if !STOPPING.swap(true, Ordering::AcqRel) {
        with_record(|record| {
            let count = count(&mut record.faults);
            *count = count.saturating_add(1);
            record.message = Text::EMPTY;
            // What does not fit is cut off.
            let _ = record.message.write_fmt(what);
        });
        defmt::error!("{}", defmt::Display2Format(&what));
        defmt::flush();
    }
    restart()
}

#[cfg(feature = "emulated")]
fn restart() -> ! {
    semihosting::process::exit(1)
}

#[cfg(not(feature = "emulated"))]
fn restart() -> ! {
    // Time for a probe to fetch the log; the watchdog may cut it short.
    cortex_m::asm::delay(crate::board::CORE_HZ);
    cortex_m::peripheral::SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    stop(|faults| &mut faults.panics, format_args!("{info}"))
}

/// Ends the program on a fault of the processor; `frame` holds the registers at the fault.
pub(crate) fn hard_fault(frame: &ExceptionFrame) -> ! {
    // SAFETY: a read of the fault status register.
    let status = unsafe { (*cortex_m::peripheral::SCB::PTR).cfsr.read() };
    stop(
        |faults| &mut faults.processor,
        format_args!(
            "hard fault: status {status:#010x}, pc {:#010x}, lr {:#010x}",
            frame.pc(),
            frame.lr()
        ),
    )
}

#[cfg(not(feature = "emulated"))]
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    hard_fault(frame)
}

#[cortex_m_rt::exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    stop(
        |faults| &mut faults.processor,
        format_args!("interrupt {number} has no handler"),
    )
}
