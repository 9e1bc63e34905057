//! Compares the filter with a textbook filter: f64, full matrices, one batch update per step.

use super::*;
use crate::fusion::compound::Chain;
use crate::fusion::testing::{
    Matrix, Random, covariance_error, inverse, is_definite, product, quadratic, random_covariance,
    transpose, wide, wrap,
};
use crate::math::matrix::Mat3;

/// The x of `m x = b`, by elimination with pivoting.
fn solve<const N: usize>(mut m: Matrix<N, N>, mut b: Matrix<N, N>) -> Matrix<N, N> {
    for c in 0..N {
        let p = (c..N)
            .max_by(|&i, &j| m[i][c].abs().total_cmp(&m[j][c].abs()))
            .unwrap();
        m.swap(c, p);
        b.swap(c, p);
        for i in (0..N).filter(|&i| i != c) {
            let f = m[i][c] / m[c][c];
            for k in 0..N {
                m[i][k] -= f * m[c][k];
                b[i][k] -= f * b[c][k];
            }
        }
    }
    core::array::from_fn(|i| b[i].map(|entry| entry / m[i][i]))
}

/// The textbook filter.
#[derive(Clone)]
struct Reference {
    t: f64,
    track: f64,
    q: Matrix<7, 7>,
    r: [f64; 4],
    r_fix: Matrix<3, 3>,
    x: [f64; 7],
    p: Matrix<7, 7>,
}

impl Reference {
    fn motion(&self, x: &[f64; 7]) -> [f64; 7] {
        let t = self.t;
        let [px, py, phi, v, w, a, b] = *x;
        let ds = v * t + a * t * t / 2.0;
        let dphi = w * t + b * t * t / 2.0;
        let m = phi + dphi / 2.0;
        [
            px + ds * m.cos(),
            py + ds * m.sin(),
            phi + dphi,
            v + a * t,
            w + b * t,
            a,
            b,
        ]
    }

    fn predict(&mut self) {
        // The Jacobian comes from central differences, independent of any derivative written by hand.
        let mut a = [[0.0; 7]; 7];
        let h = 1e-4;
        for k in 0..7 {
            let (mut low, mut high) = (self.x, self.x);
            low[k] -= h;
            high[k] += h;
            let (low, high) = (self.motion(&low), self.motion(&high));
            for i in 0..7 {
                a[i][k] = (high[i] - low[i]) / (2.0 * h);
            }
        }
        self.x = self.motion(&self.x);
        self.p = product(&product(&a, &self.p), &transpose(&a));
        for i in 0..7 {
            for j in 0..7 {
                self.p[i][j] += self.q[i][j];
            }
        }
    }

    /// One batch update by the measurements present; rows of absent measurements are zero.
    fn update(&mut self, z: &[Option<f64>; 4], fix: Option<[f64; 3]>) {
        let half = self.track / 2.0;
        let rows = [
            [0.0, 0.0, 0.0, 1.0, -half, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0, half, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        ];
        let (mut h, mut nu, mut r) = ([[0.0; 7]; 7], [0.0; 7], [[0.0; 7]; 7]);
        for k in 0..7 {
            r[k][k] = 1.0;
        }
        for k in 0..4 {
            if let Some(z) = z[k] {
                nu[k] = z - (0..7).map(|j| rows[k][j] * self.x[j]).sum::<f64>();
                h[k] = rows[k];
                r[k][k] = self.r[k];
            }
        }
        if let Some(z) = fix {
            for k in 0..3 {
                let d = z[k] - self.x[k];
                nu[4 + k] = if k == 2 { wrap(d) } else { d };
                h[4 + k][k] = 1.0;
                r[4 + k][4..].copy_from_slice(&self.r_fix[k]);
            }
        }
        let hp = product(&h, &self.p);
        let mut s = product(&hp, &transpose(&h));
        for i in 0..7 {
            for j in 0..7 {
                s[i][j] += r[i][j];
            }
        }
        // Kᵀ = S⁻¹ H P.
        let gain = transpose(&solve(s, hp));
        let fall = product(&gain, &hp);
        for i in 0..7 {
            self.x[i] += (0..7).map(|k| gain[i][k] * nu[k]).sum::<f64>();
            for j in 0..7 {
                self.p[i][j] -= 0.5 * (fall[i][j] + fall[j][i]);
            }
        }
    }
}

/// Filter and reference with the same parameters and the same start.
fn pair(
    period: f32,
    q: Mat<7, 7>,
    sigmas: [f32; 4],
    r_fix: Mat3,
    x0: [f32; 7],
    p0: Mat<7, 7>,
) -> (AxleFilter, Fix, State, Reference) {
    let track = 0.324f32;
    let config = Config {
        period_s: period,
        track_m: track,
        left_sigma_m_s: sigmas[0],
        right_sigma_m_s: sigmas[1],
        gyro_sigma_rad_s: sigmas[2],
        accelerometer_sigma_m_s2: sigmas[3],
        innovation_gate: None,
        fix_gate: None,
        ..Config::default()
    };
    let reference = Reference {
        t: period as f64,
        track: track as f64,
        q: wide(&q),
        r: sigmas.map(|s| s as f64 * s as f64),
        r_fix: wide(&r_fix),
        x: x0.map(f64::from),
        p: wide(&p0),
    };
    let filter = config.build_with(ProcessNoise::Fixed(q)).unwrap();
    let fix = Fix::new(&r_fix).unwrap();
    (filter, fix, State::from_parts(x0, &p0), reference)
}

/// Largest error of a posture component (m or rad), and largest normalised covariance error.
fn errors(state: &State, reference: &Reference) -> (f64, f64) {
    let p = state.covariance().matrix();
    let posture = state.precise_posture();
    let mut pose = 0.0f64;
    for k in 0..3 {
        let d = posture[k] - reference.x[k];
        pose = pose.max(if k == 2 { wrap(d).abs() } else { d.abs() });
    }
    (pose, covariance_error(&p, &reference.p))
}

fn is_positive_definite(state: &State) -> bool {
    is_definite(&wide(&state.covariance().matrix()))
}

/// Sensor samples of a drive with changing speed and turning, with noise.
fn drive(random: &mut Random, time: f64, sigmas: [f32; 4], loss: f64) -> Measurements {
    let v = 0.3 * (1.3 * time).sin();
    let w = 0.9 * (0.7 * time).cos();
    let a = 0.39 * (1.3 * time).cos();
    let values = [v - 0.162 * w, v + 0.162 * w, w, a];
    measured([0, 1, 2, 3].map(|k| {
        let noisy = (values[k] + sigmas[k] as f64 * random.normal()) as f32;
        (random.uniform() >= loss).then_some(noisy)
    }))
}

/// Measurements from the values of left wheel, right wheel, gyro and accelerometer.
fn measured(values: [Option<f32>; 4]) -> Measurements {
    let [left_m_s, right_m_s, gyro_rad_s, acceleration_m_s2] = values;
    Measurements {
        left_m_s,
        right_m_s,
        gyro_rad_s,
        acceleration_m_s2,
    }
}

fn as_wide(m: &Measurements) -> [Option<f64>; 4] {
    [m.left_m_s, m.right_m_s, m.gyro_rad_s, m.acceleration_m_s2].map(|z| z.map(f64::from))
}

/// Standard deviations of a case: `q` process noise, `p` start, `r` wheels, gyro and accelerometer, `fix` posture fix.
struct Levels {
    q: [f32; 7],
    p: [f32; 7],
    r: [f32; 4],
    fix: [f32; 3],
}

const TYPICAL: Levels = Levels {
    q: [1e-5, 1e-5, 2e-5, 2e-3, 1e-2, 3e-2, 0.2],
    p: [0.02, 0.02, 0.03, 0.05, 0.1, 0.3, 0.5],
    r: [0.02, 0.02, 0.005, 0.1],
    fix: [0.01, 0.01, 0.01],
};

const STRONG_MEASUREMENTS: Levels = Levels {
    p: [0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 1.0],
    r: [1e-3, 3e-3, 1e-3, 1e-2],
    ..TYPICAL
};

const GOOD_ODOMETRY: Levels = Levels {
    q: [1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-2, 1e-2],
    p: [1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 0.1, 0.1],
    r: [1e-3, 1e-3, 1e-4, 0.03],
    fix: [2e-3, 2e-3, 2e-3],
};

/// Runs filter and reference for 500 steps; returns the largest errors.
fn compare(levels: &Levels, seed: u64, period: f32, fix_every: usize, loss: f64) -> (f64, f64) {
    let mut random = Random::new(seed);
    let q = random_covariance(&mut random, levels.q, 0.4);
    let p0 = random_covariance(&mut random, levels.p, 0.4);
    let r_fix = random_covariance(&mut random, levels.fix, 0.4);
    let x0 = [-1.342, 0.7, 3.0, 0.0, 0.9, 0.39, 0.0];
    let (filter, fix, mut state, mut reference) = pair(period, q, levels.r, r_fix, x0, p0);
    let (mut pose, mut covariance) = (0.0f64, 0.0f64);
    for step in 1..=500 {
        let time = step as f64 * period as f64;
        let z = drive(&mut random, time, levels.r, loss);
        filter.step(&mut state, &z);
        reference.predict();
        reference.update(&as_wide(&z), None);
        if fix_every > 0 && step % fix_every == 0 {
            let mut measured = [0.0f32; 3];
            for k in 0..3 {
                measured[k] = (reference.x[k] + levels.fix[k] as f64 * random.normal()) as f32;
            }
            let measured64 = measured.map(f64::from);
            filter.update_fix(&mut state, &Posture::from(measured), &fix);
            reference.update(&[None; 4], Some(measured64));
        }
        let (p, c) = errors(&state, &reference);
        pose = pose.max(p);
        covariance = covariance.max(c);
    }
    (pose, covariance)
}

#[test]
fn equals_the_textbook_filter() {
    for levels in [TYPICAL, STRONG_MEASUREMENTS, GOOD_ODOMETRY] {
        for seed in 0..8 {
            for period in [1e-3, 5e-3, 2e-2] {
                for fix_every in [0, 10, 100] {
                    for loss in [0.0, 0.3] {
                        let (pose, covariance) = compare(&levels, seed, period, fix_every, loss);
                        assert!(
                            pose < 5e-6 && covariance < 2e-4,
                            "{period} {fix_every} {loss}: {pose:e} {covariance:e}"
                        );
                    }
                }
            }
        }
    }
}

/// With noise given as densities and wheels of equal noise, speed and yaw rate are two separate filters. A lost wheel
/// measurement couples them until some time after its return.
#[test]
fn equals_the_textbook_filter_with_speed_and_yaw_rate_separate() {
    let noise = Densities {
        along_m_per_sqrt_m: 0.0,
        across_m_per_sqrt_m: 0.0,
        heading_rad_per_sqrt_m: 0.0,
        along_m_per_sqrt_s: 3e-4,
        across_m_per_sqrt_s: 3e-4,
        heading_rad_per_sqrt_s: 5e-4,
        jerk_m_s3_per_sqrt_hz: 3.0,
        yaw_jerk_rad_s3_per_sqrt_hz: 20.0,
    };
    let sigmas = [0.02, 0.02, 0.005, 0.1];
    for (period, loss) in [(1e-3f32, 0.0), (1e-3, 0.01), (5e-3, 0.3), (2e-2, 0.0)] {
        let config = Config {
            period_s: period,
            noise,
            accelerometer_sigma_m_s2: sigmas[3],
            ..Config::default()
        };
        let t = period as f64;
        let variance = |density: f32| t * (density as f64).powi(2);
        let mut q = [[0.0; 7]; 7];
        for k in 0..3 {
            q[k][k] = variance([3e-4, 3e-4, 5e-4][k]);
        }
        for (state, density) in [(3, 3.0), (4, 20.0)] {
            let jerk = variance(density);
            q[state][state] = jerk * t * t / 4.0;
            q[state][state + 2] = jerk * t / 2.0;
            q[state + 2][state] = jerk * t / 2.0;
            q[state + 2][state + 2] = jerk;
        }
        let p0 = matrix::diagonal([1e-4, 1e-4, 1e-3, 1e-3, 1e-2, 1e-1, 0.5]);
        let r_fix = matrix::diagonal([1e-4; 3]);
        let x0 = [-1.342, 0.7, 3.0, 0.0, 0.9, 0.39, 0.0];
        let (_, _, mut state, mut reference) = pair(period, [[0.0; 7]; 7], sigmas, r_fix, x0, p0);
        reference.q = q;
        let filter = config.build().unwrap();
        let mut random = Random::new(23);
        let mut coupled = [0, 0];
        for step in 1..=2000 {
            // Measurements are lost only before step 300, so that the coupling can decay.
            let loss = if step < 300 { loss } else { 0.0 };
            let z = drive(&mut random, step as f64 * t, sigmas, loss);
            filter.step(&mut state, &z);
            reference.predict();
            reference.update(&as_wide(&z), None);
            let (pose, covariance) = errors(&state, &reference);
            let most = if step <= 100 { 1e-5 } else { 2e-4 };
            assert!(
                pose < 1e-6 && covariance < most,
                "{step}: {pose:e} {covariance:e}"
            );
            coupled[usize::from(state.covariance().is_coupled())] += 1;
        }
        // Coupled steps occur only with losses, and the coupling decays.
        assert_eq!(coupled[1] > 0, loss > 0.0);
        assert!(!state.covariance().is_coupled(), "{period} {loss}");
    }
}

/// A filter as on the node, with its gates on or off.
fn node_filter(gated: bool) -> AxleFilter {
    let mut config = Config::default();
    if !gated {
        config.innovation_gate = None;
        config.fix_gate = None;
    }
    config.build().unwrap()
}

fn start() -> State {
    let start = Estimate::with_sigmas(Posture::ORIGIN, [1e-3, 1e-3, 2e-3]);
    State::at_rest(&start, [0.01, 0.01, 0.1, 0.1])
}

#[test]
fn positive_definite_over_a_million_steps_with_and_without_fixes() {
    let filter = node_filter(false);
    let fix = Fix::new(&matrix::diagonal([4e-6, 4e-6, 1e-5])).unwrap();
    for (with_fixes, seed) in [(true, 3), (false, 4)] {
        let (mut state, mut random) = (start(), Random::new(seed));
        let mut last = 0.0;
        for step in 0..1_000_000u32 {
            let z = drive(&mut random, step as f64 * 1e-3, TYPICAL.r, 0.0);
            filter.step(&mut state, &z);
            if with_fixes && step % 100 == 99 {
                filter.update_fix(&mut state, &Posture::ORIGIN, &fix);
            }
            if step % 1009 == 0 {
                assert!(is_positive_definite(&state), "step {step}");
            }
            if !with_fixes && step % 100_000 == 99_999 {
                // Nothing observes the heading: its variance must grow.
                let heading = state.covariance().posture()[PHI][PHI];
                assert!(heading > last);
                last = heading;
            }
        }
        assert!(state.is_finite() && is_positive_definite(&state));
    }
}

#[test]
fn position_and_heading_keep_their_digits_over_a_million_steps() {
    // Only the motion model runs, on a circle of many turns.
    let filter = node_filter(false);
    let (v, omega) = (0.3f32, 0.41f32);
    let mut state = State::from_parts(
        [2.0, -1.0, 0.5, v, omega, 0.0, 0.0],
        &matrix::diagonal([1e-6; 7]),
    );
    let (t, v, omega) = (1e-3f32 as f64, v as f64, omega as f64);
    for _ in 0..1_000_000 {
        filter.predict(&mut state);
    }
    // The positions are those of a regular polygon with equal chords: the sum of a geometric series of rotations.
    let (turn, n) = (omega * t, 1e6);
    let radius = v * t / (2.0 * (turn / 2.0).sin());
    let (first, last) = (0.5f32 as f64, 0.5 + n * turn);
    let x = 2.0 + radius * (last.sin() - first.sin());
    let y = -1.0 - radius * (last.cos() - first.cos());
    let p = state.posture();
    assert!((p.x as f64 - x).abs() < 2e-5, "{} {x}", p.x);
    assert!((p.y as f64 - y).abs() < 2e-5, "{} {y}", p.y);
    assert!(wrap(p.phi as f64 - last).abs() < 2e-5, "{}", p.phi);
}

#[test]
fn heading_wraps_in_state_and_innovation() {
    let filter = node_filter(false);
    let fix = Fix::new(&matrix::diagonal([1e-4, 1e-4, 1e-4])).unwrap();
    let pi = core::f32::consts::PI;
    for side in [1.0, -1.0] {
        let at = [0.0, 0.0, side * (pi - 0.01), 0.0, 0.0, 0.0, 0.0];
        let mut state = State::from_parts(at, &matrix::diagonal([1e-4; 7]));
        // The fix lies 0.02 rad further, beyond the wrap; with equal variances the estimate moves halfway, to the wrap.
        let measured = Posture::new(0.0, 0.0, -side * (pi - 0.01));
        filter.update_fix(&mut state, &measured, &fix);
        assert!((state.posture().phi.abs() - pi).abs() < 1e-5);
        filter.update_fix(&mut state, &measured, &fix);
        assert!(state.posture().phi * side < 0.0);
    }
}

#[test]
fn sample_not_finite_is_counted_and_changes_nothing() {
    let filter = node_filter(true);
    let reference = start();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut state = reference;
        let verdicts = filter.update(&mut state, &measured([Some(bad); 4]));
        assert_eq!(verdicts.left, Verdict::Invalid);
        assert_eq!(verdicts.gyro, Verdict::Invalid);
        let fix = Fix::new(&matrix::diagonal([1e-4; 3])).unwrap();
        let measured = Posture::new(0.0, bad, 0.0);
        assert_eq!(
            filter.update_fix(&mut state, &measured, &fix),
            Verdict::Invalid
        );
        assert_eq!(state.counters.right.invalid, 1);
        assert_eq!(state.counters.accelerometer.invalid, 1);
        assert_eq!(state.counters.fix.invalid, 1);
        state.counters = reference.counters;
        assert_eq!(state, reference);
    }
}

#[test]
fn nis_above_the_gate_or_nan_is_rejected_until_patience_ends() {
    let mut refusals = Refusals::default();
    let nan = refusals.verdict(|| f32::NAN, Some(20.0), 5);
    // Squared innovation and variance are infinite, so the NIS is NaN.
    let undefined = refusals.scalar_verdict(1e30, 1.0, || f32::INFINITY, Some(20.0), 5);
    assert_eq!([nan, undefined], [Verdict::Gated; 2]);

    let beyond = 20.0f32.next_up();
    let (gated, used) = (Verdict::Gated, Verdict::Used);
    let mut refusals = Refusals::default();
    for (nis, gate, patience, verdict) in [
        (20.0, Some(20.0), 2, used),
        (beyond, Some(20.0), 0, used),
        (beyond, None, 2, used),
        (beyond, Some(20.0), 2, gated),
        (beyond, Some(20.0), 2, gated),
        (beyond, Some(20.0), 2, used),
        (beyond, Some(20.0), 2, gated),
        (20.0, Some(20.0), 2, used),
        (beyond, Some(20.0), 2, gated),
        (beyond, Some(20.0), 2, gated),
        (beyond, Some(20.0), 2, used),
    ] {
        assert_eq!(refusals.verdict(|| nis, gate, patience), verdict);
    }
    assert_eq!(refusals.gated, 5);
    // NIS of 9/(8 + 1) and 9/(3 + 1): squared innovation over the variances of prediction and noise.
    for (predicted, gate, verdict) in [(8.0, 1.0, used), (3.0, 2.25, used), (3.0, 2.24, gated)] {
        let mut refusals = Refusals::default();
        let found = refusals.scalar_verdict(-3.0, 1.0, || predicted, Some(gate), 5);
        assert_eq!(found, verdict, "{predicted} {gate}");
    }
}

#[test]
fn outlier_is_gated_and_a_persistent_deviation_is_accepted() {
    let filter = node_filter(true);
    let patience = usize::from(Config::default().gate_patience);
    for sensor in 0..4 {
        let mut state = start();
        let rest = measured([Some(0.0); 4]);
        for _ in 0..200 {
            filter.step(&mut state, &rest);
        }
        let mut values = [Some(0.0); 4];
        values[sensor] = Some([3.0, 3.0, 1.0, 50.0][sensor]);
        let spike = measured(values);
        values[sensor] = None;
        let without = measured(values);
        let verdict = |verdicts: Verdicts| {
            let Verdicts {
                left,
                right,
                gyro,
                accelerometer,
            } = verdicts;
            let mut all = [left, right, gyro, accelerometer];
            let own = std::mem::replace(&mut all[sensor], Verdict::Used);
            assert_eq!(all, [Verdict::Used; 4]);
            own
        };
        // A rejected sample changes only the counter of its sensor.
        let mut plain = state;
        assert_eq!(verdict(filter.step(&mut state, &spike)), Verdict::Gated);
        filter.step(&mut plain, &without);
        let mut refused = state;
        refused.counters = plain.counters;
        assert_eq!(refused, plain);
        // One accepted sample resets the number of rejections in a row; then the filter rejects as many as its patience
        // allows.
        filter.step(&mut state, &rest);
        let verdicts: Vec<_> = (0..=patience)
            .map(|_| verdict(filter.step(&mut state, &spike)))
            .collect();
        assert!(verdicts[..patience].iter().all(|v| *v == Verdict::Gated));
        assert_eq!(verdicts[patience], Verdict::Used);
        let counters = &state.counters;
        let counted = [
            counters.left,
            counters.right,
            counters.gyro,
            counters.accelerometer,
        ];
        for (k, refusals) in counted.iter().enumerate() {
            let expected = if k == sensor { 1 + patience } else { 0 };
            assert_eq!(refusals.gated as usize, expected);
        }
    }
}

/// The gate lies 0.1 % above or below the NIS computed in `f64`.
#[test]
fn fix_is_gated_by_the_nis_from_the_lower_triangle() {
    let mut random = Random::new(6);
    for _ in 0..20 {
        let mut noise = random_covariance(&mut random, [2e-3, 3e-3, 4e-3], 0.5);
        let prior = random_covariance(&mut random, [3e-3; 7], 0.3);
        let at = [0.3, -0.2, 3.1, 0.0, 0.0, 0.0, 0.0];
        let measured = Posture::new(0.31, -0.205, -3.17);
        let spread: Matrix<3, 3> = core::array::from_fn(|i| {
            core::array::from_fn(|j| f64::from(noise[i][j]) + f64::from(prior[i][j]))
        });
        let difference = [0.01, -0.005, core::f64::consts::TAU - 6.27];
        let nis = quadratic(&inverse(&spread), difference);
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            noise[i][j] = f32::NAN;
        }
        let fix = Fix::new(&noise).unwrap();
        for (factor, verdict) in [(1.001, Verdict::Used), (0.999, Verdict::Gated)] {
            let config = Config {
                fix_gate: Some((factor * nis) as f32),
                ..Config::default()
            };
            let before = State::from_parts(at, &prior);
            let mut state = before;
            let found = config
                .build()
                .unwrap()
                .update_fix(&mut state, &measured, &fix);
            assert_eq!(found, verdict);
            assert_eq!(
                state.posture() != before.posture(),
                verdict == Verdict::Used
            );
        }
    }
    // The heading wraps after a displacement of more than half a turn.
    let mut state = start();
    state.advance([1.0, 0.0, 0.0]);
    state.advance([3e-8, 0.0, 20.0]);
    let turned = wrap(f64::from(state.posture().phi) - 20.0);
    assert!(turned.abs() < 2e-6 && state.posture().phi.abs() <= core::f32::consts::PI);
}

#[test]
fn fix_noise_that_is_not_positive_definite_is_rejected() {
    assert!(Fix::new(&matrix::diagonal([1e-4; 3])).is_some());
    for k in 0..3 {
        for bad in [0.0, -1e-4, f32::INFINITY, f32::NAN] {
            let mut noise = matrix::diagonal([1e-4; 3]);
            noise[k][k] = bad;
            assert!(Fix::new(&noise).is_none(), "{k} {bad}");
        }
    }
    for (i, j) in [(1, 0), (2, 0), (2, 1)] {
        let mut noise = matrix::diagonal([1.0; 3]);
        noise[i][j] = 1.0;
        assert!(Fix::new(&noise).is_none(), "{i} {j}");
    }
}

#[test]
fn shift_moves_the_position_and_nothing_else() {
    let mut state = State::from_parts([1.0, 2.0, 0.5, 0.1, 0.2, 0.3, 0.4], &[[0.0; 7]; 7]);
    let mut expected = state;
    state.shift([0.25, -0.5]);
    expected.posture[X] = 1.25.into();
    expected.posture[Y] = 1.5.into();
    assert_eq!(state, expected);
}

#[test]
fn state_is_finite_only_if_every_part_is() {
    let bad = f32::NAN;
    assert!(start().is_finite());
    for k in 0..M {
        let mut state = start();
        state.motion[k] = bad;
        assert!(!state.is_finite());
    }
    for k in 0..3 {
        let mut state = start();
        state.posture[k].low = bad;
        assert!(!state.is_finite());
        let mut covariance = matrix::diagonal([1e-4; 7]);
        covariance[k][3] = bad;
        assert!(!State::from_parts([0.0; 7], &covariance).is_finite());
    }
}

#[test]
fn compounded_increments_carry_the_whole_covariance() {
    // One filter runs without interruption. The other gives increments every 10 ms, compounded here.
    let filter = node_filter(false);
    let (mut whole, mut parts) = (start(), start());
    let first = parts.take_increment();
    let mut last = first.posture;
    let mut total = Estimate::new(first.posture, first.covariance);
    let mut random = Random::new(8);
    for step in 1..=5000u32 {
        let z = drive(&mut random, step as f64 * 1e-3, TYPICAL.r, 0.0);
        filter.step(&mut whole, &z);
        filter.step(&mut parts, &z);
        if step % 10 == 0 {
            let increment = parts.take_increment();
            let delta = increment.posture.relative_to(last);
            last = increment.posture;
            // Turn the noise from the end frame into the start frame.
            let (s, c) = sin_cos(delta.phi);
            let turn = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
            let noise = matrix::propagate(&turn, &increment.covariance);
            let chain = Chain::front_from_rear(total.posture, delta);
            let before = matrix::propagate(&chain.by_base, &total.covariance);
            let added = matrix::propagate(&chain.by_relative, &noise);
            total = Estimate::new(chain.posture, matrix::add(&before, &added));
        }
    }
    let (p, q) = (whole.covariance().posture(), total.covariance);
    for i in 0..3 {
        // The postures of both filters differ by less than a tenth of their standard deviation.
        let d = whole.posture().minus(parts.posture())[i];
        assert!(d * d < 0.01 * p[i][i], "{i}: {d}");
        let ratio = q[i][i] / p[i][i];
        assert!((ratio - 1.0).abs() < 0.15, "{i}: {ratio}");
        assert!(parts.covariance().posture()[i][i] < 0.05 * p[i][i]);
    }
    assert!(is_positive_definite(&parts));
}

/// An error of 4 mm along and 1 mm across the heading stays along and across it.
#[test]
fn increment_covariance_lies_along_the_heading() {
    let (heading, own) = (1.1f32, matrix::diagonal([16e-6, 1e-6, 4e-6]));
    let (s, c) = heading.sin_cos();
    let world = matrix::propagate(&[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], &own);
    let mut covariance = matrix::diagonal([1e-6; 7]);
    for i in 0..3 {
        covariance[i][..3].copy_from_slice(&world[i]);
    }
    let at = [0.0, 0.0, heading, 0.0, 0.0, 0.0, 0.0];
    let increment = State::from_parts(at, &covariance).take_increment();
    for (i, j) in (0..9).map(|k| (k / 3, k % 3)) {
        let error = increment.covariance[i][j] - HANDED_OUT * own[i][j];
        assert!(error.abs() < 1e-8, "{i}{j} {error:e}");
    }
}

#[test]
fn increments_at_rest_are_positive_definite() {
    let filter = node_filter(true);
    let mut state = start();
    for _ in 0..1000 {
        for _ in 0..10 {
            filter.step(&mut state, &measured([Some(0.0), Some(0.0), None, None]));
        }
        let increment = state.take_increment();
        assert!(matrix::cholesky(&increment.covariance).is_some());
        assert!(is_positive_definite(&state));
    }
}

#[test]
fn configuration_is_checked() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("period_s", |c| c.period_s = 0.0),
        ("track_m", |c| c.track_m = f32::NAN),
        ("gyro_sigma_rad_s", |c| c.gyro_sigma_rad_s = -1.0),
        ("innovation_gate", |c| c.innovation_gate = Some(f32::NAN)),
    ]);
    for (i, j, upper, lower) in [
        (0, 1, 1.0, 0.0),
        (0, 1, 0.0, 1.0),
        (2, 6, f32::INFINITY, f32::INFINITY),
        (2, 6, f32::NAN, f32::NAN),
        (3, 3, -1.0, -1.0),
        (6, 6, f32::NAN, f32::NAN),
    ] {
        let mut q = [[0.0; 7]; 7];
        (q[i][j], q[j][i]) = (upper, lower);
        let built = Config::default().build_with(ProcessNoise::Fixed(q));
        assert_eq!(built.unwrap_err().field, "process_noise");
    }
}

/// Steering accelerates an axle from rest at 36 rad/s², the largest value seen in hours of driving. At most two samples
/// of wheels and gyro are gated, and the heading does not lag: with the configured gyro noise, and at 54 rad/s² with a
/// fifth of this noise.
#[test]
fn hard_steering_gates_at_most_two_samples_and_the_heading_does_not_lag() {
    let run = |yaw_jerk_rad_s3_per_sqrt_hz: f32, acceleration: f64, noise: f64, seed: u64| {
        let config = Config {
            noise: Densities {
                yaw_jerk_rad_s3_per_sqrt_hz,
                ..Densities::default()
            },
            ..Config::default()
        };
        let filter = config.build().unwrap();
        let start = Estimate::with_sigmas(Posture::ORIGIN, [1e-6; 3]);
        let mut state = State::at_rest(&start, [1e-3; 4]);
        let mut random = Random::new(seed);
        // The yaw rate rises from rest to 1 rad/s and falls back.
        let rate = |t: f64| {
            let (up, down) = ((t - 0.5) * acceleration, (1.0 - t) * acceleration);
            up.min(down).clamp(0.0, 1.0)
        };
        let (mut heading, mut worst) = (0.0f64, 0.0f64);
        for tick in 1..=1500 {
            let t = 1e-3 * f64::from(tick);
            heading += 1e-3 * rate(t - 0.5e-3);
            // Wheels report the mean of the period; the gyro is a period late.
            let wheel = |side: f64| Some((side * 0.162 * rate(t - 0.5e-3)) as f32);
            let gyro = (rate(t - 1e-3) + noise * random.normal()) as f32;
            let z = measured([wheel(-1.0), wheel(1.0), Some(gyro), None]);
            filter.step(&mut state, &z);
            worst = worst.max((heading - f64::from(state.posture().phi)).abs());
        }
        let counters = &state.counters;
        let refused = [counters.left, counters.right, counters.gyro].map(|sensor| sensor.gated);
        (refused.iter().sum::<u32>(), worst)
    };
    let density = Densities::default().yaw_jerk_rad_s3_per_sqrt_hz;
    for seed in 0..20 {
        for (acceleration, noise) in [(36.0, 5e-3), (54.0, 1e-3)] {
            let (refused, worst) = run(density, acceleration, noise, seed);
            assert!(refused <= 2, "{acceleration} {noise} {seed}: {refused}");
            // The lag of 1 ms at 1 rad/s is 1 mrad; the rest is noise.
            assert!(worst < 1.6e-3, "{acceleration} {noise} {seed}: {worst}");
        }
        // With too little noise of the yaw jerk both assertions above fail.
        let (refused, worst) = run(20.0, 36.0, 1e-3, seed);
        assert!(refused > 20 && worst > 2e-3, "{refused} {worst}");
    }
}
