//! Oversampling: many fast conversions of a 12-bit converter are summed to one reading with more bits.
//!
//! The sum of N conversions has a resolution of 12 + log₂ N bits. Its noise relative to its range is √N times lower
//! than that of one conversion, if a conversion has uncorrelated noise of at least half a count. A 12-bit converter
//! of 10.8 effective bits has 0.66 counts of noise; the sum of [`SCANS`] has 14.1 effective bits. The next limit is
//! the converter's non-linearity, which summing does not remove.
//!
//! Sums of bridges are ratiometric: the excitation is converted in the same scan, and each sum is scaled to the
//! nominal excitation. Supply drift cancels even if the bridges are not fed from the converter's reference. Nothing
//! here can fail.

/// Scans summed to one reading: 96 000 scans a second give one reading a millisecond.
pub const SCANS: usize = 96;
/// Largest sum of 12-bit conversions.
pub const FULL_SCALE: i32 = SCANS as i32 * 4095;

/// Sum of each of the `N` channels over all scans in `samples`. An incomplete last scan is ignored.
pub fn sums<const N: usize>(samples: &[u16]) -> [u32; N] {
    let mut sums = [0u32; N];
    for scan in samples.chunks_exact(N) {
        for (sum, &sample) in sums.iter_mut().zip(scan) {
            *sum += u32::from(sample);
        }
    }
    sums
}

/// `sum` scaled from the `measured` to the `nominal` excitation; all three are sums over [`SCANS`] conversions.
/// `None` if the excitation differs from nominal by more than a tenth: all bridge readings are then invalid.
pub fn ratiometric(sum: u32, measured: u32, nominal: u32) -> Option<i32> {
    let off = measured.abs_diff(nominal);
    if nominal == 0 || off > nominal / 10 {
        return None;
    }
    let scaled = u64::from(sum) * u64::from(nominal) + u64::from(measured) / 2;
    i32::try_from(scaled.checked_div(measured.into())?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::Random;

    /// Effective bits of readings: range over the rms of their error, as for an ideal converter.
    fn effective_bits(errors: &[f64], range: f64) -> f64 {
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let square = errors.iter().map(|e| (e - mean) * (e - mean)).sum::<f64>();
        let rms = (square / errors.len() as f64).sqrt();
        (range / (rms * 12f64.sqrt())).log2()
    }

    /// Errors of readings at levels spread over the range; a conversion is rounded after white
    /// noise of `noise` counts.
    fn errors(noise: f64, random: &mut Random) -> Vec<f64> {
        (0..4000)
            .map(|k| {
                let level = 100.0 + 3800.0 * f64::from(k) / 4000.0 + random.uniform();
                let samples: Vec<u16> = (0..SCANS)
                    .map(|_| (level + noise * random.normal()).round() as u16)
                    .collect();
                let [sum] = sums::<1>(&samples);
                f64::from(sum) / SCANS as f64 - level
            })
            .collect()
    }

    #[test]
    fn sum_of_96_conversions_has_fourteen_effective_bits() {
        let mut random = Random::new(9);
        // Total noise for 10.8 effective bits (the converter's data sheet); 1/√12 counts of it are quantisation.
        let all = 4096.0 / (10.8f64.exp2() * 12f64.sqrt());
        let analog = (all * all - 1.0 / 12.0).sqrt();
        let bits = effective_bits(&errors(analog, &mut random), 4096.0);
        println!("{bits:.2} effective bits from {SCANS} conversions of 10.8");
        assert!(bits >= 14.0, "{bits}");
        // Half a bit for each doubling of N: the gain comes from averaging of noise.
        let expected = 10.8 + 0.5 * (SCANS as f64).log2();
        assert!((bits - expected).abs() < 0.1, "{bits} {expected}");
    }

    #[test]
    fn sum_without_noise_keeps_twelve_effective_bits() {
        let bits = effective_bits(&errors(0.0, &mut Random::new(2)), 4096.0);
        assert!((bits - 12.0).abs() < 0.1, "{bits}");
    }

    #[test]
    fn channels_are_summed_separately() {
        let samples = [1, 10, 100, 2, 20, 200, 3, 30, 300, 4, 40];
        assert_eq!(sums::<3>(&samples), [6, 60, 600]);
        assert_eq!(sums::<2>(&[]), [0, 0]);
    }

    #[test]
    fn supply_drift_cancels() {
        // A bridge at 0.6 of its excitation, which sags by 0 to 9 %.
        let nominal = 96 * 4000;
        for percent in 0..10u32 {
            let excitation = nominal - nominal / 100 * percent;
            let bridge = excitation / 10 * 6;
            let reading = ratiometric(bridge, excitation, nominal).unwrap();
            assert!((reading - 230_400).abs() <= 2, "{percent} {reading}");
        }
        assert_eq!(ratiometric(100_000, 96 * 3000, nominal), None);
        assert_eq!(ratiometric(100_000, 0, nominal), None);
        assert_eq!(ratiometric(1, 1, 0), None);
    }
}
