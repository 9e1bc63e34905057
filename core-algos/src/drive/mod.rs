//! Motors and encoders of an axle board: torque to duty at the PWM rate, and readings from counts to SI units.
//!
//! Data flow: [`shunt`] (count → current) → [`winding`] (current → limit) → [`current`] (torque → voltage) → [`bridge`]
//! (voltage → compare value) → [`sampling`] (instant of the next conversion). [`response`] monitors the response of the
//! motor, [`protection`] switches the motors off, [`braking`] then detects standstill, and [`count`] extends an
//! encoder's counter.
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
