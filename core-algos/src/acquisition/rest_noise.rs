//! Noise of the strain bridges at rest: standard deviation of the readings over 10 s.
//!
//! For the bring-up of a board. Sums are integers, of differences from the first reading: no cancellation.

/// Number of readings in a window, one a millisecond.
pub const WINDOW: u16 = 10_000;

/// Sums of the window in progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RestNoise<const N: usize> {
    first: [i32; N],
    count: u16,
    sums: [i64; N],
    squares: [i64; N],
}

impl<const N: usize> Default for RestNoise<N> {
    fn default() -> Self {
        Self {
            first: [0; N],
            count: 0,
            sums: [0; N],
            squares: [0; N],
        }
    }
}

impl<const N: usize> RestNoise<N> {
    /// Takes one reading of each bridge. Returns the standard deviations, counts, at the end of a window.
    pub fn step(&mut self, counts: &[i32; N]) -> Option<[f32; N]> {
        if self.count == 0 {
            *self = Self {
                first: *counts,
                ..Self::default()
            };
        }
        self.count += 1;
        for (i, count) in counts.iter().enumerate() {
            // A count has at most 24 bits, and a window fewer than 2^14 readings: sums of squares stay below 2^63.
            let difference = i64::from(count.saturating_sub(self.first[i]));
            self.sums[i] += difference;
            self.squares[i] += difference * difference;
        }
        if self.count < WINDOW {
            return None;
        }
        let n = f32::from(self.count);
        self.count = 0;
        let deviation = |i: usize| {
            let (sum, square) = (i128::from(self.sums[i]), i128::from(self.squares[i]));
            let scatter = i128::from(WINDOW) * square - sum * sum;
            crate::math::trig::sqrt(scatter.max(0) as f32) / n
        };
        Some(core::array::from_fn(deviation))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_noise_of_a_window_is_the_deviation_in_double_precision() {
        let mut noise = RestNoise::default();
        for window in 0..3 {
            let reading = |k: u32| {
                let mut random = k.wrapping_add(77 * window).wrapping_mul(0x9e37_79b9);
                random ^= random >> 15;
                random = random.wrapping_mul(0x85eb_ca6b);
                (1_000_000 + random % 97) as i32
            };
            let readings: Vec<i32> = (0..u32::from(WINDOW)).map(reading).collect();
            let mean = readings.iter().map(|&c| f64::from(c)).sum::<f64>() / readings.len() as f64;
            let square = |&c: &i32| (f64::from(c) - mean).powi(2);
            let variance = readings.iter().map(square).sum::<f64>() / readings.len() as f64;
            let found = readings.iter().filter_map(|&c| noise.step(&[c; 2]));
            let found: Vec<_> = found.collect();
            assert_eq!(found.len(), 1);
            assert!((f64::from(found[0][0]) - variance.sqrt()).abs() < 1e-3);
        }
    }

    #[test]
    fn rest_noise_of_missing_conversions_and_full_scale_does_not_overflow() {
        let mut noise = RestNoise::default();
        let ends = (0..WINDOW).filter_map(|k| {
            let count = if k % 2 == 0 { -1 } else { (1 << 24) - 1 };
            noise.step(&[count; 2])
        });
        let found: Vec<_> = ends.collect();
        assert!((found[0][0] - f32::from(1u16 << 15) * 256.0).abs() < 10.0);
    }
}
