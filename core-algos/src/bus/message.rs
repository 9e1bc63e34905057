//! What the nodes tell each other.
//!
//! Every message carries a sequence number: the number, modulo 256, of the 10 ms epoch its content
//! refers to. Odometric postures are cumulative, so a lost message delays information and loses
//! none; their positions are sent modulo [`POSITION_SPAN_M`], and only differences are used.

use crate::math::Posture;
use crate::math::matrix::Mat3;
use crate::math::wrench::Wrench;

/// Span after which a transmitted odometric position repeats, m.
pub const POSITION_SPAN_M: f32 = 104.857_6;

/// One of the two axles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Axle {
    /// Axle 1, at the tip of the beam.
    Front,
    /// Axle 2, at the root of the beam.
    Rear,
}

impl Axle {
    /// Both axles, front first.
    pub const BOTH: [Self; 2] = [Self::Front, Self::Rear];

    /// 0 for the front axle, 1 for the rear.
    pub const fn index(self) -> usize {
        match self {
            Self::Front => 0,
            Self::Rear => 1,
        }
    }
}

/// What the lead node asks of the axles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum LeadMode {
    /// Motors off.
    #[default]
    Idle,
    /// Follow the references.
    Active,
    /// Standstill at the end of a task: hold the references.
    Hold,
}

/// A message on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    /// Mode and progress of the lead node.
    LeadStatus {
        /// Epoch modulo 256.
        sequence: u8,
        /// What the axles are to do.
        mode: LeadMode,
        /// Commanded half steering angle ψ, rad.
        steering_rad: f32,
        /// Commanded velocity of the midpoint, m/s.
        velocity_m_s: f32,
    },
    /// Reference posture of an axle in that axle's odometric frame.
    ReferencePosture {
        /// The axle addressed.
        axle: Axle,
        /// Epoch modulo 256 at whose beginning the reference holds.
        sequence: u8,
        /// The reference.
        posture: Posture,
    },
    /// Reference velocities and accelerations of an axle.
    ReferenceMotion {
        /// The axle addressed.
        axle: Axle,
        /// Epoch modulo 256 at whose beginning the reference holds.
        sequence: u8,
        /// Forward velocity, m/s.
        velocity_m_s: f32,
        /// Yaw rate, rad/s.
        yaw_rate_rad_s: f32,
        /// Forward acceleration, m/s².
        acceleration_m_s2: f32,
        /// Yaw acceleration, rad/s².
        yaw_acceleration_rad_s2: f32,
    },
    /// Odometric posture of an axle since it was started, in its own frame.
    AxlePosture {
        /// The axle that measured.
        axle: Axle,
        /// Epoch modulo 256 at whose beginning the posture holds.
        sequence: u8,
        /// The posture.
        posture: Posture,
    },
    /// Velocity of an axle.
    AxleMotion {
        /// The axle that measured.
        axle: Axle,
        /// Epoch modulo 256.
        sequence: u8,
        /// Forward velocity, m/s.
        velocity_m_s: f32,
        /// Yaw rate, rad/s.
        yaw_rate_rad_s: f32,
        /// Measurements refused by the innovation gate since the last message, at most 255.
        refused: u8,
    },
    /// Covariance of the odometric increment of an axle over the last epoch, in the axle's frame
    /// at the beginning of that epoch.
    AxleUncertainty {
        /// The axle that measured.
        axle: Axle,
        /// Epoch modulo 256.
        sequence: u8,
        /// Covariance of (x, y, phi): m², m rad, rad².
        covariance: Mat3,
    },
    /// Posture of the front axle in the rear axle's frame, from the strains of the beam.
    BeamPosture {
        /// Epoch modulo 256 at whose beginning the posture holds.
        sequence: u8,
        /// The posture.
        posture: Posture,
        /// Number of gauges in use; 0 when there is no valid estimate.
        gauges: u8,
    },
    /// Covariance of the beam's posture.
    BeamUncertainty {
        /// Epoch modulo 256.
        sequence: u8,
        /// Covariance of (x, y, phi): m², m rad, rad².
        covariance: Mat3,
    },
    /// Wrench of the frame, from the strains.
    BeamWrench {
        /// Epoch modulo 256.
        sequence: u8,
        /// The wrench.
        wrench: Wrench,
    },
}
