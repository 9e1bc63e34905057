//! What a debug probe would see.
//!
//! | module | what it holds |
//! |---|---|
//! | [`rtt`] | the log channel in the target's memory |
//! | [`vcd`] | signals over time as a Value Change Dump |
//! | [`waves`] | pins, interrupts and bus of boards as such a dump |
//! | [`profile`] | time by function and by interrupt |

pub mod profile;
pub mod rtt;
pub mod vcd;
pub mod waves;
