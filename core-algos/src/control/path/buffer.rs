//! Points of a path or trajectory in buffers of fixed size, and their interpolation.

use crate::math::Posture;
use crate::math::trig::{sin_cos, wrap_angle};
use core::fmt;

/// Limit of r²κ² for the distance by which a reference leads O: its factor `1/√(1 − r²κ²)` is singular at r²κ² = 1.
pub(super) const MAX_BEND_SQUARED: f32 = 0.9;

/// One point of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PathPoint {
    /// Position, m, and direction of the path, rad.
    pub posture: Posture,
    /// Curvature, 1/m, positive to the left.
    pub kappa: f32,
    /// Arc length from the start, m.
    pub s: f32,
}

/// One point of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TrajectoryPoint {
    /// Time from the start, s.
    pub time_s: f32,
    /// Speed along the path, m/s, not negative.
    pub v: f32,
    /// Point of the path at this time.
    pub point: PathPoint,
}

/// Reason for the rejection of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PathError {
    /// The buffer is full: some points must be driven first, or the buffer must be larger.
    Full,
    /// A component is not finite, or a speed negative.
    NotFinite,
    /// Arc length does not increase. In a trajectory: time does not increase, or arc length decreases.
    NotAdvancing,
    /// The path has already been ended.
    Ended,
    /// The curvature is more than the frame can bend to.
    TooTight,
}

impl fmt::Display for PathError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Full => "the path buffer is full",
            Self::NotFinite => "a component of the point is not a finite number",
            Self::NotAdvancing => "the point is not after the previous point",
            Self::Ended => "the path has already ended",
            Self::TooTight => "the curvature of the point exceeds the limit of the frame",
        })
    }
}

impl core::error::Error for PathError {}

/// Interpolated point of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathSample {
    /// Position, m, and direction, rad.
    pub posture: Posture,
    /// Curvature, 1/m.
    pub kappa: f32,
    /// Rate of curvature along the path (dκ/ds), 1/m².
    pub kappa_slope: f32,
}

/// The path between `a` and `b` at arc length `s`. At these points and beyond, the path is the circle of the nearer
/// point, with constant curvature.
pub(super) fn between(a: PathPoint, b: PathPoint, s: f32) -> PathSample {
    let length = b.s - a.s;
    let beyond = |end: PathPoint| PathSample {
        posture: end.posture.advance(s - end.s, end.kappa * (s - end.s)),
        kappa: end.kappa,
        kappa_slope: 0.0,
    };
    if !(s > a.s) || !(length > 0.0) {
        return beyond(a);
    }
    if !(s < b.s) {
        return beyond(b);
    }
    let u = (s - a.s) / length;
    let (sa, ca) = sin_cos(a.posture.phi);
    let (sb, cb) = sin_cos(b.posture.phi);
    // Hermite cubic, relative to `a` so that no digits are lost.
    let (dx, dy) = (b.posture.x - a.posture.x, b.posture.y - a.posture.y);
    let ease = u * u * (3.0 - 2.0 * u);
    let leave = u * (1.0 - u) * (1.0 - u) * length;
    let arrive = -u * u * (1.0 - u) * length;
    let turn = wrap_angle(b.posture.phi - a.posture.phi);
    // Heading: integral of the linear curvature, corrected to reach the heading of the next point.
    let rise = b.kappa - a.kappa;
    let missing = turn - 0.5 * length * (a.kappa + b.kappa);
    let distance = u * length;
    PathSample {
        posture: Posture {
            x: a.posture.x + ease * dx + leave * ca + arrive * cb,
            y: a.posture.y + ease * dy + leave * sa + arrive * sb,
            phi: wrap_angle(a.posture.phi + distance * (a.kappa + 0.5 * u * rise) + u * missing),
        },
        kappa: a.kappa + u * rise,
        kappa_slope: rise / length,
    }
}

/// A point of a buffer; points are in ascending order.
pub trait Point: Copy {
    /// Value of unused slots.
    const BLANK: Self;

    /// Arc length (m) or time (s), which grows from point to point.
    fn key(&self) -> f32;

    /// The point without its time and speed.
    fn place(&self) -> PathPoint;

    /// True if every component is valid.
    fn is_sound(&self) -> bool;

    /// True if the point may come after `last`.
    fn follows(&self, last: &Self) -> bool;
}

impl Point for PathPoint {
    const BLANK: Self = Self {
        posture: Posture::ORIGIN,
        kappa: 0.0,
        s: 0.0,
    };

    fn key(&self) -> f32 {
        self.s
    }

    fn place(&self) -> PathPoint {
        *self
    }

    fn is_sound(&self) -> bool {
        self.posture.is_finite() && self.kappa.is_finite() && self.s.is_finite()
    }

    /// Arc length must increase.
    fn follows(&self, last: &Self) -> bool {
        self.s > last.s
    }
}

impl Point for TrajectoryPoint {
    const BLANK: Self = Self {
        time_s: 0.0,
        v: 0.0,
        point: PathPoint::BLANK,
    };

    fn key(&self) -> f32 {
        self.time_s
    }

    fn place(&self) -> PathPoint {
        self.point
    }

    fn is_sound(&self) -> bool {
        self.point.is_sound() && self.time_s.is_finite() && self.v.is_finite() && self.v >= 0.0
    }

    /// Time must increase and arc length may not decrease.
    fn follows(&self, last: &Self) -> bool {
        self.time_s > last.time_s && self.point.s >= last.point.s
    }
}

/// Ring buffer of at most `N` points. New points are added while driven points are dropped.
#[derive(Clone, Debug, PartialEq)]
pub struct Buffer<P, const N: usize> {
    slots: [P; N],
    first: usize,
    count: usize,
    /// True if no more points will come. Otherwise the robot stops at the last point and waits for more.
    complete: bool,
}

/// A path of at most `N` points.
pub type PathBuffer<const N: usize> = Buffer<PathPoint, N>;

/// A trajectory of at most `N` points.
pub type TrajectoryBuffer<const N: usize> = Buffer<TrajectoryPoint, N>;

impl<P: Point, const N: usize> Default for Buffer<P, N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<P: Point, const N: usize> Buffer<P, N> {
    /// An empty buffer.
    pub const fn new() -> Self {
        Self {
            slots: [P::BLANK; N],
            first: 0,
            count: 0,
            complete: false,
        }
    }

    /// Number of points held.
    pub fn len(&self) -> usize {
        self.count
    }

    /// True if there is no point.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of points that can still be pushed.
    pub fn room(&self) -> usize {
        N.saturating_sub(self.count)
    }

    fn slot(&self, index: usize) -> usize {
        let place = self.first + index;
        if place >= N { place - N } else { place }
    }

    fn get(&self, index: usize) -> Option<P> {
        if index < self.count {
            self.slots.get(self.slot(index)).copied()
        } else {
            None
        }
    }

    fn last(&self) -> Option<P> {
        self.get(self.count.checked_sub(1)?)
    }

    /// Appends a point; refuses a point that is not finite or does not advance, and any point after the end.
    pub fn push(&mut self, point: P) -> Result<(), PathError> {
        if self.complete {
            return Err(PathError::Ended);
        }
        if !point.is_sound() {
            return Err(PathError::NotFinite);
        }
        if self.last().is_some_and(|last| !point.follows(&last)) {
            return Err(PathError::NotAdvancing);
        }
        if self.count >= N {
            return Err(PathError::Full);
        }
        let place = self.slot(self.count);
        let slot = self.slots.get_mut(place).ok_or(PathError::Full)?;
        *slot = point;
        self.count += 1;
        Ok(())
    }

    /// Declares the last point held the end of the path.
    pub fn finish(&mut self) {
        self.complete = true;
    }

    /// True if no more points will come.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Arc length (m) or time (s) of the first point held; 0 if there is none.
    pub fn start(&self) -> f32 {
        self.get(0).map_or(0.0, |point| point.key())
    }

    /// Arc length (m) or time (s) of the last point held; 0 if there is none.
    pub fn end(&self) -> f32 {
        self.last().map_or(0.0, |point| point.key())
    }

    /// Posture of the last point held; the origin if there is none.
    pub fn last_posture(&self) -> Posture {
        self.last()
            .map_or(Posture::ORIGIN, |point| point.place().posture)
    }

    /// Drops the points before `key`, except the start of the segment around `key`.
    pub fn discard_before(&mut self, key: f32) {
        while self.count > 2 && self.get(1).is_some_and(|second| second.key() <= key) {
            self.first = self.slot(1);
            self.count -= 1;
        }
    }

    /// Index of the last point with `key ≤ value` that has a successor; the first point if there is no such point.
    /// `None` with fewer than two points.
    fn index(&self, value: f32, key: impl Fn(&P) -> f32) -> Option<usize> {
        let last = self.count.checked_sub(2)?;
        let (mut low, mut high) = (0, last);
        while low < high {
            let middle = low + (high - low).div_ceil(2);
            let below = self.get(middle).is_some_and(|point| key(&point) <= value);
            if below {
                low = middle;
            } else {
                high = middle - 1;
            }
        }
        Some(low)
    }

    /// The point of [`Self::index`] and the next point.
    fn segment(&self, value: f32, key: impl Fn(&P) -> f32) -> Option<[P; 2]> {
        let first = self.index(value, key)?;
        Some([self.get(first)?, self.get(first + 1)?])
    }

    /// The path at arc length `s` (m). Beyond its ends, the path continues on the circle of the end point. `None` if
    /// there is no point.
    pub fn at(&self, s: f32) -> Option<PathSample> {
        let [a, b] = match self.segment(s, |point| point.place().s) {
            Some(segment) => segment,
            None => [self.get(0)?; 2],
        };
        Some(between(a.place(), b.place(), s))
    }
}

impl<const N: usize> PathBuffer<N> {
    /// Segments from the segment around `s` onward.
    pub(super) fn segments_from(&self, s: f32) -> impl Iterator<Item = [PathPoint; 2]> {
        let mut next = self.index(s, |point| point.s);
        let mut end = next.and_then(|first| self.get(first));
        core::iter::from_fn(move || {
            let (begin, index) = (end?, next? + 1);
            end = self.get(index);
            next = Some(index);
            Some([begin, end?])
        })
    }
}

impl<const N: usize> TrajectoryBuffer<N> {
    /// Arc lengths of the first and the last point, m; `None` without points.
    pub(in crate::control) fn bounds(&self) -> Option<[f32; 2]> {
        Some([self.get(0)?.point.s, self.last()?.point.s])
    }

    /// Arc length (m), speed (m/s) and acceleration (m/s²) at `time` (s), by the cubic through the neighbouring points
    /// with their speeds. Before the first and after the last point: at rest at this point.
    pub(in crate::control) fn time_law(&self, time: f32) -> Option<[f32; 3]> {
        let (first, last) = (self.get(0)?, self.last()?);
        if !(time > first.time_s) {
            return Some([first.point.s, 0.0, 0.0]);
        }
        if !(time < last.time_s) {
            return Some([last.point.s, 0.0, 0.0]);
        }
        let [a, b] = self.segment(time, |point| point.time_s)?;
        let span = b.time_s - a.time_s;
        let u = (time - a.time_s) / span;
        let mean = (b.point.s - a.point.s) / span;
        let bow = a.v + b.v - 2.0 * mean;
        let lift = 3.0 * mean - 2.0 * a.v - b.v;
        Some([
            a.point.s + u * span * (a.v + u * (lift + u * bow)),
            a.v + u * (2.0 * lift + 3.0 * u * bow),
            (2.0 * lift + 6.0 * u * bow) / span,
        ])
    }
}
