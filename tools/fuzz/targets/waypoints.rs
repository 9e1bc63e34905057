//! Waypoint files: an accepted path has sound samples and passes its waypoints; an error names the line.
#![no_main]

use host_sim::paths::{Bounds, MAX_COORDINATE_M, Path, PathError, SPACING_M, Sample, waypoints};
use libfuzzer_sys::fuzz_target;

/// Upper limit of the sum of chords, m, for speed: a path of `MAX_LENGTH_M` has half a million samples and takes 1 s.
const LONGEST_M: f64 = 3.0;

fuzz_target!(|data: &[u8]| {
    let points = match waypoints(data) {
        Ok(points) => points,
        Err(error) => {
            let PathError::Row { line, .. } = error else {
                panic!("{error}");
            };
            let lines = data.split(|&byte| byte == b'\n').count() as u64;
            assert!((1..=lines).contains(&line), "{error}");
            return assert!(error.to_string().len() <= 600);
        }
    };
    let chords: f64 = points
        .windows(2)
        .map(|pair| (pair[1].x - pair[0].x).hypot(pair[1].y - pair[0].y))
        .sum();
    if chords > LONGEST_M
        && points
            .iter()
            .all(|p| p.x.abs().max(p.y.abs()) <= MAX_COORDINATE_M)
    {
        return;
    }
    let path = match Path::through(&points) {
        Ok(path) => path,
        Err(PathError::TooFew(count)) => return assert!(count < 2 && count == points.len()),
        Err(PathError::Waypoint { number, line, .. }) => {
            assert_eq!(points[number - 1].line, line);
            return assert!(line.is_some());
        }
        Err(PathError::TooLong(length)) => return assert!(length > LONGEST_M),
        Err(error) => panic!("{error}"),
    };
    let samples = path.samples();
    assert!(samples.len() as f64 <= path.length() / SPACING_M + 4.0);
    assert!(
        path.length() >= 0.999 * chords,
        "no shorter than its chords"
    );
    for pair in samples.windows(2) {
        assert!(pair[1].s > pair[0].s);
        let step = (pair[1].x - pair[0].x).hypot(pair[1].y - pair[0].y);
        assert!(step <= 1.05 * (pair[1].s - pair[0].s) + 1e-6, "{pair:?}");
    }
    for at in samples {
        assert!(at.x.is_finite() && at.y.is_finite() && at.phi.is_finite() && !at.kappa.is_nan());
    }
    for point in &points {
        let gaps = samples
            .windows(2)
            .map(|pair| distance(pair, point.x, point.y));
        let gap = gaps.fold(f64::INFINITY, f64::min);
        assert!(gap <= SPACING_M, "{point:?} is {gap} m off");
    }
    let bounds = Bounds::default();
    match path.check(&bounds) {
        Ok(()) => {
            assert!(path.max_curvature() <= bounds.max_curvature() * (1.0 + 1e-9));
            assert_eq!(path.points().len(), samples.len());
        }
        Err(
            PathError::Curvature { value, bound, .. }
            | PathError::SteeringRate { value, bound, .. },
        ) => {
            assert!(!(value.abs() <= bound));
        }
        Err(error) => panic!("{error}"),
    }
});

/// Distance of a point from the chord of two samples, m.
fn distance(pair: &[Sample], x: f64, y: f64) -> f64 {
    let (dx, dy) = (pair[1].x - pair[0].x, pair[1].y - pair[0].y);
    let (px, py) = (x - pair[0].x, y - pair[0].y);
    let u = ((dx * px + dy * py) / (dx * dx + dy * dy).max(1e-18)).clamp(0.0, 1.0);
    (px - u * dx).hypot(py - u * dy)
}
