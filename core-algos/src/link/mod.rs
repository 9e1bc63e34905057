//! Serial link between a host and a board.
//!
//! A *driving* board runs its nodes on its own sensors and motors. Its [`RunLink`] answers the host: it identifies
//! the board, passes [`order`]s to the lead node from the host that holds the [`lease`], and resets the board into a
//! session on request, if the motors are off.
//!
//! In a *session* (hardware in the loop) the host is a rig: it simulates the robot and the bus. The [`SimLink`]
//! answers. Each request carries a board's samples and received messages; the reply carries torques and sent messages.
//! The board's time is the time in the request, so results depend neither on link speed nor on board speed.
//!
//! [`framing`] delimits and checks frames in a byte stream; [`protocol`] defines requests and replies; [`sim_link`] and
//! [`run_link`] are the board's side, without I/O; [`stored_parameters`] are the parameters in the board's store,
//! which a host reads, sets and saves; [`segment`] carries frames over the bus, so that one serial port reaches every
//! board; [`session_nodes`] holds the nodes of a session; [`record`] encodes inputs and outputs of a driving board's nodes.
//!
//! # Order and loss
//!
//! The host sends one request at a time and repeats it until the reply arrives. Each request has a number. If a board
//! receives the number of the last request again, it repeats the reply and carries out nothing. Loss and damage on the
//! link therefore cost only time. [`protocol::Request::Hello`] begins a session and is never taken for a repetition,
//! so either side may restart at any time: a restarted board refuses other requests until a hello.
//!
//! # Panic contract
//!
//! No byte sequence causes a panic. Damaged frames are counted; requests that do not fit the state are refused with a
//! reason.

pub mod framing;
pub mod lease;
pub mod order;
pub mod protocol;
pub mod record;
pub mod run_link;
pub mod segment;
pub mod session_nodes;
pub mod sim_link;
pub mod stored_parameters;

#[cfg(test)]
mod tests;

pub use lease::{Lease, Stamp};
pub use order::Order;
pub use run_link::{Demand, MotorState, RunLink};
pub use session_nodes::SessionNodes;
pub use sim_link::{Identity, SimLink};
pub use stored_parameters::Save;
