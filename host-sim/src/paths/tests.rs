use super::curve::wrapped;
use super::*;
use core_algos::control::path::TrajectoryBuffer;
use std::f64::consts::TAU;

/// Distance (m) of a point from the path.
fn distance(path: &Path, x: f64, y: f64) -> f64 {
    path.samples
        .windows(2)
        .map(|pair| {
            let (dx, dy) = (pair[1].x - pair[0].x, pair[1].y - pair[0].y);
            let (px, py) = (x - pair[0].x, y - pair[0].y);
            let u = ((dx * px + dy * py) / (dx * dx + dy * dy).max(1e-18)).clamp(0.0, 1.0);
            (px - u * dx).hypot(py - u * dy)
        })
        .fold(f64::INFINITY, f64::min)
}

fn line_of(points: &[(f64, f64)]) -> Result<Path, PathError> {
    let points: Vec<Waypoint> = points.iter().map(|&p| p.into()).collect();
    Path::through(&points)
}

/// Compares spacing, heading and curvature of the samples with differences of their positions and headings.
fn assert_consistent(path: &Path) {
    let samples = path.samples();
    let step = path.length() / (samples.len() - 1) as f64;
    for three in samples.windows(3) {
        let [a, b, c] = [three[0], three[1], three[2]];
        let chord = (b.x - a.x).hypot(b.y - a.y);
        let sagged = step * (1.0 - (step * b.kappa).powi(2) / 24.0);
        assert!((chord - sagged).abs() < 3e-6, "{chord} {sagged} {b:?}");
        let direction = (c.y - a.y).atan2(c.x - a.x);
        assert!(wrapped(direction - b.phi).abs() < 1e-3, "{b:?}");
        let turning = wrapped(c.phi - a.phi) / (2.0 * step);
        assert!(
            (turning - b.kappa).abs() < 0.02 * (1.0 + b.kappa.abs()),
            "{b:?}"
        );
    }
}

#[test]
fn built_in_shapes_have_analytic_length_and_curvature() {
    let line = Path::line(2.0).unwrap();
    assert_consistent(&line);
    assert_eq!((line.length(), line.max_curvature()), (2.0, 0.0));

    let circle = Path::circle(0.8).unwrap();
    assert_consistent(&circle);
    assert!((circle.length() - TAU * 0.8).abs() < 1e-9);
    assert!(
        circle
            .samples()
            .iter()
            .all(|at| (at.x.hypot(at.y - 0.8) - 0.8).abs() < 1e-9)
    );
    assert!(
        circle
            .samples()
            .iter()
            .all(|at| (at.kappa - 1.25).abs() < 1e-9)
    );

    let eight = Path::figure_eight(1.2).unwrap();
    assert_consistent(&eight);
    // Lemniscate: length 5.244115 a, curvature 3/a at the tips, product of the distances from the foci a²/2.
    assert!((eight.length() - 5.244_115_108_58 * 1.2).abs() < 1e-8);
    assert!((eight.max_curvature() - 3.0 / 1.2).abs() < 1e-6);
    let focus = 1.2 / 2.0; // a/√2 along each of x and −y
    for at in eight.samples() {
        let product = (at.x - focus).hypot(at.y + focus) * (at.x + focus).hypot(at.y - focus);
        let mirrored = (at.x - focus).hypot(at.y - focus) * (at.x + focus).hypot(at.y + focus);
        assert!((product - 0.72).abs() < 1e-9 || (mirrored - 0.72).abs() < 1e-9);
    }
    let start = eight.samples()[0];
    assert!(start.x.abs() < 1e-12 && start.y.abs() < 1e-12 && start.phi.abs() < 1e-12);
    assert!(eight.samples()[5].kappa > 0.0, "left first");
}

#[test]
fn spline_passes_its_waypoints_with_continuous_curvature() {
    let points = [(0.0, 0.0), (0.8, 0.1), (1.5, 0.8), (2.5, 0.6), (3.0, -0.4)];
    let path = line_of(&points).unwrap();
    assert_consistent(&path);
    for (x, y) in points {
        assert!(distance(&path, x, y) < 2e-4);
    }
    let step = path.length() / (path.samples().len() - 1) as f64;
    for pair in path.samples().windows(2) {
        assert!((pair[1].kappa - pair[0].kappa).abs() < 20.0 * step);
    }
    assert!(path.samples()[0].kappa.abs() < 1e-9, "straight at its ends");
}

#[test]
fn closed_spline_is_smooth_at_its_closure() {
    let on_circle: Vec<(f64, f64)> = (0..=24)
        .map(|i| (TAU * f64::from(i) / 24.0).sin_cos())
        .collect();
    let path = line_of(&on_circle).unwrap();
    assert!(path.is_closed());
    // The path runs clockwise round the unit circle. The curvature of a spline has an error of h²/12.
    for at in path.samples() {
        assert!((at.kappa + 1.0).abs() < 0.007, "{at:?}");
    }
    let (first, last) = (path.samples()[0], *path.samples().last().unwrap());
    assert!((first.kappa - last.kappa).abs() < 1e-9);
    assert!(wrapped(first.phi - last.phi).abs() < 1e-9);
}

#[test]
fn path_with_excess_curvature_is_refused_with_place_and_value() {
    let bounds = Bounds::default();
    assert!(Path::circle(0.33).unwrap().check(&bounds).is_ok());
    let error = Path::circle(0.3).unwrap().check(&bounds).unwrap_err();
    assert!(error.to_string().starts_with("curvature 3.333 1/m at s = "));
    assert!(error.to_string().ends_with("at most 3.080 1/m"));

    // Path with a right angle at the third waypoint.
    let corner = line_of(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 0.3), (2.0, 2.0)]);
    let PathError::Curvature { place, value, .. } = corner.unwrap().check(&bounds).unwrap_err()
    else {
        panic!("not refused for curvature");
    };
    assert!(value > 3.08);
    assert_eq!(place.waypoint, Some((3, None)));
    assert!((place.x - 2.0).hypot(place.y) < 0.1);
}

#[test]
fn path_with_excess_steering_rate_is_refused() {
    let eight = Path::figure_eight(1.2).unwrap();
    let slow = Bounds {
        max_steering_rate_rad_s: 0.01,
        ..Bounds::default()
    };
    assert!(eight.check(&Bounds::default()).is_ok());
    let error = eight.check(&slow).unwrap_err();
    assert!(matches!(error, PathError::SteeringRate { bound, .. } if (bound - 0.2).abs() < 1e-12));
    assert!(error.to_string().contains("rad/m at s = "));
}

#[test]
fn invalid_waypoints_are_refused_by_line() {
    let text = |result: Result<Path, PathError>| result.unwrap_err().to_string();
    let csv = |rows: &str| text(Path::from_csv(rows.as_bytes()));
    assert_eq!(
        text(line_of(&[(0.0, 0.0)])),
        "1 waypoint(s): a path needs at least 2"
    );
    assert_eq!(csv("x,y\n"), "0 waypoint(s): a path needs at least 2");
    assert_eq!(
        csv("x,y\n0,0\n1,a\n"),
        "line 3: y = \"a\": must be a number"
    );
    assert_eq!(
        csv("0,0\n\n1,1,1\n"),
        "line 3: 3 field(s): must be 2, x and y"
    );
    for (row, found) in [
        ("1;2", "separator ;: must be a comma"),
        ("1,5;2,5", "separator ; and the decimal comma"),
        ("0,5;1", "separator ; and the decimal comma"),
        ("1\t2", "separator tab: must be a comma"),
        ("1,5\t2", "separator tab and the decimal comma"),
        ("1 2", "separator space: must be a comma"),
    ] {
        let refused = csv(&format!("x,y\n0,0\n{row}\n"));
        assert!(
            refused.starts_with("line 3: ") && refused.contains(found),
            "{refused}"
        );
    }
    assert!(csv("0,0\n1,NaN\n").starts_with("line 2, waypoint 2: y = NaN: must be"));
    assert!(csv("0,0\ninf,1\n").starts_with("line 2, waypoint 2: x = inf"));
    assert!(csv("0,0\n1,1\n1,1\n2,2\n").starts_with("line 3, waypoint 3: repeats waypoint 2"));
    assert!(csv("0,0\nx,y\n").starts_with("line 2: x = \"x\""));
    let bytes: &[u8] = b"0,0\n\xff,1\n";
    assert!(text(Path::from_csv(bytes)).starts_with("line 2: not UTF-8"));
    assert!(text(Path::circle(f64::NAN)).starts_with("radius = NaN"));
    assert!(text(Path::line(0.0)).starts_with("length = 0"));
}

#[test]
fn header_is_optional() {
    let with = Path::from_csv("X, Y\n0,0\n1,0.1\n2,0\n".as_bytes()).unwrap();
    let without = Path::from_csv("0,0\n1,0.1\n2,0".as_bytes()).unwrap();
    assert_eq!(with.samples(), without.samples());
    let units = Path::from_csv("x_m,y_m\n0,0\n1,0.1\n2,0\n".as_bytes()).unwrap();
    assert_eq!(units.samples(), without.samples());
}

#[test]
fn unrolled_path_of_two_laps_is_open_and_twice_as_long() {
    let circle = Path::circle(0.5).unwrap();
    let twice = circle.unrolled(2);
    assert!(!twice.is_closed());
    assert!((twice.length() - 2.0 * circle.length()).abs() < 1e-9);
    assert_consistent(&twice);
}

#[test]
fn trajectory_keeps_its_limits_and_has_consistent_derivatives() {
    let (bounds, limits) = (Bounds::default(), TimeLimits::default());
    for path in [
        Path::line(1.0).unwrap(),
        Path::line(0.03).unwrap(),
        Path::figure_eight(1.0).unwrap().unrolled(2),
        line_of(&[(0.0, 0.0), (1.0, 0.1), (1.8, 0.9), (3.0, 1.0)]).unwrap(),
    ] {
        let trajectory = Trajectory::fastest(
            &path,
            &bounds,
            &TimeLimits {
                interval_s: 0.01,
                ..limits
            },
        )
        .unwrap();
        let points = trajectory.points();
        let (first, last) = (points[0], *points.last().unwrap());
        assert!(first.v.abs() < 1e-9 && last.v.abs() < 1e-9);
        assert!((last.sample.s - path.length()).abs() < 1e-6);
        let mut fastest = 0.0f64;
        for pair in points.windows(2) {
            let [a, b] = [pair[0], pair[1]];
            fastest = fastest.max(b.v);
            assert!(b.v <= limits.max_speed_m_s + 1e-9 && b.v >= -1e-9);
            assert!(b.a.abs() <= limits.max_acceleration_m_s2 + 1e-9);
            assert!((b.sample.s - a.sample.s - 0.005 * (a.v + b.v)).abs() < 1e-5);
            assert!((b.v - a.v - 0.005 * (a.a + b.a)).abs() < 1e-4);
            let jerk = 2.0 * limits.max_acceleration_m_s2 / limits.smoothing_s;
            assert!((b.a - a.a).abs() <= jerk * 0.01 + 1e-9);
            let turn = bounds.steering(b.sample.kappa) - bounds.steering(a.sample.kappa);
            assert!(turn.abs() / 0.01 < limits.max_steering_rate_rad_s);
        }
        assert!(fastest > 0.19 || path.length() < 0.1);
        // The robot's buffer accepts the points in single precision.
        let mut buffer = TrajectoryBuffer::<8000>::new();
        for point in trajectory.to_points() {
            buffer.push(point).unwrap();
        }
    }
}
