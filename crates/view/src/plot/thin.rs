//! Thinning of lines to visible points, and cutting of lines into dashes.

/// Thins a signal over time to the first, least, greatest and last point per half unit of width. Other lines are
/// unchanged.
pub(super) fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    straightened(&columns(points))
}

/// Thins a signal over time to the first, least, greatest and last point per half unit of width.
pub(super) fn columns(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let over_time = points.windows(2).all(|pair| pair[0].0 <= pair[1].0);
    if !over_time {
        return points.to_vec();
    }
    let column = |point: &(f64, f64)| (point.0 * 2.0).floor();
    let mut kept = Vec::new();
    for group in points.chunk_by(|a, b| column(a) == column(b)) {
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let pick = |point: Option<&(f64, f64)>| {
            point.and_then(|point| group.iter().position(|other| other == point))
        };
        let mut indices: Vec<usize> = [
            Some(0),
            pick(group.iter().min_by(by_height)),
            pick(group.iter().max_by(by_height)),
            Some(group.len() - 1),
        ]
        .into_iter()
        .flatten()
        .collect();
        indices.sort_unstable();
        indices.dedup();
        kept.extend(indices.into_iter().map(|index| group[index]));
    }
    kept
}

/// Drops points that lie within 0.1 units of the remaining line (Douglas and Peucker).
pub(super) fn straightened(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    const TOLERANCE: f64 = 0.1;
    if points.len() < 3 {
        return points.to_vec();
    }
    let mut keep = vec![false; points.len()];
    keep[0] = true;
    keep[points.len() - 1] = true;
    let mut open = vec![(0, points.len() - 1)];
    while let Some((first, last)) = open.pop() {
        let (a, b) = (points[first], points[last]);
        let farthest = (first + 1..last)
            .map(|k| (k, distance_to_segment(points[k], a, b)))
            .max_by(|one, two| one.1.total_cmp(&two.1));
        if let Some((k, distance)) = farthest
            && distance > TOLERANCE
        {
            keep[k] = true;
            open.push((first, k));
            open.push((k, last));
        }
    }
    let kept = points.iter().zip(keep).filter(|(_, keep)| *keep);
    kept.map(|(point, _)| *point).collect()
}

fn distance_to_segment(p: (f64, f64), a: (f64, f64), b: (f64, f64)) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let square = dx * dx + dy * dy;
    let fraction = if square > 0.0 {
        (((p.0 - a.0) * dx + (p.1 - a.1) * dy) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    libm::hypot(p.0 - a.0 - fraction * dx, p.1 - a.1 - fraction * dy)
}

/// Cuts a line into pieces by alternating lengths of dash and gap; returns the whole line if the pattern is empty.
///
/// In a PNG, the library's dashes restart at each point of a line, so that a curve appears solid.
pub(super) fn dashes(points: &[(f64, f64)], pattern: &[f64]) -> Vec<Vec<(f64, f64)>> {
    let mut lengths = pattern.iter().copied().cycle();
    let Some(first) = lengths.next() else {
        return vec![points.to_vec()];
    };
    let mut pieces = Vec::new();
    let mut piece: Vec<(f64, f64)> = points.first().copied().into_iter().collect();
    let (mut draws, mut left) = (true, first);
    for pair in points.windows(2) {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        let length = libm::hypot(x1 - x0, y1 - y0);
        let mut done = 0.0;
        while length - done > left {
            done += left;
            let at = (
                x0 + (x1 - x0) * done / length,
                y0 + (y1 - y0) * done / length,
            );
            if draws {
                piece.push(at);
                pieces.push(std::mem::take(&mut piece));
            } else {
                piece = vec![at];
            }
            draws = !draws;
            left = lengths.next().unwrap_or(first);
        }
        left -= length - done;
        if draws {
            piece.push((x1, y1));
        }
    }
    if piece.len() > 1 {
        pieces.push(piece);
    }
    pieces
}
