//! Samples of one gauge in a period: line fit, and noise from the residuals of the line.

/// Samples of one gauge since the last estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Period {
    /// Number of conversions, good or not: index of the next conversion.
    pub(super) conversions: u16,
    /// Sum of the good counts. The next three fields: sums of the good samples' indices, of the squared indices, and of
    /// count times index.
    sum: i64,
    index_sum: i64,
    index_square_sum: i64,
    product_sum: i64,
    /// First good count. `square_sum` is the sum of the squared differences of the good counts from it.
    first: i32,
    square_sum: i64,
    pub(super) good: u16,
    pub(super) saturated: u16,
    pub(super) missing: u16,
}

impl Period {
    /// Adds a good count to the sums.
    pub(super) fn put(&mut self, count: i32) {
        if self.good == 0 {
            self.first = count;
        }
        self.good = self.good.saturating_add(1);
        let (count, index) = (i64::from(count), i64::from(self.conversions));
        let difference = count - i64::from(self.first);
        // Counts have 24 bits, indices 16: the sums over counts and indices stay below 2^56.
        self.sum = self.sum.saturating_add(count);
        self.index_sum = self.index_sum.saturating_add(index);
        self.index_square_sum = self.index_square_sum.saturating_add(index * index);
        self.product_sum = self.product_sum.saturating_add(count * index);
        self.square_sum = self.square_sum.saturating_add(difference * difference);
    }

    /// `n Σ(k − k̄)²` of the n good samples' indices k, and slope of the fitted line, counts a sample. `None` with
    /// fewer than two good samples.
    fn line(&self) -> Option<(f32, f32)> {
        let good = i64::from(self.good);
        // Integer arithmetic, no cancellation: n Σk² − (Σk)² and n Σkc − Σk Σc.
        let spread = good * self.index_square_sum - self.index_sum * self.index_sum;
        let product = good * self.product_sum - self.index_sum * self.sum;
        (spread > 0).then_some((spread as f32, product as f32 / spread as f32))
    }

    /// Distance from the mean index to `ahead` samples after the last conversion, samples.
    fn lead(&self, ahead: f32) -> f32 {
        let last = f32::from(self.conversions) - 1.0;
        last + ahead - self.index_sum as f32 / f32::from(self.good)
    }

    /// Count of the gauge from one or more good samples: the fitted line `ahead` samples after the last conversion,
    /// or the mean without `ahead`.
    pub(super) fn count(&self, ahead: Option<f32>) -> f32 {
        let mean = self.sum as f32 / f32::from(self.good);
        match (ahead, self.line()) {
            (Some(ahead), Some((_, slope))) => mean + slope * self.lead(ahead),
            _ => mean,
        }
    }

    /// Variance of [`Self::count`], counts². The samples have white noise, estimated from the residuals of the line.
    /// `None` with fewer than three good samples.
    pub(super) fn variance(&self, ahead: Option<f32>) -> Option<f32> {
        let (spread, slope) = self.line().filter(|_| self.good > 2)?;
        let (n, good) = (f32::from(self.good), i64::from(self.good));
        let sum = self.sum - good * i64::from(self.first);
        let squares = good.saturating_mul(self.square_sum);
        let total = squares.saturating_sub(sum.saturating_mul(sum)) as f32;
        let scatter = (total - slope * slope * spread).max(0.0) / (n * (n - 2.0));
        let lead = ahead.map_or(0.0, |ahead| self.lead(ahead));
        Some(scatter * (1.0 / n + lead * lead * n / spread))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::Random;

    /// A period of these counts; `None` is a bad conversion.
    fn period(counts: impl Iterator<Item = Option<i32>>) -> Period {
        let mut period = Period::default();
        for count in counts {
            if let Some(count) = count {
                period.put(count);
            }
            period.conversions += 1;
        }
        period
    }

    /// Reference: linear regression in `f64`.
    #[test]
    fn count_and_variance_are_those_of_the_fitted_line() {
        let mut random = Random::new(8);
        for case in 0..300 {
            let (level, slope) = (random.between(500.0, 3500.0), random.between(-30.0, 30.0));
            let counts: Vec<Option<i32>> = (0..3 + case % 12)
                .map(|k| {
                    let count = level + slope * f64::from(k) + 4.0 * random.normal();
                    (random.uniform() < 0.8).then_some(count.round() as i32)
                })
                .collect();
            let good = (0u32..)
                .zip(&counts)
                .filter_map(|(k, count)| Some((f64::from(k), f64::from((*count)?))));
            let good: Vec<(f64, f64)> = good.collect();
            let period = period(counts.iter().copied());
            let n = good.len() as f64;
            assert_eq!(
                (usize::from(period.good), usize::from(period.conversions)),
                (good.len(), counts.len())
            );
            if good.is_empty() {
                continue;
            }
            let mean = |term: &dyn Fn(&(f64, f64)) -> f64| good.iter().map(term).sum::<f64>() / n;
            let (middle, average) = (mean(&|it| it.0), mean(&|it| it.1));
            let spread = mean(&|it| (it.0 - middle).powi(2));
            let slope = mean(&|it| (it.0 - middle) * (it.1 - average)) / spread;
            let slope = if good.len() > 1 { slope } else { 0.0 };
            let residual = |it: &(f64, f64)| it.1 - average - slope * (it.0 - middle);
            let scatter = mean(&|it| residual(it).powi(2)) * n / (n - 2.0);
            for ahead in [None, Some(0.0), Some(1.8)] {
                let lead = ahead.map_or(0.0, |ahead| {
                    counts.len() as f64 - 1.0 + f64::from(ahead) - middle
                });
                let found = f64::from(period.count(ahead));
                assert!((found - average - slope * lead).abs() < 1e-2, "{found}");
                let variance = period.variance(ahead);
                assert_eq!(variance.is_some(), good.len() > 2);
                if let Some(variance) = variance {
                    let expected = scatter * (1.0 / n + lead * lead / (n * spread));
                    let error = (f64::from(variance) - expected).abs();
                    assert!(
                        error < 1e-5 + 1e-3 * (expected + lead * lead / n),
                        "{variance} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn samples_on_a_line_have_no_variance() {
        for (slope, count) in (1..60).flat_map(|slope| [(slope, 1000), (-slope, 997)]) {
            let line = (0..count).map(|k| Some(1_000_000 + slope * k));
            let variance = period(line).variance(None).unwrap();
            assert!((0.0..1.0).contains(&variance), "{slope}: {variance}");
        }
    }
}
