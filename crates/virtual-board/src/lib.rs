#![doc = include_str!("../README.md")]

/// Bits of registers: a constant for each name and place.
macro_rules! bits {
    (pub($scope:tt): $($name:ident $bit:literal),* $(,)?) => {
        $(pub($scope) const $name: u32 = 1 << $bit;)*
    };
    ($($name:ident $bit:literal),* $(,)?) => { $(const $name: u32 = 1 << $bit;)* };
}

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
