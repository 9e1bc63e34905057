use super::bridge::LowPass;
use super::*;

/// Sensors without randomness and delay, all of them fitted.
fn clean() -> SensorConfig {
    let mut config = SensorConfig::default();
    config.gyro.fitted = true;
    config.accelerometer.fitted = true;
    config.gyro.delay_ms = 0;
    config.accelerometer.delay_ms = 0;
    config.bridge.delay_ms = 0;
    for sigma in [
        &mut config.gyro.noise_density,
        &mut config.gyro.bias_walk,
        &mut config.accelerometer.noise_density,
        &mut config.accelerometer.bias_walk,
        &mut config.bridge.noise_strain,
        &mut config.bridge.drift_walk_strain,
    ] {
        *sigma = 0.0;
    }
    config
}

fn sensors(config: &SensorConfig, imperfections: &Drawn) -> Sensors {
    Sensors::new(config, imperfections, 1, 2).unwrap()
}

/// Inputs of two axles at rest and of a straight frame with the given number of gauges.
fn at_rest(gauges: usize) -> Truth {
    Truth {
        axles: vec![AxleTruth::default(); 2],
        strains: vec![vec![0.0; gauges]],
    }
}

fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    (mean, (square / (n - 1.0)).sqrt())
}

#[test]
fn gauges_creep_and_warm() {
    let mut config = clean();
    config.bridge.converter_bits = 24;
    config.bridge.creep_share = 0.01;
    config.bridge.creep_time_s = 0.5;
    config.bridge.warming_k = 10.0;
    config.bridge.warming_time_s = 0.25;
    config.bridge.gain_per_k = 1e-4;
    let mut drawn = Drawn::none(Topology::PAIR);
    drawn.frames[0].bridge_zero_per_k[1] = 0.4e-6;
    let mut sensors = Sensors::new(&config, &drawn, 1, 1).unwrap();
    let mut truth = at_rest(2);
    truth.strains[0].fill(1e-3);
    let per_count = config.bridge.strain_per_count();
    for tick in 1..=3000 {
        let counts = sensors.sample(&truth).frames[0];
        if ![500, 3000].contains(&tick) {
            continue;
        }
        let (t, left) = (1e-3 * f64::from(tick), |time: f64, t: f64| {
            (-t / time).exp()
        });
        let warmth = 10.0 * (1.0 - left(0.25, t));
        let held = 1e-3 * (1.0 - 0.01 * (1.0 - left(0.5, t))) * (1.0 + 1e-4 * warmth);
        for (bridge, zero) in [(0, 0.0), (1, 0.4e-6)] {
            let measured = f64::from(counts[bridge]) * per_count;
            let expected = held + zero * warmth;
            assert!((measured - expected).abs() < 2e-8, "{measured} {expected}");
        }
    }
}

#[test]
fn defaults_are_valid_and_survive_toml() {
    let config = SensorConfig::default();
    config.check().unwrap();
    let text = toml::to_string(&config).unwrap();
    assert_eq!(toml::from_str::<SensorConfig>(&text).unwrap(), config);
    let part: SensorConfig = toml::from_str("[gyro]\nfitted = true").unwrap();
    assert!(part.gyro.fitted && part.gyro.noise_density == config.gyro.noise_density);
    let error = toml::from_str::<SensorConfig>("[gyro]\nfited = true").unwrap_err();
    assert!(error.to_string().contains("fited"));
}

#[test]
fn bad_parameters_are_named() {
    for entry in [
        "bridge.bandwidth_hz = 0.0",
        "gyro.noise_density = nan",
        "encoder.delay_ms = 32",
        "bridge.active_gauges = 3",
        "bridge.converter_bits = 0",
        "geometry.track_sigma = -1.0",
    ] {
        let config: SensorConfig = toml::from_str(entry).unwrap();
        let (key, _) = entry.split_once(" = ").unwrap();
        let why = config.check().unwrap_err().to_string();
        assert!(why.starts_with(&format!("sensors.{key} = ")), "{why}");
        assert!(Sensors::new(&config, &Drawn::none(Topology::PAIR), 0, 0).is_err());
    }
}

#[test]
fn encoder_counts_one_revolution_and_wraps() {
    let config = clean();
    let mut sensors = sensors(&config, &Drawn::none(Topology::PAIR));
    let mut at = |angle: f64| {
        let mut truth = at_rest(0);
        truth.axles[1].wheel_angle[0] = angle;
        sensors.sample(&truth).axles[1].encoder_counts[0].unwrap()
    };
    assert_eq!(at(0.0), 0);
    assert_eq!(at(TAU * 1.000_001), 8192);
    assert_eq!(at(-TAU * 0.999_999), -8192);
    // 2^31 counts are 2^18 revolutions, where the counter wraps around to its least value.
    assert_eq!(at(TAU * (262_144.0 + 0.5 / 8192.0)), i32::MIN);
}

#[test]
fn encoder_phase_is_uniform_over_a_count() {
    let config = clean();
    let phases: Vec<f64> = (0..500)
        .flat_map(|trial| {
            let drawn = config.draw(Topology::PAIR, 3, trial);
            drawn.encoder_phase.into_iter().flatten()
        })
        .collect();
    assert!(phases.iter().all(|p| (0.0..1.0).contains(p)));
    let (mean, sd) = mean_and_sd(&phases);
    assert!((mean - 0.5).abs() < 0.03, "{mean}");
    assert!((sd - 12f64.sqrt().recip()).abs() < 0.02, "{sd}");
}

#[test]
fn drawn_errors_have_the_configured_spread_and_common_random_numbers() {
    let config = SensorConfig::default();
    let drawn: Vec<_> = (0..2000)
        .map(|trial| config.draw(Topology::PAIR, 7, trial))
        .collect();
    let spread = |value: &dyn Fn(&Drawn) -> f64, mean: f64, sigma: f64| {
        let values: Vec<f64> = drawn.iter().map(value).collect();
        let (m, s) = mean_and_sd(&values);
        assert!((m - mean).abs() < 0.09 * sigma, "mean {m} of {mean}");
        assert!((s / sigma - 1.0).abs() < 0.07, "sd {s} of {sigma}");
    };
    spread(&|d| d.wheel_radius_factor[1][0], 1.0, 1e-3);
    spread(&|d| d.track_factor[0], 1.0, 3e-3);
    spread(&|d| d.placement[2], 0.0, 2e-3);
    spread(&|d| d.frames[0].bridge_offset[4], 0.0, 200e-6);
    spread(&|d| d.frames[0].gauge_shift_m[2], 0.0, 0.3e-3);
    // Drift is the sum of the bridge's own and the common part. The common part cancels in the difference of two
    // bridges.
    spread(&|d| d.frames[0].bridge_drift[3], 0.0, 2f64.sqrt() * 1e-6);
    spread(
        &|d| d.frames[0].bridge_drift[3] - d.frames[0].bridge_drift[0],
        0.0,
        2f64.sqrt() * 1e-6,
    );
    // Bias: noise of 4.9e-5 rad/s/√Hz averaged over 1 s, then a random walk of 5e-5 rad/s/√s for 60 s.
    let sigma = (4.9e-5f64.powi(2) * 0.5 + 5e-5f64.powi(2) * 60.0).sqrt();
    spread(&|d| d.gyro_bias[0], 0.0, sigma);

    let mut other = config.clone();
    other.gyro.fitted = true;
    other.geometry.wheel_radius_sigma = 2e-3;
    let twin = other.draw(Topology::PAIR, 7, 5);
    assert_eq!(twin.frames[0].bridge_drift, drawn[5].frames[0].bridge_drift);
    for (one, two) in drawn[5].wheel_radius_factor[0]
        .iter()
        .zip(twin.wheel_radius_factor[0])
    {
        assert!(((two - 1.0) - 2.0 * (one - 1.0)).abs() < 1e-12);
    }
    assert_ne!(drawn[5], drawn[6]);
    assert_ne!(drawn[5], config.draw(Topology::PAIR, 8, 5));
}

#[test]
fn streams_do_not_depend_on_what_else_is_fitted() {
    let bare = SensorConfig::default();
    let mut full = bare.clone();
    full.gyro.fitted = true;
    full.accelerometer.fitted = true;
    let drawn = bare.draw(Topology::PAIR, 11, 0);
    let run = |config: &SensorConfig, gauge_count| {
        let mut sensors = Sensors::new(config, &drawn, 11, 0).unwrap();
        let mut truth = at_rest(gauge_count);
        truth.strains[0].fill(1e-4);
        let mut sample = |_| sensors.sample(&truth).clone();
        (0..300).map(&mut sample).collect::<Vec<_>>()
    };
    let (few, many) = (run(&bare, 3), run(&full, 5));
    for (a, b) in few.iter().zip(&many) {
        assert_eq!(a.frames[0][..3], b.frames[0][..3]);
        assert_eq!(a.frames[0][3], 0);
        assert!(a.axles[0].gyro.is_none() && b.axles[0].gyro.is_some());
    }
    assert_eq!(many, run(&full, 5));
}

#[test]
fn noise_of_the_sensors_is_white_and_uncorrelated() {
    let mut config = clean();
    config.bridge.noise_strain = 5e-6;
    config.gyro.noise_density = 4.9e-5;
    let mut sensors = sensors(&config, &Drawn::none(Topology::PAIR));
    let truth = at_rest(2);
    let n = 20_000;
    let mut series = [const { Vec::new() }; 4];
    for _ in 0..n {
        let sample = sensors.sample(&truth);
        let scale = config.bridge.strain_per_count();
        series[0].push(f64::from(sample.frames[0][0]) * scale);
        series[1].push(f64::from(sample.frames[0][1]) * scale);
        series[2].push(f64::from(sample.axles[0].gyro.unwrap()));
        series[3].push(f64::from(sample.axles[1].gyro.unwrap()));
    }
    let correlation = |a: &[f64], b: &[f64]| {
        let ((ma, sa), (mb, sb)) = (mean_and_sd(a), mean_and_sd(b));
        let sum: f64 = a.iter().zip(b).map(|(x, y)| (x - ma) * (y - mb)).sum();
        sum / (n as f64 * sa * sb)
    };
    for i in 0..4 {
        for j in 0..i {
            assert!(correlation(&series[i], &series[j]).abs() < 0.03, "{i} {j}");
        }
        let lag = correlation(&series[i][1..], &series[i][..n - 1]);
        assert!(lag.abs() < 0.03, "{i}: {lag}");
    }
    // Quantisation adds q²/12 to the variance.
    let expected = (25e-12 + config.bridge.strain_per_count().powi(2) / 12.0).sqrt();
    assert!((mean_and_sd(&series[0]).1 / expected - 1.0).abs() < 0.03);
    // Half the sample rate is the bandwidth: 4.9e-5·√500 = 1.0957e-3.
    assert!((mean_and_sd(&series[2]).1 / 1.0957e-3 - 1.0).abs() < 0.03);
}

#[test]
fn bridge_counts_match_hand_calculation() {
    let config = clean();
    // 1000 µε · 2.1 = 2.1 mV/V; ·60 = 0.126 of the reference; ·2^14 = 2064.4 counts.
    let mut truth = at_rest(1);
    truth.strains[0][0] = 1e-3;
    let mut ideal = sensors(&config, &Drawn::none(Topology::PAIR));
    assert_eq!(ideal.sample(&truth).frames[0][0], 2064);
    // A bridge with half the active gauges gives half the counts.
    let mut half = config.clone();
    half.bridge.active_gauges = 2;
    let mut half = sensors(&half, &Drawn::none(Topology::PAIR));
    assert_eq!(half.sample(&truth).frames[0][0], 1032);
    // Gain error acts on the strain, not on the offset: 1110 µε, not 1111.
    let mut bad = Drawn::none(Topology::PAIR);
    bad.frames[0].bridge_gain_error[0] = 0.01;
    bad.frames[0].bridge_offset[0] = 100e-6;
    let mut bad = sensors(&config, &bad);
    assert_eq!(bad.sample(&truth).frames[0][0], 2291);
    truth.strains[0][0] = 1.0;
    assert_eq!(
        sensors(&config, &Drawn::none(Topology::PAIR))
            .sample(&truth)
            .frames[0][0],
        8191
    );
    truth.strains[0][0] = -1.0;
    assert_eq!(
        sensors(&config, &Drawn::none(Topology::PAIR))
            .sample(&truth)
            .frames[0][0],
        -8192
    );
}

#[test]
fn stored_zero_removes_offset_but_not_drift() {
    let config = clean();
    let mut drawn = config.draw(Topology::PAIR, 5, 9);
    drawn.frames[0].bridge_drift = [3e-6; MAX_GAUGES];
    let zero = config.bridge.zero_counts(&drawn.frames[0]);
    let mut sensors = sensors(&config, &drawn);
    let sample = sensors.sample(&at_rest(MAX_GAUGES));
    for (counts, zero) in sample.frames[0].iter().zip(zero) {
        let strain = (f64::from(*counts) - zero) * config.bridge.strain_per_count();
        assert!((strain - 3e-6).abs() < 0.51 * config.bridge.strain_per_count());
    }
}

#[test]
fn amplifier_lags_a_ramp_by_its_time_constant() {
    let mut filter = LowPass::new(200.0);
    let tau = 1.0 / (TAU * 200.0);
    filter.pass(0.0);
    let mut measured = 0.0;
    for k in 1..=50 {
        measured = filter.pass(f64::from(k) * SAMPLE_PERIOD_S);
        let t = f64::from(k) * SAMPLE_PERIOD_S;
        // Ramp response of a first-order lag.
        let exact = t - tau * (1.0 - (-t / tau).exp());
        assert!((measured - exact).abs() < 1e-12);
    }
    assert!((50.0 * SAMPLE_PERIOD_S - measured - tau).abs() < 1e-9);
}

#[test]
fn samples_have_the_configured_delay() {
    let mut config = clean();
    config.encoder.delay_ms = 3;
    config.gyro.delay_ms = 1;
    config.bridge.delay_ms = 31;
    config.bridge.bandwidth_hz = 1e9;
    let mut sensors = sensors(&config, &Drawn::none(Topology::PAIR));
    for k in 0..100 {
        let t = f64::from(k);
        let mut truth = at_rest(1);
        truth.axles.fill(AxleTruth {
            wheel_angle: [(t + 0.25) * TAU / 8192.0; 2],
            yaw_rate: t * 0.01,
            ..AxleTruth::default()
        });
        truth.strains[0][0] = t * config.bridge.strain_per_count();
        let sample = sensors.sample(&truth);
        assert_eq!(sample.axles[0].encoder_counts[1], Some((k - 3).max(0)));
        let late = f64::from((k - 1).max(0)) * 0.01;
        assert!((f64::from(sample.axles[1].gyro.unwrap()) - late).abs() < 1e-4);
        assert_eq!(sample.frames[0][0], (k - 31).max(0));
    }
}

#[test]
fn inertial_readings_are_scaled_biased_quantised_and_limited() {
    let config = clean();
    let mut drawn = Drawn::none(Topology::PAIR);
    drawn.gyro_bias = vec![0.01, -0.02];
    drawn.gyro_scale_error = vec![0.0, 0.005];
    let mut sensors = sensors(&config, &drawn);
    let mut truth = at_rest(0);
    for (axle, (rate, force)) in truth.axles.iter_mut().zip([(1.0, 100.0), (2.0, -100.0)]) {
        axle.yaw_rate = rate;
        axle.forward_acceleration = force;
    }
    let sample = sensors.sample(&truth);
    let step = 2.0 * 4.36 / 65536.0;
    assert!((f64::from(sample.axles[0].gyro.unwrap()) - 1.01).abs() < 0.51 * step);
    assert!((f64::from(sample.axles[1].gyro.unwrap()) - 1.99).abs() < 0.51 * step);
    assert!((sample.axles[0].accelerometer.unwrap() - 19.6).abs() < 1e-3);
    assert_eq!(sample.axles[1].accelerometer, Some(-19.6));
    truth.axles[0].yaw_rate = 0.0;
    let counts = f64::from(sensors.sample(&truth).axles[0].gyro.unwrap()) / step;
    assert!((counts - counts.round()).abs() < 1e-4);
}

#[test]
fn bias_walks_with_the_square_root_of_time() {
    let mut config = clean();
    config.gyro.bias_walk = 0.01;
    let ends: Vec<f64> = (0..400)
        .map(|trial| {
            let none = Drawn::none(Topology::PAIR);
            let mut sensors = Sensors::new(&config, &none, 21, trial).unwrap();
            let truth = at_rest(0);
            let mut sample = |_| sensors.sample(&truth).axles[0].gyro;
            let last = (0..4001).map(&mut sample).last().unwrap();
            f64::from(last.unwrap())
        })
        .collect();
    // A random walk of 0.01 rad/s/√s has a standard deviation of 0.02 rad/s after 4 s.
    let (mean, sd) = mean_and_sd(&ends);
    assert!(mean.abs() < 0.003, "{mean}");
    assert!((sd / 0.02 - 1.0).abs() < 0.12, "{sd}");
}

#[test]
fn values_that_are_not_finite_reach_the_boards_as_bad_samples() {
    let config = clean();
    let full = config.bridge.full_scale_counts() - 1;
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut sensors = sensors(&config, &Drawn::none(Topology::PAIR));
        let good = at_rest(1);
        let before = sensors.sample(&good).clone();
        let mut truth = good.clone();
        truth.axles[1].wheel_angle[0] = bad;
        truth.axles[1].yaw_rate = f64::NAN;
        truth.strains[0][0] = bad;
        let sample = sensors.sample(&truth).clone();
        assert_eq!(sample.axles[1].encoder_counts, [None, Some(0)]);
        assert!(sample.axles[1].gyro.unwrap().is_nan());
        assert_eq!(
            (sample.frames[0][0], sample.axles[0]),
            (full, before.axles[0])
        );
        assert_eq!(
            *sensors.sample(&good),
            before,
            "the bad sample leaves no trace"
        );
    }
    // Huge, but finite.
    let mut sensors = sensors(&config, &Drawn::none(Topology::PAIR));
    let mut truth = at_rest(1);
    truth.strains[0][0] = 1e300;
    assert_eq!(sensors.sample(&truth).frames[0][0], full);
    for _ in 0..10_000 {
        sensors.sample(&at_rest(1));
    }
    assert!(sensors.sample(&at_rest(1)).frames[0][0].abs() < full);
}
