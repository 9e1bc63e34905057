#![doc = include_str!("../README.md")]

#[macro_use]
mod bits;
pub mod board;
pub mod chip;
pub mod core;
pub mod device;
pub mod finding;
pub mod image;
pub mod network;
mod noise;
pub mod probe;
pub mod time;
pub mod wire;
mod workers;

pub use finding::{Finding, Findings, Kind};
pub use time::{Cycles, Time};
