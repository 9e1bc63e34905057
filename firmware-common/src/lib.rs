//! What both boards share.
//!
//! | module | what it holds |
//! |---|---|
//! | [`board`] | clocks, brown-out level, cause of the reset: the first call of every image |
//! | [`fault`] | panics and processor faults: outputs safe, counted, logged, restarted |
//! | [`watchdog`] | independent watchdog |
//! | [`time_driver`] | time of `embassy-time` from SysTick |
//! | [`strap`] | role of an axle board |
//! | [`stack`] | how much stack was ever used |
//! | `hil` | hardware in the loop: the node fed from a serial link (feature `hil`) |
//! | `emulated` | what QEMU needs (feature `emulated`) |
//!
//! Everything here is for the board; built for a host the crate is empty.

#![cfg(target_os = "none")]
#![no_std]

pub mod board;
pub mod fault;
pub mod stack;
pub mod strap;
pub mod time_driver;
pub mod watchdog;

#[cfg(feature = "emulated")]
pub mod emulated;
#[cfg(feature = "hil")]
pub mod hil;

#[cfg(not(feature = "emulated"))]
use defmt_rtt as _;
#[cfg(feature = "emulated")]
use defmt_semihosting as _;
