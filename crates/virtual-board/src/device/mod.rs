//! Parts that are soldered to a board.
//!
//! Each part is a plain struct. What happens at its terminals is told with the exact time, in the
//! order of time; what it shows is asked for at a time. A part that changes by itself says when
//! ([`Icm42688::next`] and so on); whoever composes a board ([`crate::chip::Surroundings`]) calls its
//! `advance` then. Noise comes from a generator of the part's own ([`crate::noise`]), so that parts neither
//! disturb each other nor depend on the order in which they are asked.

mod bridge;
mod drv8874;
mod encoder;
mod filter;
mod icm42688;
mod ina240;
mod motor;
mod remarks;
mod supply;
mod switches;
mod thermistor;

pub use bridge::{Bridge, BridgeConfig, BridgeFault};
pub use drv8874::{DriverConfig, Drv8874, Half, OverCurrent, Regulation};
pub use encoder::{Encoder, EncoderConfig, EncoderFault, Line, OutputStage};
pub use icm42688::{Icm42688, InertialConfig, InertialFault, Motion};
pub use ina240::{Amplifier, AmplifierConfig, AmplifierFault};
pub use motor::{Motor, MotorConfig, Work};
pub use remarks::{Remark, Remarks};
pub use supply::{Divider, Profile, Supply};
pub use switches::{Contact, Led};
pub use thermistor::{Thermistor, ThermistorFault};

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
