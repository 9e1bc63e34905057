//! Points of a path or trajectory in buffers of fixed size, and their interpolation.

use crate::math::Posture;
use crate::math::trig::{sin_cos, wrap_angle};
use core::fmt;

/// The lead is not raised beyond this share of `1/√(1 − r²κ²)`'s singularity.
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

impl PathPoint {
    /// The beginning of a straight path from the origin.
    const START: Self = Self {
        posture: Posture::ORIGIN,
        kappa: 0.0,
        s: 0.0,
    };
}

/// One point of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TrajectoryPoint {
    /// Time from the start, s.
    pub time_s: f32,
    /// Speed along the path, m/s, not negative.
    pub v: f32,
    /// Point of the reference.
    pub point: PathPoint,
}

/// Why a point was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PathError {
    /// No room: drive on, or give the buffer more points.
    Full,
    /// A component is not finite, or a speed negative.
    NotFinite,
    /// Arc length (of a trajectory: time) does not grow, or arc length falls.
    NotAdvancing,
    /// The path has already been ended.
    Ended,
    /// The frame does not bend to the curvature.
    TooTight,
}

impl fmt::Display for PathError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Full => "the path buffer is full",
            Self::NotFinite => "a component of the point is not a finite number",
            Self::NotAdvancing => "the point does not lie after the one before it",
            Self::Ended => "the path has already been ended",
            Self::TooTight => "the curvature of the point is more than the frame bends to",
        })
    }
}

impl core::error::Error for PathError {}

/// A first-in, first-out row of at most `N` values.
#[derive(Clone, Debug, PartialEq)]
struct Ring<T, const N: usize> {
    slots: [T; N],
    first: usize,
    count: usize,
}

impl<T: Copy, const N: usize> Ring<T, N> {
    /// Without values; `blank` fills the room.
    pub(super) const fn new(blank: T) -> Self {
        Self {
            slots: [blank; N],
            first: 0,
            count: 0,
        }
    }

    fn slot(&self, index: usize) -> usize {
        let place = self.first + index;
        if place >= N { place - N } else { place }
    }

    fn get(&self, index: usize) -> Option<T> {
        if index < self.count {
            self.slots.get(self.slot(index)).copied()
        } else {
            None
        }
    }

    fn last(&self) -> Option<T> {
        self.get(self.count.checked_sub(1)?)
    }

    /// True if there was room.
    pub(super) fn push(&mut self, value: T) -> bool {
        if self.count >= N {
            return false;
        }
        let place = self.slot(self.count);
        match self.slots.get_mut(place) {
            Some(slot) => {
                *slot = value;
                self.count += 1;
                true
            }
            None => false,
        }
    }

    fn drop_first(&mut self) {
        if self.count > 0 {
            self.first = self.slot(1);
            self.count -= 1;
        }
    }

    /// Index of the segment (a point and the next) whose first point is the last with
    /// `key ≤ value`, within the row; `None` with fewer than two points.
    fn segment(&self, value: f32, key: impl Fn(&T) -> f32) -> Option<usize> {
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
}

/// The path at one arc length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathSample {
    /// Position, m, and direction, rad.
    pub posture: Posture,
    /// Curvature, 1/m.
    pub kappa: f32,
    /// Its rate along the path (dκ/ds), 1/m².
    pub kappa_slope: f32,
}

/// The path between `a` and `b` at arc length `s`; beyond them, on the circle of the nearer one.
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
    // Hermite's cubic, written from the nearer point so that no digits are lost.
    let (dx, dy) = (b.posture.x - a.posture.x, b.posture.y - a.posture.y);
    let ease = u * u * (3.0 - 2.0 * u);
    let leave = u * (1.0 - u) * (1.0 - u) * length;
    let arrive = -u * u * (1.0 - u) * length;
    let turn = wrap_angle(b.posture.phi - a.posture.phi);
    // Heading as the integral of linear curvature, closed on the heading of the next point.
    let rise = b.kappa - a.kappa;
    let missing = turn - 0.5 * length * (a.kappa + b.kappa);
    let along = u * length;
    PathSample {
        posture: Posture {
            x: a.posture.x + ease * dx + leave * ca + arrive * cb,
            y: a.posture.y + ease * dy + leave * sa + arrive * sb,
            phi: wrap_angle(a.posture.phi + along * (a.kappa + 0.5 * u * rise) + u * missing),
        },
        kappa: a.kappa + u * rise,
        kappa_slope: rise / length,
    }
}

/// A path of at most `N` points, filled while it is driven.
#[derive(Clone, Debug, PartialEq)]
pub struct PathBuffer<const N: usize> {
    ring: Ring<PathPoint, N>,
    /// No more points will come; otherwise the robot stops at the last one it knows.
    complete: bool,
}

impl<const N: usize> Default for PathBuffer<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> PathBuffer<N> {
    /// Without points.
    pub const fn new() -> Self {
        Self {
            ring: Ring::new(PathPoint::START),
            complete: false,
        }
    }

    /// Number of points held.
    pub fn len(&self) -> usize {
        self.ring.count
    }

    /// True if there is no point.
    pub fn is_empty(&self) -> bool {
        self.ring.count == 0
    }

    /// Number of points that can still be pushed.
    pub fn room(&self) -> usize {
        N.saturating_sub(self.ring.count)
    }

    /// Appends a point; arc length must grow.
    pub fn push(&mut self, point: PathPoint) -> Result<(), PathError> {
        if self.complete {
            return Err(PathError::Ended);
        }
        if !(point.posture.is_finite() && point.kappa.is_finite() && point.s.is_finite()) {
            return Err(PathError::NotFinite);
        }
        if let Some(last) = self.ring.last()
            && !(point.s > last.s)
        {
            return Err(PathError::NotAdvancing);
        }
        if self.ring.push(point) {
            Ok(())
        } else {
            Err(PathError::Full)
        }
    }

    /// Declares the last point the end of the path.
    pub fn finish(&mut self) {
        self.complete = true;
    }

    /// True if no more points will come.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Arc length of the first point held, m; 0 if there is none.
    pub fn start(&self) -> f32 {
        self.ring.get(0).map_or(0.0, |point| point.s)
    }

    /// Arc length of the last point held, m; 0 if there is none.
    pub fn end(&self) -> f32 {
        self.ring.last().map_or(0.0, |point| point.s)
    }

    /// Drops the points that lie wholly before arc length `s` (m): the segment around `s` stays.
    pub fn discard_before(&mut self, s: f32) {
        while self.ring.count > 2 && self.ring.get(1).is_some_and(|second| second.s <= s) {
            self.ring.drop_first();
        }
    }

    /// The path at arc length `s` (m); it goes on beyond its ends on the circle of the end point.
    /// `None` if there is no point.
    pub fn at(&self, s: f32) -> Option<PathSample> {
        match self.ring.segment(s, |point| point.s) {
            Some(i) => Some(between(self.ring.get(i)?, self.ring.get(i + 1)?, s)),
            None => {
                let only = self.ring.get(0)?;
                Some(between(only, only, s))
            }
        }
    }

    /// Segment at index `i` counted from the one around `s`; `None` past the end.
    pub(super) fn segment_from(&self, s: f32, i: usize) -> Option<(PathPoint, PathPoint)> {
        let index = self.ring.segment(s, |point| point.s)? + i;
        Some((self.ring.get(index)?, self.ring.get(index + 1)?))
    }
}

/// A trajectory of at most `N` points, filled while it is driven.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryBuffer<const N: usize> {
    ring: Ring<TrajectoryPoint, N>,
}

impl<const N: usize> Default for TrajectoryBuffer<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> TrajectoryBuffer<N> {
    /// Without points.
    pub const fn new() -> Self {
        let blank = TrajectoryPoint {
            time_s: 0.0,
            v: 0.0,
            point: PathPoint::START,
        };
        Self {
            ring: Ring::new(blank),
        }
    }

    /// Number of points held.
    pub fn len(&self) -> usize {
        self.ring.count
    }

    /// True if there is no point.
    pub fn is_empty(&self) -> bool {
        self.ring.count == 0
    }

    /// Number of points that can still be pushed.
    pub fn room(&self) -> usize {
        N.saturating_sub(self.ring.count)
    }

    /// Appends a point; time must grow and arc length may not fall.
    pub fn push(&mut self, point: TrajectoryPoint) -> Result<(), PathError> {
        let place = point.point;
        if !(place.posture.is_finite()
            && place.kappa.is_finite()
            && place.s.is_finite()
            && point.time_s.is_finite()
            && point.v.is_finite()
            && point.v >= 0.0)
        {
            return Err(PathError::NotFinite);
        }
        if let Some(last) = self.ring.last()
            && !(point.time_s > last.time_s && place.s >= last.point.s)
        {
            return Err(PathError::NotAdvancing);
        }
        if self.ring.push(point) {
            Ok(())
        } else {
            Err(PathError::Full)
        }
    }

    /// Time of the first point held, s; 0 if there is none.
    pub fn start_time(&self) -> f32 {
        self.ring.get(0).map_or(0.0, |point| point.time_s)
    }

    /// Time of the last point, s; 0 if there is none.
    pub fn end_time(&self) -> f32 {
        self.ring.last().map_or(0.0, |point| point.time_s)
    }

    /// Drops the points that lie wholly before `time` (s): the segment around it stays.
    pub fn discard_before(&mut self, time: f32) {
        while self.ring.count > 2 && self.ring.get(1).is_some_and(|next| next.time_s <= time) {
            self.ring.drop_first();
        }
    }

    pub(super) fn place(&self, s: f32) -> Option<PathSample> {
        match self.ring.segment(s, |point| point.point.s) {
            Some(i) => Some(between(
                self.ring.get(i)?.point,
                self.ring.get(i + 1)?.point,
                s,
            )),
            None => {
                let only = self.ring.get(0)?.point;
                Some(between(only, only, s))
            }
        }
    }

    /// Arc length (m), speed (m/s) and acceleration (m/s²) at `time` (s): the cubic through both
    /// neighbours with their speeds. Before the first and after the last point: at rest there.
    pub(super) fn time_law(&self, time: f32) -> Option<[f32; 3]> {
        let first = self.ring.get(0)?;
        let last = self.ring.last()?;
        if !(time > first.time_s) {
            return Some([first.point.s, 0.0, 0.0]);
        }
        if !(time < last.time_s) {
            return Some([last.point.s, 0.0, 0.0]);
        }
        let i = self.ring.segment(time, |point| point.time_s)?;
        let (a, b) = (self.ring.get(i)?, self.ring.get(i + 1)?);
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
