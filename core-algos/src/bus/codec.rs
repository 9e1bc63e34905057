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
use super::message::{
    Calibrate, CalibrationResult, Hash24, LeadMode, Message, POSITION_SPAN_M, POSITION_STEP_M,
};
use crate::math::matrix::{Mat3, cholesky};
use crate::math::trig::{exp, ln, sqrt, wrap_angle};
use crate::math::{Posture, Wrench};
use crate::safety::{Conditions, OperatingState};
use crate::topology::{AxleId, Node, Role};
use core::fmt;
use core::slice::{Iter, IterMut};

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

/// Covariance of logarithms of standard deviations and of correlations.
fn covariance_from(logs: [f32; 3], mut correlation: [f32; 3]) -> Mat3 {
    let sigma = logs.map(exp);
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

/// A field of a message as one or more values of the bus, in the order of its signals.
trait Field: Sized {
    /// Appends the values.
    fn write(self, to: &mut IterMut<f32>);
    /// Takes the values; `None` if they are no field of this type.
    fn read(from: &mut Iter<f32>) -> Option<Self>;
}

impl Field for f32 {
    fn write(self, to: &mut IterMut<f32>) {
        if let Some(value) = to.next() {
            *value = self;
        }
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        from.next().copied()
    }
}

impl<const N: usize> Field for [f32; N] {
    fn write(self, to: &mut IterMut<f32>) {
        self.into_iter().for_each(|value| value.write(to));
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f32::read(from)?;
        }
        Some(values)
    }
}

/// A field of one value: `write` and `read` as functions of `f32`.
macro_rules! single {
    ($($kind:ty: |$field:ident| $write:expr, |$value:ident| $read:expr;)+) => {$(
        impl Field for $kind {
            fn write(self, to: &mut IterMut<f32>) {
                let $field = self;
                f32::write($write, to);
            }

            fn read(from: &mut Iter<f32>) -> Option<Self> {
                let $value = f32::read(from)?;
                $read
            }
        }
    )+};
}

single! {
    u8: |number| number.into(), |value| Some(value as u8);
    u16: |number| number.into(), |value| Some(value as u16);
    bool: |flag| u8::from(flag).into(), |value| Some(value != 0.0);
    Option<u16>: |delay| delay.unwrap_or(UNKNOWN_DELAY).into(),
        |value| Some(Some(value as u16).filter(|&delay| delay != UNKNOWN_DELAY));
    Hash24: |hash| hash.0 as f32, |value| Some(Self(value as u32));
    LeadMode: |mode| f32::from(mode as u8), |value| Self::from_number(value as u8);
    OperatingState: |state| f32::from(state as u8), |value| Self::from_number(value as u8);
    CalibrationResult: |result| f32::from(result as u8), |value| Self::from_number(value as u8);
}

/// The number of an epoch: its lowest byte, then the rest.
impl Field for u32 {
    fn write(self, to: &mut IterMut<f32>) {
        (self as u8).write(to);
        ((self >> 8) as f32).write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let sequence = u8::read(from)?;
        Some((f32::read(from)? as u32) << 8 | u32::from(sequence))
    }
}

/// Bits of a set: the lowest 24, then 16 more.
impl Field for Conditions {
    fn write(self, to: &mut IterMut<f32>) {
        let bits = self.bits();
        [(bits & 0xff_ffff) as f32, (bits >> 24) as f32].write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let [low, high]: [f32; 2] = Field::read(from)?;
        Some(Self::from_bits(low as u64 | (high as u64) << 24))
    }
}

impl Field for Posture {
    fn write(self, to: &mut IterMut<f32>) {
        [self.x, self.y, wrap_angle(self.phi)].write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        <[f32; 3]>::read(from).map(|[x, y, phi]| Self::new(x, y, phi))
    }
}

/// A posture whose position is sent modulo [`POSITION_SPAN_M`].
struct Odometric(Posture);

impl Field for Odometric {
    fn write(self, to: &mut IterMut<f32>) {
        // A position that would round up to half a span is sent as the other end of the span.
        const LAST: f32 = 0.5 * POSITION_SPAN_M - 0.6 * POSITION_STEP_M;
        let position = |x: f32| match wrap_position(x) {
            wrapped if wrapped > LAST => -0.5 * POSITION_SPAN_M,
            wrapped => wrapped,
        };
        let Posture { x, y, phi } = self.0;
        Posture::new(position(x), position(y), phi).write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        Posture::read(from).map(Self)
    }
}

/// Logarithms of the standard deviations, then the correlations.
impl Field for Mat3 {
    fn write(self, to: &mut IterMut<f32>) {
        let sigma = [0, 1, 2].map(|i| sqrt(self[i][i]).max(SIGMA_FLOOR));
        for i in 0..3 {
            // `max` would turn NaN into the floor; a covariance that is not finite must not be sent.
            let log = if self[i][i] >= 0.0 {
                ln(sigma[i])
            } else {
                f32::NAN
            };
            log.write(to);
        }
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            (self[i][j] / (sigma[i] * sigma[j])).write(to);
        }
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        Some(covariance_from(Field::read(from)?, Field::read(from)?))
    }
}

impl Field for Wrench {
    fn write(self, to: &mut IterMut<f32>) {
        [
            self.force_x,
            self.force_y,
            self.moment_root,
            self.moment_end,
        ]
        .write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        let [force_x, force_y, moment_root, moment_end] = Field::read(from)?;
        Some(Self {
            force_x,
            force_y,
            moment_root,
            moment_end,
        })
    }
}

impl Field for Calibrate {
    fn write(self, to: &mut IterMut<f32>) {
        let (command, curvature) = match self {
            Self::Zero(curvature) => (0.0, curvature),
            Self::Gain(curvature) => (1.0, curvature),
        };
        [command, curvature].write(to);
    }

    fn read(from: &mut Iter<f32>) -> Option<Self> {
        match (u8::read(from)?, f32::read(from)?) {
            (0, curvature) => Some(Self::Zero(curvature)),
            (1, curvature) => Some(Self::Gain(curvature)),
            _ => None,
        }
    }
}

/// Both directions of the messages: identifier, message, and its fields in the order of the signals.
/// `+ field of values` adds the index of the field to the identifier.
macro_rules! messages {
    ($($id:ident $(+ $which:ident of $all:expr)? => $name:ident {
        $($field:ident $(as $wire:ident)?),+
    };)+) => {
        fn to_values(message: &Message) -> (u16, Values) {
            let mut values = [0.0; MAX_SIGNALS];
            let mut to = values.iter_mut();
            let id = match *message {
                $(Message::$name { $($which,)? $($field),+ } => {
                    $($(let $field = $wire($field);)? $field.write(&mut to);)+
                    id::$id $(+ $which as u16)?
                })+
            };
            (id, values)
        }

        fn from_values(identifier: u16, values: &Values) -> Option<Message> {
            let mut from = values.iter();
            $(
                let index = usize::from(identifier.wrapping_sub(id::$id));
                let known = index == 0 $(|| index < $all.len())?;
                if known {
                    $(let $which = *$all.get(index)?;)?
                    $(let $field = Field::read(&mut from)?; $(let $wire($field) = $field;)?)+
                    return Some(Message::$name { $($which,)? $($field),+ });
                }
            )+
            None
        }
    };
}

messages! {
    TIME_SYNC => TimeSync { epoch, last_delay_us };
    LEAD_STATUS => LeadStatus { sequence, mode, steering_rad, velocity_m_s };
    NODE_STATUS + node of Node::ALL => NodeStatus { sequence, state, reason, notices };
    REFERENCE_POSTURE + axle of AxleId::BOTH => ReferencePosture {
        sequence, posture as Odometric
    };
    REFERENCE_MOTION + axle of AxleId::BOTH => ReferenceMotion {
        sequence, velocity_m_s, yaw_rate_rad_s, acceleration_m_s2, yaw_acceleration_rad_s2
    };
    AXLE_POSTURE + axle of AxleId::BOTH => AxlePosture { sequence, posture as Odometric };
    AXLE_MOTION + axle of AxleId::BOTH => AxleMotion {
        sequence, velocity_m_s, yaw_rate_rad_s, refused, gyro_samples, gyro_zeroed, uptime
    };
    AXLE_UNCERTAINTY + axle of AxleId::BOTH => AxleUncertainty { sequence, covariance };
    BEAM_POSTURE => BeamPosture { sequence, posture, gauges };
    BEAM_UNCERTAINTY => BeamUncertainty { sequence, covariance };
    BEAM_WRENCH => BeamWrench { sequence, wrench };
    BOARD_HEALTH + board of Role::ALL => BoardHealth {
        sequence, missed_ticks, tick_jitter_us, tick_worst_us, supply_v, temperature_c
    };
    BEAM_CALIBRATION => BeamCalibration { sequence, calibrate };
    BEAM_CALIBRATED => BeamCalibrated { sequence, result, gauge };
    BOARD_IDENTITY + board of Role::ALL => BoardIdentity { sequence, chip, build, schema };
}

#[cfg(test)]
mod tests;
