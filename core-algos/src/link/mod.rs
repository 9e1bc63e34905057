//! Hardware in the loop: a board's nodes at the end of a serial link.
//!
//! A host simulates robot and bus and sends each board its samples and the messages that arrive;
//! the board answers with its torques and the messages it sends. The board's time is the time in
//! the frame, so the result depends neither on the speed of the link nor on that of the board.
//!
//! A board that drives answers as an [`Attendant`]: it says who it is, takes the [`order`]s for its lead node from the host
//! that holds its [`lease`], and resets into a session when asked with its motors off. In a session the [`Endpoint`] answers.
//!
//! [`framing`] turns payloads into frames of a byte stream and finds them again; [`protocol`] is
//! what is said; [`endpoint`] is the board's side, without input or output of its own; [`stored_parameters`] are
//! the parameters in the board's store, which a host may read, change and save; [`segment`] carries frames over the bus,
//! so that one serial port reaches every board; [`record`] is what a board reports of its nodes.
//!
//! # Order and loss
//!
//! The host asks, the board answers, one request at a time. Each request has a number; a board
//! that sees the number of the last request again answers as before without doing anything a
//! second time. The host therefore repeats a request until the answer comes, and what is lost or
//! damaged on the link costs time and nothing else. [`protocol::Request::Hello`] begins a session
//! and is never taken for a repetition, so either side may restart at any time: a board that did
//! refuses whatever else comes, and the host says hello to it again.
//!
//! # Panic contract
//!
//! Nothing here panics, whatever bytes come: wrong ones are counted, requests that do not fit the
//! session are refused with a reason.

pub mod attendant;
pub mod endpoint;
pub mod framing;
pub mod lease;
pub mod order;
pub mod protocol;
pub mod record;
pub mod segment;
pub mod stored_parameters;

#[cfg(test)]
mod tests;

pub use attendant::{Attendant, Demand, MotorState};
pub use endpoint::{Endpoint, Identity};
pub use lease::{Lease, Stamp};
pub use order::Order;
pub use stored_parameters::Save;
