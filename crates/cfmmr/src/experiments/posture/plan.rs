//! The trials that the arguments ask for.

use super::{PostureArgs, RowSelection, Variant, paper};
use crate::experiments::Context;
use crate::experiments::arguments::LogArgs;
use crate::experiments::arguments::parse_posture;
use crate::experiments::recorder;
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect::{Run, Taken, Use};

impl PostureArgs {
    /// Rows with the sensors that the options leave: `--no-rps` keeps those without gauges, `--imu` adds the inertial
    /// sensors to all. A run that is shown has one row.
    fn variants(&self, selection: RowSelection) -> Result<Vec<Variant>, Error> {
        let sensors = &self.sensors;
        let rows = match selection {
            RowSelection::Main => &Variant::MAIN[..],
            RowSelection::All => &Variant::ALL,
            RowSelection::Pair => &Variant::PAIR,
            RowSelection::Joint => &Variant::JOINT,
        };
        let shown = match self.log.is_watched() {
            true if sensors.no_rps => &Variant::PAIR[..1],
            true => &Variant::PAIR[1..],
            false => rows,
        };
        let mut kept: Vec<Variant> = Vec::new();
        for row in shown.iter().filter(|row| !(sensors.no_rps && row.rps)) {
            let row = Variant {
                imu: row.imu || sensors.imu,
                ..*row
            };
            if !kept.contains(&row) {
                kept.push(row);
            }
        }
        match kept.is_empty() {
            true => Err(Error::input(
                "--no-rps: no row is left; every row of --rows joint has gauges",
            )),
            false => Ok(kept),
        }
    }
}

/// Number of trials a row.
const TRIALS: u32 = 50;

/// Trials to be run.
pub struct Plan<'a> {
    /// Scenario, threads and output.
    pub context: Context,
    /// Recording and display of the first trial with the sensor.
    pub log: &'a LogArgs,
    /// Rows of the table.
    pub variants: Vec<Variant>,
    /// Scenario of each row, then those of the rows of the paper's robot, if there are any.
    pub scenarios: Vec<Scenario>,
    /// Trials of each row.
    pub count: usize,
}

impl<'a> Plan<'a> {
    /// The trials, or what is wrong with the arguments.
    pub fn from_args(args: &'a PostureArgs) -> Result<Self, Error> {
        let mut context = Context::new(&args.common, "posture")?;
        place(args, &mut context)?;
        args.robot.refuse_without_boards()?;
        let selection = args.rows.unwrap_or(RowSelection::Main);
        let variants = args.variants(selection)?;
        let apply = |variant: &Variant| variant.apply(&context.scenario);
        let mut scenarios: Vec<Scenario> = variants.iter().map(apply).collect();
        let runs: Vec<Run> = scenarios.iter().map(|row| (row, Use::Regulate)).collect();
        let from = args.from.as_ref().map(|_| ("mission.start", "with --from"));
        let taken: Vec<_> = ROWS.iter().copied().chain(from).collect();
        context.check_keys(&taken, &runs)?;
        // Refused before the trials rather than after them.
        recorder::check(&args.log)?;
        if variants == Variant::MAIN {
            scenarios.extend(paper::scenarios()?);
        }
        Ok(Self {
            context,
            log: &args.log,
            variants,
            scenarios,
            count: args.trials.unwrap_or(TRIALS) as usize,
        })
    }
}

/// Puts the robot where the arguments say.
pub fn place(args: &PostureArgs, context: &mut Context) -> Result<(), Error> {
    if let Some(text) = &args.from {
        context.scenario.mission.start = parse_posture(text).map_err(Error::Input)?;
    }
    context.scenario.check()
}

/// Reason why a key has no effect that each row sets.
const SET: &str = "here: each row sets it, see --rows";

/// Keys that each row sets.
pub const ROWS: Taken = &[
    ("mission.rps", SET),
    ("robot.lead.fusion.mode", SET),
    ("sensors.gyro.fitted", SET),
    ("sensors.accelerometer.fitted", SET),
];
