//! Consistency of the fusion, from the wheels to the robot's posture. Over 600 simulated drives with the errors that
//! the filters are configured for, the mean normalised estimation error squared (NEES) must match its distribution.
//!
//! The truth is kinematic, in `f64`. Both axles follow the cascade, so that the frame keeps its length while it bends
//! to and fro; the tyres slip. The axle filters measure wheels and gyros with white noise. The second tier fuses their
//! reports of each epoch with a noisy beam. The reports do not depend on the fusion: each world is driven once, and
//! every fusion mode runs on its reports.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

#[path = "../src/fusion/testing.rs"]
#[allow(dead_code)]
mod testing;

use core_algos::beam::strip::PostureSigmas;
use core_algos::fusion::ekf::{self, AxleFilter, Measurements};
use core_algos::fusion::intersection;
use core_algos::fusion::robot::{self, Increment, Inputs, Mode, Output};
use core_algos::fusion::{Estimate, constants, ipec, joint};
use core_algos::math::Posture;
use std::sync::OnceLock;
use testing::{Pose, Random, compose, inverse, quadratic, relative, wide, wrap};

const RUNS: usize = 600;
const EPOCHS: usize = 125;
const STEPS_PER_EPOCH: usize = 20;
const STEP_S: f64 = 1e-3;
const LENGTH: f64 = 0.37;
const HALF_TRACK: f64 = 0.162;
/// White noise of the beam: m, m, rad.
const BEAM: Pose = [5e-5, 5e-5, 2e-4];

fn posture(p: Pose) -> Posture {
    Posture::new(p[0] as f32, p[1] as f32, wrap(p[2]) as f32)
}

fn midpoint(front: Pose, rear: Pose) -> Pose {
    let (dx, dy) = (front[0] - rear[0], front[1] - rear[1]);
    [
        0.5 * (front[0] + rear[0]),
        0.5 * (front[1] + rear[1]),
        dy.atan2(dx),
    ]
}

/// Small errors of the start, so that errors of the drive dominate.
const START_SIGMAS: [f32; 3] = [2e-3; 3];

/// Errors of a world, and the configuration of its filters.
#[derive(Clone, Copy)]
struct Setting {
    /// True if the world has lasting errors, which are constant throughout a drive.
    lasting: bool,
    /// True if the axles carry gyros.
    gyro: bool,
}

impl Setting {
    fn filter(&self) -> ekf::Config {
        ekf::Config {
            period_s: STEP_S as f32,
            innovation_gate: None,
            ..ekf::Config::default()
        }
    }

    fn floor_drift(&self) -> f32 {
        if self.lasting { 1.5e-2 } else { 0.0 }
    }

    fn tier(&self, mode: Mode) -> robot::Config {
        let mut config = robot::Config {
            mode,
            period_s: (STEPS_PER_EPOCH as f64 * STEP_S) as f32,
            beam_gate: None,
            ..robot::Config::default()
        };
        // The beam's covariance is exact here, so its NIS is 3 on average; that of the beam board is cautious, and its
        // NIS is far below 1. The floor is even.
        config.ground.usual_nis = 1e3;
        config.ground.contrary_nis = 1e3;
        // These worlds have no unmeasured load of a frame.
        config.slip.load_speed_m_s = 0.0;
        // These worlds have no backlash.
        config.joint.play_sigma_m = 0.0;
        if !self.lasting {
            config.joint = joint::Config {
                beam: PostureSigmas::default(),
                // Almost no slip of the tyres.
                slip_stiffness: 1e4,
                slip_sigma: 0.0,
                tyre_slip_sigma: 0.0,
                side_slip_sigma: 0.0,
                heading_drift_sigma_rad_per_m: 0.0,
                scale_sigma: 0.0,
                turn_scale_sigma: 0.0,
                gyro_bias_sigma_rad_s: 0.0,
                gyro_bias_walk_rad_s_per_sqrt_s: 0.0,
                gyro_scale_sigma: 0.0,
                ..config.joint
            };
            config.ipec = ipec::Config {
                drift_rad_per_sqrt_m: 0.0,
                ..ipec::Config::default()
            };
        }
        config
    }
}

/// The lasting errors of one robot: `zero` and `gain` of the beam, each as bend and tilt; the others front axle first.
struct Lasting {
    zero: [f64; 2],
    gain: [f64; 2],
    heading_drift: [f64; 2],
    scale: [f64; 2],
    turn: [f64; 2],
    side: [f64; 2],
    /// Slip of each tyre per metre and radian of bend, `[axle][left, right]`, rad/m.
    compliance: [[f64; 2]; 2],
    gyro_bias: [f64; 2],
    gyro_scale: [f64; 2],
    floor: [f64; 2],
}

impl Lasting {
    fn draw(prior: &joint::Config, floor_drift: f32, random: &mut Random) -> Self {
        let mut draw = |sigma: f32| f64::from(sigma) * random.normal();
        let load = 0.5 * 9.81 * f64::from(prior.axle_mass_kg);
        let lever = 2.0 * f64::from(prior.half_track_m).powi(2);
        let stiffness = load * f64::from(prior.slip_stiffness);
        let mean = f64::from(prior.frame_moment_n_m) / (lever * stiffness);
        let all = draw(prior.slip_sigma);
        let compliance =
            [(); 2].map(|()| [(); 2].map(|()| mean * (1.0 + all + draw(prior.tyre_slip_sigma))));
        let mut both = |sigma: f32| [draw(sigma), draw(sigma)];
        Self {
            zero: [
                both(prior.beam.zero_rad)[0],
                both(prior.beam.zero_tilt_m)[0],
            ],
            gain: [both(prior.beam.gain)[0], both(prior.beam.gain_tilt_m)[0]],
            heading_drift: both(prior.heading_drift_sigma_rad_per_m),
            scale: both(prior.scale_sigma),
            turn: both(prior.turn_scale_sigma),
            side: both(prior.side_slip_sigma),
            compliance,
            gyro_bias: both(prior.gyro_bias_sigma_rad_s),
            gyro_scale: both(prior.gyro_scale_sigma),
            floor: both(floor_drift),
        }
    }

    /// Error of the beam's measurement of an arc.
    fn of_beam(&self, bend: f64) -> Pose {
        let arc = |bend: f64| {
            let half = 0.5 * bend;
            let chord = LENGTH * if half == 0.0 { 1.0 } else { half.sin() / half };
            [chord * half.cos(), chord * half.sin(), bend]
        };
        let added = self.zero[0] + self.gain[0] * bend;
        let tilt = self.zero[1] + self.gain[1] * bend;
        let (to, from) = (arc(bend + added), arc(bend));
        let across = [(0.5 * bend).sin(), -(0.5 * bend).cos(), 0.0];
        [0, 1, 2].map(|k| to[k] - from[k] + tilt * across[k])
    }
}

/// Speed and yaw rate of the wheels of the front and rear axle at time `t`: the cascade's exact form for a midpoint
/// that accelerates and steers to and fro.
fn wheels(t: f64) -> [[f64; 2]; 2] {
    let ramp = (t / 0.8).min(1.0);
    let speed = 0.25 * ramp * ramp * (3.0 - 2.0 * ramp);
    let (psi, psi_dot) = (0.25 * (0.9 * t).sin(), 0.225 * (0.9 * t).cos());
    // Chord L sin ψ/ψ.
    let (stretch, chord) = match psi.abs() < 1e-4 {
        true => (-psi / 3.0, 1.0),
        false => ((psi * psi.cos() - psi.sin()) / (psi * psi), psi.sin() / psi),
    };
    let (stretch, chord) = (LENGTH * stretch * psi_dot, LENGTH * chord);
    let turn = 2.0 * speed * psi.tan() / chord;
    [1.0, -1.0].map(|sign| {
        [
            (speed + 0.5 * sign * stretch) / psi.cos(),
            turn + sign * psi_dot,
        ]
    })
}

/// Inputs of the fusion in one drive, and the true postures of the axles at its end.
struct Drive {
    inputs: Vec<Inputs>,
    front: Pose,
    rear: Pose,
}

#[expect(clippy::too_many_lines, reason = "one loop in the order of the data")]
fn drive(setting: Setting, seed: u64) -> Drive {
    let mut random = Random::new(seed);
    let sensors = setting.filter();
    let filter: AxleFilter = sensors.build().unwrap();
    // All modes have the same errors configured.
    let tier = setting.tier(Mode::Joint);
    let lasting = Lasting::draw(&tier.joint, setting.floor_drift(), &mut random);
    let mut gyro_bias = lasting.gyro_bias;
    // Bend at which the tyres slide.
    let friction = f64::from(tier.joint.friction * tier.joint.axle_mass_kg) * 9.81;
    let sliding = HALF_TRACK * friction / f64::from(tier.joint.frame_moment_n_m);

    // The true start differs from the start of the filters by its uncertainty.
    let mut draw = |sigmas: [f32; 3]| sigmas.map(|s| f64::from(s) * random.normal());
    let start = draw(START_SIGMAS);
    let bent = draw(tier.frame_sigmas);
    let link = [LENGTH + bent[0], bent[1], bent[2]];
    let rear = compose(start, relative([0.0; 3], midpoint(link, [0.0; 3])));
    let mut axles = [compose(rear, link), rear];

    let square = |x: f32| f64::from(x) * f64::from(x);
    let (own, tier_slip) = (sensors.noise, tier.slip);
    let per_m = [
        square(own.along_m_per_sqrt_m) + square(tier_slip.along_m_per_sqrt_m),
        square(own.across_m_per_sqrt_m) + square(tier_slip.across_m_per_sqrt_m),
        square(own.heading_rad_per_sqrt_m),
    ];
    let per_s = [
        square(own.along_m_per_sqrt_s) + square(tier_slip.position_m_per_sqrt_s),
        square(own.across_m_per_sqrt_s) + square(tier_slip.position_m_per_sqrt_s),
        square(own.heading_rad_per_sqrt_s),
    ];
    // A gyro measures the heading noise that the fusion would otherwise add.
    let unseen_share = if setting.gyro { 0.0 } else { 1.0 };
    let bias_walk = f64::from(tier.joint.gyro_bias_walk_rad_s_per_sqrt_s) * STEP_S.sqrt();

    let at_rest = Estimate::with_sigmas(Posture::ORIGIN, [1e-6; 3]);
    let mut filters = [ekf::State::at_rest(&at_rest, [1e-3, 1e-3, 1e-2, 1e-2]); 2];
    let mut last = [0, 1].map(|axle| filters[axle].take_increment().posture);
    let mut inputs = Vec::with_capacity(EPOCHS);
    for step in 0..EPOCHS * STEPS_PER_EPOCH {
        let bend = wrap(axles[0][2] - axles[1][2]);
        let turning = wheels((step as f64 + 0.5) * STEP_S);
        for axle in 0..2 {
            let [v, omega] = turning[axle];
            let (ds, dphi) = (v * STEP_S, omega * STEP_S);
            // Motion that the wheels do not measure.
            let sign = if axle == 0 { -1.0 } else { 1.0 };
            let load = bend / (1.0 - bend.abs() / sliding);
            let rolled = [-HALF_TRACK, HALF_TRACK].map(|arm| (ds + arm * dphi).abs());
            let distance = 0.5 * (rolled[0] + rolled[1]);
            let [left, right] =
                [0, 1].map(|k| sign * lasting.compliance[axle][k] * load * rolled[k]);
            let lasting_turn =
                lasting.heading_drift[axle] * ds + lasting.turn[axle] * dphi + 0.5 * (left + right);
            let by_tier = square(tier_slip.heading_rad_per_sqrt_m) * ds.abs()
                + square(tier_slip.creep_per_sqrt_m) * bend * bend * ds.abs()
                + (square(tier_slip.heading_rad_per_sqrt_s)
                    + square(tier_slip.creep_per_sqrt_s) * bend * bend)
                    * STEP_S;
            let by_bend = [0.0, square(tier_slip.side_m_per_sqrt_m) * bend * bend, 0.0];
            let mut noise = [0, 1, 2].map(|k| {
                ((per_m[k] + by_bend[k]) * ds.abs() + per_s[k] * STEP_S).sqrt() * random.normal()
            });
            let seen_by_gyro = by_tier.sqrt() * random.normal();
            noise[2] += seen_by_gyro;
            let turned = dphi + lasting_turn + noise[2];
            let ahead = ds * (1.0 + lasting.scale[axle])
                + lasting.heading_drift[axle] * HALF_TRACK * HALF_TRACK * dphi
                + 0.5 * HALF_TRACK * (right - left);
            let moved = [
                ahead * (0.5 * turned).cos() + noise[0],
                ahead * (0.5 * turned).sin() + lasting.side[axle] * ds + noise[1],
                turned,
            ];
            axles[axle] = compose(axles[axle], moved);
            for k in 0..2 {
                axles[axle][k] += lasting.floor[k] * distance;
            }

            let wheel = |side: f64, sigma: f32, random: &mut Random| {
                let speed = v + side * HALF_TRACK * omega + f64::from(sigma) * random.normal();
                Some(speed as f32)
            };
            gyro_bias[axle] += bias_walk * random.normal();
            let rate = (turned - noise[2] + seen_by_gyro) / STEP_S;
            let rate = (rate - gyro_bias[axle]) / (1.0 + lasting.gyro_scale[axle]);
            let rate = rate + f64::from(sensors.gyro_sigma_rad_s) * random.normal();
            let measured = Measurements {
                left_m_s: wheel(-1.0, sensors.left_sigma_m_s, &mut random),
                right_m_s: wheel(1.0, sensors.right_sigma_m_s, &mut random),
                gyro_rad_s: setting.gyro.then_some(rate as f32),
                acceleration_m_s2: None,
            };
            filter.step(&mut filters[axle], &measured);
        }
        if (step + 1) % STEPS_PER_EPOCH != 0 {
            continue;
        }
        let mut report = |axle: usize| {
            let sent = filters[axle].take_increment();
            let from = std::mem::replace(&mut last[axle], sent.posture);
            Some(Increment {
                gyro_share: 1.0 - unseen_share as f32,
                ..Increment::new(sent.posture.relative_to(from), sent.covariance)
            })
        };
        let (front, rear) = (report(0), report(1));
        let link = relative(axles[0], axles[1]);
        let noise = BEAM.map(|s| s * random.normal());
        let added = lasting.of_beam(link[2]);
        let measured = [0, 1, 2].map(|k| link[k] + noise[k] + added[k]);
        let sigmas = BEAM.map(|s| s as f32);
        inputs.push(Inputs {
            front,
            rear,
            beam: Some(Estimate::with_sigmas(posture(measured), sigmas)),
            ..Inputs::default()
        });
    }
    Drive {
        inputs,
        front: axles[0],
        rear: axles[1],
    }
}

fn error(estimate: &Estimate, truth: Pose) -> Pose {
    let p = estimate.posture;
    [
        f64::from(p.x) - truth[0],
        f64::from(p.y) - truth[1],
        wrap(f64::from(p.phi) - truth[2]),
    ]
}

/// Normalised estimation error squared.
fn nees(estimate: &Estimate, truth: Pose) -> f64 {
    let information = inverse(&wide(&estimate.covariance));
    quadratic(&information, error(estimate, truth))
}

#[derive(Debug)]
struct ConsistencyResult {
    /// Mean NEES of front, rear and O at the end of the drives.
    nees: Pose,
    /// Mean NIS of the beam.
    nis: f64,
    /// Root mean square of O's final position error (m) and heading error (rad).
    rms: [f64; 2],
}

fn evaluate(setting: Setting, drives: &[Drive], mode: Mode) -> ConsistencyResult {
    let fusion = setting.tier(mode).build().unwrap();
    let n = drives.len() as f64;
    let mut result = ConsistencyResult {
        nees: [0.0; 3],
        nis: 0.0,
        rms: [0.0; 2],
    };
    for drive in drives {
        let placed = Estimate::with_sigmas(Posture::ORIGIN, START_SIGMAS);
        let frame = Posture::new(LENGTH as f32, 0.0, 0.0);
        let frame = Estimate::with_sigmas(frame, robot::Config::default().frame_sigmas);
        let mut state = fusion.start(&placed, &frame, setting.floor_drift());
        let mut output = Output::default();
        for inputs in &drive.inputs {
            output = fusion.step(&mut state, inputs);
            result.nis += f64::from(output.beam.nis) / (n * EPOCHS as f64);
        }
        let truth = [drive.front, drive.rear, midpoint(drive.front, drive.rear)];
        let estimates = [output.front, output.rear, output.robot];
        for k in 0..3 {
            result.nees[k] += nees(&estimates[k], truth[k]) / n;
        }
        let e = error(&output.robot, truth[2]);
        result.rms[0] += (e[0] * e[0] + e[1] * e[1]) / n;
        result.rms[1] += e[2] * e[2] / n;
    }
    result.rms = result.rms.map(f64::sqrt);
    result
}

/// One world: its drives, and the result of each fusion mode, computed once.
struct World {
    setting: Setting,
    drives: OnceLock<Vec<Drive>>,
    results: [OnceLock<ConsistencyResult>; 4],
}

impl World {
    const fn new(lasting: bool, gyro: bool) -> Self {
        Self {
            setting: Setting { lasting, gyro },
            drives: OnceLock::new(),
            results: [const { OnceLock::new() }; 4],
        }
    }

    fn evaluate(&self, mode: Mode) -> &ConsistencyResult {
        let drives = || {
            (0..RUNS as u64)
                .map(|run| drive(self.setting, run))
                .collect()
        };
        self.results[mode as usize]
            .get_or_init(|| evaluate(self.setting, self.drives.get_or_init(drives), mode))
    }
}

/// Noise only, no gyro.
static WHITE: World = World::new(false, false);
/// Noise and lasting errors, no gyro.
static LASTING: World = World::new(true, false);
/// Noise and lasting errors, with gyros and their errors.
static INERTIAL: World = World::new(true, true);

/// Interval that contains the mean of a chi-square variable of three degrees of freedom over the runs with 95 %
/// probability.
fn band() -> (f64, f64) {
    let spread = 1.96 * (2.0 * 3.0 / RUNS as f64).sqrt();
    (3.0 - spread, 3.0 + spread)
}

fn assert_inside(result: &ConsistencyResult, bodies: usize) {
    let (low, high) = band();
    for nees in &result.nees[..bodies] {
        assert!(*nees > low && *nees < high, "{result:?}");
    }
}

fn assert_not_above(result: &ConsistencyResult) {
    let (_, high) = band();
    for nees in result.nees {
        assert!(nees < high, "{result:?}");
    }
}

#[test]
fn joint_filter_is_consistent_under_random_errors() {
    let joint = WHITE.evaluate(Mode::Joint);
    assert_inside(joint, 3);
    // An axle filter smooths over several epochs, so that its increments are slightly correlated.
    assert!((joint.nis - 3.0).abs() < 0.4, "{joint:?}");
}

#[test]
fn joint_filter_is_consistent_under_lasting_errors() {
    assert_inside(LASTING.evaluate(Mode::Joint), 3);
}

#[test]
fn joint_filter_is_consistent_with_gyros() {
    assert_inside(INERTIAL.evaluate(Mode::Joint), 3);
}

#[test]
fn odometry_alone_is_consistent() {
    let (low, high) = band();
    for world in [&WHITE, &LASTING, &INERTIAL] {
        let odometry = world.evaluate(Mode::Odometry);
        // O is left out: its heading follows from both positions. The increments carry the variance of an axle filter
        // within 15 %.
        for nees in &odometry.nees[..2] {
            assert!(*nees > low / 1.15 && *nees < 1.15 * high, "{odometry:?}");
        }
    }
}

#[test]
fn intersection_is_never_overconfident() {
    for world in [&WHITE, &LASTING] {
        assert_not_above(world.evaluate(Mode::Intersection));
        assert_not_above(world.evaluate(Mode::IntersectionIpec));
    }
    assert_not_above(INERTIAL.evaluate(Mode::Intersection));
}

#[test]
fn each_further_stage_improves_the_robots_heading() {
    let rms = |mode| WHITE.evaluate(mode).rms;
    let [odometry, intersection] = [Mode::Odometry, Mode::Intersection].map(rms);
    let [corrected, joint] = [Mode::IntersectionIpec, Mode::Joint].map(rms);
    assert!(intersection[1] < 0.8 * odometry[1]);
    assert!(corrected[1] < 0.7 * intersection[1]);
    assert!(joint[1] < corrected[1] && joint[0] < corrected[0]);
}

#[test]
fn gyros_improve_the_robots_heading() {
    let [with, without] = [&INERTIAL, &LASTING].map(|world| world.evaluate(Mode::Intersection));
    assert!(with.rms[1] < 0.8 * without.rms[1], "{with:?} {without:?}");
}

/// Mean NEES of the fusion of two estimates of one posture. Their errors have unit covariance and the given
/// `correlation` in each component.
fn fused_nees(correlation: f64, fuse: &dyn Fn(&Estimate, &Estimate) -> Estimate) -> f64 {
    const PAIRS: usize = 4000;
    let mut random = Random::new(11);
    let mut sum = 0.0;
    for _ in 0..PAIRS {
        let draws = [(); 3].map(|()| [random.normal(), random.normal()]);
        let own = (1.0 - correlation * correlation).sqrt();
        let a = draws.map(|[one, _]| 1e-3 * one);
        let b = draws.map(|[one, two]| 1e-3 * (correlation * one + own * two));
        let [a, b] = [a, b].map(|e| Estimate::with_sigmas(posture(e), [1e-3; 3]));
        let fused = fuse(&a, &b);
        sum += nees(&fused, [0.0; 3]);
    }
    sum / PAIRS as f64
}

/// The NEES of covariance intersection lies below the band unless the errors are fully shared. For fully shared errors
/// the covariance is exact, so a smaller covariance is overconfident.
#[test]
fn intersection_with_a_smaller_covariance_is_overconfident_for_shared_errors() {
    let intersection = intersection::Config::default().build().unwrap();
    let plain = |a: &Estimate, b: &Estimate| intersection.fuse(a, b).unwrap().estimate;
    let measured = [0.0, 0.5, 1.0].map(|correlation| fused_nees(correlation, &plain));
    // With equal weights, NEES is 3 (1 + ρ)/2.
    for (nees, expected) in measured.into_iter().zip([1.5, 2.25, 3.0]) {
        assert!((nees / expected - 1.0).abs() < 0.05, "{measured:?}");
    }
    // Half the covariance is in the band for independent errors, but too small by a factor of two for shared errors.
    let bold = |a: &Estimate, b: &Estimate| {
        let mut fused = plain(a, b);
        fused.covariance = fused.covariance.map(|row| row.map(|p| 0.5 * p));
        fused
    };
    assert!((fused_nees(0.0, &bold) - 3.0).abs() < 0.15);
    assert!(fused_nees(1.0, &bold) > 5.7);
}

/// The filters have as many lasting errors as this test draws.
#[test]
fn every_lasting_error_is_drawn() {
    // Zero, gain, drift, scale, turn, side, compliance, bias and scale of the gyros.
    let all = 2 + 2 + 2 + 2 + 2 + 2 + 4 + 2 + 2;
    assert_eq!(all, constants::COUNT);
}
