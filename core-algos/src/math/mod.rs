//! Small fixed-size mathematics: elementary functions, planar rigid motion, small matrices.

pub mod compare;
pub mod matrix;
pub mod se2;
pub mod steering;
pub mod trig;
pub mod twofloat;
pub mod wrench;

pub use compare::{bounded, greater, lesser};
pub use se2::{Posture, Transform, Twist};
pub use steering::{RelativeHeading, Steering};
pub use twofloat::TwoFloat;
pub use wrench::{AxleLoad, Wrench};
