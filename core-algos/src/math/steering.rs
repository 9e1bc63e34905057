//! Angles of the bent frame: steering ψ and relative heading 2ψ.

/// Steering angle ψ, rad, positive to the left: half the relative heading of the axles.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(transparent))]
#[repr(transparent)]
pub struct Steering(pub f32);

impl Steering {
    /// Straight frame.
    pub const STRAIGHT: Self = Self(0.0);

    /// Heading of the front axle against the rear axle.
    pub const fn relative_heading(self) -> RelativeHeading {
        RelativeHeading(2.0 * self.0)
    }
}

/// Heading of the front axle against the rear axle, 2ψ, rad, positive to the left.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
#[repr(transparent)]
pub struct RelativeHeading(pub f32);

impl RelativeHeading {
    /// Steering angle of this relative heading.
    pub const fn steering(self) -> Steering {
        Steering(0.5 * self.0)
    }
}
