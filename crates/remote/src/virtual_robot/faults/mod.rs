//! Catalogue of faults: faults of samples, frames and plant in a simulation with boards in this process, and faults
//! at registers, pins, supplies and wires of virtual boards.
//!
//! | file | what it holds |
//! |---|---|
//! | `bench` | robot with access for the acts of a fault |
//! | `entry` | entry of the catalogue: fault, run, permitted outcomes |
//! | `model` | faults of samples, frames and plant, and their runs |
//! | `bus`, `power`, `sensors`, `motors`, `program`, `starts`, `memory` | the catalogue |
//! | `board_trials` | trials of a single board: power cuts, brown-outs, damaged flash |
//! | `braking` | emergency stops until the robot is at rest |
//! | `outcome` | case and outcome of a run |
//! | `shared_robots` | robots at the time of the fault, shared by runs |
//! | `run` | run on virtual boards and its verdict |

mod bench;
mod board_trials;
mod braking;
mod bus;
mod entry;
mod memory;
pub mod model;
mod motors;
mod outcome;
mod power;
mod program;
mod run;
mod sensors;
mod shared_robots;
mod starts;

pub use bus::SILENCE;
pub use entry::{Entry, RunKind};
pub use outcome::{End, FaultCase, Outcome};
pub use run::{Reference, reference, run};
pub use shared_robots::SharedRobots;

use crate::virtual_robot::Images;
use core_algos::topology::{AxleId, FrameId, Topology};
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;

/// All faults of a robot, in the order in which tables list them. Of a robot of three or more axles the faults of an
/// axle, a wheel or a frame are those of the second axle and of the frame behind it: its boards have neighbours on both
/// sides.
pub fn catalogue(robot: Topology) -> Vec<Entry> {
    let entries = [
        model::entries(),
        bus::entries(),
        power::entries(),
        memory::entries(),
        sensors::entries(),
        motors::entries(),
        braking::entries(),
        program::entries(),
        starts::entries(),
    ]
    .concat();
    entries.into_iter().map(|it| it.of(robot)).collect()
}

/// Axle at which faults of an axle occur, unless the seed selects the axle.
const AXLE: AxleId = AxleId(1);

/// Frame at which faults of a frame occur.
const fn frame(robot: Topology) -> FrameId {
    match robot.frame_count() {
        1 => FrameId(0),
        _ => FrameId(1),
    }
}

/// Settings of all runs of the fault campaign.
#[derive(Clone)]
pub struct Campaign {
    /// Scenario of the robot.
    pub scenario: Scenario,
    /// Firmware images; `None` limits the campaign to faults of kind [`RunKind::Model`], whose boards run in this
    /// process.
    pub images: Option<Images>,
    /// True to try only a few instants of power failures.
    pub quick: bool,
}

impl Campaign {
    fn images(&self) -> Result<&Images, Error> {
        let missing = || Error::input("faults of the boards need their images");
        self.images.as_ref().ok_or_else(missing)
    }
}
