//! The CAN bus between boards, exact to the bit and, within a bit, to the time quantum.
//!
//! | file | content |
//! |---|---|
//! | [`frame`] | frames and their bits on the bus, with checksum and stuff bits |
//! | [`timing`] | bit timing, synchronization |
//! | `receiver` | parsing of a frame bit by bit |
//! | `controller` | the protocol of one node: arbitration, errors, counters |
//! | `can_node` | a node on the bus: clock, transceiver |
//! | [`bus`] | the bus: levels, time, faults |
//! | `frame_fast_path` | the undisturbed middle of a frame in one step |
//! | [`node`] | actions and events exchanged between the bus and its nodes |
//! | [`virtual_node`] | nodes without a board: sender, babbling node, listener |

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
pub use node::{Action, ErrorKind, Event, EventKind, Node, Settings};
pub use statistics::Statistics;
pub use timing::BitTiming;
pub use virtual_node::VirtualNode;

#[cfg(test)]
mod tests;
