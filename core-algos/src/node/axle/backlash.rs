//! Backlash of the gears: when the torque of a wheel reverses, its gear crosses a gap, and the encoder counts motion
//! that the wheel does not make.
//!
//! Between two reversals the gear stays on one flank and the encoder is exact. So the error is no noise of every
//! tick: its variance is added where the commanded torque reverses.

use crate::math::matrix::Mat3;
use crate::time::TICK;

/// Gap at the rim of a wheel, one standard deviation, m: 0.24° of a wheel with a radius of 73 mm.
const GAP_M: f32 = 3e-4;
/// Magnitude of the low-passed torque (3 ms) above which the gear moves through its gap to a flank, N m.
const PUSH_NM: f32 = 0.01;
const LAG_GAIN: f32 = TICK as f32 / 3e3;
/// Share of the gap that is crossed in a tick: 30 ms for the whole gap.
const CROSSED: f32 = TICK as f32 / 30e3;

/// The gap of one gear.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Backlash {
    torque: f32,
    /// Position in the gap, from -0.5 (the flank that drives backward) to 0.5; 0 if unknown.
    flank: f32,
    /// Distance crossed in the gap since the last [`Self::take_variance`], as a share of the gap.
    crossed: f32,
}

impl Backlash {
    /// Runs one tick with the commanded torque of the wheel, N m.
    pub(super) fn step(&mut self, torque_nm: f32) {
        self.torque += (torque_nm - self.torque) * LAG_GAIN;
        if self.torque.abs() > PUSH_NM {
            let moved = (0.5f32.copysign(self.torque) - self.flank).clamp(-CROSSED, CROSSED);
            self.flank += moved;
            self.crossed += moved.abs();
        }
    }

    /// Variance of the encoder's travel due to backlash since the last call, m².
    pub(super) fn take_variance(&mut self) -> f32 {
        GAP_M * GAP_M * core::mem::take(&mut self.crossed)
    }
}

/// Adds the variances of the travel of left and right wheel (m²) to the covariance of an axle's increment.
/// `share` of the heading comes from the wheels, the rest from a gyro.
pub(super) fn add(
    mut covariance: Mat3,
    [left, right]: [f32; 2],
    half_track: f32,
    share: f32,
) -> Mat3 {
    let inverse = 0.5 / half_track;
    let turning = share * inverse * (right - left) * 0.5;
    covariance[0][0] += 0.25 * (left + right);
    covariance[0][2] += turning;
    covariance[2][0] += turning;
    covariance[2][2] += share * share * inverse * inverse * (left + right);
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reversal_adds_the_variance_of_the_gap_and_a_push_to_the_same_side_none() {
        let mut backlash = Backlash::default();
        let mut run = |torque: f32, ticks: u32| {
            (0..ticks).for_each(|_| backlash.step(torque));
            backlash.take_variance() / (GAP_M * GAP_M)
        };
        // The gear moves from the middle to a flank, because its position is unknown at the start.
        assert!((run(0.1, 60) - 0.5).abs() < 1e-5);
        assert_eq!(run(0.4, 500), 0.0);
        assert_eq!(run(0.0, 500), 0.0);
        assert!((run(-0.1, 60) - 1.0).abs() < 1e-5);
        // A torque that swings faster than the gear crosses its gap leaves it on its flank.
        assert_eq!(run(0.005, 500), 0.0);
    }

    /// Reference: sum over both wheels of the effect of each wheel's error on advance and heading.
    #[test]
    fn added_covariance_is_that_of_independent_errors_of_both_wheels() {
        let (half_track, share, travels) = (0.162, 0.7, [2e-4f32, 5e-4]);
        let mut sums = [0.0f32; 3];
        for (k, travel) in travels.into_iter().enumerate() {
            // Errors of the two wheels are independent.
            let (left, right) = if k == 0 { (travel, 0.0) } else { (0.0, travel) };
            let (ahead, turned) = (
                0.5 * (left + right),
                share * (right - left) / (2.0 * half_track),
            );
            sums[0] += ahead * ahead;
            sums[1] += ahead * turned;
            sums[2] += turned * turned;
        }
        let added = add(
            [[0.0; 3]; 3],
            travels.map(|travel| travel * travel),
            half_track,
            share,
        );
        for (found, expected) in [
            (added[0][0], sums[0]),
            (added[0][2], sums[1]),
            (added[2][0], sums[1]),
            (added[2][2], sums[2]),
        ] {
            assert!(
                (found - expected).abs() < 1e-6 * sums[2],
                "{found:e} {expected:e}"
            );
        }
    }
}
