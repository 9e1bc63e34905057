//! Motors and encoders of an axle board: torque to duty at the rate of the pulse-width modulation,
//! and what the board reads, from counts to SI units.
//!
//! Data goes [`shunt`] (count → current) → [`winding`] (current → limit) → [`current`] (torque →
//! voltage) → [`bridge`] (voltage → compare value) → [`sampling`] (when to convert next);
//! [`response`] sees whether the motor answers, [`protection`] switches off, [`braking`] finds standstill
//! afterwards, and [`count`] extends an encoder's counter.
//!
//! # Panic contract
//!
//! Each `Config::build` validates; nothing else can fail. A number that is not finite switches the
//! motor off.

pub mod braking;
pub mod bridge;
pub mod count;
pub mod current;
pub mod protection;
pub mod response;
pub mod sampling;
pub mod shunt;
pub mod winding;
