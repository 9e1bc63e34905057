//! Messages to bytes and back, by the table of [`super::layout`].
//!
//! # Example
//!
//! ```
//! use core_algos::bus::{CanFrame, LeadMode, Message, decode, encode};
//!
//! let message = Message::LeadStatus {
//!     sequence: 7,
//!     mode: LeadMode::Active,
//!     steering_rad: 0.25,
//!     velocity_m_s: f32::NAN,
//! };
//! let refused = encode(&message).unwrap_err();
//! assert_eq!((refused.message, refused.signal), ("LeadStatus", "velocity"));
//!
//! let Message::LeadStatus { sequence, mode, steering_rad, .. } = message else { unreachable!() };
//! let message = Message::LeadStatus { sequence, mode, steering_rad, velocity_m_s: -0.125 };
//! let frame = encode(&message).unwrap();
//! // 2500 and -1250 units of 1e-4, little-endian.
//! assert_eq!(frame.data[..6], [7, 1, 0xc4, 0x09, 0x1e, 0xfb]);
//! assert_eq!(decode(&frame), Ok(message));
//! assert!(decode(&CanFrame { length: 3, ..frame }).is_err());
//! ```

use super::layout::{self, Signal, id};
use super::message::{Calibrate, CalibrationResult, LeadMode, Message, POSITION_SPAN_M};
use crate::math::matrix::{Mat3, cholesky};
use crate::math::trig::{exp, ln, sqrt, wrap_angle};
use crate::math::{Posture, Wrench};
use crate::safety::OperatingState;
use crate::topology::Node;
use crate::topology::{AxleId, Role};
use core::fmt;

/// A classic CAN data frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFrame {
    /// Identifier, 11 bits.
    pub id: u16,
    /// Number of data bytes, 0 to 8.
    pub length: u8,
    /// Data; bytes from `length` on are zero.
    pub data: [u8; 8],
}

/// A value that cannot be sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncodeError {
    /// Name of the message.
    pub message: &'static str,
    /// Name of the signal.
    pub signal: &'static str,
    /// The value.
    pub value: f32,
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}.{} = {}: not representable",
            self.message, self.signal, self.value
        )
    }
}

impl core::error::Error for EncodeError {}

/// A frame that is not a message of this bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// No message has this identifier.
    UnknownId(u16),
    /// The frame is too short or too long for its message.
    Length {
        /// Identifier of the frame.
        id: u16,
        /// Bytes it has.
        found: u8,
        /// Bytes it must have.
        expected: u8,
    },
    /// A signal holds a value its message does not know.
    Value {
        /// Identifier of the frame.
        id: u16,
    },
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownId(id) => write!(f, "identifier {id:#05x} is unknown"),
            Self::Length {
                id,
                found,
                expected,
            } => write!(f, "frame {id:#05x} has {found} bytes, must have {expected}"),
            Self::Value { id } => write!(f, "frame {id:#05x} holds an undefined value"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// Raw delay of a [`Message::TimeSync`] that says "not known".
const UNKNOWN_DELAY: u16 = u16::MAX;
const MAX_SIGNALS: usize = 7;
type Values = [f32; MAX_SIGNALS];

/// Bytes of a message. NaN, infinity and values outside a signal's range are refused.
///
/// Positions of odometric and reference postures are sent modulo [`POSITION_SPAN_M`].
pub fn encode(message: &Message) -> Result<CanFrame, EncodeError> {
    let (id, values) = to_values(message);
    let Some(layout) = layout::find(id) else {
        // The one message without an identifier: the service tool has no status.
        return Err(EncodeError {
            message: "NodeStatus",
            signal: "node",
            value: f32::from(id),
        });
    };
    let mut bits = 0u64;
    let mut position = 0u32;
    for (signal, &value) in layout.signals.iter().zip(&values) {
        let raw = to_raw(signal, value).ok_or(EncodeError {
            message: layout.name,
            signal: signal.name,
            value,
        })?;
        let mask = (1u64 << signal.bits) - 1;
        bits |= (u64::from(raw as u32) & mask) << position;
        position += u32::from(signal.bits);
    }
    Ok(CanFrame {
        id,
        length: layout.bytes(),
        data: bits.to_le_bytes(),
    })
}

/// The message in a frame.
pub fn decode(frame: &CanFrame) -> Result<Message, DecodeError> {
    let layout = layout::find(frame.id).ok_or(DecodeError::UnknownId(frame.id))?;
    if frame.length != layout.bytes() {
        return Err(DecodeError::Length {
            id: frame.id,
            found: frame.length,
            expected: layout.bytes(),
        });
    }
    let mut bits = u64::from_le_bytes(frame.data);
    let mut values = [0.0; MAX_SIGNALS];
    for (signal, value) in layout.signals.iter().zip(&mut values) {
        let raw = (bits & ((1u64 << signal.bits) - 1)) as u32;
        bits >>= signal.bits;
        let shift = 32 - u32::from(signal.bits);
        let raw = if signal.signed {
            ((raw << shift) as i32) >> shift
        } else {
            raw as i32
        };
        if !signal.labels.is_empty() && raw as usize >= signal.labels.len() {
            return Err(DecodeError::Value { id: frame.id });
        }
        *value = signal.physical(raw);
    }
    from_values(frame.id, &values).ok_or(DecodeError::Value { id: frame.id })
}

/// Nearest raw value; `None` for NaN and out of range.
fn to_raw(signal: &Signal, value: f32) -> Option<i32> {
    let scaled = (value - signal.offset) / signal.scale;
    let (low, high) = signal.raw_range();
    // Bounds are at most 2^24, so they, the whole part and the rest are exact in f32.
    if !(scaled > low as f32 - 1.0 && scaled < high as f32 + 1.0) {
        return None;
    }
    let whole = scaled as i32;
    let rest = scaled - whole as f32;
    let raw = if rest >= 0.5 {
        whole + 1
    } else if rest <= -0.5 {
        whole - 1
    } else {
        whole
    };
    (low..=high).contains(&raw).then_some(raw)
}

fn posture_values(sequence: u8, posture: &Posture) -> Values {
    // What would round up to half a span is the other end of it.
    const LAST: f32 = 0.5 * POSITION_SPAN_M - 6e-5;
    let position = |x: f32| {
        let wrapped = wrap_position(x);
        if wrapped > LAST {
            -0.5 * POSITION_SPAN_M
        } else {
            wrapped
        }
    };
    [
        f32::from(sequence),
        position(posture.x),
        position(posture.y),
        wrap_angle(posture.phi),
        0.0,
        0.0,
        0.0,
    ]
}

/// A position difference or position brought into half a span around zero.
pub fn wrap_position(x: f32) -> f32 {
    const HALF: f32 = 0.5 * POSITION_SPAN_M;
    if x.abs() < HALF {
        return x;
    }
    let reduced = x % POSITION_SPAN_M;
    if reduced >= HALF {
        reduced - POSITION_SPAN_M
    } else if reduced < -HALF {
        reduced + POSITION_SPAN_M
    } else {
        reduced
    }
}

/// Smallest standard deviation the bus tells from zero.
const SIGMA_FLOOR: f32 = 2e-9;

fn covariance_values(sequence: u8, covariance: &Mat3) -> Values {
    let sigma = [0, 1, 2].map(|i| sqrt(covariance[i][i]).max(SIGMA_FLOOR));
    let correlation = |i: usize, j: usize| covariance[i][j] / (sigma[i] * sigma[j]);
    // `max` would turn NaN into the floor; a covariance that is not finite must not be sent.
    let log = |i: usize| {
        if covariance[i][i] >= 0.0 {
            ln(sigma[i])
        } else {
            f32::NAN
        }
    };
    [
        f32::from(sequence),
        log(0),
        log(1),
        log(2),
        correlation(0, 1),
        correlation(0, 2),
        correlation(1, 2),
    ]
}

fn covariance_from(values: &Values) -> Mat3 {
    let sigma = [1, 2, 3].map(|i| exp(values[i]));
    let mut correlation = [values[4], values[5], values[6]];
    let mut m = [[0.0; 3]; 3];
    // Rounded correlations near one can make the matrix indefinite: pull them toward zero. The
    // scaled matrix is checked, because scaling rounds as well.
    for _ in 0..8 {
        let [xy, xp, yp] = correlation;
        let unit = [[1.0, xy, xp], [xy, 1.0, yp], [xp, yp, 1.0]];
        for i in 0..3 {
            for j in 0..3 {
                m[i][j] = unit[i][j] * (sigma[i] * sigma[j]);
            }
        }
        if cholesky(&m).is_some() {
            return m;
        }
        correlation = correlation.map(|c| 0.97 * c);
    }
    for i in 0..3 {
        for j in 0..3 {
            if i != j {
                m[i][j] = 0.0;
            }
        }
    }
    m
}

fn to_values(message: &Message) -> (u16, Values) {
    let pick = |axle: AxleId, id: u16| id + axle.index() as u16;
    match *message {
        Message::TimeSync {
            epoch,
            last_delay_us,
        } => (
            id::TIME_SYNC,
            [
                f32::from(epoch as u8),
                (epoch >> 8) as f32,
                f32::from(last_delay_us.unwrap_or(UNKNOWN_DELAY)),
                0.0,
                0.0,
                0.0,
                0.0,
            ],
        ),
        Message::LeadStatus {
            sequence,
            mode,
            steering_rad,
            velocity_m_s,
        } => {
            let (s, mode) = (f32::from(sequence), f32::from(mode as u8));
            (
                id::LEAD_STATUS,
                [s, mode, steering_rad, velocity_m_s, 0.0, 0.0, 0.0],
            )
        }
        Message::NodeStatus {
            node,
            sequence,
            state,
            reason,
            notices,
        } => (
            id::NODE_STATUS + node as u16,
            [
                f32::from(sequence),
                f32::from(state as u8),
                f32::from(reason),
                f32::from(notices),
                0.0,
                0.0,
                0.0,
            ],
        ),
        Message::ReferencePosture {
            axle,
            sequence,
            posture,
        } => (
            pick(axle, id::REFERENCE_POSTURE),
            posture_values(sequence, &posture),
        ),
        Message::ReferenceMotion {
            axle,
            sequence,
            velocity_m_s,
            yaw_rate_rad_s,
            acceleration_m_s2,
            yaw_acceleration_rad_s2,
        } => (
            pick(axle, id::REFERENCE_MOTION),
            [
                f32::from(sequence),
                velocity_m_s,
                yaw_rate_rad_s,
                acceleration_m_s2,
                yaw_acceleration_rad_s2,
                0.0,
                0.0,
            ],
        ),
        Message::AxlePosture {
            axle,
            sequence,
            posture,
        } => (
            pick(axle, id::AXLE_POSTURE),
            posture_values(sequence, &posture),
        ),
        Message::AxleMotion {
            axle,
            sequence,
            velocity_m_s,
            yaw_rate_rad_s,
            refused,
            gyro_samples,
            gyro_zeroed,
            uptime,
        } => (
            pick(axle, id::AXLE_MOTION),
            [
                f32::from(sequence),
                velocity_m_s,
                yaw_rate_rad_s,
                f32::from(refused),
                f32::from(gyro_samples),
                f32::from(u8::from(gyro_zeroed)),
                f32::from(uptime),
            ],
        ),
        Message::AxleUncertainty {
            axle,
            sequence,
            covariance,
        } => (
            pick(axle, id::AXLE_UNCERTAINTY),
            covariance_values(sequence, &covariance),
        ),
        Message::BeamPosture {
            sequence,
            posture,
            gauges,
        } => (
            id::BEAM_POSTURE,
            [
                f32::from(sequence),
                posture.x,
                posture.y,
                wrap_angle(posture.phi),
                f32::from(gauges),
                0.0,
                0.0,
            ],
        ),
        Message::BeamUncertainty {
            sequence,
            covariance,
        } => (
            id::BEAM_UNCERTAINTY,
            covariance_values(sequence, &covariance),
        ),
        Message::BeamWrench { sequence, wrench } => (
            id::BEAM_WRENCH,
            [
                f32::from(sequence),
                wrench.force_x,
                wrench.force_y,
                wrench.moment_root,
                wrench.moment_end,
                0.0,
                0.0,
            ],
        ),
        Message::BoardHealth {
            board,
            sequence,
            missed_ticks,
            tick_jitter_us,
            tick_worst_us,
            supply_v,
            temperature_c,
        } => (
            id::BOARD_HEALTH + board as u16,
            [
                f32::from(sequence),
                f32::from(missed_ticks),
                f32::from(tick_jitter_us),
                f32::from(tick_worst_us),
                supply_v,
                temperature_c,
                0.0,
            ],
        ),
        Message::BeamCalibration {
            sequence,
            calibrate,
        } => {
            let (command, curvature) = match calibrate {
                Calibrate::Zero(curvature) => (0.0, curvature),
                Calibrate::Gain(curvature) => (1.0, curvature),
            };
            let s = f32::from(sequence);
            (
                id::BEAM_CALIBRATION,
                [s, command, curvature, 0.0, 0.0, 0.0, 0.0],
            )
        }
        Message::BeamCalibrated {
            sequence,
            result,
            gauge,
        } => {
            let (s, result) = (f32::from(sequence), f32::from(result as u8));
            (
                id::BEAM_CALIBRATED,
                [s, result, f32::from(gauge), 0.0, 0.0, 0.0, 0.0],
            )
        }
    }
}

fn from_values(identifier: u16, values: &Values) -> Option<Message> {
    let sequence = values[0] as u8;
    let axle = if identifier & 1 == 0 {
        AxleId::Front
    } else {
        AxleId::Rear
    };
    let of_axle = |front: u16| identifier == front || identifier == front + 1;
    let posture = Posture::new(values[1], values[2], values[3]);
    Some(match identifier {
        id::TIME_SYNC => Message::TimeSync {
            epoch: (values[1] as u32) << 8 | u32::from(sequence),
            last_delay_us: Some(values[2] as u16).filter(|&delay| delay != UNKNOWN_DELAY),
        },
        id::LEAD_STATUS => Message::LeadStatus {
            sequence,
            mode: LeadMode::from_number(values[1] as u8)?,
            steering_rad: values[2],
            velocity_m_s: values[3],
        },
        id::NODE_STATUS..=0x043 => Message::NodeStatus {
            node: *Node::ALL.get(usize::from(identifier - id::NODE_STATUS))?,
            sequence,
            state: OperatingState::from_number(values[1] as u8)?,
            reason: values[2] as u8,
            notices: values[3] as u16,
        },
        _ if of_axle(id::REFERENCE_POSTURE) => Message::ReferencePosture {
            axle,
            sequence,
            posture,
        },
        _ if of_axle(id::REFERENCE_MOTION) => Message::ReferenceMotion {
            axle,
            sequence,
            velocity_m_s: values[1],
            yaw_rate_rad_s: values[2],
            acceleration_m_s2: values[3],
            yaw_acceleration_rad_s2: values[4],
        },
        _ if of_axle(id::AXLE_POSTURE) => Message::AxlePosture {
            axle,
            sequence,
            posture,
        },
        _ if of_axle(id::AXLE_MOTION) => Message::AxleMotion {
            axle,
            sequence,
            velocity_m_s: values[1],
            yaw_rate_rad_s: values[2],
            refused: values[3] as u8,
            gyro_samples: values[4] as u8,
            gyro_zeroed: values[5] != 0.0,
            uptime: values[6] as u8,
        },
        _ if of_axle(id::AXLE_UNCERTAINTY) => Message::AxleUncertainty {
            axle,
            sequence,
            covariance: covariance_from(values),
        },
        id::BEAM_POSTURE => Message::BeamPosture {
            sequence,
            posture,
            gauges: values[4] as u8,
        },
        id::BEAM_UNCERTAINTY => Message::BeamUncertainty {
            sequence,
            covariance: covariance_from(values),
        },
        id::BEAM_WRENCH => Message::BeamWrench {
            sequence,
            wrench: Wrench {
                force_x: values[1],
                force_y: values[2],
                moment_root: values[3],
                moment_end: values[4],
            },
        },
        id::BEAM_CALIBRATION => Message::BeamCalibration {
            sequence,
            calibrate: match values[1] as u8 {
                0 => Calibrate::Zero(values[2]),
                1 => Calibrate::Gain(values[2]),
                _ => return None,
            },
        },
        id::BEAM_CALIBRATED => Message::BeamCalibrated {
            sequence,
            result: CalibrationResult::from_number(values[1] as u8)?,
            gauge: values[2] as u8,
        },
        _ => Message::BoardHealth {
            board: *Role::ALL.get(usize::from(identifier.wrapping_sub(id::BOARD_HEALTH)))?,
            sequence,
            missed_ticks: values[1] as u8,
            tick_jitter_us: values[2] as u16,
            tick_worst_us: values[3] as u16,
            supply_v: values[4],
            temperature_c: values[5],
        },
    })
}

#[cfg(test)]
mod tests;
