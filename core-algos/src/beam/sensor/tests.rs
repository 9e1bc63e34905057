use super::super::reference::{Elastica, Random};
use super::super::strip::GAUSS_5;
use super::*;
use proptest::prelude::*;

const LENGTH: f64 = 0.37;
const LSB: f64 = 1.0 / (4096.0 * 64.0 * 2.0);

/// Simulated strip that bends to and fro, with its bridges and converter.
struct StripBench {
    random: Random,
    gain: [f64; 5],
    offset: [f64; 5],
    phase: f64,
}

impl StripBench {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let common = 0.75e-6 * random.normal();
        Self {
            gain: core::array::from_fn(|_| 1.0 + 3e-3 * random.normal()),
            offset: core::array::from_fn(|_| 1e-6 * random.normal() + common),
            phase: random.between(0.0, 6.0),
            random,
        }
    }

    /// Strains and end posture at time `t`, s.
    fn truth(&self, t: f64) -> ([f64; 5], [f64; 3]) {
        let w = t + self.phase;
        let shape = Elastica {
            root_curvature: 1.2 * (1.9 * w).sin() + 0.4 * (0.7 * w).cos(),
            force: [-2.0 * (1.3 * w).sin(), 1.5 * (1.1 * w).cos()],
        };
        let bent = shape.bent(&GAUSS_5.map(f64::from));
        let strain = core::array::from_fn(|i| 0.5e-3 * bent.curvature[i] / LENGTH);
        let [x, y, phi] = bent.end;
        (strain, [LENGTH * x, LENGTH * y, phi])
    }

    fn counts(&mut self, strain: &[f64; 5]) -> [i32; MAX_GAUGES] {
        let mut counts = [0; MAX_GAUGES];
        for i in 0..5 {
            let strain = strain[i] * self.gain[i] + self.offset[i];
            let analog = 2048.0 + strain / LSB + 0.8 * self.random.normal();
            counts[i] = analog.round() as i32;
        }
        counts
    }

    /// Estimate from ten samples at time `t`, each modified by `tamper`.
    fn estimate(
        &mut self,
        sensor: &RelativePositionSensor,
        state: &mut State,
        t: f64,
        mut tamper: impl FnMut(&mut [i32; MAX_GAUGES], f64),
    ) -> (Estimate, [f64; 3]) {
        let (strain, end) = self.truth(t);
        for _ in 0..10 {
            let mut counts = self.counts(&strain);
            tamper(&mut counts, self.random.uniform());
            sensor.sample(state, &counts);
        }
        (sensor.estimate(state), end)
    }
}

fn sensor() -> RelativePositionSensor {
    let mut config = Config::default();
    config.strip.uncertainty = crate::beam::strip::Uncertainty::calibrated();
    config.build().unwrap()
}

/// Normalised estimation error squared (NEES) of a posture: 3 on average.
fn normalised_error(relative: &RelativePosture, truth: [f64; 3]) -> f64 {
    let p: [f32; 3] = relative.posture.into();
    let d: [f32; 3] = core::array::from_fn(|i| (f64::from(p[i]) - truth[i]) as f32);
    let inverse = crate::math::matrix::inverse_spd(&relative.covariance).unwrap();
    let weighed = crate::math::matrix::apply(&inverse, &d);
    (0..3).map(|i| f64::from(d[i] * weighed[i])).sum()
}

/// A bend that grows at a constant rate is estimated without lag, even with gaps in the samples.
#[test]
fn extrapolated_estimate_of_a_moving_frame_has_no_lag() {
    let config = Config::default();
    let sensor = config.build().unwrap();
    let averaging = Config {
        extrapolate: false,
        ..config
    };
    let averaging = averaging.build().unwrap();
    // ψ̇ = 1 rad/s: the front axle turns at 2 rad/s against the rear. Readings are late by 1 ms and 0.8 ms.
    let strain = |t: f64| 0.5e-3 / LENGTH * 2.0 * (t - 1.8e-3);
    for gaps in [false, true] {
        let (mut state, mut slow) = (State::default(), State::default());
        let mut t = 0.1;
        let mut last = [0.0; 2];
        for period in 0..20 {
            for k in 0..10 {
                t += 1e-3;
                let count = (2048.0 + strain(t) / LSB + 0.3 * f64::from(k % 3)).round();
                let lost = gaps && (k == 3 || k == 7) && period > 0;
                let counts = [if lost { -1 } else { count as i32 }; MAX_GAUGES];
                sensor.sample(&mut state, &counts);
                averaging.sample(&mut slow, &counts);
            }
            let phi = |estimate: Estimate| f64::from(estimate.relative.unwrap().posture.phi);
            let estimates = [sensor.estimate(&mut state), averaging.estimate(&mut slow)];
            last = estimates.map(|estimate| phi(estimate) - 2.0 * t);
        }
        let [now, mean] = last;
        assert!(now.abs() < 1.5e-3, "{now}");
        // The mean lags by 4.5 samples to the middle of the period and 1.8 of latency, 2 mrad a sample.
        assert!((mean + 12.6e-3).abs() < 1.5e-3, "{mean}");
    }
}

/// No fault and a consistent covariance over many robots and bends.
#[test]
fn healthy_sensor_reports_no_fault_and_a_consistent_covariance() {
    let sensor = sensor();
    let (mut total, mut n, mut worst_m, mut worst_rad) = (0.0, 0.0, 0.0f64, 0.0f64);
    let mut unexplained = 0.0;
    for robot in 0..30 {
        let mut bench = StripBench::new(1000 + robot);
        let mut state = State::default();
        for period in 0..300 {
            let t = 0.03 * f64::from(period);
            let (estimate, truth) = bench.estimate(&sensor, &mut state, t, |_, _| {});
            assert_eq!(estimate.faults, [Fault::None; MAX_GAUGES]);
            assert!(estimate.used.count() == 5);
            assert!(estimate.chi_square.is_none_or(|chi| chi < 30.0));
            unexplained += f64::from(u8::from(!estimate.consistent));
            let relative = estimate.relative.unwrap();
            total += normalised_error(&relative, truth);
            n += 1.0;
            let p = relative.posture;
            worst_m = worst_m.max((f64::from(p.x) - truth[0]).hypot(f64::from(p.y) - truth[1]));
            worst_rad = worst_rad.max((f64::from(p.phi) - truth[2]).abs());
        }
    }
    // Zeros and gains of a robot are constant, so a probability of 0.02 means that one robot of 30 exceeds the limit in
    // most of its bends.
    assert!(unexplained / n < 0.06, "{}", unexplained / n);
    // With 30 draws of gain and offset, the mean NEES of 3 has a standard deviation of 0.4.
    assert!((1.0..4.5).contains(&(total / n)), "{}", total / n);
    assert!(worst_m < 2e-3 && worst_rad < 8e-3, "{worst_m} {worst_rad}");
}

/// Runs for 5 s, with `tamper` after the first second. Returns the delay of detection (periods), the faults, and the
/// largest NEES after detection.
fn tampered(
    seed: u64,
    mut tamper: impl FnMut(&mut [i32; MAX_GAUGES], f64),
) -> (Option<u32>, [Fault; MAX_GAUGES], f64) {
    let sensor = sensor();
    let mut bench = StripBench::new(seed);
    let mut state = State::default();
    let (mut found, mut faults, mut worst) = (None, [Fault::None; MAX_GAUGES], 0.0f64);
    for period in 0..500 {
        let t = 0.01 * f64::from(period);
        let (estimate, truth) = bench.estimate(&sensor, &mut state, t, |counts, unit| {
            if period >= 100 {
                tamper(counts, unit);
            }
        });
        faults = estimate.faults;
        if faults != [Fault::None; MAX_GAUGES] {
            found.get_or_insert(period - 100);
            assert_eq!(estimate.used.count(), 4);
            worst = worst.max(normalised_error(&estimate.relative.unwrap(), truth));
        } else {
            assert!(found.is_none() && (period < 100 || estimate.relative.is_some()));
        }
    }
    (found, faults, worst)
}

fn only(i: usize, fault: Fault) -> [Fault; MAX_GAUGES] {
    core::array::from_fn(|j| if i == j { fault } else { Fault::None })
}

#[test]
fn each_failed_gauge_is_detected_and_the_estimate_continues() {
    for seed in 0..2 {
        for gauge in 0..5 {
            let (found, faults, worst) = tampered(seed, |counts, _| counts[gauge] = 4095);
            assert_eq!((found, faults), (Some(4), only(gauge, Fault::Saturated)));
            assert!(worst < 40.0, "{worst}");

            let (found, faults, _) = tampered(seed, |counts, _| counts[gauge] = -1);
            assert_eq!((found, faults), (Some(4), only(gauge, Fault::Missing)));

            // Three faults of a gauge: stuck without noise, stuck with noise, a jump of 300 µε.
            let (found, faults, worst) = tampered(seed, |counts, _| counts[gauge] = 2150);
            assert!(found.unwrap() < 250, "gauge {gauge}: {found:?}");
            assert!(matches!(faults[gauge], Fault::Dead | Fault::Inconsistent));
            assert!(worst < 40.0, "{worst}");

            let (found, faults, worst) = tampered(seed, |counts, unit| {
                counts[gauge] = 2150 + (6.0 * unit) as i32
            });
            assert!(found.unwrap() < 250, "gauge {gauge}: {found:?}");
            assert_eq!(faults, only(gauge, Fault::Inconsistent));
            assert!(worst < 40.0, "{worst}");

            let (found, faults, _) = tampered(seed, |counts, _| counts[gauge] += 157);
            assert!(found.unwrap() < 100, "gauge {gauge}: {found:?}");
            assert_eq!(faults, only(gauge, Fault::Inconsistent));
        }
    }
}

/// Ratio of sample variance to stated variance of the heading, and consistency, of a strip at rest. `sigma` is the
/// noise of each gauge, counts. The first 100 periods are ignored.
fn scatter(config: &Config, sigma: [f64; 5]) -> (f64, bool) {
    let sensor = config.build().unwrap();
    let (mut random, mut state, mut claimed) = (Random(5), State::default(), 0.0);
    let (mut sum, mut square_sum, mut consistent) = (0.0, 0.0, false);
    for period in 0..1100 {
        for _ in 0..10 {
            let mut counts = [0; MAX_GAUGES];
            for i in 0..5 {
                counts[i] = (2300.0 + sigma[i] * random.normal()).round() as i32;
            }
            sensor.sample(&mut state, &counts);
        }
        let estimate = sensor.estimate(&mut state);
        let relative = estimate.relative.unwrap();
        consistent = estimate.consistent;
        if period >= 100 {
            let phi = f64::from(relative.posture.phi);
            (sum, square_sum) = (sum + phi, square_sum + phi * phi);
            claimed += f64::from(relative.noise[2][2]);
        }
    }
    let variance = square_sum - sum * sum / 1000.0;
    (variance / claimed, consistent)
}

#[test]
fn excess_noise_enlarges_the_covariance_and_is_not_consistent() {
    for (method, extrapolate) in [
        (Method::Elastica, true),
        (Method::Elastica, false),
        (Method::Quadrature, true),
    ] {
        let mut config = Config {
            method,
            extrapolate,
            ..Config::default()
        };
        config.strip.uncertainty.heading_rad = 1e-6;
        config.strip.uncertainty.interpolation = 0.0;
        for (sigma, sound) in [(1.8, true), (8.0, false), (30.0, false)] {
            let (ratio, consistent) = scatter(&config, [sigma; 5]);
            assert_eq!(consistent, sound, "{method:?} {sigma}");
            assert!((0.8..1.25).contains(&ratio), "{method:?} {sigma}: {ratio}");
        }
        // The middle gauge has the largest weight; the covariance is that of the mean noise.
        let (ratio, consistent) = scatter(&config, [0.3, 0.3, 8.0, 0.3, 0.3]);
        assert!(!consistent && ratio < 2.5, "{method:?}: {ratio}");
    }
    let (ratio, consistent) = scatter(&Config::default(), [0.3; 5]);
    assert!(consistent && ratio < 1.0, "{ratio}");
}

/// Five readings and three parameters leave two degrees of freedom, or three if the prior decides a parameter.
#[test]
fn a_residual_above_the_limit_enlarges_the_covariances_by_its_excess() {
    let config = Config::default();
    let estimate = |max_chi_square, odd| {
        let mut config = config;
        config.health.max_chi_square = max_chi_square;
        let sensor = config.build().unwrap();
        let mut state = State::default();
        let mut counts = [2300; MAX_GAUGES];
        counts[1] += odd;
        (0..10).for_each(|_| sensor.sample(&mut state, &counts));
        sensor.estimate(&mut state)
    };
    let free = estimate(1e6, 157);
    let chi_square = free.chi_square.unwrap();
    assert!(chi_square > 30.0 && !free.consistent, "{chi_square}");
    let of = |estimate: &Estimate| estimate.relative.unwrap();
    assert_eq!(estimate(chi_square, 157), free);
    let limited = estimate(chi_square.next_down(), 157);
    assert_eq!(limited.chi_square, free.chi_square);
    for (large, small) in [
        (of(&limited).covariance, of(&free).covariance),
        (of(&limited).noise, of(&free).noise),
    ] {
        for i in 0..3 {
            let degrees = chi_square / (large[i][i] / small[i][i]);
            assert!((1.999..3.001).contains(&degrees), "{degrees}");
        }
    }
    // A residual that the uncertainties explain leaves the covariances unchanged, however low the limit.
    let sound = estimate(5.0, 0);
    assert!(sound.consistent);
    assert_eq!(sound, estimate(1e6, 0));
}

/// Configured noise 1 µε. The excess is a mean over the gauges; the limit applies to each gauge.
#[test]
fn a_gauge_is_noisy_above_three_times_the_configured_noise() {
    let sensor = sensor();
    let limit = NOISY * NOISY * (1e-6f32 * 1e-6);
    for (odd, quiet) in [
        (limit, true),
        (limit.next_up(), false),
        (f32::NAN, false),
        (0.0, true),
    ] {
        for i in 0..5 {
            let mut state = State::default();
            state.noise = [4e-12; MAX_GAUGES];
            state.noise[i] = odd;
            let (excess, found) = sensor.excess_noise(&state, GaugeMask::first(5));
            assert_eq!(found, quiet, "{odd:e}");
            let expected = (4.0 * 4e-12 + odd) / 5.0 - 1e-12;
            assert!(
                odd.is_nan() || (excess - expected).abs() < 1e-17,
                "{excess:e}"
            );
            // The noise of a gauge that is not good is ignored.
            let others = sensor.excess_noise(&state, GaugeMask::first(5).without(i));
            assert!((others.0 - 3e-12).abs() < 1e-17 && others.1);
        }
    }
    let state = State::default();
    assert_eq!(
        sensor.excess_noise(&state, GaugeMask::first(5)),
        (0.0, true)
    );
    assert_eq!(sensor.excess_noise(&state, GaugeMask::NONE), (0.0, true));
}

#[test]
fn drift_of_the_zeros_has_the_configured_variance_per_second() {
    let mut config = Config::default();
    config.period_s = 0.02;
    let state = State {
        age: 500,
        ..State::default()
    };
    // The zeros walk by 0.05 µε/√s for 10 s.
    let drift = config.build().unwrap().drift(&state);
    assert!((drift / 25e-15 - 1.0).abs() < 1e-5, "{drift:e}");
}

/// On a strip of three gauges the fit has no residual: only the flatness test detects a stuck gauge.
#[test]
fn a_flat_gauge_among_three_is_dead() {
    let mut config = Config::default();
    config.strip.gauges_m = strip::PerGauge::new(&[0.05, 0.185, 0.32]).unwrap();
    config.calibration.zero_counts = strip::PerGauge::uniform(3, 2048.0);
    config.calibration.gain = strip::PerGauge::uniform(3, 1.0);
    let sensor = config.build().unwrap();
    let mut state = State::default();
    let mut faults = [Fault::None; MAX_GAUGES];
    for t in 0..1000i32 {
        let moving = 2048 + (t % 200 - 100).abs();
        sensor.sample(&mut state, &[moving, 2100, moving, 0, 0, 0, 0, 0]);
        if t % 10 == 9 {
            let estimate = sensor.estimate(&mut state);
            faults = estimate.faults;
            assert!(estimate.relative.is_some());
        }
    }
    assert_eq!(faults, only(1, Fault::Dead));
}

#[test]
fn without_two_gauges_there_is_no_posture() {
    let sensor = sensor();
    let mut state = State::default();
    assert_eq!(sensor.estimate(&mut state).relative, None);
    assert_eq!(state.work, None);
    sensor.sample(&mut state, &[2048, -1, -1, -1, 4095, 0, 0, 0]);
    assert_eq!(sensor.estimate(&mut state).relative, None);
    sensor.sample(&mut state, &[2048, -1, -1, 2048, 4095, 0, 0, 0]);
    let estimate = sensor.estimate(&mut state);
    assert_eq!(estimate.used, GaugeMask(0b1001));
    // Two gauges give a larger covariance than five.
    let two = estimate.relative.unwrap().covariance;
    sensor.sample(&mut state, &[2048; MAX_GAUGES]);
    let five = sensor.estimate(&mut state).relative.unwrap().covariance;
    assert!(two[1][1] > 1.3 * five[1][1] && two[2][2] > 1.3 * five[2][2]);
}

#[test]
fn the_three_methods_agree_on_gentle_bends() {
    let strain = [2e-4, 3e-4, 3e-4, 2.5e-4, 2e-4, 0.0, 0.0, 0.0];
    let postures = [Method::Piecewise, Method::Quadrature, Method::Elastica].map(|method| {
        let strip = strip::Config::default().build().unwrap();
        let solver = PostureSolver::new(strip, method, 100).unwrap();
        let solution = solver.solve(&strain, GaugeMask(255)).unwrap();
        assert_eq!(solution.method, method);
        assert_eq!(solution.wrench.is_some(), method == Method::Elastica);
        solution.relative.posture
    });
    for p in postures {
        assert!(p.distance(postures[2]) < 1e-3 && (p.phi - postures[2].phi).abs() < 4e-3);
    }
    let strip = strip::Config::default().build().unwrap();
    let none = PostureSolver::new(strip, Method::Piecewise, 0);
    assert_eq!(none.unwrap_err().field, "segments");
}

fn count() -> impl Strategy<Value = i32> {
    prop_oneof![3 => 0i32..4096, 1 => proptest::num::i32::ANY]
}

properties! {
    #[test]
    fn any_counts_give_a_sound_posture_or_none(
        samples in proptest::collection::vec(proptest::array::uniform8(count()), 1..40),
        method in 0usize..3,
    ) {
        let method = [Method::Piecewise, Method::Quadrature, Method::Elastica][method];
        let sensor = Config { method, segments: 10, ..Config::default() }.build().unwrap();
        let mut state = State::default();
        for counts in samples {
            sensor.sample(&mut state, &counts);
            let estimate = sensor.estimate(&mut state);
            if let Some(relative) = estimate.relative {
                prop_assert!(relative.is_sound() && estimate.used.count() >= 2);
            }
            prop_assert!(estimate.wrench.is_none_or(|wrench| wrench.is_finite()));
            prop_assert!(estimate.strain.iter().all(|strain| strain.is_finite()));
        }
    }

    #[test]
    fn any_strains_give_a_sound_posture_or_none(
        strain in proptest::array::uniform8(prop_oneof![
            3 => -5e-3f32..5e-3,
            1 => proptest::num::f32::ANY,
        ]),
        bits in proptest::num::u8::ANY,
    ) {
        for method in [Method::Piecewise, Method::Quadrature, Method::Elastica] {
            let strip = strip::Config::default().build().unwrap();
            let solver = PostureSolver::new(strip, method, 20).unwrap();
            if let Some(solution) = solver.solve(&strain, GaugeMask(bits)) {
                prop_assert!(solution.relative.is_sound());
            }
        }
    }
}
