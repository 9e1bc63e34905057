//! Independent watchdog: resets the board if the work that feeds it stops.

use embassy_stm32::Peri;
use embassy_stm32::pac::IWDG as IWDG_REGISTERS;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
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

    /// Feeds it and gives the next piece of work half a minute: an erase of the flash holds the core
    /// for up to two seconds. [`Self::feed`] alone does not take that back, [`Self::shorten`] does.
    pub fn lengthen(&mut self) {
        self.set(Pr::DIVIDE_BY256, 0xfff);
    }

    /// Back to [`TIMEOUT_US`].
    pub fn shorten(&mut self) {
        // 32 kHz / 16: half a millisecond a count.
        self.set(Pr::DIVIDE_BY16, (TIMEOUT_US / 500) as u16);
    }

    fn set(&mut self, prescaler: Pr, reload: u16) {
        self.feed();
        IWDG_REGISTERS.kr().write(|w| w.set_key(Key::ENABLE));
        IWDG_REGISTERS.pr().write(|w| w.set_pr(prescaler));
        IWDG_REGISTERS.rlr().write(|w| w.set_rl(reload));
        // Taken over within five periods of its clock; a missing oscillator must not hang the board.
        for _ in 0..100_000 {
            let busy = IWDG_REGISTERS.sr().read();
            if !(busy.pvu() || busy.rvu()) {
                break;
            }
        }
        self.feed();
    }

    /// Begins the time anew. To be called where the board's work is known to go on, not by a timer.
    pub fn feed(&mut self) {
        self.0.pet();
    }
}
