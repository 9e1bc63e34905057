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
mod tests {
    use super::*;
    use crate::math::matrix::is_finite;
    use proptest::prelude::*;

    /// Signals that are no enumeration, each with its message.
    fn quantities() -> impl Iterator<Item = (&'static Signal, &'static layout::Layout)> {
        layout::MESSAGES.iter().flat_map(|layout| {
            let signals = layout.signals.iter();
            signals
                .filter(|signal| signal.labels.is_empty())
                .map(move |signal| (signal, layout))
        })
    }

    /// Half a unit beyond the range, computed in double precision.
    fn bounds(signal: &Signal) -> [f64; 2] {
        let (low, high) = signal.raw_range();
        let (scale, offset) = (f64::from(signal.scale), f64::from(signal.offset));
        [
            (f64::from(low) - 0.5) * scale + offset,
            (f64::from(high) + 0.5) * scale + offset,
        ]
    }

    fn range_holds(signal: &Signal, value: f32) -> bool {
        let [low, high] = bounds(signal);
        (low..high).contains(&f64::from(value))
    }

    /// So close to a bound that single precision may judge either way.
    fn at_a_bound(signal: &Signal, value: f32) -> bool {
        bounds(signal)
            .iter()
            .any(|bound| (f64::from(value) - bound).abs() <= 1e-6 * bound.abs())
    }

    fn round_trip(message: Message) -> Message {
        decode(&encode(&message).unwrap()).unwrap()
    }

    properties! {
        #[test]
        fn posture_survives_to_half_a_unit(
            x in -52.0f32..52.0, y in -52.0f32..52.0, phi in -3.1f32..3.1, sequence: u8,
        ) {
            for axle in AxleId::BOTH {
                let sent = Posture::new(x, y, phi);
                let received = round_trip(Message::AxlePosture { axle, sequence, posture: sent });
                let Message::AxlePosture { axle: a, sequence: s, posture } = received else {
                    panic!("{received:?}");
                };
                prop_assert_eq!((a, s), (axle, sequence));
                let [dx, dy, dphi] = posture.minus(sent);
                prop_assert!(dx.abs() < 6e-5 && dy.abs() < 6e-5 && dphi.abs() < 5.1e-5);
            }
        }

        #[test]
        fn positions_repeat_and_differences_stay(x in -400.0f32..400.0, step in -0.01f32..0.01) {
            let sent = |x| match round_trip(Message::AxlePosture {
                axle: AxleId::Rear, sequence: 0, posture: Posture::new(x, 0.0, 0.0),
            }) {
                Message::AxlePosture { posture, .. } => posture.x,
                _ => f32::NAN,
            };
            let difference = wrap_position(sent(x + step) - sent(x));
            prop_assert!((difference - step).abs() < 1.6e-4);
        }

        #[test]
        fn covariance_stays_positive_definite_and_close(
            l in proptest::array::uniform3(proptest::array::uniform3(-1.0f32..1.0)),
            exponent in -7.0f32..-1.0,
        ) {
            let size = exponent.exp2() * 1e-3;
            let mut m = crate::math::matrix::propagate(&l, &crate::math::matrix::identity());
            for i in 0..3 {
                m[i][i] += 1e-3;
                for j in 0..3 {
                    m[i][j] *= size * size;
                }
            }
            for i in 0..3 {
                m[i][i] *= 1.0001;
            }
            let Message::BeamUncertainty { covariance, .. } =
                round_trip(Message::BeamUncertainty { sequence: 1, covariance: m }) else {
                panic!("another message");
            };
            prop_assert!(cholesky(&covariance).is_some());
            for i in 0..3 {
                let ratio = covariance[i][i] / m[i][i];
                prop_assert!((0.975..1.025).contains(&ratio), "{}", ratio);
            }
        }

        #[test]
        fn positions_around_the_end_of_the_span_are_sent(turns in -3i32..3, step in -2e-4f32..2e-4) {
            let x = (turns as f32 + 0.5) * POSITION_SPAN_M + step;
            let Message::AxlePosture { posture, .. } = round_trip(Message::AxlePosture {
                axle: AxleId::Front, sequence: 0, posture: Posture::new(x, -x, 0.0),
            }) else {
                panic!("another message");
            };
            // Far from the origin a position is itself no finer than this.
            let resolution = 1e-4 + x.abs() * f32::EPSILON;
            prop_assert!(wrap_position(posture.x - wrap_position(x)).abs() <= resolution);
            prop_assert!(wrap_position(posture.y - wrap_position(-x)).abs() <= resolution);
        }

        /// Any value at all, of any signal: refused by name, or sent to the nearest unit.
        #[test]
        fn a_value_is_refused_or_rounded_to_the_nearest_unit(bits: u32, small in -40.0f32..40.0) {
            for value in [f32::from_bits(bits), small] {
                for (signal, layout) in quantities() {
                    match (to_raw(signal, value), range_holds(signal, value)) {
                        (Some(raw), true) => {
                            let off = f64::from(raw) * f64::from(signal.scale)
                                + f64::from(signal.offset) - f64::from(value);
                            let unit = f64::from(signal.scale);
                            // Half a unit, and the rounding of the quotient in single precision.
                            let slack = 0.5 * unit + 1e-6 * f64::from(value.abs() + signal.offset.abs());
                            prop_assert!(off.abs() <= slack, "{} {}", layout.name, signal.name);
                        }
                        (None, false) => {}
                        (raw, _) => prop_assert!(
                            at_a_bound(signal, value), "{} {} {value} {raw:?}", layout.name, signal.name
                        ),
                    }
                }
            }
        }

        /// Decoded and encoded again, every valid frame is the same frame.
        #[test]
        fn frames_survive_decoding_and_encoding(draws: [u32; MAX_SIGNALS]) {
            for layout in &layout::MESSAGES {
                let mut bits = 0u64;
                let mut position = 0;
                for (signal, draw) in layout.signals.iter().zip(draws) {
                    let (low, high) = if signal.name == "phi" {
                        // The bus carries headings within half a turn.
                        (-31_415, 31_415)
                    } else {
                        signal.raw_range()
                    };
                    let raw = i64::from(low) + i64::from(draw) % (i64::from(high) - i64::from(low) + 1);
                    bits |= (raw as u64 & ((1 << signal.bits) - 1)) << position;
                    position += u32::from(signal.bits);
                }
                let frame = CanFrame { id: layout.id, length: layout.bytes(), data: bits.to_le_bytes() };
                let message = decode(&frame);
                prop_assert!(message.is_ok(), "{message:?}");
                // A covariance is rebuilt positive definite, so its correlations may change.
                if layout.signals.last().is_some_and(|signal| signal.name != "correlation_yphi") {
                    prop_assert_eq!(encode(&message.unwrap()), Ok(frame));
                }
            }
        }

        #[test]
        fn any_frame_decodes_or_is_refused(id in 0u16..0x800, length in 0u8..16, data: [u8; 8]) {
            if let Ok(message) = decode(&CanFrame { id, length, data }) {
                // What was accepted is finite and can be sent again.
                match message {
                    Message::AxleUncertainty { covariance, .. }
                    | Message::BeamUncertainty { covariance, .. } => {
                        prop_assert!(is_finite(&covariance));
                    }
                    other => prop_assert!(encode(&other).is_ok()),
                }
            }
        }
    }

    #[test]
    fn nan_infinity_and_range_are_refused_by_name() {
        for bad in [f32::NAN, f32::INFINITY, 9.0] {
            let error = encode(&Message::BeamWrench {
                sequence: 0,
                wrench: Wrench {
                    moment_root: bad,
                    ..Wrench::ZERO
                },
            })
            .unwrap_err();
            assert_eq!((error.message, error.signal), ("BeamWrench", "moment_root"));
        }
        let mut covariance = [[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, f32::NAN]];
        let send = |covariance| {
            encode(&Message::BeamUncertainty {
                sequence: 0,
                covariance,
            })
        };
        assert!(send(covariance).is_err());
        covariance[2][2] = -1.0;
        assert!(send(covariance).is_err());
    }

    #[test]
    fn unknown_and_short_frames_are_refused() {
        let frame = |id, length| CanFrame {
            id,
            length,
            data: [0; 8],
        };
        assert_eq!(decode(&frame(0x123, 8)), Err(DecodeError::UnknownId(0x123)));
        assert_eq!(
            decode(&frame(0x100, 7)),
            Err(DecodeError::Length {
                id: 0x100,
                found: 7,
                expected: 8
            })
        );
        let mut undefined = frame(0x070, 6);
        undefined.data[1] = 9;
        assert_eq!(decode(&undefined), Err(DecodeError::Value { id: 0x070 }));
    }

    #[test]
    fn bytes_of_a_known_message() {
        // sequence 7, force_x 1 N = 20 units, force_y −0.05 N = −1 unit, moments 0.002 and 0.
        let frame = encode(&Message::BeamWrench {
            sequence: 7,
            wrench: Wrench {
                force_x: 1.0,
                force_y: -0.05,
                moment_root: 0.002,
                moment_end: 0.0,
            },
        })
        .unwrap();
        assert_eq!((frame.id, frame.length), (0x202, 8));
        let expected: u64 = 7 | 20 << 8 | 0x3fff << 22 | 2 << 36;
        assert_eq!(frame.data, expected.to_le_bytes());
    }
}
