//! The bus on CAN1: RX on PB8, TX on PB9, 1 Mbit/s.
//!
//! What a board wants to send goes through [`Sender`], what arrived comes out of [`Receiver`], each
//! with one end in the board's tick. Between these queues and the registers stand the controller's
//! interrupts; [`supervise`] looks after what no interrupt tells.
//!
//! | module | what it holds |
//! |---|---|
//! | `bit_timing` | bit rate, sample point and jump width as the register has them |
//! | `mailboxes` | which mailbox a frame may take, and which frames have waited too long |
//! | `controller` | the registers and their interrupts |
//! | `service` | frames of the link of other boards |
//!
//! The HAL's driver is not used: it displaces frames from their mailboxes, stamps arrivals in a task,
//! passes over a full FIFO, and waits for ever for a bus that is not there.

pub mod bit_timing;
pub mod mailboxes;

#[cfg(target_os = "none")]
mod controller;
#[cfg(target_os = "none")]
pub mod service;
#[cfg(target_os = "none")]
pub use controller::{
    Arrived, Counters, REPORTS_WITHIN, Receiver, Sender, carry, counters, is_off, start, supervise,
};
