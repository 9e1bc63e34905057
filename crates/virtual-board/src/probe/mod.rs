//! Features of a debug probe.
//!
//! | module | content |
//! |---|---|
//! | [`rtt`] | the log channel in the target's memory |
//! | [`profile`] | time by function and by interrupt |

pub mod profile;
pub mod rtt;
