//! An STM32F405 board on a host: core, peripherals, pins and time.
//!
//! The board runs an unchanged firmware image, the very file that a debug probe would write, on a
//! register-level model of the chip. What the image does wrong, such as an access to a peripheral
//! whose clock is off, is a [`Finding`] with the place in the program and the time.
//!
//! | module | what it holds |
//! |---|---|
//! | [`core`] | Cortex-M4F: instructions, exceptions, NVIC, SysTick, DWT, MPU |
//! | [`chip`] | memories, clocks and peripherals of the STM32F405 |
//! | [`wire`] | the CAN bus between boards |
//! | [`device`] | parts that are soldered to a board: sensors, drivers, encoders |
//! | [`image`] | an ELF file: what goes into the flash, symbols, source lines |
//! | [`probe`] | what a debug probe would see: log, trace, profile, coverage |
//!
//! # Time
//!
//! A board counts cycles of its core clock ([`Cycles`]); the world around it counts picoseconds
//! ([`Time`]). Each board's crystal may be off by some parts in a million.
//!
//! Everything is deterministic: the same image with the same surroundings gives the same bytes.

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
