//! TIM1: pulses of both drivers, the break input of the emergency stop and the trigger of the
//! converter.
//!
//! The HAL's `ComplementaryPwm` is not used: it does not make OC4REF the trigger output (MMS of CR2).
//!
//! # Pulses
//!
//! The counter goes up and down between zero and [`TOP`], 168 MHz / (2 · 4200) = 20 kHz. An output is
//! high around zero: the middle of ON is the underflow, the middle of OFF the overflow. Both events update
//! the compare values and the top. So a new duty waits for 25 µs at most, and takes effect in the middle of
//! ON or OFF.
//!
//! # When the currents are sampled
//!
//! The first current is sampled during 1.33 µs from the trigger on, the second from 1.90 to 3.24 µs: 28 cycles of the
//! converter at 21 MHz each, 12 of conversion between them. An edge disturbs a reading until driver (propagation and
//! dead time, 1 µs) and amplifier have settled; an INA240 takes 9.6 µs to 0.5 % after a step of its common mode.
//! [`Sampling`] chooses the sampling instant. The time since the latest edge is at least 11.9 µs at equal duties or if
//! one motor has no pulses, and 5.5 µs at the worst pair of duties.
//!
//! The trigger is the reference signal of channel 4 (OC4REF) as TRGO. Unlike the converter's own input TIM1_CC4, OC4REF
//! does not depend on the outputs' enable. A stop must not end the conversions, because they generate the board's tick.
//!
//! # Emergency stop
//!
//! The contact's pin is the timer's break input, so that an open contact drives both outputs low (the drivers brake)
//! without software. The program then latches the stop; only [`Pwm::enable`] enables the outputs again. The break input
//! of this chip has no filter, so a pulse of nanoseconds stops the robot. This errs on the safe side, and the capacitor
//! at the pin (see the wiring) suppresses such pulses.

use core_algos::drive::sampling::{self, Sampling};
use embassy_stm32::gpio::{AfType, Flex, OutputType, Pull, Speed};
use embassy_stm32::pac::TIM1;
use embassy_stm32::pac::timer::vals::{Bkp, Cms, Mms, Ocm, Ossi};
use embassy_stm32::peripherals::{self, PA8, PA9, PB12};
use embassy_stm32::{Peri, rcc};

/// Top of the counter.
pub const TOP: u16 = sampling::AXLE.top;
/// Counts in a microsecond.
const COUNTS_PER_US: u16 = 168;
/// TIM1 is alternate function 1 on all of its pins.
const ALTERNATE: u8 = 1;
/// Index of the channel that triggers the conversions, channel 4.
const TRIGGER: usize = 3;

/// Sampling instants of the currents, see the module's documentation.
const SAMPLING: Sampling = match sampling::AXLE.build() {
    Some(sampling) => sampling,
    None => panic!("no sampling instant free of PWM edges"),
};

/// The timer; its outputs are low until they are enabled.
pub struct Pwm {
    _enable: [Flex<'static>; 2],
    stop: Flex<'static>,
    /// Compare values: the first starts the next conversions, the second started the previous conversions.
    trigger: (u16, u16),
}

impl Pwm {
    /// Sets up the timer, the enable pins (left, right) and the pin of the emergency stop. The counter does not run
    /// yet.
    pub fn new(
        _timer: Peri<'static, peripherals::TIM1>,
        enable: (Peri<'static, PA8>, Peri<'static, PA9>),
        stop: Peri<'static, PB12>,
    ) -> Self {
        let mut stop = Flex::new(stop);
        // `contact_open` can still read the level, because a pin's input also works in an alternate function.
        stop.set_as_af_unchecked(ALTERNATE, AfType::input(Pull::Up));
        let trigger = SAMPLING.compare([0; 2]);
        set_up(trigger);
        let mut enable = [Flex::new(enable.0), Flex::new(enable.1)];
        for pin in &mut enable {
            let push_pull = AfType::output(OutputType::PushPull, Speed::High);
            pin.set_as_af_unchecked(ALTERNATE, push_pull);
        }
        Self {
            _enable: enable,
            stop,
            trigger: (trigger, trigger),
        }
    }

    /// Starts the counter and with it the conversions.
    pub fn start() {
        TIM1.cr1().modify(|w| w.set_cen(true));
    }

    /// True if the contact of the emergency stop is open.
    pub fn contact_open(&self) -> bool {
        self.stop.is_high()
    }

    /// True if the break input switched the outputs off since they were enabled, even if the
    /// contact has closed again.
    pub fn broken(&self) -> bool {
        !TIM1.bdtr().read().moe()
    }

    /// Enables the outputs; has no effect while the contact is open.
    pub fn enable(&mut self) {
        // Writing 0 clears a flag. The break flag must be clear before the next break; no other flag is used.
        TIM1.sr().write(|_| ());
        TIM1.bdtr().modify(|w| w.set_moe(true));
    }

    /// Drives the outputs low, with only a register access.
    pub fn disable() {
        TIM1.bdtr().modify(|w| w.set_moe(false));
    }

    /// Sets the compare values (left, right), and with them the instant of the next conversions.
    pub fn set(&mut self, compares: [u16; 2]) {
        for (i, compare) in compares.into_iter().enumerate() {
            TIM1.ccr(i).write(|w| w.set_ccr(compare));
        }
        let trigger = SAMPLING.compare(compares);
        TIM1.ccr(TRIGGER).write(|w| w.set_ccr(trigger));
        self.trigger = (trigger, self.trigger.0);
    }

    /// Time from the beginning of the period to the conversions before the latest [`Pwm::set`], µs. It varies by 23 µs
    /// with the duties.
    pub fn phase_us(&self) -> u64 {
        u64::from(self.trigger.1 / COUNTS_PER_US)
    }

    /// Lengthens the next periods by `by` parts in 4200; negative values shorten them.
    pub fn trim(by: i8) {
        TIM1.arr()
            .write(|w| w.set_arr(TOP.wrapping_add_signed(by.into())));
    }
}

fn set_up(trigger: u16) {
    rcc::enable_and_reset::<peripherals::TIM1>();
    TIM1.arr().write(|w| w.set_arr(TOP));
    TIM1.ccmr_output(0).write(|w| {
        for channel in 0..2 {
            w.set_ocm(channel, Ocm::PWM_MODE1);
            w.set_ocpe(channel, true);
        }
    });
    // The trigger is high from the compare value on, so it rises on the way up.
    TIM1.ccmr_output(TRIGGER / 2).write(|w| {
        w.set_ocm(TRIGGER % 2, Ocm::PWM_MODE2);
        w.set_ocpe(TRIGGER % 2, true);
    });
    TIM1.ccr(TRIGGER).write(|w| w.set_ccr(trigger));
    TIM1.ccer().write(|w| {
        w.set_cce(0, true);
        w.set_cce(1, true);
    });
    TIM1.cr2().write(|w| {
        w.set_mms(Mms::COMPARE_OC4);
        // Disabled outputs are low, which brakes; the sleep pin lets the motors coast.
        for channel in 0..2 {
            w.set_ois(channel, false);
        }
    });
    TIM1.bdtr().write(|w| {
        // Disabled outputs are driven, not floating.
        w.set_ossi(Ossi::IDLE_LEVEL);
        // A high level disables the outputs, and only the program enables them again.
        w.set_bke(0, true);
        w.set_bkp(0, Bkp::ACTIVE_HIGH);
        w.set_aoe(false);
    });
    TIM1.cr1().write(|w| {
        w.set_cms(Cms::CENTER_ALIGNED1);
        w.set_arpe(true);
    });
    TIM1.egr().write(|w| w.set_ug(true));
}
