//! A path drawn by hand, made smooth enough for the frame.

use host_sim::base::error::Error;
use host_sim::paths::{Path, PathError, Waypoint};
use host_sim::run::path_run::{Route, start_distances};
use host_sim::scenario::Scenario;

/// Distance between the points after resampling, m.
const SPACING_M: f64 = 0.05;
/// Number of resampled points from one waypoint to the next.
const STRIDE: usize = 5;
/// Lengths over which the path is smoothed, tried in this order, m.
const SMOOTHING_M: [f64; 7] = [0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8];
/// Longest drawn path, m.
const MAX_LENGTH_M: f64 = 100.0;
/// Length at the beginning in which the robot's heading decides, m.
const LEAD_IN_M: f64 = 0.1;

/// Path from the posture `at` through the points `drawn` (m). `at` belongs to the point of the robot that drives on the
/// path: the midpoint, or the first of three and more axles; `midpoint` is the robot's. The least smoothing that the
/// frame allows is used; the error names place and reason where no smoothing is enough.
pub fn route(
    at: [f64; 3],
    midpoint: [f64; 2],
    drawn: &[[f64; 2]],
    scenario: &Scenario,
) -> Result<Route, Error> {
    let lead_in = [0.0, LEAD_IN_M].map(|s| ahead(at, s));
    // What is drawn around the robot is left out.
    let reach = distance(midpoint, lead_in[0]) + LEAD_IN_M;
    let near = |point: &&[f64; 2]| distance(**point, midpoint) < reach;
    let rest = drawn.iter().skip_while(near);
    let points: Vec<[f64; 2]> = lead_in.into_iter().chain(rest.copied()).collect();
    let points = resampled(&points)?;
    let mut refused = Error::input("path: must be longer than 0.3 m");
    if points.len() <= STRIDE + 1 {
        return Err(refused);
    }
    for length_m in SMOOTHING_M {
        match smooth_route(at, &points, length_m, scenario) {
            Ok(route) => return Ok(route),
            Err(error) => refused = Error::input(format!("path: {error}")),
        }
    }
    Err(refused)
}

fn smooth_route(
    at: [f64; 3],
    points: &[[f64; 2]],
    length_m: f64,
    scenario: &Scenario,
) -> Result<Route, PathError> {
    let points = smoothed(points, length_m);
    let last = points.len() - 1;
    let chosen = (0..last)
        .step_by(STRIDE)
        .filter(|&i| last - i >= STRIDE / 2);
    let waypoints = chosen
        .chain([last])
        .map(|i| Waypoint::from((points[i][0], points[i][1])));
    let route = Route::new(&Path::through(&waypoints.collect::<Vec<_>>())?, 1, scenario)?;
    // The check takes a midpoint, and the first axle of a straight robot is ahead of it.
    let first = &route.path().samples()[0];
    let [x, y, _] = route.start();
    let [back_x, back_y] = ahead(at, -distance([first.x, first.y], [x, y]));
    route.check_start([back_x, back_y, at[2]], start_distances(scenario)[1])?;
    Ok(route)
}

/// Point at a distance (m) ahead of a posture.
fn ahead([x, y, phi]: [f64; 3], distance: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(phi);
    [x + distance * cos, y + distance * sin]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(a[0] - b[0], a[1] - b[1])
}

/// Points of a polyline at equal distances.
fn resampled(points: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, Error> {
    if let Some(point) = points.iter().flatten().find(|value| !value.is_finite()) {
        return Err(Error::input(format!(
            "path: point = {point}: must be a finite number"
        )));
    }
    let length: f64 = points
        .windows(2)
        .map(|pair| distance(pair[0], pair[1]))
        .sum();
    if !(length <= MAX_LENGTH_M) {
        return Err(Error::input(format!(
            "path: length = {length:.1} m: must be at most {MAX_LENGTH_M} m"
        )));
    }
    let mut found = vec![points[0]];
    // Distance from the latest point to the beginning of the segment.
    let mut passed = 0.0;
    for pair in points.windows(2) {
        let whole = distance(pair[0], pair[1]);
        let mut next = SPACING_M - passed;
        while next <= whole {
            let share = next / whole;
            found.push([0, 1].map(|k| pair[0][k] + share * (pair[1][k] - pair[0][k])));
            next += SPACING_M;
        }
        passed = whole - (next - SPACING_M);
    }
    Ok(found)
}

/// Points p that minimise Σ|p − points|² + λ Σ|second difference of p|² with λ = (length/spacing)⁴ (Whittaker 1923).
/// Position and direction of the beginning, and the end, stay.
fn smoothed(points: &[[f64; 2]], length_m: f64) -> Vec<[f64; 2]> {
    /// Weight of a point that stays.
    const FIXED: f64 = 1e9;
    let count = points.len();
    let lambda = libm::pow(length_m / SPACING_M, 4.0);
    // Diagonals of the matrix, and its factors L D Lᵀ in their place.
    let mut diagonal = vec![1.0; count];
    let (mut first, mut second) = (vec![0.0; count], vec![0.0; count]);
    for i in (0..2).chain([count - 1]) {
        diagonal[i] = FIXED;
    }
    let weights = diagonal.clone();
    for i in 0..count - 2 {
        for (offset, value) in [(0, 1.0), (1, 4.0), (2, 1.0)] {
            diagonal[i + offset] += lambda * value;
        }
        first[i] -= 2.0 * lambda;
        first[i + 1] -= 2.0 * lambda;
        second[i] += lambda;
    }
    for i in 0..count {
        let (f, s, d) = (first[i], second[i], diagonal[i]);
        if i + 1 < count {
            diagonal[i + 1] -= f * f / d;
            first[i + 1] -= f * s / d;
        }
        if i + 2 < count {
            diagonal[i + 2] -= s * s / d;
        }
        (first[i], second[i]) = (f / d, s / d);
    }
    let mut solved: Vec<[f64; 2]> = points.to_vec();
    for k in 0..2 {
        for i in 0..count {
            solved[i][k] *= weights[i];
        }
        for i in 0..count {
            let value = solved[i][k];
            if i + 1 < count {
                solved[i + 1][k] -= first[i] * value;
            }
            if i + 2 < count {
                solved[i + 2][k] -= second[i] * value;
            }
        }
        for i in (0..count).rev() {
            let mut value = solved[i][k] / diagonal[i];
            if i + 1 < count {
                value -= first[i] * solved[i + 1][k];
            }
            if i + 2 < count {
                value -= second[i] * solved[i + 2][k];
            }
            solved[i][k] = value;
        }
    }
    solved
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A circle of 0.8 m to the left, drawn by a hand that shakes by 1 cm.
    #[test]
    fn shaky_circle_becomes_a_path_near_the_circle() {
        let scenario = Scenario::default();
        let drawn: Vec<[f64; 2]> = (0..200)
            .map(|k| {
                let angle = 0.025 * f64::from(k);
                let radius = 0.8 + 0.01 * libm::sin(7.0 * f64::from(k));
                [radius * libm::sin(angle), 0.8 - radius * libm::cos(angle)]
            })
            .collect();
        let route = route([0.0; 3], [0.0; 2], &drawn, &scenario).unwrap();
        assert!(route.path().max_curvature() <= route.curvature_bound());
        let length = route.path().length();
        assert!(
            (length / (0.8 * 0.025 * 199.0) - 1.0).abs() < 0.05,
            "{length}"
        );
        for sample in route.path().samples() {
            let off = libm::hypot(sample.x, sample.y - 0.8) - 0.8;
            assert!(off.abs() < 0.06, "{off} at {} {}", sample.x, sample.y);
        }
    }

    #[test]
    fn path_that_turns_on_the_spot_or_is_too_short_or_too_long_is_refused_with_its_place() {
        let scenario = Scenario::default();
        let refusal = |drawn: &[[f64; 2]]| {
            route([0.0; 3], [0.0; 2], drawn, &scenario)
                .unwrap_err()
                .to_string()
        };
        let zigzag: Vec<[f64; 2]> = (0..20)
            .map(|k| [1.0 - f64::from(k % 2), 0.02 * f64::from(k)])
            .collect();
        let text = refusal(&zigzag);
        assert!(
            text.starts_with("path: ") && text.contains("at s = "),
            "{text}"
        );
        assert!(refusal(&[]).contains("must be longer"));
        assert!(refusal(&[[0.0, 0.1]]).contains("must be longer"));
        assert!(refusal(&[[200.0, 0.0]]).contains("must be at most"));
        assert!(refusal(&[[f64::NAN, 0.0]]).contains("finite"));
    }

    /// At the minimum the gradient is zero: p − points + λ Dᵀ D p, with D the second difference.
    #[test]
    fn smoothed_points_minimise_distance_and_bending_and_keep_the_ends() {
        let points: Vec<[f64; 2]> = (0..40)
            .map(|k| [0.05 * f64::from(k), 0.1 * libm::sin(1.7 * f64::from(k))])
            .collect();
        let length_m = 0.15;
        let lambda = libm::pow(length_m / SPACING_M, 4.0);
        let p = smoothed(&points, length_m);
        for i in [0, 1, 39] {
            assert!(distance(p[i], points[i]) < 1e-6, "{i}");
        }
        let bend = |i: usize| p[i][1] - 2.0 * p[i + 1][1] + p[i + 2][1];
        for i in 2..37 {
            let gradient =
                p[i][1] - points[i][1] + lambda * (bend(i - 2) - 2.0 * bend(i - 1) + bend(i));
            assert!(gradient.abs() < 1e-9, "{i}: {gradient}");
        }
    }

    #[test]
    fn resampled_points_are_equally_far_apart() {
        let points = resampled(&[[0.0, 0.0], [0.12, 0.0], [0.12, 0.31], [0.3, 0.31]]).unwrap();
        assert_eq!(points.len(), 13);
        for (k, point) in points.iter().enumerate() {
            let s = SPACING_M * k as f64;
            let on_line = match s {
                s if s <= 0.12 => [s, 0.0],
                s if s <= 0.43 => [0.12, s - 0.12],
                s => [s - 0.31, 0.31],
            };
            assert!(distance(*point, on_line) < 1e-9, "{k}: {point:?}");
        }
    }
}
