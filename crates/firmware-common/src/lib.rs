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
//! | `watchdog` | independent watchdog, window watchdog of the current loop |
//! | `task_watchdog` | feeds the independent watchdog only while every task reports |
//! | `time_driver` | time of `embassy-time` from SysTick |
//! | `store` | parameters in flash |
//! | `board_id` | axle of an axle board |
//! | `identity` | identity of the board on the bus |
//! | `led` | LED |
//! | `stack` | how much stack was ever used, and the guard below it |
//! | `timing` | how late ticks come and how long they take |
//! | `record` | entries of the tick for a host at the serial port |
//! | `can` | the bus |
//! | `dma_halves` | bookkeeping of a buffer that a DMA stream fills |
//! | `executors` | tick above bus above thread |
//! | `link` | serial port: identity, orders, reports, and the session with a rig |
//! | `tick_loop` | the tick that all boards share, and the trait of what differs |
//!
//! Modules without hardware also build for tests on the host; the others build for the board only.

#![cfg_attr(target_os = "none", no_std)]

#[cfg(target_os = "none")]
mod accelerator;
#[cfg(target_os = "none")]
pub mod board;
#[cfg(any(test, target_os = "none"))]
pub mod board_id;
#[cfg(any(test, target_os = "none"))]
pub mod clock;
#[cfg(any(test, target_os = "none"))]
pub mod crash_record;
#[cfg(target_os = "none")]
pub mod critical;
#[cfg(target_os = "none")]
mod crystal;
#[cfg(target_os = "none")]
pub mod fault;
#[cfg(any(test, target_os = "none"))]
pub mod identity;
#[cfg(target_os = "none")]
pub mod led;
#[cfg(any(test, target_os = "none"))]
mod record;
#[cfg(target_os = "none")]
pub mod stack;
#[cfg(target_os = "none")]
mod supply;
#[cfg(target_os = "none")]
pub mod task_watchdog;
#[cfg(target_os = "none")]
pub mod time_driver;
#[cfg(any(test, target_os = "none"))]
pub mod timing;
#[cfg(target_os = "none")]
pub mod watchdog;

pub mod dma_halves;
pub mod store;

#[cfg(any(test, target_os = "none"))]
pub mod can;
#[cfg(target_os = "none")]
pub mod executors;

#[cfg(any(test, target_os = "none"))]
pub mod link;

#[cfg(any(test, target_os = "none"))]
pub mod tick_loop;

#[cfg(target_os = "none")]
use defmt_rtt as _;
