//! Gain and bias of a gyro from turns by known angles, each between two rests.

use host_sim::base::statistics::square;

/// Sum of gyro readings, rad/s, at a fixed interval.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sum {
    total: f64,
    count: f64,
}

impl Sum {
    /// Adds a reading, rad/s.
    pub fn add(&mut self, reading: f64) {
        self.total += reading;
        self.count += 1.0;
    }

    /// Mean of the readings, rad/s; 0 without a reading.
    pub fn mean(&self) -> f64 {
        self.total / self.count.max(1.0)
    }
}

/// Gyro readings of one turn by a known angle.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    /// Readings at rest before and after the turn.
    pub rests: [Sum; 2],
    /// Readings during the turn.
    pub turning: Sum,
    /// Known angle of the turn, rad.
    pub angle: f64,
}

impl Turn {
    /// Bias of the gyro, rad/s: mean of both rests.
    pub fn bias(&self) -> f64 {
        0.5 * (self.rests[0].mean() + self.rests[1].mean())
    }
}

/// Gain, true over measured rate, by least squares over the turns; `None` without a turn.
pub fn gain(turns: &[Turn], interval_s: f64) -> Option<f64> {
    let read = |turn: &Turn| (turn.turning.total - turn.bias() * turn.turning.count) * interval_s;
    let squares: f64 = turns.iter().map(|turn| square(read(turn))).sum();
    let product: f64 = turns.iter().map(|turn| read(turn) * turn.angle).sum();
    let gain = product / squares;
    (squares > 0.0 && gain.is_finite()).then_some(gain)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings of a gyro with scale `scale` and a bias that grows linearly from `bias`.
    fn turn(scale: f64, angle: f64, bias: f64, growth: f64) -> Turn {
        let mut sums = [Sum::default(); 3];
        for k in 0..12_000u32 {
            let part = (k / 4000) as usize;
            let rate = if part == 1 { angle / 4.0 } else { 0.0 };
            sums[part].add(scale * rate + bias + growth * f64::from(k) * 1e-3);
        }
        Turn {
            rests: [sums[0], sums[2]],
            turning: sums[1],
            angle,
        }
    }

    #[test]
    fn gain_is_independent_of_bias_and_linear_drift() {
        for scale in [0.99, 1.007] {
            let turns = [
                turn(scale, 18.0, 0.02, 1e-4),
                turn(scale, -18.0, -0.01, -2e-4),
            ];
            let found = gain(&turns, 1e-3).unwrap();
            assert!((found * scale - 1.0).abs() < 1e-9, "{found}");
        }
        assert_eq!(gain(&[], 1e-3), None);
        assert_eq!(gain(&[turn(1.0, 0.0, 0.0, 0.0)], 1e-3), None);
    }
}
