//! Control: from a goal to wheel torques.
//!
//! [`kinematic`] steers the midpoint of the robot (paper eq. 4); [`funnel`] and [`planner`] bring any start posture
//! to where this law cannot fail; [`governor`] shapes the law's output within limits of speed, acceleration and
//! steering; [`cascade`] turns the result into a reference for each axle (eq. 5, 6); [`dynamic`] turns a reference
//! into wheel torques (eq. 7–10), with the force of the ground estimated by [`disturbance`]. [`path`] supplies references along a path. A user's own [`controller`] can replace
//! the regulator. A robot of three and more axles is controlled by [`train`].

mod arc;
pub mod cascade;
pub mod controller;
pub mod disturbance;
pub mod dynamic;
pub mod funnel;
pub mod governor;
pub mod kinematic;
pub mod path;
pub mod planner;
pub mod regulator;
pub mod stuck;
pub mod train;
pub mod wheel_observer;
