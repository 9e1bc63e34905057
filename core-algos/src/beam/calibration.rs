//! From bridge counts to strain; estimation of zero and gain.
//!
//! The converter is ratiometric (bridge and converter share their supply), so a count is proportional to the bridge's
//! ratio of output to supply voltage, and supply drift cancels. Zeroing is essential: a zero error of 1 µε on all
//! gauges is 0.7 mrad of bend on the default strip.
//!
//! [`Config::build`] validates; [`Calibration::strain`] never fails. [`Standstill::average`] rejects a noisy,
//! drifting or incomplete average with the reason.

use super::strip::{GaugeMask, MAX_GAUGES, PerGauge};
use crate::config::{Allowed, Checked, ConfigError, declare, require};
use crate::math::trig::sqrt;

/// Largest converter range supported: 24 bits.
const MAX_FULL_SCALE: f32 = 16_777_215.0;

declare! {
    /// Converter, amplifier and the stored calibration of each gauge.
    ///
    /// Default: Five full bridges of gauge factor 2, amplified 64 times into 12 bits: ±3900 µε.
    pub struct Config {
        /// Highest count of the converter; the lowest is 0. A count outside means "no conversion".
        pub full_scale_counts: i32 = 4095, "counts": Range(15.0, MAX_FULL_SCALE);
        /// A count closer to either end of the range is saturated.
        pub rail_margin_counts: i32 = 4, "counts": NonNegative;
        /// Strain of one count by the data sheets: 1/(counts × amplification × gauge factor × active
        /// arms/4). Negative if the bridge is wired so that a left bend lowers the count.
        pub strain_per_count: f32 = 1.0 / (4096.0 * 64.0 * 2.0), "strain": Range(-1e-3, 1e-3);
        /// Count of each gauge when the strip is straight.
        pub zero_counts: PerGauge = PerGauge::uniform(5, 2048.0), "counts": Range(0.0, MAX_FULL_SCALE);
        /// True strain over nominal strain of each gauge.
        pub gain: PerGauge = PerGauge::uniform(5, 1.0), "": Range(0.5, 2.0);
        /// Largest plausible strain in magnitude.
        pub max_strain: f32 = 5e-3, "strain": Range(1e-6, 0.1);
    }
}

impl Config {
    /// Builds the validated calibration of a strip with `gauges` gauges; the error names the invalid field.
    pub fn build(&self, gauges: usize) -> Result<Calibration, ConfigError> {
        self.check_ranges()?;
        let full_scale = self.full_scale_counts;
        Allowed::Range(0.0, (full_scale / 4) as f32)
            .check("rail_margin_counts", self.rail_margin_counts as f32)?;
        require(
            self.strain_per_count.abs() >= 1e-12 && self.strain_per_count.abs() <= 1e-3,
            "strain_per_count",
            self.strain_per_count,
            Allowed::Condition("from 1e-12 to 1e-3 in magnitude"),
        )?;
        for (field, list) in [("zero_counts", &self.zero_counts), ("gain", &self.gain)] {
            require(
                list.count() == gauges,
                field,
                list.count() as f32,
                Allowed::Condition("as many entries as the strip has gauges"),
            )?;
        }
        let counts = Allowed::Range(0.0, full_scale as f32);
        self.zero_counts.check("zero_counts", counts)?;
        Ok(Calibration {
            lowest: self.rail_margin_counts,
            highest: full_scale - self.rail_margin_counts,
            full_scale,
            strain_per_count: self.strain_per_count,
            zero: self.zero_counts.padded(),
            scale: self.gain.padded().map(|gain| gain * self.strain_per_count),
            max_strain: self.max_strain,
        })
    }

    /// This calibration with the zero of each gauge set so that `average`, taken with the strip at
    /// the known strains `known` (all zero for a straight strip), reads `known`.
    pub fn zeroed(&self, average: &[f32; MAX_GAUGES], known: &[f32; MAX_GAUGES]) -> Self {
        let mut zero = self.zero_counts.padded();
        let gain = self.gain.padded();
        for i in 0..MAX_GAUGES {
            zero[i] = average[i] - known[i] / (self.strain_per_count * gain[i]);
        }
        Self {
            zero_counts: self.zero_counts.replaced(zero),
            ..*self
        }
    }

    /// This calibration with the gain of each gauge set so that `average`, taken at a known bend, reads `known`. With
    /// the strip on a former, the known strain is half thickness × curvature. The bend must be much larger than the
    /// error of the zeros; check the result with [`Self::build`].
    pub fn with_gain(&self, average: &[f32; MAX_GAUGES], known: &[f32; MAX_GAUGES]) -> Self {
        let zero = self.zero_counts.padded();
        let mut gain = self.gain.padded();
        for i in 0..MAX_GAUGES {
            gain[i] = known[i] / (self.strain_per_count * (average[i] - zero[i]));
        }
        Self {
            gain: self.gain.replaced(gain),
            ..*self
        }
    }
}

impl PerGauge {
    /// List with the first values of `values`, as many as `self` has.
    fn replaced(&self, values: [f32; MAX_GAUGES]) -> Self {
        values
            .get(..self.count())
            .and_then(Self::new)
            .unwrap_or(*self)
    }
}

/// Validity of a single count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Conversion {
    /// A count inside the converter's range.
    Good,
    /// A count at either end of the range: the true value may lie beyond.
    Saturated,
    /// No count: outside the range of the converter.
    Missing,
}

/// Validated calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    lowest: i32,
    highest: i32,
    full_scale: i32,
    strain_per_count: f32,
    zero: [f32; MAX_GAUGES],
    scale: [f32; MAX_GAUGES],
    max_strain: f32,
}

impl Calibration {
    /// Validity of one raw count of the converter.
    pub fn classify(&self, count: i32) -> Conversion {
        if !(0..=self.full_scale).contains(&count) {
            Conversion::Missing
        } else if count < self.lowest || count > self.highest {
            Conversion::Saturated
        } else {
            Conversion::Good
        }
    }

    /// Strain of each gauge from its count, which may be an average of counts.
    pub fn strain(&self, counts: &[f32; MAX_GAUGES]) -> [f32; MAX_GAUGES] {
        core::array::from_fn(|i| (counts[i] - self.zero[i]) * self.scale[i])
    }

    /// Magnitude of the nominal strain of one count, before the gauges' gains.
    pub fn resolution(&self) -> f32 {
        self.strain_per_count.abs()
    }

    /// True if `strain` is plausible for this strip; false for NaN.
    pub fn is_plausible(&self, strain: f32) -> bool {
        strain.abs() <= self.max_strain
    }
}

declare! {
    /// Limits of an average that is used for a calibration.
    pub struct StandstillLimits {
        /// Fewest samples of each gauge.
        pub min_samples: u32 = 500, "": Range(4.0, 1e6);
        /// Standard deviation of a gauge's samples above which the average is rejected: the robot moves or a bridge is
        /// loose.
        pub max_noise_strain: f32 = 2e-5, "strain": Range(1e-9, 1e-2);
        /// Difference between the averages of the two halves of the samples above which the average is rejected.
        pub max_drift_strain: f32 = 2e-6, "strain": Range(1e-9, 1e-2);
    }
}

impl StandstillLimits {
    /// These limits, validated; the error names the invalid field.
    pub fn build(&self) -> Result<Self, ConfigError> {
        self.check_ranges()?;
        Ok(*self)
    }
}

/// Reason for the rejection of an average. The number is the gauge, counted from the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StandstillError {
    /// Not enough samples yet.
    TooFewSamples(u8),
    /// A sample was saturated or missing.
    BadSample(u8),
    /// Samples scatter too much.
    Noisy(u8),
    /// The averages of the two halves differ too much.
    Drifting(u8),
}

/// Exact sums of one gauge's counts: integers, of differences from the first count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Moments {
    count: u32,
    sum: i64,
    squares: i64,
}

impl Moments {
    fn add(&mut self, deviation: i64) {
        self.count = self.count.saturating_add(1);
        self.sum = self.sum.saturating_add(deviation);
        self.squares = self.squares.saturating_add(deviation * deviation);
    }

    fn mean(&self) -> f32 {
        self.sum as f32 / self.count as f32
    }

    /// Unbiased variance of the counts; needs two or more counts.
    fn variance(&self) -> f32 {
        let mean = self.mean();
        let count = self.count as f32;
        ((self.squares as f32 - count * mean * mean) / (count - 1.0)).max(0.0)
    }
}

/// Collects samples while the strip is held still at a known shape.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Standstill {
    first: Option<[i32; MAX_GAUGES]>,
    halves: [[Moments; 2]; MAX_GAUGES],
    bad: GaugeMask,
    samples: u32,
}

impl Standstill {
    /// Adds one sample of every gauge. The two halves are the samples before and after
    /// `limits.min_samples / 2`.
    pub fn add(
        &mut self,
        calibration: &Calibration,
        limits: &StandstillLimits,
        counts: &[i32; MAX_GAUGES],
    ) {
        let first = *self.first.get_or_insert(*counts);
        let late = self.samples >= limits.min_samples / 2;
        for i in 0..MAX_GAUGES {
            if calibration.classify(counts[i]) == Conversion::Good {
                self.halves[i][usize::from(late)].add(i64::from(counts[i]) - i64::from(first[i]));
            } else {
                self.bad = self.bad.with(i);
            }
        }
        self.samples = self.samples.saturating_add(1);
    }

    /// Mean count of each gauge of `mask` over all samples; an error if a gauge exceeds a limit.
    pub fn average(
        &self,
        calibration: &Calibration,
        limits: &StandstillLimits,
        mask: GaugeMask,
    ) -> Result<[f32; MAX_GAUGES], StandstillError> {
        let resolution = calibration.resolution();
        let first = self.first.unwrap_or([0; MAX_GAUGES]);
        let mut average = [0.0; MAX_GAUGES];
        for i in mask.iter() {
            let gauge = i as u8;
            if self.bad.contains(i) {
                return Err(StandstillError::BadSample(gauge));
            }
            let [early, late] = &self.halves[i];
            let count = early.count.saturating_add(late.count);
            // `late` needs no check: with `min_samples` in total, it has at least as many samples as `early`.
            if count < limits.min_samples || early.count < 2 {
                return Err(StandstillError::TooFewSamples(gauge));
            }
            // The variance is computed in each half, so that drift between the halves does not count as noise.
            let variance = early.variance().max(late.variance());
            if !(sqrt(variance) * resolution <= limits.max_noise_strain) {
                return Err(StandstillError::Noisy(gauge));
            }
            let drift = late.mean() - early.mean();
            if !(drift.abs() * resolution <= limits.max_drift_strain) {
                return Err(StandstillError::Drifting(gauge));
            }
            let total = early.sum.saturating_add(late.sum) as f32;
            average[i] = first[i] as f32 + total / count as f32;
        }
        Ok(average)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::Random;
    use proptest::prelude::*;

    fn calibration() -> Calibration {
        Config::default().build(5).unwrap()
    }

    fn collect(
        limits: &StandstillLimits,
        n: usize,
        mut count: impl FnMut(usize, usize) -> f64,
    ) -> Standstill {
        let mut standstill = Standstill::default();
        for t in 0..n {
            let counts = core::array::from_fn(|i| count(t, i).round() as i32);
            standstill.add(&calibration(), limits, &counts);
        }
        standstill
    }

    const FIVE: GaugeMask = GaugeMask(0b11111);

    #[test]
    fn zeroing_error_of_noisy_gauges_is_that_of_their_mean() {
        let limits = StandstillLimits::default();
        let mut random = Random(4);
        let truth = [
            2051.3, 2040.8, 2049.5, 2100.0, 1990.2, 2000.0, 2000.0, 2000.0,
        ];
        let (mut squared, runs) = (0.0, 60);
        for _ in 0..runs {
            let standstill = collect(&limits, 1000, |_, i| truth[i] + 1.5 * random.normal());
            let average = standstill.average(&calibration(), &limits, FIVE).unwrap();
            let config = Config::default().zeroed(&average, &[0.0; MAX_GAUGES]);
            for (i, zero) in config.zero_counts.iter().enumerate() {
                let error = f64::from(zero) - truth[i];
                assert!((error * f64::from(config.strain_per_count)).abs() < 0.5e-6);
                squared += error.powi(2);
            }
        }
        // Variance of noise and of rounding to counts, over 1000 samples.
        let variance = (1.5 * 1.5 + 1.0 / 12.0) / 1000.0;
        let normalised = squared / (5.0 * f64::from(runs) * variance);
        assert!((0.5..1.3).contains(&normalised), "{normalised}");
    }

    #[test]
    fn a_moving_noisy_short_or_saturated_record_is_refused() {
        let limits = StandstillLimits::default();
        // `added`: counts of the gauges above their zero.
        let refusal = |n, added: &dyn Fn(usize, usize) -> f64| {
            let standstill = collect(&limits, n, |t, i| 2048.0 + added(t, i));
            let average = standstill.average(&calibration(), &limits, FIVE);
            average.unwrap_err()
        };
        let drifting = refusal(1000, &|t, i| if i == 3 { 0.01 * t as f64 } else { 0.0 });
        assert_eq!(drifting, StandstillError::Drifting(3));
        let noisy = refusal(1000, &|t, i| {
            f64::from(u8::from(i == 1 && t % 2 == 0)) * 40.0
        });
        assert_eq!(noisy, StandstillError::Noisy(1));
        let saturated = refusal(1000, &|t, i| if (t, i) == (77, 4) { 2047.0 } else { 0.0 });
        assert_eq!(saturated, StandstillError::BadSample(4));
        let short = [0, 400].map(|n| refusal(n, &|_, _| 0.0));
        assert_eq!(short, [StandstillError::TooFewSamples(0); 2]);
    }

    #[test]
    fn gain_from_a_known_bend_restores_the_strain() {
        let limits = StandstillLimits::default();
        let gains = [1.03, 0.97, 1.1, 0.92, 1.0, 1.0, 1.0, 1.0];
        let lsb = f64::from(Config::default().strain_per_count);
        let counts = |strain: f64, i: usize| 2048.0 + strain / (lsb * gains[i]);
        let bent = collect(&limits, 600, |_, i| counts(1e-3, i))
            .average(&calibration(), &limits, FIVE)
            .unwrap();
        let config = Config::default().with_gain(&bent, &[1e-3; MAX_GAUGES]);
        let calibrated = config.build(5).unwrap();
        let reading: [f32; MAX_GAUGES] = core::array::from_fn(|i| counts(-2e-3, i) as f32);
        for strain in &calibrated.strain(&reading)[..5] {
            assert!((strain + 2e-3).abs() < 4e-6, "{strain}");
        }
        // A gain from a straight strip is out of range, and `build` names the field.
        let straight = collect(&limits, 600, |_, _| 2048.0)
            .average(&calibration(), &limits, FIVE)
            .unwrap();
        let wrong = Config::default().with_gain(&straight, &[1e-3; MAX_GAUGES]);
        assert_eq!(wrong.build(5).unwrap_err().field, "gain");
    }

    #[test]
    fn counts_are_classified_by_range_and_margin() {
        let c = calibration();
        assert_eq!(c.classify(-1), Conversion::Missing);
        assert_eq!(c.classify(4096), Conversion::Missing);
        assert_eq!(c.classify(i32::MIN), Conversion::Missing);
        for count in [0, 3, 4092, 4095] {
            assert_eq!(c.classify(count), Conversion::Saturated, "{count}");
        }
        for count in [4, 2048, 4091] {
            assert_eq!(c.classify(count), Conversion::Good, "{count}");
        }
        for (strain, plausible) in [
            (5e-3f32, true),
            (5e-3f32.next_up(), false),
            (f32::NAN, false),
        ] {
            assert_eq!(
                [c.is_plausible(strain), c.is_plausible(-strain)],
                [plausible; 2]
            );
        }
    }

    /// Each case holds the counts of the second gauge in both halves of the 8 samples. A count is 2⁻²⁰ strain, so
    /// that mean, variance and difference of the halves are exact.
    #[test]
    fn average_is_accepted_up_to_the_limits_of_noise_and_drift() {
        let unit = 0.5f32.powi(20);
        let config = Config {
            strain_per_count: -unit,
            ..Config::default()
        };
        let calibration = config.build(5).unwrap();
        let (quiet, noisy) = ([0, 0, 0, 2], [0, 0, 0, 4]);
        let moved = [3, 3, 3, 5];
        for (halves, noise, drift, expected) in [
            // Means of `quiet`, `noisy` and `moved`: 0.5, 1 and 3.5. Variances: 1, 4 and 1.
            ([quiet, quiet], unit, unit, Ok(0.5)),
            (
                [quiet, quiet],
                unit.next_down(),
                unit,
                Err(StandstillError::Noisy(1)),
            ),
            ([quiet, noisy], 2.0 * unit, unit, Ok(0.75)),
            ([quiet, noisy], unit, unit, Err(StandstillError::Noisy(1))),
            ([noisy, quiet], unit, unit, Err(StandstillError::Noisy(1))),
            ([quiet, moved], unit, 3.0 * unit, Ok(2.0)),
            (
                [quiet, moved],
                unit,
                (3.0 * unit).next_down(),
                Err(StandstillError::Drifting(1)),
            ),
            (
                [moved, quiet],
                unit,
                (3.0 * unit).next_down(),
                Err(StandstillError::Drifting(1)),
            ),
        ] {
            let limits = StandstillLimits {
                min_samples: 8,
                max_noise_strain: noise,
                max_drift_strain: drift,
            };
            let mut standstill = Standstill::default();
            for (k, count) in halves.concat().into_iter().enumerate() {
                let found = standstill.average(&calibration, &limits, FIVE);
                assert_eq!(found, Err(StandstillError::TooFewSamples(0)), "{k}");
                let mut counts = [2000; MAX_GAUGES];
                counts[1] += count;
                standstill.add(&calibration, &limits, &counts);
            }
            let found = standstill.average(&calibration, &limits, FIVE);
            let expected = expected.map(|mean: f32| {
                core::array::from_fn(|i| match i {
                    1 => 2000.0 + mean,
                    0..5 => 2000.0,
                    _ => 0.0,
                })
            });
            assert_eq!(found, expected, "{halves:?}");
        }
    }

    /// The least `min_samples` that `build` allows is enough for an average. A lower limit leaves too few samples in
    /// the early half.
    #[test]
    fn four_samples_are_enough_and_fewer_are_rejected() {
        for (min_samples, enough) in [(4, true), (3, false), (2, false), (0, false)] {
            let limits = StandstillLimits {
                min_samples,
                ..StandstillLimits::default()
            };
            assert_eq!(limits.build().is_ok(), enough);
            let average =
                |n| collect(&limits, n, |_, _| 2000.0).average(&calibration(), &limits, FIVE);
            assert_eq!(
                [average(3).is_ok(), average(4).is_ok(), average(9).is_ok()],
                [false, enough, enough]
            );
        }
    }

    /// The bad sample may be the first sample, to which the sums are relative.
    #[test]
    fn bad_sample_rejects_the_average_of_its_gauge_only() {
        let limits = StandstillLimits::default();
        for (at, bad) in [(0, 4094.0), (0, -1.0), (700, 4094.0)] {
            let standstill = collect(
                &limits,
                1000,
                |t, i| if (t, i) == (at, 2) { bad } else { 2000.0 },
            );
            let average = |mask| standstill.average(&calibration(), &limits, mask);
            assert_eq!(average(FIVE), Err(StandstillError::BadSample(2)));
            assert!(average(FIVE.without(2)).is_ok());
        }
    }

    #[test]
    fn strain_per_count_outside_1e_12_to_1e_3_is_rejected() {
        for (unit, accepted) in [
            (1e-12, true),
            (0.9e-12, false),
            (1e-3, true),
            (1.1e-3, false),
        ] {
            for strain_per_count in [unit, -unit] {
                let config = Config {
                    strain_per_count,
                    ..Config::default()
                };
                assert_eq!(config.build(5).is_ok(), accepted, "{strain_per_count}");
            }
        }
    }

    /// One gauge has a gain of 0.8; the strip is held at a known strain.
    #[test]
    fn zero_from_a_bent_strip_equals_that_of_a_straight_strip() {
        let mut config = Config::default();
        config.gain.set(3, 0.8);
        let lsb = config.strain_per_count;
        let known = [1e-3; MAX_GAUGES];
        let average: [f32; MAX_GAUGES] =
            core::array::from_fn(|i| 1990.0 + 1e-3 / lsb / if i == 3 { 0.8 } else { 1.0 });
        let zeroed = config.zeroed(&average, &known);
        for zero in zeroed.zero_counts.iter() {
            assert!((zero - 1990.0).abs() < 1e-2, "{zero}");
        }
        let strain = zeroed.build(5).unwrap().strain(&average);
        assert!(
            strain[..5]
                .iter()
                .all(|strain| (strain - 1e-3).abs() < 1e-7),
            "{strain:?}"
        );
    }

    #[test]
    fn lists_that_do_not_match_the_strip_are_rejected() {
        assert_eq!(Config::default().build(4).unwrap_err().field, "zero_counts");
        crate::config::refusal_of(Config::default(), |c| c.build(5)).names(&[
            ("gain", |c| c.gain = PerGauge::uniform(4, 1.0)),
            ("strain_per_count", |c| c.strain_per_count = f32::NAN),
        ]);
    }

    properties! {
        #[test]
        fn any_counts_average_or_are_refused(
            a in proptest::array::uniform8(proptest::num::i32::ANY),
            b in proptest::array::uniform8(0i32..4096),
        ) {
            let limits = StandstillLimits { min_samples: 4, ..StandstillLimits::default() };
            let mut standstill = Standstill::default();
            for counts in [a, b, b, b, b] {
                standstill.add(&calibration(), &limits, &counts);
            }
            if let Ok(average) = standstill.average(&calibration(), &limits, FIVE) {
                prop_assert!(average.iter().all(|c| c.is_finite()));
            }
        }
    }
}
