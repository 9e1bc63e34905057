//! Conversion of messages to bytes and back, by the table of [`super::layout`].
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

use super::field::Values;
use super::layout;
use super::message::Message;
use super::signal::Signal;
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

impl CanFrame {
    /// The data bytes.
    pub fn bytes(&self) -> &[u8] {
        self.data
            .get(..usize::from(self.length))
            .unwrap_or(&self.data)
    }
}

/// A value that cannot be sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncodeError {
    /// Name of the message.
    pub message: &'static str,
    /// Name of the signal.
    pub signal: &'static str,
    /// Value that cannot be sent.
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
        /// Length of the frame, bytes.
        found: u8,
        /// Length of the message with this identifier, bytes.
        expected: u8,
    },
    /// A signal holds an undefined value.
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

/// Bytes of a message. NaN, infinity and values outside a signal's range are refused.
///
/// Positions of odometric and reference postures are sent modulo
/// [`POSITION_SPAN_M`](super::field::POSITION_SPAN_M).
pub fn encode(message: &Message) -> Result<CanFrame, EncodeError> {
    let (id, values) = message.to_values();
    let found = id.and_then(|id| Some((id, layout::find(id)?)));
    let Some((id, layout)) = found else {
        // No identifier: the number of the axle or frame is too large, or the sender is the service tool, which has no
        // status.
        return Err(EncodeError {
            message: "Message",
            signal: "sender",
            value: f32::NAN,
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
    let mut values = Values::default();
    for (signal, value) in layout.signals.iter().zip(&mut values) {
        let raw = (bits & ((1u64 << signal.bits) - 1)) as u32;
        bits >>= signal.bits;
        let shift = 32 - u32::from(signal.bits);
        let raw = if signal.signed {
            ((raw << shift) as i32) >> shift
        } else {
            raw as i32
        };
        *value = signal.physical(raw);
    }
    Message::from_values(layout.id, frame.id - layout.id, &values)
        .ok_or(DecodeError::Value { id: frame.id })
}

/// Raw value nearest to a physical value; `None` for NaN and for a value out of the signal's range.
fn to_raw(signal: &Signal, value: f32) -> Option<i32> {
    let scaled = (value - signal.offset) / signal.scale;
    let (low, high) = signal.raw_range();
    // Bounds are at most 2^24, so bounds, whole part and rest are exact in f32.
    if !(low as f32 - 1.0..=high as f32 + 1.0).contains(&scaled) {
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

#[cfg(test)]
mod tests;
