//! SysTick as the clock of `embassy-time`, in microseconds.
//!
//! With SysTick as the clock, every timer of the chip is free for motors and encoders. The resolution is one
//! microsecond; alarms fire on the millisecond.
//!
//! SysTick has the highest priority of all readers of the time, so that no reader sees a period that has ended but is
//! not counted. Only the current loop has a higher priority, and it does not read the time.

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Waker;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use critical_section::Mutex;
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

use crate::clock::CORE_HZ;

/// Core cycles per microsecond; period of SysTick in µs and in core cycles.
const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;
const PERIOD_US: u32 = 1_000;
const PERIOD: u32 = CYCLES_PER_US * PERIOD_US;

struct SysTickDriver {
    /// Periods since the start, 64 bits in two halves; only the interrupt writes them.
    low: AtomicU32,
    high: AtomicU32,
    queue: Mutex<RefCell<Queue>>,
}

embassy_time_driver::time_driver_impl!(static DRIVER: SysTickDriver = SysTickDriver {
    low: AtomicU32::new(0),
    high: AtomicU32::new(0),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

/// Starts SysTick with its interrupt.
pub(crate) fn start() {
    // SAFETY: only this module uses SysTick.
    let mut systick = unsafe { cortex_m::Peripherals::steal() }.SYST;
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(PERIOD - 1);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}

impl SysTickDriver {
    fn periods(&self) -> u64 {
        u64::from(self.high.load(Ordering::Relaxed)) << 32
            | u64::from(self.low.load(Ordering::Relaxed))
    }
}

impl Driver for SysTickDriver {
    fn now(&self) -> u64 {
        critical_section::with(|_| {
            let mut count = SYST::get_current();
            let mut periods = self.periods();
            // The interrupt has not yet counted a period that ended while interrupts were masked.
            if SCB::is_pendst_pending() {
                count = SYST::get_current();
                periods += 1;
            }
            // The counter runs down from PERIOD − 1 to 0; its value 0 is the start of the next period.
            let elapsed = (PERIOD - count) % PERIOD;
            periods * u64::from(PERIOD_US) + u64::from(elapsed / CYCLES_PER_US)
        })
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            self.queue.borrow(cs).borrow_mut().schedule_wake(at, waker);
        });
    }
}

#[cortex_m_rt::exception]
fn SysTick() {
    let (low, carry) = DRIVER.low.load(Ordering::Relaxed).overflowing_add(1);
    critical_section::with(|cs| {
        DRIVER.low.store(low, Ordering::Relaxed);
        if carry {
            DRIVER
                .high
                .store(DRIVER.high.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        }
        // Wakes the tasks that are due. The time of the next alarm is not needed, because the interrupt is periodic.
        DRIVER
            .queue
            .borrow(cs)
            .borrow_mut()
            .next_expiration(DRIVER.now());
    });
}
