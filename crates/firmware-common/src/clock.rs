//! Frequencies of the core and its buses.

/// Frequency of the core, Hz.
pub const CORE_HZ: u32 = 168_000_000;
/// Frequency of the bus APB1, Hz.
pub const APB1_HZ: u32 = CORE_HZ / 4;
