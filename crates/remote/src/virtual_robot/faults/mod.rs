//! Catalogue of faults: in the samples and frames of a simulated robot whose boards run in this process, and at registers,
//! pins, supplies and wires of virtual boards that run the images that users flash.
//!
//! | file | what it holds |
//! |---|---|
//! | `bench` | the robot with what an act of a fault can reach |
//! | `entry` | what an entry of the catalogue says |
//! | `model` | faults of samples, frames and plant, with a run of them |
//! | `bus`, `power`, `sensors`, `motors`, `program`, `starts`, `memory` | the catalogue |
//! | `alone` | boards that are tried one by one: power cuts and brown-outs |
//! | `braking` | emergency stops until the robot stands |
//! | `outcome` | a run to do, and how it ended |
//! | `under_way` | robots under way, from which runs go on |
//! | `run` | a run on virtual boards and how it is judged |

mod alone;
mod bench;
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
mod starts;
mod under_way;

pub use bus::SILENCE;
pub use entry::{Course, Entry};
pub use outcome::{Case, End, Outcome};
pub use run::{Reference, reference, run};
pub use under_way::UnderWay;

use crate::virtual_robot::Images;
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;

/// Every fault, in the order of the table.
pub fn catalogue() -> Vec<Entry> {
    [
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
    .concat()
}

/// Settings of all runs.
#[derive(Clone)]
pub struct Campaign {
    /// The robot.
    pub scenario: Scenario,
    /// Images of the boards; without them only faults of the simulation in process can be run.
    pub images: Option<Images>,
    /// Only some of the instants at which power can fail are tried.
    pub quick: bool,
}

impl Campaign {
    /// Images of the boards.
    fn images(&self) -> Result<&Images, Error> {
        let missing = || Error::input("faults of the boards need their images");
        self.images.as_ref().ok_or_else(missing)
    }
}
