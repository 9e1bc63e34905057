//! Panics, processor faults and stack overflows. Each makes the outputs safe, is counted, recorded and logged, and
//! restarts the board.
//!
//! The counts and the message are in memory that a reset keeps ([`crash_record`](crate::crash_record)), so the next
//! start reports them.

use core::cell::Cell;
use core::fmt::{Arguments, Write};
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, AtomicPtr, Ordering};

use core_algos::link::protocol::CrashRecord;
use critical_section::Mutex;
use embassy_stm32::pac::{FLASH, RCC, WWDG, rcc::vals::Sw};

pub use crate::crash_record::Faults;
use crate::crash_record::{Record, Text};
use crate::stack;

#[unsafe(link_section = ".uninit.FAULTS")]
static mut RECORD: core::mem::MaybeUninit<Record> = core::mem::MaybeUninit::uninit();

/// True if a fault or the watchdog restarted the program.
static RESTARTED: AtomicBool = AtomicBool::new(false);

/// Function that makes the outputs safe; null before [`on_fault`].
static MAKE_SAFE: AtomicPtr<()> = AtomicPtr::new(core::ptr::null_mut());
static STOPPING: AtomicBool = AtomicBool::new(false);

/// Sets the function that runs first on a panic or fault, with interrupts off. `make_safe` must not panic and must
/// not use any state of the program: it writes the registers that switch the outputs off.
pub fn on_fault(make_safe: fn()) {
    MAKE_SAFE.store(make_safe as *mut (), Ordering::Release);
}

/// Counts of faults since power-on.
pub fn counts() -> Faults {
    with_record(|record| record.faults)
}

/// Message of the fault that restarted the board.
static LAST: Mutex<Cell<Text>> = Mutex::new(Cell::new(Text::EMPTY));

/// Counts of faults and the last message, for a host.
pub fn record() -> CrashRecord {
    let Faults {
        panics,
        processor,
        watchdog,
        stack,
    } = counts();
    let last = critical_section::with(|cs| LAST.borrow(cs).get());
    let message = last.as_str().and_then(|text| text.try_into().ok());
    CrashRecord {
        counts: [panics, processor, watchdog, stack],
        message: message.unwrap_or_default(),
    }
}

/// True if a fault or the watchdog restarted the program.
pub fn restarted() -> bool {
    RESTARTED.load(Ordering::Relaxed)
}

/// Updates the record at the start of the board: clears it after power-on and counts a watchdog reset. Returns the
/// counts and the last fault's message, and removes the message from the record.
pub(crate) fn begin(power_on: bool, by_watchdog: bool) -> (Faults, Text) {
    with_record(|record| {
        if power_on {
            *record = Record::new();
        }
        record.faults.watchdog = record.faults.watchdog.saturating_add(by_watchdog.into());
        let message = core::mem::replace(&mut record.message, Text::EMPTY);
        let has_message = message.as_str().is_some_and(|text| !text.is_empty());
        RESTARTED.store(by_watchdog || has_message, Ordering::Relaxed);
        critical_section::with(|cs| LAST.borrow(cs).set(message));
        (record.faults, message)
    })
}

fn with_record<T>(f: impl FnOnce(&mut Record) -> T) -> T {
    critical_section::with(|_| {
        let place = addr_of_mut!(RECORD).cast::<Record>();
        // SAFETY: the critical section makes the access exclusive. The memory keeps its contents over a reset, and a
        // record of integers is valid for every bit pattern. A volatile read keeps the compiler from treating the
        // memory as uninitialised.
        let mut record = unsafe { place.read_volatile() }.or_new();
        let result = f(&mut record);
        // SAFETY: the critical section makes the write exclusive.
        unsafe { place.write_volatile(record.sealed()) };
        result
    })
}

/// Switches interrupts off, makes the outputs safe and takes the board off the bus.
fn make_safe() {
    cortex_m::interrupt::disable();
    let make_safe = MAKE_SAFE.load(Ordering::Acquire);
    if !make_safe.is_null() {
        // SAFETY: the pointer was stored from a `fn()`.
        unsafe { core::mem::transmute::<*mut (), fn()>(make_safe)() };
    }
    // On the internal oscillator the controller's bit rate is wrong, and it would disturb the bus until the reset.
    RCC.apb1rstr().modify(|w| w.set_can1rst(true));
}

/// Handles a falling supply. Within microseconds it may be too low for the core's clock, so the core switches to the
/// internal oscillator before the fault is recorded.
pub(crate) fn supply_low() -> ! {
    make_safe();
    RCC.cfgr().modify(|w| w.set_sw(Sw::HSI));
    // Prefetch does not work below 2.1 V, to which the supply may fall.
    FLASH.acr().modify(|w| w.set_prften(false));
    stop(
        |faults| &mut faults.processor,
        format_args!("the supply fell below 2.8 V"),
    )
}

/// Handles a watchdog that does not run: without it a hanging program would leave the motors on.
pub(crate) fn watchdog_missing(which: &str) -> ! {
    stop(
        |faults| &mut faults.processor,
        format_args!("the {which} watchdog does not run"),
    )
}

/// Makes the outputs safe; then counts, records and logs the fault `what`, and restarts the board.
fn stop(count: impl FnOnce(&mut Faults) -> &mut u32, what: Arguments) -> ! {
    make_safe();
    // A second fault during the stop, for example in the log, restarts the board at once.
    if !STOPPING.swap(true, Ordering::AcqRel) {
        with_record(|record| {
            let count = count(&mut record.faults);
            *count = count.saturating_add(1);
            record.message = Text::EMPTY;
            // Text beyond the longest message is cut off.
            let _ = record.message.write_fmt(what);
        });
        // The log is not flushed: a flush would wait for a probe that has been disconnected.
        defmt::error!("{}", defmt::Display2Format(&what));
    }
    restart()
}

fn restart() -> ! {
    // Wait 0.1 s so that a probe can read the log. The wait is shorter than the shortest timeout of the independent
    // watchdog, whose reset would count as a second fault. Without the crystal the core runs at 16 MHz. A turn of the
    // delay takes three cycles.
    let hz = match RCC.cfgr().read().sws() {
        Sw::HSI => 16_000_000,
        _ => crate::clock::CORE_HZ,
    };
    for _ in 0..50 {
        cortex_m::asm::delay(hz / 3 / 500);
        feed_window_watchdog();
    }
    cortex_m::peripheral::SCB::sys_reset()
}

/// Feeds the window watchdog if it was started. The register is written directly: the driver belongs to the current
/// loop, which the fault may have interrupted.
fn feed_window_watchdog() {
    if RCC.apb1enr().read().wwdgen() {
        WWDG.cr().modify(|w| w.set_t(0x7f));
    }
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    stop(|faults| &mut faults.panics, format_args!("{info}"))
}

/// Ends the program on a processor fault. `pc` is the address of the fault, `lr` the return address, and `sp` the
/// stack pointer after the processor stacked its registers.
pub(crate) extern "C" fn hard_fault(pc: u32, lr: u32, sp: u32) -> ! {
    // SAFETY: reads of the fault status registers.
    let (status, address) = unsafe {
        let scb = &*cortex_m::peripheral::SCB::PTR;
        (scb.cfsr.read(), scb.mmfar.read())
    };
    if stack::overflowed(sp, status, address) {
        stop(
            |faults| &mut faults.stack,
            format_args!("stack overflow: sp {sp:#010x}, pc {pc:#010x}, lr {lr:#010x}"),
        )
    }
    stop(
        |faults| &mut faults.processor,
        format_args!("hard fault: status {status:#010x}, pc {pc:#010x}, lr {lr:#010x}"),
    )
}

/// Hard fault vector. The stack may be exhausted, and then neither the processor nor this handler can push to it. The
/// program does not continue, so the handler resets the stack pointer to the start of the stack. Before that it reads
/// the stacked registers only if they are certain to be in RAM.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() {
    core::arch::naked_asm!(
        "mov r2, sp",
        "movs r0, #0",
        "movs r1, #0",
        "movw r3, #:lower16:_stack_end",
        "movt r3, #:upper16:_stack_end",
        "cmp r2, r3",
        // The stacked pc and lr are read only if the stack pointer is in RAM.
        "itt hs",
        "ldrhs r0, [r2, #24]",
        "ldrhs r1, [r2, #20]",
        "movw r3, #:lower16:_stack_start",
        "movt r3, #:upper16:_stack_start",
        "msr msp, r3",
        "b {handler}",
        handler = sym hard_fault,
    )
}

/// Handles a stopped crystal, the only source of this interrupt; the core then runs on the internal oscillator.
#[cortex_m_rt::exception]
unsafe fn NonMaskableInt() -> ! {
    stop(
        |faults| &mut faults.processor,
        format_args!("the crystal has stopped"),
    )
}

#[cortex_m_rt::exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    stop(
        |faults| &mut faults.processor,
        format_args!("interrupt {number} has no handler"),
    )
}
