//! What the targets share.
//!
//! The modules of the simulator that read input are compiled here by their paths, without the rest
//! of it: pictures, log decoders and the command line would take most of the time of a build.

pub mod attendant_model;
pub mod numbers;
pub use plant;

pub mod base;
pub mod bus;
#[path = "../../../host-sim/src/experiments/eval/mod.rs"]
pub mod eval;
#[path = "../../../host-sim/src/paths/mod.rs"]
pub mod paths;
pub mod recording;
#[path = "../../../host-sim/src/scenario/mod.rs"]
pub mod scenario;
pub mod targets;
#[path = "../../../host-sim/src/world/mod.rs"]
pub mod world;
