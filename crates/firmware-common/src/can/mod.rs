//! CAN bus on CAN1: RX on PB8, TX on PB9, 1 Mbit/s.
//!
//! [`start`] returns the ends: the tick sends with [`Sender`] and receives with [`Receiver`], the link uses
//! [`ServicePort`]. Interrupts move frames between the tick's queues and the registers; [`supervise`] handles what
//! has no interrupt.
//!
//! | module | what it holds |
//! |---|---|
//! | `bit_timing` | bit rate, sample point and jump width in register format |
//! | `mailboxes` | choice of a frame's mailbox, list of stale frames |
//! | `queues` | queues between tick and interrupts; moves frames to mailboxes, drops old ones |
//! | `health` | counters, state after bus-off |
//! | `registers` | access to the controller's registers |
//! | `driver` | start, interrupts, supervision, the tick's ends |
//! | `service` | frames of the link, for boards reached over the bus |
//!
//! The HAL's driver is not used: it replaces waiting frames in their mailboxes, timestamps arrivals in a task,
//! ignores a full FIFO, and waits for ever for a missing bus.

mod bit_timing;
mod health;
mod mailboxes;
mod queues;

#[cfg(target_os = "none")]
mod driver;
#[cfg(target_os = "none")]
mod registers;
#[cfg(target_os = "none")]
mod service;

use core_algos::bus::Message;
use core_algos::time::Micros;

#[cfg(target_os = "none")]
pub use driver::{
    Bus, REPORTS_WITHIN, Receiver, Sender, counters, is_off, run_session_bus, start, supervise,
};
#[cfg(target_os = "none")]
pub use service::ServicePort;

pub use health::Counters;

/// A received message and the local time at which its frame ended.
#[derive(Clone, Copy, Debug)]
pub struct Arrived {
    /// Local time at which the frame ended, µs.
    pub local: Micros,
    /// The received message.
    pub message: Message,
}
