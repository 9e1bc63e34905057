//! Honesty of the second tier: over 200 simulated drives whose noise is what the filters are told,
//! the normalised estimation error squared (NEES) must be what its distribution says.
//!
//! The truth is kinematic and in f64: the rear axle drives a wavy path, the frame bends to and fro,
//! the front axle follows from both. Each axle's odometry slips at random; the beam is noisy.

#[path = "../src/fusion/testing.rs"]
mod testing;

use core_algos::fusion::tandem::{Config, Increment, Inputs, Mode, Output, Slip, State, Tandem};
use core_algos::fusion::{Estimate, ipec, joint};
use core_algos::math::Posture;
use testing::Random;

const RUNS: usize = 200;
const TICKS: usize = 400;
const PERIOD: f64 = 0.01;
const LENGTH: f64 = 0.37;

type Pose = [f64; 3];

fn wrap(a: f64) -> f64 {
    a - std::f64::consts::TAU * (a / std::f64::consts::TAU).round()
}

fn compose(a: Pose, b: Pose) -> Pose {
    let (s, c) = a[2].sin_cos();
    [
        a[0] + c * b[0] - s * b[1],
        a[1] + s * b[0] + c * b[1],
        a[2] + b[2],
    ]
}

fn relative(tip: Pose, base: Pose) -> Pose {
    let (s, c) = base[2].sin_cos();
    let (x, y) = (tip[0] - base[0], tip[1] - base[1]);
    [c * x + s * y, -s * x + c * y, wrap(tip[2] - base[2])]
}

fn posture(p: Pose) -> Posture {
    Posture::new(p[0] as f32, p[1] as f32, wrap(p[2]) as f32)
}

/// The frame bent by `bend`: a circular arc of constant length.
fn frame(bend: f64) -> Pose {
    let half = bend / 2.0;
    let chord = if half.abs() < 1e-6 {
        LENGTH
    } else {
        LENGTH * half.sin() / half
    };
    [chord * half.cos(), chord * half.sin(), bend]
}

/// Errors that stay the same throughout a drive.
#[derive(Clone, Copy, Default)]
struct Constants {
    beam_offset: [f64; 2],
    heading_drift: [f64; 2],
    scale: [f64; 2],
    creep: f64,
}

struct World {
    random: Random,
    slip: Slip,
    beam_sigmas: Pose,
    constants: Constants,
    rear: Pose,
    front: Pose,
    time: f64,
}

impl World {
    fn new(
        seed: u64,
        config: &Config,
        beam_sigmas: Pose,
        constants: impl Fn(&mut Random) -> Constants,
    ) -> Self {
        let mut random = Random::new(seed);
        let constants = constants(&mut random);
        // The start differs from what the filters are told by its own uncertainty.
        let draw =
            |sigmas: [f32; 3], random: &mut Random| sigmas.map(|s| s as f64 * random.normal());
        let start = draw(config.start_sigmas, &mut random);
        let bent = draw(config.frame_sigmas, &mut random);
        let link = [LENGTH + bent[0], bent[1], bent[2]];
        // O halfway along the link, heading along it.
        let middle = [link[0] / 2.0, link[1] / 2.0, link[1].atan2(link[0])];
        let back = relative([0.0; 3], middle);
        let rear = compose(start, back);
        Self {
            random,
            slip: config.slip,
            beam_sigmas,
            constants,
            rear,
            front: compose(rear, link),
            time: 0.0,
        }
    }

    /// Moves the truth on by one tick; what odometry and beam say of it.
    fn tick(&mut self) -> Inputs {
        self.time += PERIOD;
        let t = self.time;
        let v = 0.25 * (1.0 - (-3.0 * t).exp());
        let w = 0.8 * (0.9 * t).sin();
        let rear = compose(self.rear, [v * PERIOD, 0.0, w * PERIOD]);
        // The bend follows a wave, starting from what it is.
        let now = relative(self.front, self.rear);
        let target = frame(0.5 * (0.7 * t).sin());
        let link = [0, 1, 2].map(|k| now[k] + (target[k] - now[k]) * 0.05);
        let front = compose(rear, link);
        let steps = [relative(front, self.front), relative(rear, self.rear)];
        self.front = front;
        self.rear = rear;

        let slip = self.slip;
        let square = |x: f32| x as f64 * x as f64;
        let mut increments = [Increment::default(); 2];
        for axle in 0..2 {
            let step = steps[axle];
            let driven = step[0].abs();
            let bend = now[2];
            let c = &self.constants;
            let position = square(slip.position_m_per_sqrt_s) * PERIOD;
            let variances = [
                square(slip.along_m_per_sqrt_m) * driven + position,
                square(slip.across_m_per_sqrt_m) * driven + position,
                square(slip.heading_rad_per_sqrt_m) * driven
                    + (square(slip.heading_rad_per_sqrt_s)
                        + square(slip.creep_per_sqrt_s) * bend * bend)
                        * PERIOD,
            ];
            let sign = if axle == 0 { -1.0 } else { 1.0 };
            // What the wheels say is the motion less what they do not see.
            let unseen = [
                step[0] * c.scale[axle],
                step[1] * c.scale[axle],
                step[0] * c.heading_drift[axle] + sign * c.creep * bend * PERIOD,
            ];
            let noise = variances.map(|v| v.sqrt() * self.random.normal());
            let said = [0, 1, 2].map(|k| step[k] - unseen[k] - noise[k]);
            increments[axle] = Increment::new(posture(said), [[0.0; 3]; 3]);
        }
        let link = relative(self.front, self.rear);
        let noise = self.beam_sigmas.map(|s| s * self.random.normal());
        let [y, phi] = self.constants.beam_offset;
        let seen = [
            link[0] + noise[0],
            link[1] + noise[1] + y,
            link[2] + noise[2] + phi,
        ];
        Inputs {
            front: Some(increments[0]),
            rear: Some(increments[1]),
            beam: Some(Estimate::with_sigmas(
                posture(seen),
                self.beam_sigmas.map(|s| s as f32),
            )),
        }
    }
}

/// eᵀ P⁻¹ e.
fn nees(estimate: &Estimate, truth: Pose) -> f64 {
    let p = estimate.covariance.map(|row| row.map(f64::from));
    let e = [
        estimate.posture.x as f64 - truth[0],
        estimate.posture.y as f64 - truth[1],
        wrap(estimate.posture.phi as f64 - truth[2]),
    ];
    let cofactor = |i: usize, j: usize| {
        let (r, s) = ((i + 1) % 3, (i + 2) % 3);
        let (c, d) = ((j + 1) % 3, (j + 2) % 3);
        p[r][c] * p[s][d] - p[r][d] * p[s][c]
    };
    let determinant: f64 = (0..3).map(|j| p[0][j] * cofactor(0, j)).sum();
    let mut sum = 0.0;
    for i in 0..3 {
        for j in 0..3 {
            sum += e[i] * e[j] * cofactor(i, j) / determinant;
        }
    }
    sum
}

struct Honesty {
    /// Mean NEES of front, rear and O.
    nees: [f64; 3],
    /// Mean NIS of the beam.
    nis: f64,
    /// Root mean square of O's final position error (m) and heading error (rad).
    rms: [f64; 2],
}

fn campaign(
    config: &Config,
    beam_sigmas: Pose,
    constants: impl Fn(&mut Random) -> Constants,
) -> Honesty {
    let tandem: Tandem = config.build().unwrap();
    let mut honesty = Honesty {
        nees: [0.0; 3],
        nis: 0.0,
        rms: [0.0; 2],
    };
    for run in 0..RUNS {
        let mut world = World::new(run as u64, config, beam_sigmas, &constants);
        let mut state: State = tandem.start(Posture::ORIGIN);
        let mut output = Output::default();
        for _ in 0..TICKS {
            output = tandem.step(&mut state, &world.tick());
            honesty.nis += output.beam.nis as f64 / (RUNS * TICKS) as f64;
        }
        let link = relative(world.front, world.rear);
        let middle = compose(
            world.rear,
            [link[0] / 2.0, link[1] / 2.0, link[1].atan2(link[0])],
        );
        let n = RUNS as f64;
        honesty.nees[0] += nees(&output.front, world.front) / n;
        honesty.nees[1] += nees(&output.rear, world.rear) / n;
        honesty.nees[2] += nees(&output.robot, middle) / n;
        let o = output.robot;
        let (x, y) = (
            o.posture.x as f64 - middle[0],
            o.posture.y as f64 - middle[1],
        );
        let phi = wrap(o.posture.phi as f64 - middle[2]);
        honesty.rms[0] += (x * x + y * y) / n;
        honesty.rms[1] += phi * phi / n;
    }
    honesty.rms = honesty.rms.map(f64::sqrt);
    honesty
}

/// 95 % band of the mean over the runs of a chi-square variable of three degrees of freedom.
fn band() -> (f64, f64) {
    let spread = 1.96 * (2.0 * 3.0 / RUNS as f64).sqrt();
    (3.0 - spread, 3.0 + spread)
}

/// Slip and beam noise without any constant error.
fn white(mode: Mode) -> Config {
    Config {
        mode,
        beam_noise_share: 1.0,
        beam_gate: None,
        joint: joint::Config {
            beam_offset_sigma_m: 0.0,
            beam_offset_sigma_rad: 0.0,
            beam_offset_correlation: 0.0,
            beam_offset_walk_m_per_sqrt_s: 0.0,
            beam_offset_walk_rad_per_sqrt_s: 0.0,
            heading_drift_sigma_rad_per_m: 0.0,
            scale_sigma: 0.0,
            creep_sigma_per_s: 0.0,
        },
        ipec: ipec::Config {
            drift_rad_per_sqrt_m: 0.0,
            ..ipec::Config::default()
        },
        ..Config::default()
    }
}

const BEAM: Pose = [5e-5, 5e-5, 2e-4];

#[test]
fn joint_filter_is_honest_about_random_errors() {
    let joint = campaign(&white(Mode::Joint), BEAM, |_| Constants::default());
    let (low, high) = band();
    for nees in joint.nees {
        assert!(nees > low && nees < high, "{nees}");
    }
    // The mean over 120 000 samples, correlated a little by the start.
    assert!((joint.nis - 3.0).abs() < 0.05, "{}", joint.nis);
}

/// Constant errors as the filters expect them.
fn constants(config: &Config, random: &mut Random) -> Constants {
    let prior = config.joint;
    let mut draw = |sigma: f32| sigma as f64 * random.normal();
    // Two errors of one cause each, as correlated as the filters think.
    let (shared, own) = (draw(1.0), draw(1.0));
    let correlation = prior.beam_offset_correlation as f64;
    let heading = correlation * shared + (1.0 - correlation * correlation).sqrt() * own;
    Constants {
        beam_offset: [
            prior.beam_offset_sigma_m as f64 * shared,
            prior.beam_offset_sigma_rad as f64 * heading,
        ],
        heading_drift: [(); 2].map(|()| draw(prior.heading_drift_sigma_rad_per_m)),
        scale: [(); 2].map(|()| draw(prior.scale_sigma)),
        creep: draw(prior.creep_sigma_per_s),
    }
}

#[test]
fn intersection_allows_for_constant_errors() {
    let (_, high) = band();
    for mode in [Mode::Intersection, Mode::IntersectionIpec] {
        let config = Config {
            mode,
            beam_gate: None,
            beam_noise_share: 1.0,
            ..Config::default()
        };
        let honesty = campaign(&config, BEAM, |random| constants(&config, random));
        for nees in honesty.nees {
            assert!(nees < high, "{mode:?} {nees}");
        }
    }
}

#[test]
fn joint_filter_is_honest_about_constant_errors() {
    let config = Config {
        beam_gate: None,
        beam_noise_share: 1.0,
        ..Config::default()
    };
    let joint = campaign(&config, BEAM, |random| constants(&config, random));
    let (low, high) = band();
    for nees in joint.nees {
        assert!(nees > low && nees < high, "{nees}");
    }
}

#[test]
fn odometry_alone_is_honest_about_random_errors() {
    let odometry = campaign(&white(Mode::Odometry), BEAM, |_| Constants::default());
    let (low, high) = band();
    for nees in &odometry.nees[..2] {
        assert!(*nees > low && *nees < high, "{nees}");
    }
}

#[test]
fn intersection_never_overclaims_and_plain_kalman_fusion_does() {
    let (_, high) = band();
    let intersection = campaign(&white(Mode::Intersection), BEAM, |_| Constants::default());
    let corrected = campaign(&white(Mode::IntersectionIpec), BEAM, |_| {
        Constants::default()
    });
    let kalman = campaign(&white(Mode::Kalman), BEAM, |_| Constants::default());
    for k in 0..3 {
        assert!(intersection.nees[k] < high, "{:?}", intersection.nees);
        assert!(corrected.nees[k] < high, "{:?}", corrected.nees);
        assert!(kalman.nees[k] > 10.0 * high, "{:?}", kalman.nees);
    }
}

#[test]
fn each_further_stage_improves_the_robots_heading() {
    let rms = |mode| campaign(&white(mode), BEAM, |_| Constants::default()).rms;
    let odometry = rms(Mode::Odometry);
    let intersection = rms(Mode::Intersection);
    let corrected = rms(Mode::IntersectionIpec);
    let joint = rms(Mode::Joint);
    assert!(intersection[1] < 0.8 * odometry[1]);
    assert!(corrected[1] < 0.5 * intersection[1]);
    assert!(joint[1] < corrected[1] && joint[0] < corrected[0]);
}
