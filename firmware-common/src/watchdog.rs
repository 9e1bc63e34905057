//! Independent watchdog: resets the board if the work that feeds it stops.

use embassy_stm32::Peri;
use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;

/// Time without feeding after which the board is reset, µs; its clock is good to ±45 %.
pub const TIMEOUT_US: u32 = 500_000;

/// A started watchdog; it cannot be stopped.
pub struct Watchdog(IndependentWatchdog<'static, IWDG>);

impl Watchdog {
    /// Starts it.
    pub fn start(peripheral: Peri<'static, IWDG>) -> Self {
        let mut watchdog = IndependentWatchdog::new(peripheral, TIMEOUT_US);
        watchdog.unleash();
        Self(watchdog)
    }

    /// Begins the time anew. To be called where the board's work is known to go on, not by a timer.
    pub fn feed(&mut self) {
        self.0.pet();
    }
}
