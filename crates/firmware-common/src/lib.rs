//! What both boards share.
//!
//! | module | what it holds |
//! |---|---|
//! | `board` | supply, crystal, clocks, cause of the reset: the first call of every image |
//! | `clock` | frequencies |
//! | `accelerator` | prefetch and caches of the flash |
//! | `critical` | critical sections that the current loop does not wait for |
//! | `fault` | panics and processor faults: outputs safe, counted, kept, logged, restarted |
//! | `crash_record` | faults and the last message, kept over a reset |
//! | `watchdog`, `task_watchdog` | independent watchdog, fed only while every task reports |
//! | `time_driver` | time of `embassy-time` from SysTick |
//! | `store` | parameters in flash |
//! | `board_id` | role of an axle board |
//! | `identity` | identity of the board on the bus (not with `hil`) |
//! | `led` | LED: state of the node (not with `hil`) |
//! | `stack` | how much stack was ever used, and the guard below it |
//! | `timing` | how late ticks come and how long they take |
//! | `can` | the bus (not with `hil`) |
//! | `dma_halves` | bookkeeping of a buffer that a DMA stream fills |
//! | `executors` | tick above bus above thread (not with `hil`) |
//! | `hil` | hardware in the loop: the node fed from a serial link (feature `hil`) |
//! | `emulated` | what QEMU needs (feature `emulated`) |
//!
//! All but what can be tested on a host is for the board.

#![cfg_attr(target_os = "none", no_std)]

#[cfg(all(target_os = "none", not(feature = "emulated")))]
mod accelerator;
#[cfg(target_os = "none")]
pub mod board;
#[cfg(target_os = "none")]
pub mod board_id;
#[cfg(target_os = "none")]
pub mod clock;
#[cfg(any(test, target_os = "none"))]
pub mod crash_record;
#[cfg(target_os = "none")]
pub mod critical;
#[cfg(all(target_os = "none", not(feature = "emulated")))]
mod crystal;
#[cfg(target_os = "none")]
pub mod fault;
#[cfg(all(target_os = "none", not(feature = "hil")))]
pub mod identity;
#[cfg(all(target_os = "none", not(feature = "hil")))]
pub mod led;
#[cfg(target_os = "none")]
pub mod stack;
#[cfg(all(target_os = "none", not(feature = "emulated")))]
mod supply;
#[cfg(all(target_os = "none", not(feature = "hil")))]
pub mod task_watchdog;
#[cfg(target_os = "none")]
pub mod time_driver;
#[cfg(target_os = "none")]
pub mod timing;
#[cfg(target_os = "none")]
pub mod watchdog;

pub mod dma_halves;
pub mod store;

#[cfg(any(test, all(target_os = "none", not(feature = "hil"))))]
pub mod can;
#[cfg(all(target_os = "none", not(feature = "hil")))]
pub mod executors;

#[cfg(any(test, all(target_os = "none", feature = "emulated")))]
pub mod emulated;
#[cfg(all(target_os = "none", feature = "hil"))]
pub mod hil;

#[cfg(all(target_os = "none", not(feature = "emulated")))]
use defmt_rtt as _;
#[cfg(all(target_os = "none", feature = "emulated"))]
use defmt_semihosting as _;
