//! Watchdogs: they reset the board if the work that feeds them stops.
//!
//! The window watchdog waits for the current loop, 6 ms at most, and the independent one for all tasks. The
//! independent one is started before anything else, by its registers alone (RM0090, 21.3): the crystal, for which
//! the start of the clocks waits without limit, is the first that may never come. Its oscillator
//! starts with it.

use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::pac::{IWDG, RCC, WWDG};

/// Time without feeding after which the board is reset, µs; its clock is good to ±45 %.
pub const TIMEOUT_US: u32 = 500_000;

/// Time that the start of a board may take, µs. It takes some 40 ms, or a second where the flash does
/// not take the option bytes.
const START_US: u32 = 2_000_000;

/// A started watchdog; it cannot be stopped.
pub struct Watchdog(());

impl Watchdog {
    /// Starts it, with time for the start of the board; call it once, first. [`Self::shorten`] ends
    /// that time.
    pub fn start() -> Self {
        IWDG.kr().write(|w| w.set_key(Key::START));
        let mut watchdog = Self(());
        // 32 kHz / 64: two milliseconds a count.
        watchdog.set(Pr::DIVIDE_BY64, (START_US / 2_000) as u16);
        watchdog
    }

    /// Feeds it and gives the next piece of work half a minute: an erase of the flash holds the core
    /// for up to two seconds. [`Self::feed`] alone does not take that back, [`Self::shorten`] does.
    pub fn lengthen(&mut self) {
        self.set(Pr::DIVIDE_BY256, 0xfff);
    }

    /// Feeds it; from here on its time is [`TIMEOUT_US`].
    pub fn shorten(&mut self) {
        // 32 kHz / 16: half a millisecond a count.
        self.set(Pr::DIVIDE_BY16, (TIMEOUT_US / 500) as u16);
    }

    fn set(&mut self, prescaler: Pr, reload: u16) {
        self.feed();
        IWDG.kr().write(|w| w.set_key(Key::ENABLE));
        IWDG.pr().write(|w| w.set_pr(prescaler));
        IWDG.rlr().write(|w| w.set_rl(reload));
        // Taken over within five periods of its clock; a missing oscillator must not hang the board.
        for _ in 0..100_000 {
            let busy = IWDG.sr().read();
            if !(busy.pvu() || busy.rvu()) {
                break;
            }
        }
        self.feed();
    }

    /// Begins the time anew. To be called where the board's work is known to go on, not by a timer.
    pub fn feed(&mut self) {
        IWDG.kr().write(|w| w.set_key(Key::RESET));
    }
}

/// Window watchdog of the current loop, without a window: 64 counts of 4096 cycles of APB1, 6.2 ms at 42 MHz.
///
/// Only a reset stops it. An erase of the flash holds the core for longer, so a board with this watchdog
/// erases nothing.
pub struct WindowWatchdog(());

impl WindowWatchdog {
    /// Starts it.
    pub fn start() -> Self {
        RCC.apb1enr().modify(|w| w.set_wwdgen(true));
        WWDG.cr().write(|w| {
            w.set_wdga(true);
            w.set_t(0x7f);
        });
        Self(())
    }

    /// Begins its time anew.
    pub fn feed(&mut self) {
        WWDG.cr().write(|w| w.set_t(0x7f));
    }

    /// Begins its time anew if it was started, for the wait after a fault.
    pub(crate) fn feed_after_fault() {
        if RCC.apb1enr().read().wwdgen() {
            Self(()).feed();
        }
    }
}
