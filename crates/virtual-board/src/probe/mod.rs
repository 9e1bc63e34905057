//! What a debug probe would see.
//!
//! | module | what it holds |
//! |---|---|
//! | [`rtt`] | the log channel in the target's memory |
//! | [`profile`] | time by function and by interrupt |

pub mod profile;
pub mod rtt;
