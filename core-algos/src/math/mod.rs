//! Small fixed-size mathematics: elementary functions, planar rigid motion, small matrices.

pub mod decay;
pub mod matrix;
pub mod order;
pub mod se2;
pub mod small_angle;
pub mod trig;
pub mod twofloat;
pub mod wrench;

pub use decay::decay;
pub use order::{bounded, greater, lesser};
pub use se2::{Posture, Transform, Twist};
pub use twofloat::TwoFloat;
pub use wrench::{AxleLoad, Wrench};
