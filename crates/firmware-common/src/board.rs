//! Start of a board: supply, crystal, clocks, cause of the reset.

use embassy_stm32::pac::{DBGMCU, RCC};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource,
    Sysclk,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals};

use crate::{accelerator, can, critical, crystal, fault, stack, supply, time_driver};

/// Brings the board up and gives its peripherals; call it once, first. `build` names the image: the first
/// line of the log.
///
/// Core at 168 MHz from the crystal through the PLL, AHB at the same, APB1 at 42 MHz, APB2 at
/// 84 MHz, 48 MHz for USB unused; prefetch and caches of the flash on, the crystal watched. Below the
/// stack is a guard before anything else is done; then supply and crystal are checked. At the end the clock of
/// `embassy-time` runs, and the log says why the board was reset and which faults it had since power came on.
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
    // The HAL resets the voltage detector: the clock is raised when the supply is watched again.
    let mut rcc = config.rcc;
    let mut peripherals = embassy_stm32::init(config);
    critical::set_up();
    supply::watch();
    rcc.sys = Sysclk::PLL1_P;
    embassy_stm32::rcc::reinit(rcc, &mut peripherals.RCC);
    accelerator::enable();
    // A crystal that stops would leave the core without a clock and the timers as they stand. Now
    // it is a fault ([`fault`]) and a break of TIM1, on the internal oscillator.
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

/// Logs the health of bus, stack and program.
pub fn log() {
    defmt::info!(
        "bus off {}, {}; {}; {}",
        can::is_off(),
        can::counters(),
        stack::high_water(),
        fault::counts()
    );
}

/// A debugger that halts the core stops the watchdogs and TIM1 with it, and the outputs of a stopped TIM1
/// are off (RM0090, 38.16.2): without that the motors would go on with their last duty.
fn stop_with_core() {
    DBGMCU.apb1fzr().modify(|w| {
        w.set_iwdg(true);
        w.set_wwdg(true);
    });
    DBGMCU.apb2fzr().modify(|w| w.set_tim1(true));
}

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum ResetCause {
    /// Power came on, or sagged below the brown-out level of the option bytes.
    PowerOn,
    /// The independent watchdog was not fed.
    Watchdog,
    /// The window watchdog was not fed: the current loop stood still.
    WindowWatchdog,
    /// The program asked for it, after a fault or on command.
    Software,
    /// The reset pin, which a debug probe drives too.
    Pin,
    /// None of the flags is set.
    Unknown,
}

impl ResetCause {
    /// Reads the flags and clears them.
    fn take() -> Self {
        let flags = RCC.csr().read();
        RCC.csr().modify(|w| w.set_rmvf(true));
        // The pin's flag accompanies all others, so it comes last.
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
