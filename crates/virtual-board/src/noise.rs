//! Random numbers of one device.

/// A small random number generator (SplitMix64; Steele, Lea and Flood 2014), with normal numbers derived from it.
///
/// A normal number is the sum of twelve uniform numbers minus its mean (Irwin–Hall). Variance: 1, except for rounding
/// to 16 bits. Range: six standard deviations. Excess kurtosis: −0.1. No transcendental function is needed, so the
/// numbers are bit-identical on all machines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Noise {
    state: u64,
}

impl Noise {
    /// Creates a generator. Different seeds, even adjacent ones, give unrelated sequences.
    pub fn new(seed: u64) -> Self {
        let mut noise = Self { state: seed };
        noise.state = noise.bits() ^ 0xd1b5_4a32_d192_ed03;
        noise
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform, from 0 to less than 1.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Normal, mean 0, variance 1.
    pub fn normal(&mut self) -> f64 {
        const LOW: u64 = 0x0000_ffff_0000_ffff;
        // The two halves of a 64-bit word add six 16-bit numbers each; neither half overflows.
        let pairs = (0..3).fold(0u64, |sum, _| {
            let bits = self.bits();
            sum + (bits & LOW) + (bits >> 16 & LOW)
        });
        let sum = (pairs & 0xffff_ffff) + (pairs >> 32);
        // Less the mean of the sum: a 16-bit number has the mean (2¹⁶ − 1)/2, and the sum has twelve.
        (sum as f64 - 6.0 * 65_535.0) * (1.0 / 65_536.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_the_moments_of_a_sum_of_twelve_uniform_numbers() {
        let mut noise = Noise::new(7);
        let n = 200_000;
        let (mut m1, mut m2, mut m4, mut lag) = (0.0, 0.0, 0.0, 0.0);
        let mut last = 0.0;
        for _ in 0..n {
            let x = noise.normal();
            assert!(x.abs() <= 6.0);
            m1 += x;
            m2 += x * x;
            m4 += x * x * x * x;
            lag += x * last;
            last = x;
        }
        let n = f64::from(n);
        assert!((m1 / n).abs() < 0.01, "{}", m1 / n);
        assert!((m2 / n - 1.0).abs() < 0.01, "{}", m2 / n);
        // Kurtosis of the sum of n uniform numbers: 3 − 6/(5 n).
        assert!((m4 / n - 2.9).abs() < 0.05, "{}", m4 / n);
        assert!((lag / n).abs() < 0.01, "{}", lag / n);
    }

    #[test]
    fn uniform_numbers_are_evenly_distributed() {
        let mut noise = Noise::new(1);
        let mut bins = [0u32; 16];
        for _ in 0..160_000 {
            bins[(noise.uniform() * 16.0) as usize] += 1;
        }
        // Chi-squared with 15 degrees of freedom exceeds 37.7 with probability 0.001.
        let chi: f64 = bins
            .iter()
            .map(|&b| (f64::from(b) - 1e4).powi(2) / 1e4)
            .sum();
        assert!(chi < 37.7, "{chi}");
    }

    #[test]
    fn adjacent_seeds_give_uncorrelated_numbers() {
        let (mut a, mut b) = (Noise::new(10), Noise::new(11));
        let sum: f64 = (0..10_000).map(|_| a.normal() * b.normal()).sum();
        assert!((sum / 10_000.0).abs() < 0.04, "{sum}");
    }
}
