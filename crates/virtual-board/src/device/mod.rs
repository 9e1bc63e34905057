//! Parts that are soldered to a board.
//!
//! Each part is a plain struct. What happens at its terminals is told with the exact time, in the
//! order of time; what it shows is asked for at a time. A part that changes by itself says when
//! ([`Contact::next`] and so on); whoever composes a board ([`crate::chip::Circuit`]) calls its
//! `advance` then. Noise comes from a generator of the part's own, so that parts neither
//! disturb each other nor depend on the order in which they are asked.

mod encoder;
pub mod olimex_h405;
#[cfg(feature = "devices")]
mod robot;
mod supply;
mod switches;

pub use encoder::{Encoder, EncoderConfig, EncoderFault, Line};
#[cfg(feature = "devices")]
pub use robot::*;
pub use supply::{Divider, Profile, Supply};
pub use switches::Contact;

use crate::time::Time;

/// Seconds from one time to a later one; 0 if it is not later.
fn span_s(from: Time, to: Time) -> f64 {
    (to - from).0 as f64 * 1e-12
}

/// The time so many seconds later; [`Time::NEVER`] if that is not to be told.
fn later(from: Time, seconds: f64) -> Time {
    let ps = seconds * 1e12;
    // 2⁶³ ps are a hundred days.
    if ps.is_nan() || ps >= 9.2e18 {
        return Time::NEVER;
    }
    from + Time(ps.max(0.0) as u64)
}
