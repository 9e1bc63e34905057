//! Raw readings of a board's sensors to SI units: inertial sensor, oversampled bridges, temperature
//! and supply.
//!
//! # Panic contract
//!
//! Each `Config::build` validates; nothing else can fail. An implausible reading is `None`.

pub mod analog;
pub mod icm42688;
pub mod inertial;
pub mod oversampling;
pub mod rest_noise;
