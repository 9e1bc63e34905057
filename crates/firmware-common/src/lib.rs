//! Drivers and services of both boards.
//!
//! | module | what it holds |
//! |---|---|
//! | `board` | supply, crystal, clocks, cause of the reset; every image calls it first |
//! | `clock` | frequencies |
//! | `accelerator` | prefetch and caches of the flash |
//! | `critical` | critical sections that do not delay the motor current loop |
//! | `fault` | panics and processor faults: makes outputs safe, counts, records, logs, restarts |
//! | `crash_record` | counts of faults and the last message, in memory that a reset keeps |
//! | `watchdog` | independent watchdog, window watchdog of the current loop |
//! | `task_watchdog` | feeds the independent watchdog only while every task reports |
//! | `time_driver` | SysTick as the clock of `embassy-time` |
//! | `store` | parameters in flash |
//! | `board_id` | strap that selects the kind of an axle board |
//! | `identity` | identity of the board on the bus |
//! | `led` | LED |
//! | `stack` | largest stack use, guard below the stack |
//! | `timing` | lateness and duration of ticks |
//! | `record` | queue of log entries from the tick to a host at the serial port |
//! | `can` | CAN bus |
//! | `dma_halves` | bookkeeping of a buffer that a DMA stream fills |
//! | `executors` | executors by priority: tick, bus, thread |
//! | `link` | serial port: identity, orders, reports, and sessions (hardware in the loop) |
//! | `tick_loop` | tick loop of every board; a trait supplies the board-specific parts |
//!
//! Modules that use no hardware are also built for tests on the host; the others are built for the board only.

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
