//! Both wheel encoders: TIM3 and TIM4 count every edge, in hardware.
//!
//! The encoder inputs are next to bridges that switch at 20 kHz. The input filter accepts a level after eight equal
//! samples at 84 MHz/32, so a pulse below 2.7 µs never counts and a pulse above 3.1 µs always counts. At 20 rad/s and
//! 8192 counts per turn a level lasts for two counts, 77 µs, and the edges of both channels are 38 µs apart: 25 and 12
//! times the delay of the filter. Both channels have the same delay.

use core_algos::drive::count::Extended;
use core_algos::topology::Wheels;
use embassy_stm32::Peri;
use embassy_stm32::gpio::Pull;
use embassy_stm32::pac;
use embassy_stm32::pac::timer::vals::FilterValue;
use embassy_stm32::peripherals::{PB6, PB7, PC6, PC7, TIM3, TIM4};
use embassy_stm32::timer::qei::{self, Qei, QeiMode};
use embassy_time::{Duration, block_for};

/// Time longer than the delay of the filter.
const FILTERED: Duration = Duration::from_micros(10);

/// The encoders (left, right).
pub struct Encoders {
    left: Qei<'static, TIM3>,
    right: Qei<'static, TIM4>,
    counts: [Extended; 2],
}

impl Encoders {
    /// Starts counting at zero.
    pub fn start(
        left: (Peri<'static, TIM3>, Peri<'static, PC6>, Peri<'static, PC7>),
        right: (Peri<'static, TIM4>, Peri<'static, PB6>, Peri<'static, PB7>),
    ) -> Self {
        // Encoders with open collectors need the pull-ups; push-pull encoders also work with pull-ups.
        let mut config = qei::Config::default();
        config.mode = QeiMode::Mode3;
        config.ch1_pull = Pull::Up;
        config.ch2_pull = Pull::Up;
        let (left, right) = (
            Qei::new(left.0, left.1, left.2, config),
            Qei::new(right.0, right.1, right.2, config),
        );
        // The filter is set by registers, because the HAL's driver has no setting for it.
        for timer in [pac::TIM3, pac::TIM4] {
            timer.ccmr_input(0).modify(|w| {
                for channel in 0..2 {
                    w.set_icf(channel, FilterValue::FDTS_DIV32_N8);
                }
            });
        }
        block_for(FILTERED);
        let counts = [
            Extended::starting_at(left.count()),
            Extended::starting_at(right.count()),
        ];
        Self {
            left,
            right,
            counts,
        }
    }

    /// Encoder counts, forward positive. The right count is negated, because the right encoder is mounted mirrored.
    pub fn read(&mut self) -> Wheels<i32> {
        let [left, right] = &mut self.counts;
        Wheels {
            left: left.step(self.left.count()),
            right: right.step(self.right.count()).wrapping_neg(),
        }
    }
}
