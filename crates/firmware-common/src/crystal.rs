//! Frequency of the crystal, measured against the internal oscillator before the core runs on it.
//!
//! A crystal of a wrong frequency would scale every time constant, and the board could not receive on the bus. TIM11
//! counts the internal oscillator, 16 MHz, between edges of the divided crystal (RM0090, 19.5.11). The internal
//! oscillator is accurate to −8 and +4.5 % over all temperatures, and to 1 % at 25 °C (data sheet).

use embassy_stm32::pac::gpio::vals::Moder;
use embassy_stm32::pac::timer::vals::CcmrInputCcs;
use embassy_stm32::pac::{GPIOC, RCC, TIM11};

/// Nominal frequency of the crystal, Hz.
const HZ: u32 = 8_000_000;
/// Frequency of the internal oscillator, Hz.
const INTERNAL_HZ: u32 = 16_000_000;
/// Largest allowed deviation from the nominal frequency, %.
const TOLERANCE: u32 = 9;
/// Divider of the crystal's frequency before the timer, and number of edges per capture.
const DIVIDER: u32 = 31;
const EDGES: u32 = 8;
/// Captures per measurement. The counter overflows after 4 ms, so two captures must be less than 4 ms apart.
const CAPTURES: u32 = 32;
/// Polls until a flag counts as missing, about 10 cycles each: 0.1 s for the crystal's start, 1 ms for a capture.
const START_POLLS: u32 = 160_000;
const CAPTURE_POLLS: u32 = 1_600;
/// Value of TIM11's option register that connects the divided crystal to the timer.
const HSE_RTC: u32 = 2;
/// Half a blink period as turns of a three-cycle delay; the LED flashes 20 times a second.
const BLINK: u32 = INTERNAL_HZ / 3 / 40;
/// Blinks between two measurements.
const BLINKS: u32 = 8;

/// Returns once the crystal has its nominal frequency. Until then the LED blinks, and the watchdog resets the board
/// after two seconds.
pub(crate) fn check() {
    loop {
        let found = start().and_then(|()| measure());
        if found.is_some_and(|hz| hz.abs_diff(HZ) <= HZ / 100 * TOLERANCE) {
            return;
        }
        defmt::error!("crystal: {} Hz, must be {} Hz", found, HZ);
        RCC.ahb1enr().modify(|w| w.set_gpiocen(true));
        // The port's clock starts a few cycles after it is enabled (ES0182).
        cortex_m::asm::dsb();
        GPIOC.moder().modify(|w| w.set_moder(12, Moder::OUTPUT));
        for _ in 0..BLINKS {
            GPIOC.bsrr().write(|w| w.set_br(12, true));
            cortex_m::asm::delay(BLINK);
            GPIOC.bsrr().write(|w| w.set_bs(12, true));
            cortex_m::asm::delay(BLINK);
        }
    }
}

/// Switches the crystal on; `None` if it does not start within 0.1 s.
fn start() -> Option<()> {
    RCC.cr().modify(|w| w.set_hseon(true));
    (0..START_POLLS)
        .find(|_| RCC.cr().read().hserdy())
        .map(drop)
}

/// Frequency of the crystal, Hz; `None` if an edge is missing for 1 ms.
fn measure() -> Option<u32> {
    RCC.cfgr().modify(|w| w.set_rtcpre(DIVIDER as u8));
    RCC.apb2enr().modify(|w| w.set_tim11en(true));
    cortex_m::asm::dsb();
    RCC.apb2rstr().modify(|w| w.set_tim11rst(true));
    RCC.apb2rstr().modify(|w| w.set_tim11rst(false));
    TIM11.or().write_value(HSE_RTC);
    TIM11.ccmr_input(0).write(|w| {
        w.set_ccs(0, CcmrInputCcs::TI4);
        w.set_icpsc(0, 3);
    });
    TIM11.ccer().write(|w| w.set_cce(0, true));
    TIM11.cr1().write(|w| w.set_cen(true));
    let mut last = capture()?;
    let mut counts = 0;
    for _ in 0..CAPTURES {
        let next = capture()?;
        counts += u32::from(next.wrapping_sub(last));
        last = next;
    }
    RCC.apb2rstr().modify(|w| w.set_tim11rst(true));
    RCC.apb2rstr().modify(|w| w.set_tim11rst(false));
    RCC.apb2enr().modify(|w| w.set_tim11en(false));
    let edges = u64::from(DIVIDER * EDGES * CAPTURES);
    let hz = u64::from(INTERNAL_HZ) * edges / u64::from(counts.max(1));
    Some(hz.min(u32::MAX.into()) as u32)
}

/// Counter value at the next capture; `None` after 1 ms.
fn capture() -> Option<u16> {
    (0..CAPTURE_POLLS).find(|_| TIM11.sr().read().ccif(0))?;
    Some(TIM11.ccr(0).read().ccr())
}
