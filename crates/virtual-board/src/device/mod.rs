//! Parts soldered to a board.
//!
//! Each part is a plain struct. Changes at its terminals are passed with their exact times, in the order of time; its
//! outputs are read for a given time. A part that changes by itself reports the time of the next change
//! ([`Contact::next`] and others), and the board's circuit ([`crate::chip::Circuit`]) then calls `advance`. Each part
//! has its own noise generator, so parts are independent of each other and of the order of the calls.

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

/// Time from `from` to `to`, s; 0 if `to` is not later.
fn span_s(from: Time, to: Time) -> f64 {
    (to - from).0 as f64 * 1e-12
}

/// Time `seconds` after `from`; [`Time::NEVER`] if out of range or NaN.
fn later(from: Time, seconds: f64) -> Time {
    let ps = seconds * 1e12;
    // 2⁶³ ps are about a hundred days.
    if ps.is_nan() || ps >= 9.2e18 {
        return Time::NEVER;
    }
    from + Time(ps.max(0.0) as u64)
}
