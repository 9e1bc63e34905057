//! Splines through waypoints, and waypoints from CSV files.

use super::curve::Path;
use super::limits::PathError;
use super::{MAX_COORDINATE_M, MIN_SEPARATION_M};

/// A point that a path must pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Position along x, m.
    pub x: f64,
    /// Position along y, m.
    pub y: f64,
    /// Line in the file, from 1; `None` for a waypoint from no file.
    pub line: Option<u64>,
}

impl From<(f64, f64)> for Waypoint {
    fn from((x, y): (f64, f64)) -> Self {
        Self { x, y, line: None }
    }
}

/// Waypoints of a CSV file: two columns, x and y in metres, with or without the header `x,y` or `x_m,y_m`. Empty lines
/// are skipped.
pub fn waypoints(csv: &[u8]) -> Result<Vec<Waypoint>, PathError> {
    let mut waypoints = Vec::new();
    let mut first = true;
    let content = csv.strip_prefix(b"\xef\xbb\xbf").unwrap_or(csv);
    for (row, line) in content.split(|&byte| byte == b'\n').zip(1..) {
        let refuse = |problem: String| PathError::Row { line, problem };
        let row = std::str::from_utf8(row)
            .map_err(|_| refuse("not UTF-8".to_owned()))?
            .trim();
        if row.is_empty() {
            continue;
        }
        let fields: Vec<&str> = row
            .split(',')
            .map(|field| field.trim().trim_matches('"'))
            .collect();
        let &[x, y] = fields.as_slice() else {
            return Err(refuse(format!(
                "{} field(s): must be 2, x and y{}",
                fields.len(),
                separator(row)
            )));
        };
        let header = [x, y].map(str::to_ascii_lowercase);
        if std::mem::take(&mut first) && [["x", "y"], ["x_m", "y_m"]].iter().any(|h| header == *h) {
            continue;
        }
        let number = |name: &str, text: &str| {
            text.parse::<f64>().map_err(|_| {
                let shown: String = text.chars().take(40).collect();
                refuse(format!(
                    "{name} = {shown:?}: must be a number{}",
                    separator(row)
                ))
            })
        };
        waypoints.push(Waypoint {
            x: number("x", x)?,
            y: number("y", y)?,
            line: Some(line),
        });
    }
    Ok(waypoints)
}

/// Advice in errors about a row that is not separated by commas.
fn separator(row: &str) -> &'static str {
    let decimal_comma = row.contains(',');
    match row {
        _ if row.contains(';') && decimal_comma => {
            "; found the separator ; and the decimal comma: write 0.5,1.25"
        }
        _ if row.contains(';') => "; found the separator ;: must be a comma",
        _ if row.contains('\t') && decimal_comma => {
            "; found the separator tab and the decimal comma: write 0.5,1.25"
        }
        _ if row.contains('\t') => "; found the separator tab: must be a comma",
        _ if row.split_whitespace().count() == 2 && !decimal_comma => {
            "; found the separator space: must be a comma"
        }
        _ => "",
    }
}

impl Path {
    /// A cubic spline through waypoints, twice continuously differentiable in chord length. The ends have zero
    /// curvature. If the last waypoint repeats the first, the path is closed and equally smooth there. Refuses
    /// fewer than two waypoints, coordinates that are not finite or too large, and a waypoint that repeats the
    /// previous waypoint.
    pub fn through(waypoints: &[Waypoint]) -> Result<Self, PathError> {
        let refuse = |number: usize, problem: String| PathError::Waypoint {
            number: number + 1,
            line: waypoints[number].line,
            problem,
        };
        if waypoints.len() < 2 {
            return Err(PathError::TooFew(waypoints.len()));
        }
        for (i, point) in waypoints.iter().enumerate() {
            for (name, value) in [("x", point.x), ("y", point.y)] {
                if !(value.abs() <= MAX_COORDINATE_M) {
                    return Err(refuse(
                        i,
                        format!("{name} = {value}: must be a number from -1000 to 1000"),
                    ));
                }
            }
        }
        let mut knots = vec![0.0];
        for (i, pair) in waypoints.windows(2).enumerate() {
            let chord = libm::hypot(pair[1].x - pair[0].x, pair[1].y - pair[0].y);
            if chord < MIN_SEPARATION_M {
                return Err(refuse(
                    i + 1,
                    format!(
                        "repeats waypoint {} (waypoints must be at least 1 mm apart)",
                        i + 1
                    ),
                ));
            }
            knots.push(knots[i] + chord);
        }
        let last = waypoints.len() - 1;
        let gap = libm::hypot(
            waypoints[last].x - waypoints[0].x,
            waypoints[last].y - waypoints[0].y,
        );
        let closed = last >= 3 && gap < MIN_SEPARATION_M;
        let mut values = [
            waypoints.iter().map(|p| p.x).collect::<Vec<_>>(),
            waypoints.iter().map(|p| p.y).collect::<Vec<_>>(),
        ];
        if closed {
            for axis in &mut values {
                axis[last] = axis[0];
            }
        }
        let moments = values
            .each_ref()
            .map(|axis| spline_moments(&knots, axis, closed));
        let curve = |t: f64| {
            let i = knots.partition_point(|&k| k <= t).clamp(1, last) - 1;
            let h = knots[i + 1] - knots[i];
            let (b, a) = ((t - knots[i]) / h, (knots[i + 1] - t) / h);
            let mut result = [[0.0; 2]; 3];
            for axis in 0..2 {
                let (y0, y1) = (values[axis][i], values[axis][i + 1]);
                let (m0, m1) = (moments[axis][i], moments[axis][i + 1]);
                result[0][axis] =
                    a * y0 + b * y1 + ((a * a * a - a) * m0 + (b * b * b - b) * m1) * h * h / 6.0;
                result[1][axis] =
                    (y1 - y0) / h + ((3.0 * b * b - 1.0) * m1 - (3.0 * a * a - 1.0) * m0) * h / 6.0;
                result[2][axis] = a * m0 + b * m1;
            }
            result
        };
        let mut path = Self::from_curve(&curve, &knots, closed)?;
        for (place, waypoint) in path.waypoints.iter_mut().zip(waypoints) {
            place.1 = waypoint.line;
        }
        Ok(path)
    }

    /// Path through the waypoints of a CSV file, whose format [`waypoints`] describes.
    pub fn from_csv(bytes: &[u8]) -> Result<Self, PathError> {
        Self::through(&waypoints(bytes)?)
    }
}

/// Second derivatives at the knots of the cubic spline through `values`: natural, or periodic.
fn spline_moments(knots: &[f64], values: &[f64], closed: bool) -> Vec<f64> {
    let n = knots.len() - 1;
    let h = |i: usize| knots[i + 1] - knots[i];
    let slope = |i: usize| (values[i + 1] - values[i]) / h(i);
    if !closed {
        let mut moments = vec![0.0; n + 1];
        if n < 2 {
            return moments;
        }
        let (lower, diagonal, right): (Vec<_>, Vec<_>, Vec<_>) = (1..n)
            .map(|i| {
                (
                    h(i - 1),
                    2.0 * (h(i - 1) + h(i)),
                    6.0 * (slope(i) - slope(i - 1)),
                )
            })
            .collect();
        let upper: Vec<_> = (1..n).map(h).collect();
        moments[1..n].copy_from_slice(&tridiagonal(&lower, &diagonal, &upper, &right));
        return moments;
    }
    // Knot n is knot 0: a cyclic tridiagonal system of n unknowns, by the Sherman-Morrison formula.
    let before = |i: usize| if i == 0 { n - 1 } else { i - 1 };
    let lower: Vec<_> = (0..n).map(|i| h(before(i))).collect();
    let upper: Vec<_> = (0..n).map(h).collect();
    let mut diagonal: Vec<_> = (0..n).map(|i| 2.0 * (h(before(i)) + h(i))).collect();
    let right: Vec<_> = (0..n)
        .map(|i| 6.0 * (slope(i) - slope(before(i))))
        .collect();
    let corner = lower[0];
    let gamma = -diagonal[0];
    diagonal[0] -= gamma;
    diagonal[n - 1] -= corner * corner / gamma;
    let mut edge = vec![0.0; n];
    edge[0] = gamma;
    edge[n - 1] = corner;
    let solution = tridiagonal(&lower, &diagonal, &upper, &right);
    let response = tridiagonal(&lower, &diagonal, &upper, &edge);
    let factor = (solution[0] + corner / gamma * solution[n - 1])
        / (1.0 + response[0] + corner / gamma * response[n - 1]);
    let mut moments: Vec<_> = solution
        .iter()
        .zip(&response)
        .map(|(value, share)| value - factor * share)
        .collect();
    moments.push(moments[0]);
    moments
}

/// Solves a tridiagonal system of equations; the first entry of `lower` and the last entry of `upper` are not read.
fn tridiagonal(lower: &[f64], diagonal: &[f64], upper: &[f64], right: &[f64]) -> Vec<f64> {
    let n = diagonal.len();
    let mut ratio = vec![0.0; n];
    let mut solution = vec![0.0; n];
    for i in 0..n {
        let (before, value) = if i == 0 {
            (0.0, 0.0)
        } else {
            (lower[i] * ratio[i - 1], lower[i] * solution[i - 1])
        };
        let pivot = diagonal[i] - before;
        ratio[i] = upper[i] / pivot;
        solution[i] = (right[i] - value) / pivot;
    }
    for i in (0..n.saturating_sub(1)).rev() {
        solution[i] -= ratio[i] * solution[i + 1];
    }
    solution
}
