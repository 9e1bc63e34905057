//! Supervision: what a node does when something is wrong.
//!
//! Every node runs one [`supervisor::Supervisor`]. Monitors report the [`Condition`]s that hold at a tick: `watch` in
//! `node/axle/watch.rs` and `node/lead/watch.rs`. The supervisor decides by a pure table ([`transition`]) in which [`OperatingState`] the node is, and
//! with that what its motors may do; `AxleNode::step` obeys. A condition has a [`Class`], which is also the range of its
//! code: notices never change the state, a degradation lets the robot drive on for a limited time
//! and distance, a stop is coordinated (both axles slow down along the path they are on, so that
//! the frame is not bent further), a cut switches the motors off at once.
//!
//! # Panic contract
//!
//! [`supervisor::Config::build`] validates; after it nothing fails or panics.

pub mod condition;
pub mod ramp;
pub mod state;
pub mod supervisor;
pub mod task_deadlines;

pub use condition::{Class, Condition, Conditions};
pub use state::{Cause, OperatingState, Permit, StateRequest, transition};
