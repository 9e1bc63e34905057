//! Watchdogs: they reset the board if the work that feeds them stops.
//!
//! The window watchdog waits for the current loop, 6.2 ms at most, and the independent one for all tasks. The
//! independent one is started before anything else, even the HAL: the crystal, for which the start of the clocks
//! waits without limit, is the first that may never come. Its oscillator starts with it.
//!
//! A watchdog that does not run is a fault: the board restarts and its motors stay off.

use core::marker::PhantomData;

use embassy_stm32::pac::{self, WWDG};
use embassy_stm32::{Peri, peripherals, wdg};

use crate::fault;

/// Time without feeding after which the board is reset, µs; 0.34 to 0.94 s by its oscillator of 17 to 47 kHz.
pub const TIMEOUT_US: u32 = 500_000;

/// Time that the start of a board may take, µs. It takes some 40 ms.
const START_US: u32 = 2_000_000;

/// Time of an extension, µs: an erase of a sector holds the core for up to half a second, a save for several.
const EXTENDED_US: u32 = 30_000_000;

/// Looks at the status until the watchdog must have taken over its registers, some 10 cycles each. Five periods of its
/// oscillator are 0.3 ms at most, 50 000 cycles.
const STATUS_LOOKS: u32 = 100_000;

type Driver = wdg::IndependentWatchdog<'static, peripherals::IWDG>;

/// Keeps an end in one executor: a feed between the writes of a new time would lock the registers again.
type NotSend = PhantomData<*const ()>;

/// The independent watchdog during the start of a board; it cannot be stopped.
pub struct Watchdog(());

impl Watchdog {
    /// Starts it, with time for the start of the board; call it once, first.
    pub fn start() -> Self {
        set::<START_US>();
        Self(())
    }

    /// Ends the start of the board: from here on the time is [`TIMEOUT_US`]. Gives the ends for the tasks of the thread.
    pub fn split(self) -> (Feeder, Extension) {
        let feeder = Feeder(set::<TIMEOUT_US>(), PhantomData);
        (feeder, Extension(PhantomData))
    }
}

/// The end that feeds the independent watchdog.
pub struct Feeder(Driver, NotSend);

impl Feeder {
    /// Begins the time anew. To be called where the board's work is known to go on, not by a timer alone.
    pub fn feed(&mut self) {
        self.0.pet();
    }
}

/// The end that extends the time of the independent watchdog.
pub struct Extension(NotSend);

impl Extension {
    /// Does work that holds the core, with half a minute for it.
    pub fn during<T>(&mut self, work: impl FnOnce() -> T) -> T {
        set::<EXTENDED_US>();
        let result = work();
        set::<TIMEOUT_US>();
        result
    }
}

/// Starts the independent watchdog if it does not run, and sets its time, which begins anew.
fn set<const TIMEOUT_US: u32>() -> Driver {
    // SAFETY: only this module uses the peripheral, and the callers' ends are in one executor.
    let peripheral = unsafe { peripherals::IWDG::steal() };
    let mut watchdog = Driver::new(peripheral, TIMEOUT_US);
    watchdog.unleash();
    // The driver does not wait, and a feed before the time is taken over would begin the former time.
    let busy = || {
        let status = pac::IWDG.sr().read();
        status.pvu() || status.rvu()
    };
    if (0..STATUS_LOOKS).all(|_| busy()) {
        fault::watchdog_missing("independent");
    }
    watchdog.pet();
    watchdog
}

/// Time of the window watchdog, µs: all of its 64 counts of 4096 cycles of APB1.
const WINDOW_TIMEOUT_US: u32 = 6_241;

/// Window watchdog of the current loop, without a window. The HAL waits between the clock's enable and the first write,
/// which would be lost otherwise (errata sheet ES0182).
///
/// Only a reset stops it. An erase of the flash holds the core for longer, so a board with this watchdog
/// erases nothing.
pub struct WindowWatchdog(wdg::WindowWatchdog<'static, peripherals::WWDG>);

impl WindowWatchdog {
    /// Starts it.
    pub fn start(peripheral: Peri<'static, peripherals::WWDG>) -> Self {
        let watchdog = wdg::WindowWatchdog::new(peripheral, WINDOW_TIMEOUT_US, 0);
        if !WWDG.cr().read().wdga() {
            fault::watchdog_missing("window");
        }
        Self(watchdog)
    }

    /// Begins its time anew.
    pub fn feed(&mut self) {
        self.0.pet();
    }
}
