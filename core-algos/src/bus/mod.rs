//! Messages between the nodes and their bytes on a classic CAN bus.
//!
//! [`message`] holds the table of messages; [`field`] the types of their fields; [`signal`] and [`layout`] their
//! identifiers, timing and signals; [`codec`] converts a message to at most eight bytes and back.
//!
//! Encoding refuses NaN and values out of range; decoding refuses unknown identifiers and frames of
//! the wrong length. Neither can panic.

pub mod codec;
pub mod field;
pub mod layout;
pub mod message;
pub mod signal;

pub use codec::{CanFrame, DecodeError, EncodeError, decode, encode};
pub use field::LeadMode;
pub use message::Message;
