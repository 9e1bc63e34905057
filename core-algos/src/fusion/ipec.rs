//! Internal Posture Error Correction (IPEC): two coupled axles correct each other's odometry
//! (Borenstein; paper section VI-B), with the variance of what it finds.
//!
//! Heading errors of an axle appear at once — a bump under one wheel, slip, a wheel too small — but
//! lateral position errors grow only slowly out of them. So over one short interval the odometric
//! positions of both axles tell the direction of the line between them better than either axle's
//! wheel difference tells its heading. Each interval:
//!
//! 1. odometry of each axle: ds = (left + right)/2, dθ = (right − left)/track, position advanced
//!    along φ + dθ/2, then φ += dθ;
//! 2. α = atan2(r_y, r_x), the direction of axle 2 seen from axle 1, measured; β, the direction of
//!    the line from axle 1 to axle 2 between the odometric positions;
//! 3. φ₁ ← β − α, φ₂ ← φ₁ + r_φ;
//! 4. both positions slide along the line, half each, until their distance is |r|;
//! 5. with g₁ = −α, g₂ = r_φ − α, B = |r|, σ_α = σ_ry/B, σ_ds² = σ_wheel²/2:
//!    σ_β² += [sin²g₁ σ_ds² + sin²g₂ σ_ds² + (ds₂ cos g₂)² σ_rφ² +
//!    (ds₁ cos g₁ − ds₂ cos g₂)² σ_α²]/B².
//!
//! Here r is axle 2's posture in axle 1's frame and axle 1 is the front: the inverse of what the
//! beam measures. [`Ipec::step`] applies the interval in full. [`Ipec::weigh`] is the form for the
//! second tier: the three opinions on the line's direction — positions, front odometry, rear
//! odometry — averaged by inverse variance, an axle whose heading change is implausible (a bump,
//! slip) left out. Constant errors of the beam add up linearly, not in square; their share is the
//! configured drift per √m.
//!
//! Nothing here panics. A relative posture that is not finite or shorter than
//! [`MIN_BASELINE_M`] leaves the odometry as it is.
//!
//! # Example
//!
//! ```
//! use core_algos::fusion::ipec::{Config, State};
//! use core_algos::math::Posture;
//!
//! let ipec = Config::default().build()?;
//! let (front, rear) = (Posture::new(0.37, 0.0, 0.0), Posture::ORIGIN);
//! let mut state = State::new(front, rear);
//! let seen = rear.relative_to(front);
//! // A bump lengthens the way of the front axle's right wheel by 2 mm; the beam is as it was.
//! let correction = ipec.step(&mut state, &[0.01, 0.012, 0.01, 0.01], &seen).expect("a direction");
//! let [front, _] = state.postures();
//! assert!(front.phi.abs() < 2e-4, "by its wheels it would have turned by 6.2e-3");
//! assert!((correction.heading[0] + 6.2e-3).abs() < 2e-4);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use crate::config::{ConfigError, non_negative, positive};
use crate::math::trig::{atan2, hypot, sin_cos, wrap_angle};
use crate::math::{Posture, TwoFloat};

/// Shortest distance between the axles that gives a direction, m.
pub const MIN_BASELINE_M: f32 = 1e-3;

/// Standard deviations of what one interval measures.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Distance between the wheels of an axle, m.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub track_m: f32,
    /// Standard deviation of one wheel's advance in an interval, m.
    pub wheel_sigma_m: f32,
    /// Standard deviation of the beam's lateral position (r_y), m.
    pub lateral_sigma_m: f32,
    /// Standard deviation of the beam's heading (r_φ), rad.
    pub heading_sigma_rad: f32,
    /// Drift of the line's direction from errors that do not change from interval to interval
    /// (beam zero, wheel radius), as an equivalent random walk, rad/√m. Only in [`Ipec::weigh`].
    pub drift_rad_per_sqrt_m: f32,
    /// Deviation of an axle's heading change, in standard deviations, beyond which it is taken for
    /// a bump or slip and left out. Only in [`Ipec::weigh`].
    pub gate_sigmas: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            track_m: 0.324,
            wheel_sigma_m: 5e-5,
            lateral_sigma_m: 5e-5,
            heading_sigma_rad: 2e-4,
            drift_rad_per_sqrt_m: 2.5e-3,
            gate_sigmas: 5.0,
        }
    }
}

impl Config {
    /// The ready form; an error names the parameter out of range.
    pub fn build(&self) -> Result<Ipec, ConfigError> {
        let square = |x: f32| x * x;
        Ok(Ipec {
            inverse_track: 1.0 / positive("track_m", self.track_m)?,
            step_variance: 0.5 * square(non_negative("wheel_sigma_m", self.wheel_sigma_m)?),
            lateral_variance: square(non_negative("lateral_sigma_m", self.lateral_sigma_m)?),
            heading_variance: square(non_negative("heading_sigma_rad", self.heading_sigma_rad)?),
            drift_variance: square(non_negative(
                "drift_rad_per_sqrt_m",
                self.drift_rad_per_sqrt_m,
            )?),
            gate: square(positive("gate_sigmas", self.gate_sigmas)?),
        })
    }
}

/// The correction, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ipec {
    inverse_track: f32,
    /// σ_ds².
    step_variance: f32,
    lateral_variance: f32,
    heading_variance: f32,
    drift_variance: f32,
    gate: f32,
}

/// Both axles' postures as IPEC keeps them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Position and heading of axle 1 and axle 2.
    axles: [[TwoFloat; 3]; 2],
    /// σ_β², rad².
    pub variance: f32,
}

impl State {
    /// From the postures of axle 1 (front) and axle 2 (rear).
    pub fn new(axle1: Posture, axle2: Posture) -> Self {
        let wide = |p: Posture| <[f32; 3]>::from(p).map(TwoFloat::from_f32);
        Self {
            axles: [wide(axle1), wide(axle2)],
            variance: 0.0,
        }
    }

    /// Postures of axle 1 and axle 2.
    pub fn postures(&self) -> [Posture; 2] {
        self.axles
            .map(|axle| Posture::from(axle.map(TwoFloat::value)))
    }

    /// Postures of axle 1 and axle 2 with all their digits.
    pub fn precise_postures(&self) -> [[TwoFloat; 3]; 2] {
        self.axles
    }

    /// Vector from axle 1 to axle 2.
    fn line(&self) -> (f32, f32) {
        let [first, second] = &self.axles;
        (second[0].minus(first[0]), second[1].minus(first[1]))
    }

    /// Moves both axles alike in opposite directions, axle 2 by `by`.
    fn spread(&mut self, by: [f32; 2]) {
        for k in 0..2 {
            self.axles[0][k] = self.axles[0][k].plus(-by[k]);
            self.axles[1][k] = self.axles[1][k].plus(by[k]);
        }
    }
}

/// Advance of the wheels in one interval, m: left and right of axle 1, left and right of axle 2.
pub type WheelAdvance = [f32; 4];

/// What one interval corrected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Correction {
    /// Heading correction of axle 1 and axle 2, rad.
    pub heading: [f32; 2],
    /// Variance of axle 1's corrected heading, σ_β² + σ_α², rad².
    pub heading_variance: f32,
    /// The axle's own heading change was implausible (bump, slip) and left out.
    pub gated: [bool; 2],
}

impl Ipec {
    /// One interval in full: `advance` of the wheels, then correction by `r` (axle 2 in axle 1's
    /// frame). `None` if `r` gives no direction; the axles then hold plain odometry.
    pub fn step(
        &self,
        state: &mut State,
        advance: &WheelAdvance,
        r: &Posture,
    ) -> Option<Correction> {
        let [left1, right1, left2, right2] = *advance;
        let (ds1, turn1) = (
            0.5 * (left1 + right1),
            (right1 - left1) * self.inverse_track,
        );
        let (ds2, turn2) = (
            0.5 * (left2 + right2),
            (right2 - left2) * self.inverse_track,
        );
        for (axle, (ds, turn)) in state.axles.iter_mut().zip([(ds1, turn1), (ds2, turn2)]) {
            let (sin, cos) = sin_cos(axle[2].value() + 0.5 * turn);
            axle[0] = axle[0].plus(ds * cos);
            axle[1] = axle[1].plus(ds * sin);
            axle[2] = axle[2].plus(turn).wrapped_once();
        }
        let seen = Direction::of(r)?;
        let (x, y) = state.line();
        let length = hypot(x, y);
        if !(length >= MIN_BASELINE_M) {
            return None;
        }
        let beta = atan2(y, x);
        let first = TwoFloat::from_sum(beta, -seen.alpha).wrapped_once();
        let second = first.plus(r.phi).wrapped_once();
        let heading = [
            wrap_angle(first.minus(state.axles[0][2])),
            wrap_angle(second.minus(state.axles[1][2])),
        ];
        state.axles[0][2] = first;
        state.axles[1][2] = second;
        let half = 0.5 * (seen.baseline - length) / length;
        state.spread([half * x, half * y]);
        state.variance += self.growth(&seen, r, [ds1, ds2]);
        Some(Correction {
            heading,
            heading_variance: state.variance + seen.variance(self.lateral_variance),
            gated: [false; 2],
        })
    }

    /// Growth of σ_β² over one interval.
    fn growth(&self, seen: &Direction, r: &Posture, [ds1, ds2]: [f32; 2]) -> f32 {
        let (sin1, cos1) = sin_cos(-seen.alpha);
        let (sin2, cos2) = sin_cos(r.phi - seen.alpha);
        let (along1, along2) = (ds1 * cos1, ds2 * cos2);
        let gap = along1 - along2;
        ((sin1 * sin1 + sin2 * sin2) * self.step_variance
            + along2 * along2 * self.heading_variance
            + gap * gap * seen.variance(self.lateral_variance))
            / (seen.baseline * seen.baseline)
    }

    /// The same correction weighed against the axles' own headings.
    ///
    /// `postures` of axle 1 and 2 after odometry; `advance` of their midpoints in the interval (m);
    /// `own_variance` of each axle's own heading change in the interval (rad²); `r` as in
    /// [`Self::step`]. Returns the corrected postures, which stand to each other exactly as `r`
    /// says, and what was corrected. `None` if `r` gives no direction, or if both axles contradict
    /// the line alike, so that `r` itself is in doubt.
    pub fn weigh(
        &self,
        postures: [Posture; 2],
        advance: [f32; 2],
        own_variance: [f32; 2],
        r: &Posture,
    ) -> Option<([Posture; 2], Correction)> {
        let seen = Direction::of(r)?;
        let mut state = State::new(postures[0], postures[1]);
        let (x, y) = state.line();
        if !(hypot(x, y) >= MIN_BASELINE_M) {
            return None;
        }
        let beta = atan2(y, x);
        // Direction of the line by each axle's own heading, less β.
        let opinion = [
            wrap_angle(postures[0].phi + seen.alpha - beta),
            wrap_angle(postures[1].phi - r.phi + seen.alpha - beta),
        ];
        let driven = 0.5 * (advance[0].abs() + advance[1].abs());
        let line_variance = self.growth(&seen, r, advance) + self.drift_variance * driven + 1e-12;
        // The beam's own noise, of this interval and the last.
        let noise = 2.0 * (seen.variance(self.lateral_variance) + self.heading_variance);
        let mut gated = [false; 2];
        let (mut information, mut sum) = (1.0 / line_variance, 0.0);
        for i in 0..2 {
            let spread = own_variance[i] + line_variance + noise;
            gated[i] = !(opinion[i] * opinion[i] <= self.gate * spread);
            if !gated[i] {
                let weight = 1.0 / (own_variance[i] + 1e-12);
                information += weight;
                sum += weight * opinion[i];
            }
        }
        if gated == [true; 2] {
            let apart = opinion[0] - opinion[1];
            let spread = own_variance[0] + own_variance[1] + noise;
            if !(apart * apart > self.gate * spread) {
                return None;
            }
        }
        let direction = beta + sum / information;
        let (sin, cos) = sin_cos(direction);
        let half = 0.5 * seen.baseline;
        state.spread([half * cos - 0.5 * x, half * sin - 0.5 * y]);
        let [mut first, mut second] = state.postures();
        first.phi = wrap_angle(direction - seen.alpha);
        second.phi = wrap_angle(direction - seen.alpha + r.phi);
        let heading = [
            wrap_angle(first.phi - postures[0].phi),
            wrap_angle(second.phi - postures[1].phi),
        ];
        let correction = Correction {
            heading,
            heading_variance: 1.0 / information + seen.variance(self.lateral_variance),
            gated,
        };
        Some(([first, second], correction))
    }
}

/// Where axle 1 sees axle 2.
struct Direction {
    baseline: f32,
    alpha: f32,
}

impl Direction {
    fn of(r: &Posture) -> Option<Self> {
        let baseline = hypot(r.x, r.y);
        (baseline >= MIN_BASELINE_M && r.is_finite()).then(|| Self {
            baseline,
            alpha: atan2(r.y, r.x),
        })
    }

    /// σ_α².
    fn variance(&self, lateral_variance: f32) -> f32 {
        lateral_variance / (self.baseline * self.baseline)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::Random;

    type Pose = [f64; 3];

    fn wrap(a: f64) -> f64 {
        a - core::f64::consts::TAU * (a / core::f64::consts::TAU).round()
    }

    /// Posture of `tip` seen from `base`.
    fn seen(tip: Pose, base: Pose) -> Pose {
        let (s, c) = base[2].sin_cos();
        let (x, y) = (tip[0] - base[0], tip[1] - base[1]);
        [c * x + s * y, -s * x + c * y, wrap(tip[2] - base[2])]
    }

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
            let line =
                (self.axles[0][1] - self.axles[1][1]).atan2(self.axles[0][0] - self.axles[1][0]);
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
            seen(self.axles[1], self.axles[0])
        }
    }

    /// Bends the robot to and fro while it drives.
    fn turns(k: usize) -> [f64; 2] {
        let w = 0.004 * (k as f64 * 0.01).cos();
        [w, -w]
    }

    fn narrow4(d: [f64; 4]) -> [f32; 4] {
        d.map(|x| x as f32)
    }

    #[test]
    fn exact_measurements_keep_the_exact_postures() {
        let (mut robot, ipec) = (Robot::new(), Config::default().build().unwrap());
        let [front, rear] = robot.axles;
        let mut state = State::new(narrow(front), narrow(rear));
        for k in 0..2000 {
            let d = robot.step(0.0025, turns(k));
            ipec.step(&mut state, &narrow4(d), &narrow(robot.link()))
                .unwrap();
        }
        for (posture, truth) in state.postures().into_iter().zip(robot.axles) {
            let error = seen(
                [posture.x as f64, posture.y as f64, posture.phi as f64],
                truth,
            );
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
            ipec.step(&mut state, &narrow4(d), &narrow(r)).unwrap();
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
                ipec.step(&mut state, &narrow4(d), &narrow(r)).unwrap();
            }
            let [p, q] = state.postures();
            let beta = f64::from(q.y - p.y).atan2(f64::from(q.x - p.x));
            let [t, u] = robot.axles;
            let error = wrap(beta - (u[1] - t[1]).atan2(u[0] - t[0]));
            spread += error * error / runs as f64;
            claimed = f64::from(state.variance);
        }
        // 400 runs: the estimate of a variance is good to 7 %.
        assert!(
            (spread / claimed - 1.0).abs() < 0.25,
            "{spread:e} {claimed:e}"
        );
    }

    #[test]
    fn weighed_form_obeys_the_more_certain_side() {
        let ipec = Config {
            drift_rad_per_sqrt_m: 0.0,
            ..Config::default()
        }
        .build()
        .unwrap();
        let postures = [Posture::new(0.37, 0.0, 0.01), Posture::new(0.0, 0.0, 0.01)];
        // The beam says straight; both axles say that the line points 0.01 to the left.
        let r = Posture::new(-0.37, 0.0, 0.0);
        let weigh = |own: f32| ipec.weigh(postures, [0.0025; 2], [own; 2], &r).unwrap().0;
        let [front, rear] = weigh(1e-3);
        assert!(front.phi.abs() < 1e-3 && rear.phi.abs() < 1e-3);
        let loose = Config {
            drift_rad_per_sqrt_m: 1.0,
            ..Config::default()
        }
        .build()
        .unwrap();
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
            assert!(
                ipec.weigh(start.postures(), [0.01; 2], [1e-6; 2], &r)
                    .is_none()
            );
        }
        assert_eq!(
            Config {
                wheel_sigma_m: -1.0,
                ..Config::default()
            }
            .build()
            .unwrap_err()
            .field,
            "wheel_sigma_m"
        );
    }
}
