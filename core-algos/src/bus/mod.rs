//! Messages between the nodes and their bytes on a classic CAN bus.
//!
//! [`message`] holds the typed messages; [`layout`] the one table of identifiers, signals, scales
//! and ranges; [`codec`] turns a message into at most eight bytes and back by that table.
//!
//! Encoding refuses NaN and values out of range; decoding refuses unknown identifiers and frames of
//! the wrong length. Neither can panic.

pub mod codec;
pub mod layout;
pub mod message;

pub use codec::{CanFrame, DecodeError, EncodeError, decode, encode};
pub use message::{LeadMode, Message};
