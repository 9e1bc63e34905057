//! Link of a board: its serial port and the services there.
//!
//! A board that drives reports its identity, executes orders of a host and sends reports to a host that watches
//! ([`Driving`]). While its motors are off, a host can request a session, which is hardware in the loop: the board
//! resets, and the host feeds its nodes in place of sensors and bus. In a session, motor drivers and sensors are not
//! started; the session ends with a reset.
//!
//! A host at another board's serial port reaches this board over the bus. A session requested over the bus is also
//! served over the bus.
//!
//! | module | what it holds |
//! |---|---|
//! | `ends` | the tick's end and the link's end of a board that drives |
//! | `driving` | link of a board that drives: replies, orders, reports, relays; without hardware |
//! | `ports` | serial port and frames on the bus |
//! | `request` | request for a session, kept over the reset |
//! | `tasks` | link task of a board that drives, and of a session |
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

/// Route from the host to the board; the value is the word that requests a session over that route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Route {
    /// The board's own serial port.
    Serial = 0x5e55_10e1,
    /// Another board's serial port; that board relays over the bus.
    Bus = 0x5e55_10e2,
}

/// Destinations of the link's replies and frames.
pub trait Output {
    /// Sends a frame at the serial port, after the previous frame.
    fn write(&mut self, bytes: &[u8]);
    /// True if the serial port has sent the previous frame.
    fn is_free(&self) -> bool;
    /// Sends frames on the bus, one per tick.
    fn send(&mut self, frames: impl Iterator<Item = CanFrame>);

    /// Sends a reply of this board to the host.
    fn reply(&mut self, route: Route, role: Role, bytes: &[u8]) {
        match route {
            Route::Serial => self.write(bytes),
            Route::Bus => self.send(segment::frames(role, Direction::From, bytes)),
        }
    }
}
