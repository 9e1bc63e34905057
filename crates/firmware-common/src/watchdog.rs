//! Watchdogs that reset the board if the work that feeds them stops.
//!
//! The window watchdog supervises the current loop, with a timeout of 6.2 ms, the independent watchdog all tasks. The
//! independent watchdog is started first, before the HAL: the start of the clocks waits without limit for the
//! crystal, which may never start. The watchdog has an oscillator of its own.
//!
//! A watchdog that does not run is a fault: the board restarts and its motors stay off.

use core::marker::PhantomData;

use embassy_stm32::pac::{self, WWDG};
use embassy_stm32::{Peri, peripherals, wdg};

use crate::fault;

/// Timeout of the independent watchdog, µs. The real timeout is 0.34 to 0.94 s, because its oscillator runs at 17 to
/// 47 kHz.
pub const TIMEOUT_US: u32 = 500_000;

/// Timeout during the start of a board, µs; a start takes about 40 ms.
const START_US: u32 = 2_000_000;

/// Extended timeout during a save, µs. A save may erase several sectors; each erase stops the core for up to 0.5 s.
const EXTENDED_US: u32 = 30_000_000;

/// Polls of the status, about 10 cycles each, after which the watchdog must have accepted its registers. Accepting
/// them takes five periods of its oscillator, at most 0.3 ms or 50 000 cycles.
const STATUS_POLLS: u32 = 100_000;

type Driver = wdg::IndependentWatchdog<'static, peripherals::IWDG>;

/// Keeps a handle in one executor: a feed between the writes of a new timeout would lock the registers again.
type NotSend = PhantomData<*const ()>;

/// The independent watchdog during the start of a board; it cannot be stopped.
pub struct Watchdog(());

impl Watchdog {
    /// Starts the watchdog with the timeout of a start; call it once, first.
    pub fn start() -> Self {
        set::<START_US>();
        Self(())
    }

    /// Ends the start of the board and sets [`TIMEOUT_US`]. Returns the handles for the tasks of the thread.
    pub fn split(self) -> (Feeder, Extension) {
        let feeder = Feeder(set::<TIMEOUT_US>(), PhantomData);
        (feeder, Extension(PhantomData))
    }
}

/// Handle that feeds the independent watchdog.
pub struct Feeder(Driver, NotSend);

impl Feeder {
    /// Restarts the timeout. Call it where the board's work is known to continue, not from a timer alone.
    pub fn feed(&mut self) {
        self.0.pet();
    }
}

/// Handle that extends the timeout of the independent watchdog.
pub struct Extension(NotSend);

impl Extension {
    /// Runs `work`, which stops the core, with a timeout of half a minute.
    pub fn during<T>(&mut self, work: impl FnOnce() -> T) -> T {
        set::<EXTENDED_US>();
        let result = work();
        set::<TIMEOUT_US>();
        result
    }
}

/// Starts the independent watchdog if it does not run, sets its timeout and feeds it.
fn set<const TIMEOUT_US: u32>() -> Driver {
    // SAFETY: only this module uses the peripheral, and all handles are in one executor.
    let peripheral = unsafe { peripherals::IWDG::steal() };
    let mut watchdog = Driver::new(peripheral, TIMEOUT_US);
    watchdog.unleash();
    // The driver does not wait until the registers are accepted, and a feed before that would restart the former
    // timeout.
    let busy = || {
        let status = pac::IWDG.sr().read();
        status.pvu() || status.rvu()
    };
    if (0..STATUS_POLLS).all(|_| busy()) {
        fault::watchdog_missing("independent");
    }
    watchdog.pet();
    watchdog
}

/// Timeout of the window watchdog, µs: its maximum, 64 counts of 4096 cycles of APB1.
const WINDOW_TIMEOUT_US: u32 = 6_241;

/// Window watchdog of the current loop, with only an upper limit. The HAL waits between enabling the clock and the
/// first write, which would otherwise be lost (errata sheet ES0182).
///
/// Only a reset stops the window watchdog. Erasing the flash stops the core for longer than its timeout, so a board
/// with this watchdog never erases.
pub struct WindowWatchdog(wdg::WindowWatchdog<'static, peripherals::WWDG>);

impl WindowWatchdog {
    /// Starts the window watchdog, which only a reset can stop.
    pub fn start(peripheral: Peri<'static, peripherals::WWDG>) -> Self {
        let watchdog = wdg::WindowWatchdog::new(peripheral, WINDOW_TIMEOUT_US, 0);
        if !WWDG.cr().read().wdga() {
            fault::watchdog_missing("window");
        }
        Self(watchdog)
    }

    /// Restarts the timeout of the window watchdog.
    pub fn feed(&mut self) {
        self.0.pet();
    }
}
