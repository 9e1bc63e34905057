//! Speed of the leading axle: acceleration, braking ahead of stops, wheel speeds.
//!
//! | limit | law |
//! |---|---|
//! | stop at the distance d | v² = 2 a d − (a τ)²; below v = a τ: v = d/τ |
//! | acceleration | the configured limit, fading as the speed reaches its target |
//! | deceleration | the stop deceleration |
//! | wheels | the outer wheel of no axle runs faster than its limit: v (1 + d κ) r, with r the axle's speed over the leader's |
//!
//! The speed ends at zero exactly at the stop.
//!
//! # Panic contract
//!
//! Nothing can fail; a wish or a distance that is not a number brakes.

use crate::math::trig::sqrt;
use crate::math::{greater, lesser};
use crate::time::EPOCH_S;

/// Distance from a stop at which the robot stands, m.
const ARRIVED_M: f32 = 1e-4;
/// Share of the largest acceleration that remains as the speed reaches its target.
const FINAL_RAMP: f32 = 0.05;

/// Limits of the speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed, m/s.
    pub speed: f32,
    /// Largest acceleration, also the deceleration ahead of stops, m/s².
    pub acceleration: f32,
    /// Largest deceleration, m/s².
    pub deceleration: f32,
    /// Time constant τ of the end of a stop and of the end of an acceleration, s.
    pub lag: f32,
    /// Largest speed of a wheel over ground, m/s.
    pub wheel: f32,
    /// Half the track of an axle, m.
    pub half_track: f32,
}

/// Speed along the direction of travel, m/s, and its rate, m/s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Speed, not negative.
    pub v: f32,
    /// Rate of the speed in the last step.
    pub rate: f32,
}

impl Limits {
    /// Speed (m/s) from which the robot stops within `distance` (m).
    pub fn braking(&self, distance: f32) -> f32 {
        let joint = self.acceleration * self.lag;
        if distance > joint * self.lag {
            sqrt(2.0 * self.acceleration * distance - joint * joint)
        } else {
            greater(distance, 0.0) / self.lag
        }
    }

    /// Speed of the leader (m/s) at which the outer wheel of an axle on the curvature `kappa` (1/m) reaches its limit.
    /// The axle drives `ratio` times as fast as the leader.
    pub fn by_wheels(&self, kappa: f32, ratio: f32) -> f32 {
        self.wheel / (ratio * (1.0 + self.half_track * kappa.abs()))
    }

    /// Distance (m) driven in an epoch at the wish `wanted` (m/s), with a stop after `distance` (m).
    pub fn step(&self, motion: &mut Motion, wanted: f32, distance: f32) -> f32 {
        if !(distance > ARRIVED_M) {
            let left = greater(distance, 0.0);
            if motion.v <= 2.0 * ARRIVED_M / self.lag + self.deceleration * EPOCH_S {
                *motion = Motion::default();
                return left;
            }
        }
        let next = distance - motion.v * EPOCH_S;
        // Zero for a wish that is not a number.
        let wanted = greater(wanted, 0.0);
        let target = lesser(lesser(wanted, self.speed), self.braking(next));
        let missing = target - motion.v;
        let up = lesser(
            self.acceleration,
            missing / self.lag + FINAL_RAMP * self.acceleration,
        );
        let rate = greater(lesser(missing / EPOCH_S, up), -self.deceleration);
        let v = greater(motion.v + rate * EPOCH_S, 0.0);
        let driven = lesser(0.5 * (motion.v + v) * EPOCH_S, greater(distance, 0.0));
        *motion = Motion { v, rate };
        driven
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        speed: 0.2,
        acceleration: 0.4,
        deceleration: 0.8,
        lag: 1.0 / 6.0,
        wheel: 0.6,
        half_track: 0.162,
    };

    #[test]
    fn robot_stops_exactly_at_the_end_within_its_limits() {
        for way in [0.003f32, 0.02, 0.1, 1.0, 3.7] {
            let (mut motion, mut left, mut time) = (Motion::default(), way, 0.0f32);
            while left > 0.0 || motion.v > 0.0 {
                let before = motion.v;
                let latest = LIMITS.braking(left);
                left -= LIMITS.step(&mut motion, 1.0, left);
                let rate = (motion.v - before) / EPOCH_S;
                // The robot brakes at the last moment.
                assert!(
                    rate >= 0.0 || left < 1e-4 || motion.v > 0.93 * latest,
                    "{motion:?} {latest}"
                );
                // The deceleration ahead of a stop is the acceleration, but for the last 0.1 mm.
                let least = if motion.v > 0.0 { -0.42 } else { -0.801 };
                assert!(motion.v <= 0.2 && (least..=0.401).contains(&rate), "{rate}");
                time += EPOCH_S;
                assert!(time < 30.0, "{way}: {left} left");
            }
            assert_eq!((left, motion), (0.0, Motion::default()), "{way}");
            // A trapezoid of 0.4 m/s², and the end of the lag.
            let least = way / 0.2 + 0.2 / 0.4;
            assert!(time < least + 1.4, "{way}: {time}");
        }
    }

    #[test]
    fn wish_of_zero_or_nan_brakes_at_the_stop_deceleration() {
        for wish in [0.0, f32::NAN] {
            let mut motion = Motion { v: 0.2, rate: 0.0 };
            let mut way = 0.0;
            for _ in 0..25 {
                way += LIMITS.step(&mut motion, wish, f32::INFINITY);
            }
            assert!(motion.v < 1e-6, "{wish}");
            assert!((way - 0.025).abs() < 1e-4);
        }
    }

    /// The end of a path that comes nearer than the robot can stop is overrun, not stopped at once.
    #[test]
    fn robot_at_the_end_brakes_at_the_stop_deceleration() {
        let mut motion = Motion { v: 0.03, rate: 0.0 };
        let mut before = motion.v;
        while motion.v > 0.0 {
            LIMITS.step(&mut motion, 0.2, 0.0);
            assert!(before - motion.v < 0.8 * EPOCH_S + 2e-3, "{motion:?}");
            before = motion.v;
        }
    }

    #[test]
    fn outer_wheel_keeps_its_limit() {
        let v = LIMITS.by_wheels(-2.0, 1.1);
        assert!((1.1 * v * (1.0 + 0.162 * 2.0) - 0.6).abs() < 1e-6);
    }
}
