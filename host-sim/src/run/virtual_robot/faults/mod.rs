//! Faults of the boards as users flash them: at registers, pins, supplies and wires of virtual boards.
//!
//! | file | what it holds |
//! |---|---|
//! | `bench` | the robot with what an act of a fault can reach |
//! | `entry` | what an entry of the catalogue says |
//! | `bus`, `power`, `sensors`, `motors`, `program`, `starts`, `memory` | the catalogue |
//! | `alone` | boards that are tried one by one: power cuts and brown-outs |
//! | `run` | a run and how it is judged |

mod alone;
mod bench;
mod bus;
mod entry;
mod memory;
mod motors;
mod power;
mod program;
mod run;
mod sensors;
mod starts;

pub use bus::SILENCE;
pub use entry::{Course, Entry};
pub use run::{Case, End, Outcome, Reference, reference, run};

use crate::run::virtual_robot::Images;
use crate::scenario::Scenario;
use std::sync::{Arc, Mutex};
use virtual_board::probe::coverage::Coverage;

/// Every fault, in the order of the table.
pub fn catalogue() -> Vec<Entry> {
    [
        bus::entries(),
        power::entries(),
        memory::entries(),
        sensors::entries(),
        motors::entries(),
        program::entries(),
        starts::entries(),
    ]
    .concat()
}

/// Settings of all runs.
pub struct Campaign {
    /// The robot.
    pub scenario: Scenario,
    /// Images of the boards.
    pub images: Images,
    /// Only some of the instants at which power can fail are tried.
    pub quick: bool,
    /// Sum of the line coverage, if requested.
    pub coverage: Option<Arc<Mutex<Coverage>>>,
}
