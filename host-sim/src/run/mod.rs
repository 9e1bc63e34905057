//! Runs of the robot: the simulated plant with its boards in lockstep, tasks, recovery from faults.
//!
//! Start with [`simulation`]: one trial at 1 kHz.

pub mod bit_compare;
pub mod drive;
pub mod end;
pub mod final_error;
pub mod keyboard;
pub mod path_run;
pub mod real_time;
pub mod recovery;
pub mod regulate;
pub mod rig;
pub mod robot;
pub mod script;
pub mod simulation;
