//! Panics and processor faults: outputs made safe, the fault counted and logged, the board restarted.
//!
//! The counts stand in memory that a reset does not clear, so that the next start reports them.

use core::panic::PanicInfo;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, AtomicPtr, Ordering};

use cortex_m_rt::ExceptionFrame;

/// Faults since power came on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub struct Faults {
    /// Panics of the program.
    pub panics: u32,
    /// Faults of the processor and interrupts without a handler.
    pub processor: u32,
    /// Resets by the watchdog.
    pub watchdog: u32,
}

impl Faults {
    const NONE: Self = Self {
        panics: 0,
        processor: 0,
        watchdog: 0,
    };
}

#[repr(C)]
struct Record {
    magic: u32,
    faults: Faults,
}

/// Says that the record was written by this program, not by chance.
const MAGIC: u32 = 0x6661_756c;

#[unsafe(link_section = ".uninit.FAULTS")]
static mut RECORD: core::mem::MaybeUninit<Record> = core::mem::MaybeUninit::uninit();

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
    with_record(|faults| *faults)
}

/// Takes over the record at start: cleared after power-on, a watchdog reset counted.
pub(crate) fn begin(power_on: bool, by_watchdog: bool) -> Faults {
    with_record(|faults| {
        if power_on {
            *faults = Faults::NONE;
        }
        faults.watchdog = faults.watchdog.saturating_add(by_watchdog.into());
        *faults
    })
}

fn with_record<T>(f: impl FnOnce(&mut Faults) -> T) -> T {
    critical_section::with(|_| {
        let place = addr_of_mut!(RECORD).cast::<Record>();
        // SAFETY: the critical section makes the access exclusive. The memory holds what it held
        // before the reset, of which every pattern is a record of integers; a volatile read keeps
        // the compiler from taking it as never written.
        let mut record = unsafe { place.read_volatile() };
        if record.magic != MAGIC {
            record = Record {
                magic: MAGIC,
                faults: Faults::NONE,
            };
        }
        let result = f(&mut record.faults);
        // SAFETY: as above.
        unsafe { place.write_volatile(record) };
        result
    })
}

/// Outputs safe, then `count` and `log`, then restart.
fn stop(count: impl FnOnce(&mut Faults), log: impl FnOnce()) -> ! {
    cortex_m::interrupt::disable();
    let make_safe = MAKE_SAFE.load(Ordering::Acquire);
    if !make_safe.is_null() {
        // SAFETY: the pointer was stored from a `fn()`.
        unsafe { core::mem::transmute::<*mut (), fn()>(make_safe)() };
    }
    // A fault while stopping, such as one inside the log, ends without another word.
    if !STOPPING.swap(true, Ordering::AcqRel) {
        with_record(count);
        log();
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
    stop(
        |faults| faults.panics = faults.panics.saturating_add(1),
        || defmt::error!("{}", defmt::Display2Format(info)),
    )
}

/// Ends the program on a fault of the processor; `frame` holds the registers at the fault.
pub(crate) fn hard_fault(frame: &ExceptionFrame) -> ! {
    // SAFETY: a read of the fault status register.
    let status = unsafe { (*cortex_m::peripheral::SCB::PTR).cfsr.read() };
    stop(
        |faults| faults.processor = faults.processor.saturating_add(1),
        || {
            defmt::error!(
                "hard fault: status {:#010x}, pc {:#010x}, lr {:#010x}",
                status,
                frame.pc(),
                frame.lr()
            )
        },
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
        |faults| faults.processor = faults.processor.saturating_add(1),
        || defmt::error!("interrupt {} has no handler", number),
    )
}
