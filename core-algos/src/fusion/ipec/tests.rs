use super::*;
use crate::fusion::testing::{Pose, Random, relative, wrap};

fn narrow(p: Pose) -> Posture {
    Posture::new(p[0] as f32, p[1] as f32, p[2] as f32)
}

/// Two-axle robot without slip, in `f64`. Each axle moves along its own heading; equal advances along the line keep
/// the distance of the axles.
struct Robot {
    axles: [Pose; 2],
}

impl Robot {
    fn new() -> Self {
        Self {
            axles: [[0.37, 0.0, 0.0], [0.0; 3]],
        }
    }

    /// Moves both axles by `ds` along the line between them and turns their headings by `turn`. Returns the advance of
    /// the wheels.
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

/// Heading changes of step `k`, which bend the robot left and right.
fn turns(k: usize) -> [f64; 2] {
    let w = 0.004 * (k as f64 * 0.01).cos();
    [w, -w]
}

/// Runs one interval with the advances of the wheels and the measured relative posture `link`.
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
        // After 5 m. The midpoint rule is exact here, so the error is rounding alone.
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
        // In ten steps a bump makes the left front wheel run 2.5 mm further than its axle.
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
fn variance_growth_equals_first_order_propagation_to_the_direction() {
    let (baseline, ds) = (0.37, [1e-4, -2e-4]);
    let (sigma_ds, sigma_alpha, sigma_phi) = (1e-2, 100.0, 100.0);
    let config = Config {
        wheel_sigma_m: (sigma_ds * 2f64.sqrt()) as f32,
        lateral_sigma_m: (sigma_alpha * baseline) as f32,
        heading_sigma_rad: sigma_phi as f32,
        ..Config::default()
    };
    let ipec = config.build().unwrap();
    for (alpha, phi) in [(2.6, 0.3), (-2.9, -0.5), (3.0, 1.2), (2.0, 0.9)] {
        // Headings relative to the line: −`alpha` for axle 1, `phi` − `alpha` for axle 2.
        let direction = |[ds1, ds2, alpha, phi]: [f64; 4]| {
            let (first, second) = (-alpha, phi - alpha);
            let x = baseline + ds2 * second.cos() - ds1 * first.cos();
            (ds2 * second.sin() - ds1 * first.sin()).atan2(x)
        };
        let at = [ds[0], ds[1], alpha, phi];
        let sigmas = [sigma_ds, sigma_ds, sigma_alpha, sigma_phi];
        let expected: f64 = (0..4)
            .map(|k| {
                let (mut low, mut high) = (at, at);
                low[k] -= 1e-6;
                high[k] += 1e-6;
                (sigmas[k] * (direction(high) - direction(low)) / 2e-6).powi(2)
            })
            .sum();
        let r = [baseline * alpha.cos(), baseline * alpha.sin(), phi];
        let back = [-ds[0] * alpha.cos(), ds[0] * alpha.sin(), -alpha];
        let mut state = State::new(narrow(back), narrow([baseline, 0.0, phi - alpha]));
        let [front, rear] = ds;
        let correction = ipec
            .step(
                &mut state,
                &[front, front, rear, rear].map(|x| x as f32),
                &narrow(r),
            )
            .unwrap();
        // Each axle has moved along the line by half the missing distance.
        let [p, q] = state.postures().map(<[f32; 3]>::from);
        assert!((f64::from(p[0] - q[0]).hypot(f64::from(p[1] - q[1])) - baseline).abs() < 1e-6);
        let gone = ds[1] * (phi - alpha).cos();
        assert!((f64::from(p[0] + q[0]) - baseline - gone).abs() < 1e-6);
        let ratio = f64::from(state.variance) / expected;
        assert!((ratio - 1.0).abs() < 3e-3, "{alpha} {phi}: {ratio}");
        let claimed =
            f64::from(correction.heading_variance) / (expected + sigma_alpha * sigma_alpha);
        assert!((claimed - 1.0).abs() < 3e-3, "{alpha} {phi}: {claimed}");
    }
}

/// Reference in `f64`: mean of the three directions by inverse variance.
#[test]
fn weigh_returns_the_mean_by_inverse_variance() {
    let mut random = Random::new(9);
    let config = Config {
        wheel_sigma_m: 0.0,
        lateral_sigma_m: 1e-3,
        heading_sigma_rad: 2e-3,
        drift_rad_per_sqrt_m: 0.02,
        gate_sigmas: 1.5,
        ..Config::default()
    };
    let ipec = config.build().unwrap();
    let (mut gates, mut refused) = ([0; 2], 0);
    for _ in 0..400 {
        let line = random.between(-3.1, 3.1);
        let r = [
            -0.3 + random.between(-0.1, 0.1),
            random.between(-0.2, 0.2),
            random.between(-1.0, 1.0),
        ];
        let (baseline, alpha) = (r[0].hypot(r[1]), r[1].atan2(r[0]));
        let wrong = [(); 2].map(|()| 0.02 * random.normal());
        let front = [0.5, -0.7, line - alpha + wrong[0]];
        let apart = baseline + 1e-3 * random.normal();
        let rear = [
            front[0] + apart * line.cos(),
            front[1] + apart * line.sin(),
            line - alpha + r[2] + wrong[1],
        ];
        let ds = [random.between(-0.5, 0.5), random.between(-0.5, 0.5)];
        let own = [(); 2].map(|()| 1e-5 * random.between(1.0, 20.0));
        let found = ipec.weigh(
            [narrow(front), narrow(rear)],
            ds.map(|x| x as f32),
            own.map(|x| x as f32),
            &narrow(r),
        );

        let sigma_alpha = 1e-3 / baseline;
        let projected = [ds[0] * alpha.cos(), ds[1] * (r[2] - alpha).cos()];
        let by_beam =
            (projected[1] * 2e-3).powi(2) + ((projected[0] - projected[1]) * sigma_alpha).powi(2);
        let driven = 0.5 * (ds[0].abs() + ds[1].abs());
        let of_line = by_beam / (baseline * baseline) + 4e-4 * driven;
        let noise = 2.0 * (sigma_alpha * sigma_alpha + 4e-6);
        let bound = |variance: f64| 1.5 * variance.sqrt();
        let gated = [0, 1].map(|i| wrong[i].abs() > bound(own[i] + of_line + noise));
        if gated == [true; 2] && (wrong[0] - wrong[1]).abs() <= bound(own[0] + own[1] + noise) {
            assert!(found.is_none());
            refused += 1;
            continue;
        }
        let (mut information, mut sum) = (1.0 / of_line, 0.0);
        for i in (0..2).filter(|&i| !gated[i]) {
            information += 1.0 / own[i];
            sum += wrong[i] / own[i];
        }
        let direction = line + sum / information;
        let middle = [0, 1].map(|k| 0.5 * (front[k] + rear[k]));
        let (postures, correction) = found.unwrap();
        for (i, side) in [-0.5, 0.5].into_iter().enumerate() {
            let position = [direction.cos(), direction.sin()];
            let p: [f32; 3] = postures[i].into();
            for k in 0..2 {
                let exact = middle[k] + side * baseline * position[k];
                assert!((f64::from(p[k]) - exact).abs() < 1e-6);
            }
            let heading = direction - alpha + [0.0, r[2]][i];
            assert!(wrap(f64::from(p[2]) - heading).abs() < 2e-6);
            let turned = heading - [front, rear][i][2];
            assert!(wrap(f64::from(correction.heading[i]) - turned).abs() < 2e-6);
            gates[i] += u32::from(gated[i]);
        }
        assert_eq!(correction.gated, gated);
        let claimed = 1.0 / information + sigma_alpha * sigma_alpha;
        assert!((f64::from(correction.heading_variance) / claimed - 1.0).abs() < 1e-3);
    }
    assert!(
        gates[0] > 20 && gates[1] > 20 && refused > 5,
        "{gates:?} {refused}"
    );
}

/// Only the axles' own headings have a variance. The variances and the bounds of the gate are exact in binary.
#[test]
fn heading_at_the_gate_is_used_and_two_headings_gated_alike_give_none() {
    let config = Config {
        wheel_sigma_m: 0.0,
        lateral_sigma_m: 0.0,
        heading_sigma_rad: 0.0,
        drift_rad_per_sqrt_m: 0.0,
        gate_sigmas: 1.0,
        ..Config::default()
    };
    let ipec = config.build().unwrap();
    let weigh = |deviations: [f32; 2], own: [f32; 2]| {
        let front = Posture::new(0.0, 0.0, deviations[0]);
        let rear = Posture::new(0.5, 0.0, deviations[1]);
        let relative = Posture::new(0.5, 0.0, 0.0);
        let found = ipec.weigh([front, rear], [0.0; 2], own, &relative);
        found.map(|(_, correction)| correction.gated)
    };
    for (deviation, out) in [(0.5f32, false), (0.5f32.next_up(), true)] {
        assert_eq!(weigh([deviation, 0.0], [0.25; 2]), Some([out, false]));
        assert_eq!(weigh([0.0, -deviation], [0.25; 2]), Some([false, out]));
    }
    for own in [[0.0625, 0.1875], [0.1875, 0.0625]] {
        assert_eq!(weigh([1.0, 0.5], own), None);
        assert_eq!(weigh([1.0f32.next_up(), 0.5], own), Some([true; 2]));
    }
}

#[test]
fn shortest_baseline_gives_a_direction() {
    let ipec = Config::default().build().unwrap();
    let shorter = MIN_BASELINE_M.next_down();
    for (baseline, line, given) in [
        (MIN_BASELINE_M, 0.37, true),
        (shorter, 0.37, false),
        (0.37, MIN_BASELINE_M, true),
        (0.37, shorter, false),
    ] {
        let postures = [Posture::new(line, 0.0, 0.0), Posture::ORIGIN];
        let r = Posture::new(-baseline, 0.0, 0.0);
        let mut state = State::new(postures[0], postures[1]);
        assert_eq!(ipec.step(&mut state, &[0.0; 4], &r).is_some(), given);
        let weighed = ipec.weigh(postures, [0.0; 2], [1e-6; 2], &r);
        assert_eq!(weighed.is_some(), given);
    }
}

#[test]
fn relative_posture_without_direction_leaves_plain_odometry() {
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
