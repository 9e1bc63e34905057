//! Wheel ratio and track of one axle from return errors: UMBmark, of Borenstein and Feng ("Measurement and correction
//! of systematic odometry errors in mobile robots", 1996).
//!
//! The robot drives a square in both directions, and the final odometric posture is compared with the true one. Unequal
//! wheels bend every side, a wrong track turns every corner too far: the errors add in one direction and cancel in the
//! other. UMBmark's formulas are for corners turned on the spot. This robot drives around its corners, so the effect of
//! each error is summed along the driven path. For sharp corners both methods agree to first order.
//!
//! In a bend the frame's moment makes the tyres creep. Creep looks like a wrong track, but grows with the time in the
//! bend, not with the angle: squares at two speeds separate the two errors.

use core_algos::bus::field::POSITION_SPAN_M;
use host_sim::run::final_error::wrap;
use plant::elastica::solve;

/// Standard deviation of an axle's measured end position, m. Weighs headings against positions in the fit.
const MARK_M: f64 = 1e-3;

/// Odometry of an axle in one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lap {
    last_posture: Option<[f64; 3]>,
    steps: Vec<OdometryStep>,
}

/// Step of the odometry: motion ahead and aside, m, turn, rad, and change of the turn for a unit of each error, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
struct OdometryStep {
    displacement: [f64; 2],
    turn: f64,
    by_errors: [f64; 3],
}

impl Lap {
    /// Adds the next odometric posture (m, m, rad) of an axle with configured track `track_m`. The position wraps at
    /// the range of the bus format. During the preceding `dt_s`, the relative heading was `heading_rad`.
    pub fn add(&mut self, posture: [f64; 3], track_m: f64, heading_rad: f64, dt_s: f64) {
        let [mut x, mut y, phi] = posture;
        if let Some([x0, y0, phi0]) = self.last_posture {
            let span = f64::from(POSITION_SPAN_M);
            x -= span * ((x - x0) / span).round();
            y -= span * ((y - y0) / span).round();
            let turn = wrap(phi - phi0);
            let (s, c) = libm::sincos(phi0 + 0.5 * turn);
            let ahead = c * (x - x0) + s * (y - y0);
            let aside = c * (y - y0) - s * (x - x0);
            self.steps.push(OdometryStep {
                displacement: [ahead, aside],
                turn,
                by_errors: [2.0 * ahead / track_m, turn, heading_rad * dt_s],
            });
        }
        self.last_posture = Some([x, y, phi]);
    }

    /// Final odometric posture: m, m, rad.
    pub fn end(&self) -> [f64; 3] {
        self.last_posture.unwrap_or_default()
    }

    /// Final posture of the axle with the given odometry errors, and its derivatives by the errors.
    fn predict(&self, errors: &[f64; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
        let [mut x, mut y, mut phi] = [0.0f64; 3];
        let (mut turned, mut moment) = ([0.0; 3], [[0.0; 2]; 3]);
        for step in &self.steps {
            let besides: f64 = (0..3).map(|k| step.by_errors[k] * errors[k]).sum();
            let turn = step.turn + besides;
            let (s, c) = libm::sincos(phi + 0.5 * turn);
            let [ahead, aside] = step.displacement;
            let (dx, dy) = (c * ahead - s * aside, s * ahead + c * aside);
            for k in 0..3 {
                let angle = step.by_errors[k];
                turned[k] += angle;
                moment[k][0] += angle * (x + 0.5 * dx);
                moment[k][1] += angle * (y + 0.5 * dy);
            }
            (x, y, phi) = (x + dx, y + dy, phi + turn);
        }
        let mut by = [[0.0; 3]; 3];
        for k in 0..3 {
            by[0][k] = moment[k][1] - y * turned[k];
            by[1][k] = x * turned[k] - moment[k][0];
            by[2][k] = turned[k];
        }
        ([x, y, phi], by)
    }
}

/// Odometry and true end of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Return {
    /// Odometry of the run.
    pub lap: Lap,
    /// True final posture in the coordinates of the start: m, m, rad.
    pub end: [f64; 3],
}

impl Return {
    /// True less odometric end position, m.
    pub fn error(&self) -> [f64; 2] {
        let [x, y, _] = self.lap.end();
        [self.end[0] - x, self.end[1] - y]
    }

    /// True less odometric end position, m, with the odometry corrected for `creep`, 1/s.
    pub fn without_creep(&self, creep: f64) -> [f64; 2] {
        let ([x, y, _], _) = self.lap.predict(&[0.0, 0.0, creep]);
        [self.end[0] - x, self.end[1] - y]
    }
}

/// Errors of an axle's odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OdometryErrors {
    /// Relative difference of true and configured radius: of the right wheel `ratio`, of the left wheel −`ratio`.
    pub ratio: f64,
    /// True less odometric turn, as a fraction of the odometric turn.
    pub turn: f64,
    /// Yaw rate due to creep, per relative heading, 1/s.
    pub creep: f64,
}

/// Least-squares estimate of the errors (Gauss–Newton). The first round uses headings only, which are linear in the
/// errors. `None` if the runs do not determine the errors.
pub fn fit(returns: &[Return], track_m: f64) -> Option<OdometryErrors> {
    let heading = track_m / (2f64.sqrt() * MARK_M);
    let weights = [[0.0, 0.0, heading], [1.0 / MARK_M, 1.0 / MARK_M, heading]];
    let mut errors = [0.0; 3];
    for round in 0..10 {
        let change = improve(returns, &errors, &weights[round.min(1)])?;
        for k in 0..3 {
            errors[k] += change[k];
        }
    }
    let [ratio, turn, creep] = errors;
    let sound = ratio.abs() < 0.1 && turn.abs() < 0.2 && creep.is_finite();
    sound.then_some(OdometryErrors { ratio, turn, creep })
}

/// Change of the errors by one Gauss–Newton step; `None` if the equations are singular.
fn improve(returns: &[Return], errors: &[f64; 3], weights: &[f64; 3]) -> Option<[f64; 3]> {
    let (mut normal, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
    for item in returns {
        let (end, by) = item.lap.predict(errors);
        for k in 0..3 {
            let miss = item.end[k] - end[k];
            let miss = weights[k] * if k == 2 { wrap(miss) } else { miss };
            let row = by[k].map(|value| weights[k] * value);
            for i in 0..3 {
                right[i] += row[i] * miss;
                for j in 0..3 {
                    normal[i][j] += row[i] * row[j];
                }
            }
        }
    }
    let scale: [f64; 3] = std::array::from_fn(|i| normal[i][i].sqrt());
    if !scale.iter().all(|scale| *scale > 0.0) {
        return None;
    }
    for i in 0..3 {
        right[i] /= scale[i];
        for j in 0..3 {
            normal[i][j] /= scale[i] * scale[j];
        }
    }
    let change = solve(&normal, &right)?;
    Some([0, 1, 2].map(|i| change[i] / scale[i]))
}

/// Wheel radius, wheel ratio and track of an axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxleConstants {
    /// Mean radius of both wheels, m.
    pub radius_m: f64,
    /// Radius of the right wheel over radius of the left wheel.
    pub ratio: f64,
    /// Half the track, m.
    pub half_track_m: f64,
}

impl AxleConstants {
    /// Corrected constants; `scale` is the true length of a straight line divided by its odometric length.
    pub fn corrected(&self, scale: f64, errors: &OdometryErrors) -> Self {
        Self {
            radius_m: self.radius_m * scale,
            ratio: self.ratio * (1.0 + errors.ratio) / (1.0 - errors.ratio),
            // Odometric turns used the uncorrected radii, hence the factor `scale`.
            half_track_m: self.half_track_m * scale / (1.0 + errors.turn),
        }
    }
}

/// UMBmark's systematic error, m: length of the mean return error, the larger of both directions.
pub fn systematic(directions: [&[[f64; 2]]; 2]) -> f64 {
    let distance = |errors: &[[f64; 2]]| {
        let count = errors.len().max(1) as f64;
        let sum = errors.iter().fold([0.0; 2], |sum: [f64; 2], error| {
            [sum[0] + error[0], sum[1] + error[1]]
        });
        libm::hypot(sum[0], sum[1]) / count
    };
    directions.into_iter().map(distance).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Radii of left and right, m.
    fn radii(axle: &AxleConstants) -> [f64; 2] {
        let left = 2.0 * axle.radius_m / (1.0 + axle.ratio);
        [left, axle.ratio * left]
    }
    use std::f64::consts::FRAC_PI_2;

    const CONFIGURED: AxleConstants = AxleConstants {
        radius_m: 0.073,
        ratio: 1.0,
        half_track_m: 0.162,
    };

    /// Square of side `side` with corners of `radius` (0: on the spot). The wheels turn so that the configured axle
    /// would drive the square exactly; the true axle moves by its own radii, track and creep.
    fn square(
        truth: &AxleConstants,
        side: f64,
        radius: f64,
        direction: f64,
        speed: f64,
        creep: f64,
    ) -> Return {
        let (mut lap, mut posture) = (Lap::default(), [0.0f64; 3]);
        let mut odometry = [0.0f64; 3];
        let track = 2.0 * CONFIGURED.half_track_m;
        lap.add(odometry, track, 0.0, 0.0);
        let mut step = |ds: f64, turn: f64, dt: f64, heading: f64| {
            // Wheel travel that odometry computes with the configured radii; below, the travel with the true radii.
            let wheel = [ds - 0.5 * turn * track, ds + 0.5 * turn * track];
            let configured = radii(&CONFIGURED);
            let real = radii(truth);
            let real = [0, 1].map(|i| wheel[i] * real[i] / configured[i]);
            let true_turn = (real[1] - real[0]) / (2.0 * truth.half_track_m) + creep * heading * dt;
            let moves = [
                (ds, turn, &mut odometry),
                (0.5 * (real[0] + real[1]), true_turn, &mut posture),
            ];
            for (ds, turn, at) in moves {
                let middle = at[2] + 0.5 * turn;
                *at = [
                    at[0] + ds * middle.cos(),
                    at[1] + ds * middle.sin(),
                    at[2] + turn,
                ];
            }
            lap.add(odometry, track, heading, dt);
        };
        for _ in 0..4 {
            let straight = side - 2.0 * radius;
            for _ in 0..400 {
                step(straight / 400.0, 0.0, straight / speed / 400.0, 0.0);
            }
            for _ in 0..400 {
                let arc = radius * FRAC_PI_2;
                let heading = if radius > 0.0 {
                    direction * 0.37 / radius
                } else {
                    0.0
                };
                step(
                    arc / 400.0,
                    direction * FRAC_PI_2 / 400.0,
                    arc / speed / 400.0,
                    heading,
                );
            }
        }
        Return { lap, end: posture }
    }

    const TRUTH: AxleConstants = AxleConstants {
        radius_m: 0.073,
        ratio: 1.002,
        half_track_m: 0.1628,
    };

    #[test]
    fn rounded_squares_with_creep_give_the_true_constants() {
        for truth in [
            TRUTH,
            AxleConstants {
                ratio: 0.9985,
                half_track_m: 0.1612,
                ..TRUTH
            },
        ] {
            let mut returns = Vec::new();
            for direction in [1.0, -1.0] {
                for speed in [0.1, 0.2] {
                    returns.push(square(&truth, 2.0, 0.5, direction, speed, -0.03));
                }
            }
            let errors = fit(&returns, 0.324).unwrap();
            let found = CONFIGURED.corrected(1.0, &errors);
            // The tolerances are for second-order errors, which the fit neglects.
            assert!((found.ratio - truth.ratio).abs() < 3e-5, "{found:?}");
            let track = found.half_track_m / truth.half_track_m;
            assert!((track - 1.0).abs() < 3e-4, "{found:?}");
            assert!((errors.creep + 0.03).abs() < 2e-4, "{errors:?}");
        }
    }

    /// Wheel ratio and track factor by UMBmark's formulas, which are for corners turned on the spot.
    fn umbmark(ccw: [f64; 2], cw: [f64; 2], side: f64) -> (f64, f64) {
        let alpha = (cw[0] + ccw[0]) / (-4.0 * side);
        let beta = (cw[0] - ccw[0]) / (-4.0 * side);
        let radius = 0.5 * side / (0.5 * beta).sin();
        let half = CONFIGURED.half_track_m;
        (
            (radius + half) / (radius - half),
            FRAC_PI_2 / (FRAC_PI_2 - alpha),
        )
    }

    #[test]
    fn sharp_corners_agree_with_the_formulas_of_umbmark() {
        let ccw = square(&TRUTH, 2.0, 0.0, 1.0, 0.2, 0.0);
        let cw = square(&TRUTH, 2.0, 0.0, -1.0, 0.2, 0.0);
        let (ratio, track) = umbmark(ccw.error(), cw.error(), 2.0);
        assert!((ratio - TRUTH.ratio).abs() < 2e-4, "{ratio}");
        assert!(
            (track * CONFIGURED.half_track_m / TRUTH.half_track_m - 1.0).abs() < 1e-3,
            "{track}"
        );
        // Sharp corners take no time, so the creep cannot be fitted and the errors are from UMBmark's formulas.
        let both = [ccw, cw];
        assert_eq!(fit(&both, 0.324), None);
        let errors = [0.5 * (ratio - 1.0), 1.0 / track - 1.0, 0.0];
        for item in &both {
            let ([x, y, _], _) = item.lap.predict(&errors);
            let left = (item.end[0] - x).hypot(item.end[1] - y);
            let [dx, dy] = item.error();
            assert!(left < 0.1 * dx.hypot(dy), "{left} of {}", dx.hypot(dy));
        }
    }

    #[test]
    fn systematic_error_is_the_larger_mean_of_both_directions() {
        let one = [[0.03, 0.0], [0.05, 0.0]];
        let two = [[0.0, 0.02], [0.0, -0.02]];
        assert!((systematic([&one, &two]) - 0.04).abs() < 1e-15);
    }
}
