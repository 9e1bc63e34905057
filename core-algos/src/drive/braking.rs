//! Braking until standstill after the motors were switched off.
//!
//! A driver that is awake with its enable pin low shorts its motor, which brakes. Asleep, the driver leaves the motor
//! open, and the robot rolls on. So the drivers stay awake until both wheels stand still. A shorted motor that turns
//! has a current, so standstill is detected even if the tick has failed.
//!
//! Nothing here can fail; NaN counts as motion.

/// Limits of standstill.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Limit of a motor's mean current, A. Up to this current the shorted motor counts as standing still.
    pub current_a: f32,
    /// Limit of a wheel's speed, rad/s. Up to this speed the wheel counts as standing still.
    pub speed_rad_s: f32,
    /// Successive PWM periods for which current and speed must be within their limits.
    pub periods: u16,
}

/// Standstill detector of both motors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Braking {
    limits: Limits,
    /// Low-passed currents, A; `None` before the first reading.
    mean_a: [Option<f32>; 2],
    still: u16,
}

/// Weight of a new reading in the mean. A single reading is not used alone, because its noise and its converter step
/// exceed the limit.
const SHARE: f32 = 1.0 / 64.0;

impl Braking {
    /// Detector before the first period.
    pub const fn new(limits: Limits) -> Self {
        Self {
            limits,
            mean_a: [None; 2],
            still: 0,
        }
    }

    /// Resets the detector; called while the motors are driven.
    pub fn reset(&mut self) {
        (self.mean_a, self.still) = ([None; 2], 0);
    }

    /// Runs one period of braking with the currents (A; `None` if a reading is at a rail) and the latest known wheel
    /// speeds (rad/s); true once both wheels have stood still for the required periods.
    pub fn step(&mut self, current_a: [Option<f32>; 2], speed_rad_s: [f32; 2]) -> bool {
        let Limits {
            current_a: current,
            speed_rad_s: speed,
            periods,
        } = self.limits;
        for (mean, reading) in self.mean_a.iter_mut().zip(current_a) {
            *mean = match (*mean, reading) {
                (Some(mean), Some(reading)) if mean.is_finite() => {
                    Some(mean + SHARE * (reading - mean))
                }
                (_, reading) => reading,
            };
        }
        let without_current = |i: Option<f32>| i.is_some_and(|i| i.abs() <= current);
        let still = self.mean_a.into_iter().all(without_current)
            && speed_rad_s.into_iter().all(|w| w.abs() <= speed);
        self.still = if still {
            self.still.saturating_add(1)
        } else {
            0
        };
        self.still >= periods
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        current_a: 0.02,
        speed_rad_s: 0.1,
        periods: 100,
    };

    /// Periods until standstill with constant readings.
    fn periods(current_a: [Option<f32>; 2], speed_rad_s: [f32; 2]) -> Option<usize> {
        let mut braking = Braking::new(LIMITS);
        (1..=10_000).find(|_| braking.step(current_a, speed_rad_s))
    }

    #[test]
    fn standstill_needs_both_currents_and_both_speeds_for_the_whole_time() {
        let (none, rest) = ([Some(0.0); 2], [0.0; 2]);
        assert_eq!(periods(none, rest), Some(100));
        assert_eq!(periods([Some(-0.02), Some(0.02)], [0.1, -0.1]), Some(100));
        for i in 0..2 {
            for moving in [Some(0.021), Some(-0.021), Some(f32::NAN), None] {
                let mut current = none;
                current[i] = moving;
                assert_eq!(periods(current, rest), None, "{moving:?}");
            }
            for moving in [0.11, -0.11, f32::NAN] {
                let mut speed = rest;
                speed[i] = moving;
                assert_eq!(periods(none, speed), None, "{moving}");
            }
        }
    }

    #[test]
    fn noise_about_zero_is_standstill_and_about_a_current_is_not() {
        let periods = |offset: f32| {
            let mut braking = Braking::new(LIMITS);
            (1..=10_000).find(|k| {
                let noise = 0.03 * ((k * 7919 % 101) as f32 / 50.0 - 1.0);
                braking.step([Some(noise), Some(offset - noise)], [0.0; 2])
            })
        };
        assert!(periods(0.0).is_some_and(|n| n < 500));
        assert_eq!(periods(0.03), None);
    }

    #[test]
    fn motion_in_one_period_or_reset_restarts_the_count() {
        let mut braking = Braking::new(LIMITS);
        let rest = |braking: &mut Braking, count: usize| {
            (0..count).any(|_| braking.step([Some(0.0); 2], [0.0; 2]))
        };
        assert!(!rest(&mut braking, 99));
        assert!(!braking.step([Some(3.0), Some(0.0)], [0.0; 2]));
        assert!(!rest(&mut braking, 99));
        braking.reset();
        assert!(!rest(&mut braking, 99));
        assert!(rest(&mut braking, 1));
        // NaN does not stay in the mean.
        assert!(!braking.step([Some(f32::NAN), Some(0.0)], [0.0; 2]));
        assert!(!rest(&mut braking, 99));
        assert!(rest(&mut braking, 1));
    }
}
