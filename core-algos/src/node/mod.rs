//! State machines of the nodes that the boards run, without input or output of their own.
//!
//! [`axle::AxleNode`] runs once a millisecond on each axle board, [`beam::BeamNode`] on the beam board,
//! [`lead::LeadNode`] once an epoch of 10 ms on the front board. A node receives the time, its samples and its
//! messages, and returns commands and messages; it has no access to clock, bus or hardware. The same object runs in a
//! simulation, on a virtual and on a real board.

pub mod axle;
pub mod beam;
pub mod board;
pub mod clock;
pub mod lead;
pub mod led;
pub mod outbox;
pub mod path_task;
pub mod peers;
pub mod robot;
pub mod role_conflict;
#[cfg(test)]
pub(crate) mod testing;
pub mod tick_sync;

pub use outbox::Outbox;
