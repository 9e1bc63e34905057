//! What the targets share.
//!
//! The modules of the simulator that read input are compiled here by their paths, without the rest
//! of it: pictures, log decoders and the command line would take most of the time of a build.

pub mod numbers;

#[path = "../../../host-sim/src/effect.rs"]
pub mod effect;
#[path = "../../../host-sim/src/error.rs"]
pub mod error;
#[path = "../../../host-sim/src/eval/mod.rs"]
pub mod eval;
#[path = "../../../host-sim/src/overlay.rs"]
pub mod overlay;
#[path = "../../../host-sim/src/paths.rs"]
pub mod paths;
pub use plant;
pub mod recording;
#[path = "../../../host-sim/src/scenario.rs"]
pub mod scenario;
#[path = "../../../host-sim/src/scenario_file.rs"]
pub mod scenario_file;
#[path = "../../../host-sim/src/sensors.rs"]
pub mod sensors;
#[path = "../../../host-sim/src/virtual_bus.rs"]
pub mod virtual_bus;
#[path = "../../../host-sim/src/world/mod.rs"]
pub mod world;
