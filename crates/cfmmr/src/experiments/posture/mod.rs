//! `cfmmr posture`: posture regulation with and without the relative position sensor, as the
//! paper's experiment has it.

pub mod paper;
pub mod pictures;
mod plan;
mod publish;
mod report;
mod trials;
mod variant;

use crate::experiments::arguments::LogArgs;
use crate::experiments::arguments::{Common, RobotArgs, SensorArgs};
use clap::{Args, ValueEnum};
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
pub use plan::{Plan, ROWS, place};
pub use publish::publish;
pub use report::{CHI_SQUARE_99, Report, Row, summarize, table};
pub use trials::Trial;
pub use variant::Variant;

/// Rows of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RowSelection {
    /// Encoders alone, the paper's fusion, the joint filter; and the paper's robot.
    Main,
    /// Every fusion, with and without inertial sensors.
    All,
    /// Encoders alone and the joint filter.
    Pair,
    /// The joint filter, without and with inertial sensors.
    Joint,
}

/// Arguments of `posture`.
#[derive(Clone, Debug, Args)]
pub struct PostureArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Recording of the run.
    #[command(flatten)]
    pub log: LogArgs,
    /// Number of paired trials a row [default: 50]
    #[arg(long, value_parser = whole::<u32>(1..=1_000_000), conflicts_with_all = ["dashboard", "live"])]
    pub trials: Option<u32>,
    /// Start posture of the midpoint O: m, m, rad, or heading with `deg`: -1.5,0.2,90deg
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Rows of the table [default: main]
    #[arg(long, value_enum, conflicts_with_all = ["dashboard", "live"])]
    pub rows: Option<RowSelection>,
    /// Sensors of a robot with boards.
    #[command(flatten)]
    pub sensors: SensorArgs,
    /// The robot.
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// Runs the command.
pub fn run(args: &PostureArgs) -> Result<(), Error> {
    Plan::from_args(args)?.run()?.publish()
}
