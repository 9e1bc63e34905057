//! Supervision: reaction of a node to faults.
//!
//! Every node runs one [`supervisor::Supervisor`]. Monitors report the [`Condition`]s that hold at a tick: `watch` in
//! `node/axle/watch.rs` and `node/lead/watch.rs`. The supervisor derives the [`OperatingState`] of the node and the
//! [`Permit`] of its motors by a pure table ([`transition`]); `AxleNode::step` applies the permit.
//!
//! A condition has a [`Class`], which is also the range of its code. A notice never changes the state. With a
//! degradation the robot may drive on for a limited time and distance. A stop is coordinated: both axles slow down
//! along their paths, so that the frame is not bent further. A cut switches the motors off at once.
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
