//! Both wheel encoders: TIM3 and TIM4 count every edge, in hardware.

use core_algos::drive::count::Extended;
use embassy_stm32::Peri;
use embassy_stm32::gpio::Pull;
use embassy_stm32::peripherals::{PB6, PB7, PC6, PC7, TIM3, TIM4};
use embassy_stm32::timer::qei::{self, Qei, QeiMode};

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
        // Encoders with open collectors need the pull-ups; they do the others no harm.
        let mut config = qei::Config::default();
        config.mode = QeiMode::Mode3;
        config.ch1_pull = Pull::Up;
        config.ch2_pull = Pull::Up;
        let (left, right) = (
            Qei::new(left.0, left.1, left.2, config),
            Qei::new(right.0, right.1, right.2, config),
        );
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

    /// Counts (left, right), forward positive: the right encoder is mounted the other way round.
    pub fn read(&mut self) -> [i32; 2] {
        let [left, right] = &mut self.counts;
        [
            left.step(self.left.count()),
            right.step(self.right.count()).wrapping_neg(),
        ]
    }
}
