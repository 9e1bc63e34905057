//! Start of a board: supply, crystal, clocks, cause of the reset.

use embassy_stm32::pac::{DBGMCU, RCC};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource,
    Sysclk,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals};

use crate::{accelerator, can, critical, crystal, fault, stack, supply, time_driver};

/// Starts the board and returns its peripherals; call it once, first. `build` names the image and is the first line
/// of the log.
///
/// The core and AHB run at 168 MHz from the crystal through the PLL, APB1 at 42 MHz, APB2 at 84 MHz; the 48 MHz for
/// USB are unused. Prefetch, caches and the crystal's clock security are on. The guard below the stack is set first;
/// then supply and crystal are checked. At the end the clock of `embassy-time` runs, and the log shows the cause of
/// the reset and the faults since power-on.
pub fn start(build: &str) -> Peripherals {
    stack::guard();
    stop_with_core();
    supply::wait();
    crystal::check();

    let mut config = Config::default();
    config.rcc.hse = Some(Hse {
        freq: Hertz(8_000_000),
        mode: HseMode::Oscillator,
    });
    config.rcc.pll_src = PllSource::HSE;
    // 8 MHz / 4 · 168 = 336 MHz in the oscillator; /2 for the core, /7 for USB.
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    // The HAL resets the voltage detector, so the clock is raised only after the detector is set up again.
    let mut rcc = config.rcc;
    let mut peripherals = embassy_stm32::init(config);
    critical::set_up();
    supply::watch();
    rcc.sys = Sysclk::PLL1_P;
    embassy_stm32::rcc::reinit(rcc, &mut peripherals.RCC);
    accelerator::enable();
    // If the crystal stopped, the core would have no clock and the timers would hold their outputs. With the clock
    // security system a stopped crystal is a fault ([`fault`]) and a break of TIM1, and the core runs on the internal
    // oscillator.
    RCC.cr().modify(|w| w.set_csson(true));
    defmt::info!("{=str}", build);
    supply::log();
    let clocks = embassy_stm32::rcc::clocks(&peripherals.RCC);
    defmt::info!(
        "core at {} Hz",
        clocks.sys.to_hertz().map_or(0, |rate| rate.0)
    );

    time_driver::start();
    let cause = ResetCause::take();
    let by_watchdog = matches!(cause, ResetCause::Watchdog | ResetCause::WindowWatchdog);
    let (faults, message) = fault::begin(cause == ResetCause::PowerOn, by_watchdog);
    defmt::info!("reset by {}, {}", cause, faults);
    if let Some(text) = message.as_str().filter(|text| !text.is_empty()) {
        defmt::error!("before the reset: {}", text);
    }
    peripherals
}

/// Logs the health of bus and stack and the counts of faults.
pub fn log() {
    defmt::info!(
        "bus off {}, {}; {}; {}",
        can::is_off(),
        can::counters(),
        stack::high_water(),
        fault::counts()
    );
}

/// Stops the watchdogs and TIM1 while a debugger halts the core. A stopped TIM1 switches its outputs off (RM0090,
/// 38.16.2); if it kept running, the motors would keep their last duty cycle.
fn stop_with_core() {
    DBGMCU.apb1fzr().modify(|w| {
        w.set_iwdg(true);
        w.set_wwdg(true);
    });
    DBGMCU.apb2fzr().modify(|w| w.set_tim1(true));
}

/// Cause of the latest reset, from the reset flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum ResetCause {
    /// Power came on, or sagged below the brown-out level of the option bytes.
    PowerOn,
    /// The independent watchdog was not fed.
    Watchdog,
    /// The window watchdog was not fed: the current loop stopped.
    WindowWatchdog,
    /// Software reset, after a fault or on command.
    Software,
    /// Reset pin, which a debug probe also drives.
    Pin,
    /// None of the flags is set.
    Unknown,
}

impl ResetCause {
    /// Reads the cause from the reset flags, then clears the flags.
    fn take() -> Self {
        let flags = RCC.csr().read();
        RCC.csr().modify(|w| w.set_rmvf(true));
        // Every reset also sets the pin's flag, so that flag is checked last.
        if flags.porrstf() || flags.borrstf() {
            Self::PowerOn
        } else if flags.wwdgrstf() {
            Self::WindowWatchdog
        } else if flags.wdgrstf() {
            Self::Watchdog
        } else if flags.sftrstf() {
            Self::Software
        } else if flags.padrstf() {
            Self::Pin
        } else {
            Self::Unknown
        }
    }
}
