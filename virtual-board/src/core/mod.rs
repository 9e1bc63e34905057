//! Cortex-M4F: instructions, exceptions and the private peripherals.

mod system;

pub use system::{BusError, System, Width};
