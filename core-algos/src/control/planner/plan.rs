//! Segments of a plan.

use crate::control::kinematic::Direction;
use crate::math::Posture;

/// A piece of path of constant curvature.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Segment {
    /// End of the robot that leads.
    pub direction: Direction,
    /// Curvature of the path of O, 1/m, positive to the left of the robot's heading.
    pub curvature: f32,
    /// Length, m, not negative.
    pub length_m: f32,
}

impl Segment {
    /// The segment with another length, m.
    pub(super) fn with_length(self, length_m: f32) -> Self {
        Self { length_m, ..self }
    }

    /// The posture `distance` metres into the segment that starts at `from`.
    pub fn posture_at(&self, from: Posture, distance: f32) -> Posture {
        let ds = self.direction.sign() * distance;
        from.advance(ds, ds * self.curvature)
    }
}

/// Segments that lead into the funnel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plan {
    pub(super) first: Option<Segment>,
    pub(super) second: Option<Segment>,
    /// Direction in which to approach the goal from the end of the segments.
    pub approach: Direction,
    /// Estimated length of segments and approach plus the price of cusps and stops, m.
    pub cost_m: f32,
}

impl Plan {
    /// A plan without segments: the approach starts at once.
    pub const fn direct(approach: Direction) -> Self {
        Self {
            first: None,
            second: None,
            approach,
            cost_m: 0.0,
        }
    }

    /// A plan of one segment.
    #[cfg(test)]
    pub(in crate::control) fn single(segment: Segment) -> Self {
        Self {
            first: Some(segment),
            ..Self::default()
        }
    }

    /// Segment `index`; `None` beyond the last segment.
    pub fn segment(&self, index: usize) -> Option<Segment> {
        match index {
            0 => self.first,
            1 => self.second,
            _ => None,
        }
    }

    /// The segments in order.
    pub fn segments(&self) -> impl Iterator<Item = Segment> {
        self.first.into_iter().chain(self.second)
    }
}
