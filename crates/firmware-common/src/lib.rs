//! Drivers and services of both boards.
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
//! | `identity` | identity of the board on the bus |
//! | `led` | LED: state of the node |
//! | `stack` | how much stack was ever used, and the guard below it |
//! | `timing` | how late ticks come and how long they take |
//! | `record` | entries of the tick for a host at the serial port |
//! | `can` | the bus |
//! | `dma_halves` | bookkeeping of a buffer that a DMA stream fills |
//! | `executors` | tick above bus above thread |
//! | `link` | serial port: identity, and the session with a rig |
//!
//! All but what can be tested on a host is for the board.

#![cfg_attr(target_os = "none", no_std)]

#[cfg(target_os = "none")]
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
#[cfg(target_os = "none")]
mod crystal;
#[cfg(target_os = "none")]
pub mod fault;
#[cfg(target_os = "none")]
pub mod identity;
#[cfg(target_os = "none")]
pub mod led;
#[cfg(target_os = "none")]
pub mod record;
#[cfg(target_os = "none")]
pub mod stack;
#[cfg(target_os = "none")]
mod supply;
#[cfg(target_os = "none")]
pub mod task_watchdog;
#[cfg(target_os = "none")]
pub mod time_driver;
#[cfg(target_os = "none")]
pub mod timing;
#[cfg(target_os = "none")]
pub mod watchdog;

pub mod dma_halves;
pub mod store;

#[cfg(any(test, target_os = "none"))]
pub mod can;
#[cfg(target_os = "none")]
pub mod executors;

#[cfg(target_os = "none")]
pub mod link;

#[cfg(target_os = "none")]
use defmt_rtt as _;
