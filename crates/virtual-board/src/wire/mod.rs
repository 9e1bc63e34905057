//! The CAN bus between boards, exact to the bit and, within a bit, to the time quantum.
//!
//! | file | what it holds |
//! |---|---|
//! | [`frame`] | frames, their bits on the wire with checksum and stuff bits |
//! | [`timing`] | bit timing, synchronisation |
//! | `receiver` | a frame taken apart bit by bit |
//! | `controller` | the protocol of one node: arbitration, errors, counters |
//! | `can_node` | a node at the wire: clock, transceiver |
//! | [`bus`] | the wire: levels, time, faults |
//! | `frame_fast_path` | the undisturbed middle of a frame in one go |
//! | [`node`] | what a wire and its nodes tell each other |
//! | [`virtual_node`] | nodes without a board: a sender, a babbling node, a listener |

pub mod bus;
mod can_node;
mod controller;
pub mod frame;
mod frame_fast_path;
pub mod node;
mod receiver;
mod statistics;
pub mod timing;
pub mod virtual_node;

pub use bus::{Fault, Level, Record, Wire};
pub use frame::{Bits, Frame, Id};
pub use node::{Action, ErrorKind, Event, Node, Settings, What};
pub use statistics::Statistics;
pub use timing::BitTiming;
pub use virtual_node::VirtualNode;

#[cfg(test)]
mod tests;
