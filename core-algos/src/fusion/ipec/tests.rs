use super::*;
use crate::fusion::testing::{Pose, Random, relative, wrap};

fn narrow(p: Pose) -> Posture {
    Posture::new(p[0] as f32, p[1] as f32, p[2] as f32)
}

/// A two-axle robot without slip, in f64: each axle moves along its own heading, the rear
/// steered so that the distance stays as the front pulls it (a trailer whose axle steers too).
struct Robot {
    axles: [Pose; 2],
}

impl Robot {
    fn new() -> Self {
        Self {
            axles: [[0.37, 0.0, 0.0], [0.0; 3]],
        }
    }

    /// Moves by `ds` with the headings turned by `turn`; the wheels' advance.
    fn step(&mut self, ds: f64, turn: [f64; 2]) -> [f64; 4] {
        let mut wheels = [0.0; 4];
        let line = (self.axles[0][1] - self.axles[1][1]).atan2(self.axles[0][0] - self.axles[1][0]);
        // Equal advance along the line keeps the distance to first order.
        for i in 0..2 {
            let middle = self.axles[i][2] + turn[i] / 2.0;
            let advance = ds / (middle - line).cos();
            self.axles[i][0] += advance * middle.cos();
            self.axles[i][1] += advance * middle.sin();
            self.axles[i][2] += turn[i];
            wheels[2 * i] = advance - turn[i] * 0.162;
            wheels[2 * i + 1] = advance + turn[i] * 0.162;
        }
        wheels
    }

    fn link(&self) -> Pose {
        relative(self.axles[1], self.axles[0])
    }
}

/// Bends the robot to and fro while it drives.
fn turns(k: usize) -> [f64; 2] {
    let w = 0.004 * (k as f64 * 0.01).cos();
    [w, -w]
}

/// A step by advances of the wheels and the link that is seen.
fn advance(ipec: &Ipec, state: &mut State, wheels: [f64; 4], link: Pose) {
    let wheels = wheels.map(|x| x as f32);
    ipec.step(state, &wheels, &narrow(link)).unwrap();
}

#[test]
fn exact_measurements_keep_the_exact_postures() {
    let (mut robot, ipec) = (Robot::new(), Config::default().build().unwrap());
    let [front, rear] = robot.axles;
    let mut state = State::new(narrow(front), narrow(rear));
    for k in 0..2000 {
        let d = robot.step(0.0025, turns(k));
        advance(&ipec, &mut state, d, robot.link());
    }
    for (posture, truth) in state.postures().into_iter().zip(robot.axles) {
        let found: [f32; 3] = posture.into();
        let error = relative(found.map(f64::from), truth);
        // 5 m; the midpoint rule is exact here, so what remains is rounding.
        assert!(error.iter().all(|e| e.abs() < 2e-5), "{error:?}");
    }
}

#[test]
fn bumps_turn_the_odometry_but_not_the_corrected_heading() {
    let (mut robot, ipec) = (Robot::new(), Config::default().build().unwrap());
    let [front, rear] = robot.axles;
    let mut state = State::new(narrow(front), narrow(rear));
    let (mut odometry, mut random) = (0.0, Random::new(1));
    for k in 0..4000usize {
        let mut d = robot.step(0.0025, turns(k));
        // Ten bumps: the left front wheel runs 2.5 mm further than the axle.
        if k % 400 == 200 {
            d[0] += 2.5e-3;
        }
        odometry += (d[1] - d[0]) / 0.324;
        let mut r = robot.link();
        r[1] += 5e-5 * random.normal();
        r[2] += 2e-4 * random.normal();
        advance(&ipec, &mut state, d, r);
    }
    let truth = robot.axles[0][2];
    assert!((odometry - truth).abs() > 0.06);
    let error = wrap(state.postures()[0].phi as f64 - truth);
    assert!(error.abs() < 5e-3, "{error}");
}

#[test]
fn variance_is_what_many_noisy_drives_show() {
    let config = Config {
        wheel_sigma_m: 2e-4,
        lateral_sigma_m: 2e-4,
        heading_sigma_rad: 2e-3,
        ..Config::default()
    };
    let ipec = config.build().unwrap();
    let (runs, mut spread, mut claimed) = (400, 0.0, 0.0);
    for run in 0..runs {
        let (mut robot, mut random) = (Robot::new(), Random::new(run));
        let [front, rear] = robot.axles;
        let mut state = State::new(narrow(front), narrow(rear));
        for k in 0..400 {
            let mut d = robot.step(0.005, turns(k));
            for wheel in &mut d {
                *wheel += 2e-4 * random.normal();
            }
            let mut r = robot.link();
            r[1] += 2e-4 * random.normal();
            r[2] += 2e-3 * random.normal();
            advance(&ipec, &mut state, d, r);
        }
        let [p, q] = state.postures();
        let beta = f64::from(q.y - p.y).atan2(f64::from(q.x - p.x));
        let [t, u] = robot.axles;
        let error = wrap(beta - (u[1] - t[1]).atan2(u[0] - t[0]));
        spread += error * error / runs as f64;
        claimed = f64::from(state.variance);
    }
    // 400 runs: the estimate of a variance is good to 7 %.
    let ratio = spread / claimed;
    assert!((ratio - 1.0).abs() < 0.25, "{ratio}");
}

#[test]
fn weighed_form_obeys_the_more_certain_side() {
    let with_drift = |drift_rad_per_sqrt_m| {
        let config = Config {
            drift_rad_per_sqrt_m,
            ..Config::default()
        };
        config.build().unwrap()
    };
    let [ipec, loose] = [0.0, 1.0].map(with_drift);
    let postures = [Posture::new(0.37, 0.0, 0.01), Posture::new(0.0, 0.0, 0.01)];
    // The beam says straight; both axles say that the line points 0.01 to the left.
    let r = Posture::new(-0.37, 0.0, 0.0);
    let weigh = |own: f32| ipec.weigh(postures, [0.0025; 2], [own; 2], &r).unwrap().0;
    let [front, rear] = weigh(1e-3);
    assert!(front.phi.abs() < 1e-3 && rear.phi.abs() < 1e-3);
    let ([front, rear], _) = loose.weigh(postures, [0.0025; 2], [1e-9; 2], &r).unwrap();
    assert!((front.phi - 0.01).abs() < 1e-4);
    // The line has turned with them about the middle.
    let line = atan2(front.y - rear.y, front.x - rear.x);
    assert!((line - 0.01).abs() < 1e-4);
    assert!((front.x + rear.x - 0.37).abs() < 1e-4);
}

#[test]
fn a_bump_of_one_axle_is_left_out() {
    let ipec = Config::default().build().unwrap();
    let postures = [Posture::new(0.37, 0.0, 0.05), Posture::new(0.0, 0.0, 0.0)];
    let r = Posture::new(-0.37, 0.0, 0.0);
    let (corrected, what) = ipec.weigh(postures, [0.0025; 2], [1e-7; 2], &r).unwrap();
    assert_eq!(what.gated, [true, false]);
    assert!(corrected[0].phi.abs() < 1e-3);
    assert!((what.heading[0] + 0.05).abs() < 1e-3);
    // Both alike: the beam is in doubt.
    let postures = postures.map(|p| Posture { phi: 0.05, ..p });
    assert!(ipec.weigh(postures, [0.0025; 2], [1e-7; 2], &r).is_none());
}

#[test]
fn no_direction_leaves_odometry() {
    let ipec = Config::default().build().unwrap();
    let start = State::new(Posture::new(0.37, 0.0, 0.0), Posture::ORIGIN);
    for r in [
        Posture::ORIGIN,
        Posture::new(f32::NAN, 0.0, 0.0),
        Posture::new(-0.37, 0.0, f32::INFINITY),
    ] {
        let mut state = start;
        assert!(ipec.step(&mut state, &[0.01; 4], &r).is_none());
        assert!((state.postures()[1].x - 0.01).abs() < 1e-7);
        let weighed = ipec.weigh(start.postures(), [0.01; 2], [1e-6; 2], &r);
        assert!(weighed.is_none());
    }
    crate::config::refusal_of(Config::default(), |c| c.build())
        .names(&[("wheel_sigma_m", |c| c.wheel_sigma_m = -1.0)]);
}
