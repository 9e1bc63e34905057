//! The bus on CAN1: RX on PB8, TX on PB9, 1 Mbit/s.
//!
//! [`start`] gives the ends: the tick sends with [`Sender`] and receives with [`Receiver`], the link uses
//! [`ServicePort`]. Between the tick's queues and the registers stand the controller's
//! interrupts; [`supervise`] looks after what has no interrupt.
//!
//! | module | what it holds |
//! |---|---|
//! | `bit_timing` | bit rate, sample point and jump width as the register has them |
//! | `mailboxes` | which mailbox a frame may take, and which frames have waited too long |
//! | `queues` | queues between tick and interrupts; moves frames to mailboxes, drops old ones |
//! | `health` | counters, memory of a bus-off |
//! | `registers` | access to the controller's registers |
//! | `driver` | start, interrupts, supervision, the tick's ends |
//! | `service` | frames of the link of other boards |
//!
//! The HAL's driver is not used: it displaces frames from their mailboxes, stamps arrivals in a task,
//! passes over a full FIFO, and waits for ever for a bus that is not there.

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
    Bus, REPORTS_WITHIN, Receiver, Sender, carry, counters, is_off, start, supervise,
};
#[cfg(target_os = "none")]
pub use service::ServicePort;

pub use health::Counters;

/// A message and the local time at which its frame ended.
#[derive(Clone, Copy, Debug)]
pub struct Arrived {
    /// Local time, µs.
    pub local: Micros,
    /// The message.
    pub message: Message,
}
