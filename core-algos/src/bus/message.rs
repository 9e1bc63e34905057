//! What the nodes tell each other.
//!
//! Every message carries a sequence number: the number, modulo 256, of the 10 ms epoch its content
//! refers to. Odometric postures are cumulative, so a lost message delays information and loses
//! none; their positions are sent modulo [`POSITION_SPAN_M`], and only differences are used.

use crate::math::Posture;
use crate::math::matrix::Mat3;
use crate::math::wrench::Wrench;
use crate::safety::{Conditions, OperatingState};
use crate::topology::{AxleId, Node, Role};

/// Step of a transmitted odometric position, m.
pub const POSITION_STEP_M: f32 = 1e-5;
/// Width of a transmitted odometric position, bits.
pub const POSITION_BITS: u8 = 20;
/// Span after which it repeats, m.
pub const POSITION_SPAN_M: f32 = POSITION_STEP_M * (1 << POSITION_BITS) as f32;

/// An enumeration that crosses the bus as its index, with the names of its values.
macro_rules! wire_enum {
    ($(#[$doc:meta])* $name:ident { $($(#[$note:meta])* $value:ident = $label:literal,)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
        pub enum $name { $($(#[$note])* $value,)+ }

        impl $name {
            /// Every value, in the order of its number.
            pub const ALL: [Self; [$($label),+].len()] = [$(Self::$value),+];
            /// Names of the values.
            pub const NAMES: [&'static str; Self::ALL.len()] = [$($label),+];

            /// The value with this number.
            pub fn from_number(number: u8) -> Option<Self> {
                Self::ALL.get(usize::from(number)).copied()
            }
        }
    };
}

wire_enum! {
    /// Result of a calibration.
    CalibrationResult {
        /// Taken over and stored.
        #[default]
        Stored = "stored",
        /// Refused: the motors are on.
        MotorsOn = "motors_on",
        /// Refused: a sample was saturated or missing.
        BadSample = "bad_sample",
        /// Refused: samples scatter too much.
        Noisy = "noisy",
        /// Refused: the average moved.
        Drifting = "drifting",
        /// Refused: the result is out of range.
        OutOfRange = "out_of_range",
        /// In use, but it could not be stored.
        NotStored = "not_stored",
    }
}

/// A calibration the beam board can be asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Calibrate {
    /// The strip is bent to this curvature now (0 for straight), 1/m: find the zeros.
    Zero(f32),
    /// The strip is bent to this curvature now, 1/m: find the gains.
    Gain(f32),
}

wire_enum! {
    /// Mode that the lead node commands to the axles.
    LeadMode {
        /// Motors off.
        #[default]
        Idle = "idle",
        /// Follow the references.
        Active = "active",
        /// Standstill at the end of a task: hold the references.
        Hold = "hold",
        /// Motors off, and forget latched faults.
        Clear = "clear",
    }
}

/// A hash of 24 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Hash24(pub u32);

impl Hash24 {
    /// Hash (FNV-1a) of bytes.
    pub fn of(bytes: &[u8]) -> Self {
        let fold = |sum: u32, byte: &u8| (sum ^ u32::from(*byte)).wrapping_mul(0x0100_0193);
        let sum = bytes.iter().fold(0x811c_9dc5, fold);
        Self((sum ^ sum >> 24) & 0xff_ffff)
    }

    /// First six digits of the hash at the end of the text that names an image; zero without one.
    pub fn of_build(text: &str) -> Self {
        let hash = text.rsplit(' ').next().unwrap_or_default();
        let digits = hash.get(..6).unwrap_or_default();
        Self(u32::from_str_radix(digits, 16).unwrap_or_default())
    }
}

/// A message on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub enum Message {
    /// Sent by the front board at the beginning of every epoch, so that all boards count the same
    /// time.
    TimeSync {
        /// Number of the epoch that begins.
        epoch: u32,
        /// Time from the beginning of the epoch before to the end of that epoch's `TimeSync` on the
        /// bus, µs; `None` if it was not sent or not within 65 ms.
        last_delay_us: Option<u16>,
    },
    /// Mode and progress of the lead node.
    LeadStatus {
        /// Epoch modulo 256.
        sequence: u8,
        /// Mode commanded to the axles.
        mode: LeadMode,
        /// Commanded half steering angle ψ, rad.
        steering_rad: f32,
        /// Commanded velocity of the midpoint, m/s.
        velocity_m_s: f32,
    },
    /// Operating state of a node: its heartbeat.
    NodeStatus {
        /// The node.
        node: Node,
        /// Epoch modulo 256.
        sequence: u8,
        /// Operating state.
        state: OperatingState,
        /// Code of the first stop or cut since the last clearing, see
        /// [`Condition`](crate::safety::Condition); of a node that is not armed, what arming waits
        /// for; 0 if there is none.
        reason: u8,
        /// Notices and degradations since the heartbeat before.
        notices: Conditions,
    },
    /// Reference posture of an axle in that axle's odometric frame.
    ReferencePosture {
        /// The axle addressed.
        axle: AxleId,
        /// Epoch modulo 256 at whose beginning the reference holds.
        sequence: u8,
        /// The reference.
        posture: Posture,
    },
    /// Reference velocities and accelerations of an axle.
    ReferenceMotion {
        /// The axle addressed.
        axle: AxleId,
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
        axle: AxleId,
        /// Epoch modulo 256 at whose beginning the posture holds.
        sequence: u8,
        /// The posture.
        posture: Posture,
    },
    /// Velocity of an axle.
    AxleMotion {
        /// The axle that measured.
        axle: AxleId,
        /// Epoch modulo 256.
        sequence: u8,
        /// Forward velocity, m/s.
        velocity_m_s: f32,
        /// Yaw rate, rad/s.
        yaw_rate_rad_s: f32,
        /// Measurements refused by the innovation gate since the last message, at most 255.
        refused: u8,
        /// Yaw-rate samples that took part in the odometry since the last message, at most 127.
        gyro_samples: u8,
        /// True if the gyro was zeroed at rest since the last message.
        gyro_zeroed: bool,
        /// Epochs since the axle node was started and its odometric frame began, at most 255.
        uptime: u8,
    },
    /// Covariance of the odometric increment of an axle over the last epoch, in the axle's frame
    /// at the beginning of that epoch.
    AxleUncertainty {
        /// The axle that measured.
        axle: AxleId,
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
    /// Health of a board.
    BoardHealth {
        /// The board.
        board: Role,
        /// Epoch modulo 256.
        sequence: u8,
        /// Ticks that were missed since the start, at most 255.
        missed_ticks: u8,
        /// Largest lateness of a tick since the last report, µs, at most 4095.
        tick_jitter_us: u16,
        /// Longest tick since the last report, µs, at most 4095.
        tick_worst_us: u16,
        /// Supply of the board, V, at most 25.5.
        supply_v: f32,
        /// Highest temperature on the board, °C, −128 to 127.
        temperature_c: f32,
    },
    /// Asks the beam board for a calibration.
    BeamCalibration {
        /// Comes back in the answer.
        sequence: u8,
        /// Requested calibration.
        calibrate: Calibrate,
    },
    /// Answer of the beam board.
    BeamCalibrated {
        /// Of the request.
        sequence: u8,
        /// Result of the calibration.
        result: CalibrationResult,
        /// Gauge to blame, counted from the root.
        gauge: u8,
    },
    /// Identity of a board.
    BoardIdentity {
        /// The board.
        board: Role,
        /// Epoch modulo 256.
        sequence: u8,
        /// Hash of the chip's unique identifier.
        chip: Hash24,
        /// First digits of the hash of the image's sources.
        build: Hash24,
        /// [`schema`](super::layout::schema) of the image.
        schema: u8,
    },
}
