//! The link of a board: its serial port, and what it serves there.
//!
//! A board that drives answers who it is ([`Driving`]). With its motors off it can be asked for a session: it resets, and
//! its nodes are fed from the link instead of sensors and bus. Drivers and sensors are not started then;
//! the session ends with a reset.
//!
//! A host at the serial port of another board reaches this one over the bus. A session that it asks for there is served
//! there.
//!
//! | module | what it holds |
//! |---|---|
//! | `ends` | the tick's end and the link's end of a board that drives |
//! | `driving` | a board that drives: replies, orders, reports, relays; without hardware |
//! | `ports` | serial port and frames on the bus |
//! | `request` | request for a session, kept over the reset |
//! | `tasks` | the task of a board that drives, and that of a session |
//! | `uart` | driver of the serial port |

mod driving;
mod ends;
#[cfg(target_os = "none")]
mod ports;
#[cfg(target_os = "none")]
mod request;
#[cfg(target_os = "none")]
mod tasks;
#[cfg(test)]
mod tests;
#[cfg(target_os = "none")]
mod uart;

use core_algos::bus::CanFrame;
use core_algos::link::segment::{self, Direction};
use core_algos::topology::Role;

pub use driving::{Driving, Event};
#[cfg(test)]
pub(crate) use ends::Channels;
pub use ends::{LinkEnd, OrderResult, TickEnd};
#[cfg(target_os = "none")]
pub use request::take as requested_session;
#[cfg(target_os = "none")]
pub use tasks::{Link, ends};

/// Route from the host to the board, with the word that asks for a session there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Route {
    /// The board's serial port.
    Serial = 0x5e55_10e1,
    /// The port of another board, and the bus.
    Bus = 0x5e55_10e2,
}

/// Outputs of the link.
pub trait Output {
    /// Sends a frame at the serial port, after the one before.
    fn write(&mut self, bytes: &[u8]);
    /// True if the serial port has sent the frame before.
    fn is_free(&self) -> bool;
    /// Sends frames on the bus, one a tick.
    fn send(&mut self, frames: impl Iterator<Item = CanFrame>);

    /// Sends a reply of this board to the host.
    fn reply(&mut self, route: Route, role: Role, bytes: &[u8]) {
        match route {
            Route::Serial => self.write(bytes),
            Route::Bus => self.send(segment::frames(role, Direction::From, bytes)),
        }
    }
}
