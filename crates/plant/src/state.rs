//! State of the plant for its users.

use super::geometry::Vec3;

/// State of one axle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxleState {
    /// Midpoint (m, m) and heading (rad, not wrapped) in the global frame.
    pub posture: Vec3,
    /// Velocity of the midpoint forward and to the left (m/s) and yaw rate (rad/s).
    pub velocity: Vec3,
    /// Specific force at the midpoint forward and to the left (m/s²): acceleration minus gravity along the floor, as an
    /// accelerometer there reads. Third entry: yaw acceleration (rad/s²). Means over the last step.
    pub acceleration: Vec3,
    /// Wheel speeds, left and right, rad/s, positive forward.
    pub wheel_speed: [f64; 2],
    /// Wheel angles since the start, rad.
    pub wheel_angle: [f64; 2],
    /// Speeds of the motors at the wheels' side of the gears, rad/s: the wheel speeds except within the backlash.
    pub motor_speed: [f64; 2],
    /// Angles of the motors since the start, at the wheels' side of the gears, rad: the encoders measure these.
    pub motor_angle: [f64; 2],
    /// Torques of the motors at the wheels after all limits, N m.
    pub torque: [f64; 2],
    /// Loads on the left and the right wheel, N.
    pub load: [f64; 2],
}

/// Wrench of a frame: (+force, +root moment) on the axle behind, (−force, −end moment) on the axle
/// ahead, in the coordinates of the axle behind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force forward and to the left, N.
    pub force: [f64; 2],
    /// Moment about the midpoint of the axle behind, N m.
    pub root_moment: f64,
    /// Moment about the midpoint of the axle ahead, N m.
    pub end_moment: f64,
}

/// Counters of the solution of the frames since the robot was placed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Health {
    /// Number of substeps taken.
    pub steps: u64,
    /// Number of factorisations of the frames' equations.
    pub factorisations: u64,
    /// Largest number of factorisations for one equilibrium.
    pub most_factorisations: u32,
    /// Parts of substeps taken; an undivided substep is one part.
    pub parts: u64,
    /// Evaluations of a frame's wrench by its linear prediction.
    pub linear_wrenches: u64,
    /// Number of snap-throughs of a frame from one branch to another.
    pub snap_throughs: u64,
    /// Parts of substeps in which a frame was under internal viscosity, during snap-throughs.
    pub creep_steps: u64,
    /// Parts of substeps in which a frame had no solution even under internal viscosity and kept its shape.
    pub failures: u64,
}
