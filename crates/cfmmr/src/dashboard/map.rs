//! Map of the run: robot with its bent frame, path, goal, and the 95 % ellipse of the position.

use super::view::View;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::widgets::canvas::{Canvas, Line, Points};
use ratatui::widgets::{Block, Borders};

/// Half of an axle's drawn length, m.
const HALF_TRACK_M: f64 = 0.16;
/// Least half width and height of the map, m.
const MIN_HALF_RANGE_M: f64 = 0.5;
/// Scale of the standard deviations for 95 % of a normal distribution in the plane: √5.991.
const SCALE_95: f64 = 2.4477;

/// Draws the map.
pub fn draw(frame: &mut Frame, area: Rect, view: &View) {
    let Some((center, half)) = bounds(view, area) else {
        return;
    };
    let title = format!(" Map, {:.1} x {:.1} m ", 2.0 * half[0], 2.0 * half[1]);
    let block = Block::new().borders(Borders::TOP).title(title);
    let canvas = Canvas::default()
        .block(block)
        .marker(Marker::Braille)
        .x_bounds([center[0] - half[0], center[0] + half[0]])
        .y_bounds([center[1] - half[1], center[1] + half[1]])
        .paint(|context| {
            let mut points = |coords: &[[f64; 2]], color| {
                let coords: Vec<(f64, f64)> = coords.iter().map(|[x, y]| (*x, *y)).collect();
                context.draw(&Points::new(&coords, color));
            };
            points(&view.trail, Color::Blue);
            points(&ellipse(view), Color::Yellow);
            let mut lines = |corners: &[[f64; 2]], color| {
                for pair in corners.windows(2) {
                    let ([x1, y1], [x2, y2]) = (pair[0], pair[1]);
                    context.draw(&Line::new(x1, y1, x2, y2, color));
                }
            };
            for frame in &view.record.frames {
                let points = frame.points.map(|point| point.map(f64::from));
                lines(&points, Color::White);
            }
            for axle in &view.record.axles {
                let [x, y, phi] = axle.posture;
                let (s, c) = libm::sincos(phi);
                let end = |side: f64| [x - side * HALF_TRACK_M * s, y + side * HALF_TRACK_M * c];
                lines(&[end(1.0), end(-1.0)], Color::White);
            }
            let [x, y, phi] = view.goal;
            if x.is_nan() {
                return;
            }
            let ahead = [x + 0.1 * libm::cos(phi), y + 0.1 * libm::sin(phi)];
            lines(&[[x, y], ahead], Color::Green);
            context.print(x, y, "+");
        });
    frame.render_widget(canvas, area);
}

/// Center and half size of the map, m. Both axes have one scale; a character cell is twice as high as wide.
fn bounds(view: &View, area: Rect) -> Option<([f64; 2], [f64; 2])> {
    let axles = view.record.axles.iter().map(|axle| &axle.posture);
    let corners = axles.chain([&view.goal]);
    let corners = corners
        .map(|at| [at[0], at[1]])
        .chain(view.trail.iter().copied());
    let known = corners.filter(|at| at.iter().all(|value| value.is_finite()));
    let (low, high) = known.fold(([f64::MAX; 2], [f64::MIN; 2]), |(low, high), at| {
        let with = |limit: [f64; 2], better: fn(f64, f64) -> f64| {
            [better(limit[0], at[0]), better(limit[1], at[1])]
        };
        (with(low, f64::min), with(high, f64::max))
    });
    let cells = [
        f64::from(area.width),
        2.0 * f64::from(area.height.checked_sub(1)?),
    ];
    if low[0] > high[0] || cells.contains(&0.0) {
        return None;
    }
    let center = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
    let half = [0, 1].map(|k| (0.5 * (high[k] - low[k]) + 0.3).max(MIN_HALF_RANGE_M));
    let scale = (half[0] / cells[0]).max(half[1] / cells[1]);
    Some((center, cells.map(|count| scale * count)))
}

/// Points of the 95 % ellipse of the midpoint.
fn ellipse(view: &View) -> Vec<[f64; 2]> {
    let robot = &view.record.lead.fused.robot;
    let [x, y] = [robot.posture.x, robot.posture.y].map(f64::from);
    let p = |i: usize, k: usize| f64::from(robot.covariance[i][k]);
    // Cholesky factor of the position's covariance: [[a, 0], [b, c]].
    let a = p(0, 0).max(0.0).sqrt();
    let b = if a > 0.0 { p(0, 1) / a } else { 0.0 };
    let c = (p(1, 1) - b * b).max(0.0).sqrt();
    let point = |i: u32| {
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * f64::from(i) / 48.0);
        [x + SCALE_95 * a * cos, y + SCALE_95 * (b * cos + c * sin)]
    };
    (0..48).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::math::Posture;

    /// Every point has the squared Mahalanobis distance 5.991, the 95 % quantile of χ² with 2 degrees of freedom.
    #[test]
    fn ellipse_has_the_mahalanobis_distance_of_95_percent() {
        let mut view = View::default();
        let robot = &mut view.record.lead.fused.robot;
        robot.posture = Posture::new(1.0, -2.0, 0.3);
        let (xx, xy, yy) = (0.04f32, 0.02f32, 0.03f32);
        robot.covariance[0] = [xx, xy, 0.0];
        robot.covariance[1] = [xy, yy, 0.0];
        let (xx, xy, yy) = (f64::from(xx), f64::from(xy), f64::from(yy));
        let det = xx * yy - xy * xy;
        for [x, y] in ellipse(&view) {
            let (dx, dy) = (x - 1.0, y + 2.0);
            let squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det;
            assert!((squared - 5.991).abs() < 1e-2, "{squared}");
        }
    }
}
