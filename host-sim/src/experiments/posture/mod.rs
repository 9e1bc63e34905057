//! `cfmmr posture`: posture regulation with and without the relative position sensor, as the
//! paper's experiment has it.

pub mod paper;
pub mod pictures;
mod report;
mod variant;

use crate::base::error::Error;
use crate::base::numbers::whole;
use crate::base::output::OutputDir;
use crate::experiments::Context;
use crate::experiments::arguments::{Common, RobotArgs, SensorArgs, parse_posture};
use crate::experiments::recorder::{self, Stage};
use crate::recording::{LogArgs, csv};
use crate::run::regulate::{Outcome, regulate, regulate_on};
use crate::run::robot::Record;
use crate::scenario::Scenario;
use crate::scenario::effect::{Run, Taken, Use};
use crate::view::{figures, page};
use clap::{Args, ValueEnum};
use pictures::Picture;
pub use report::{CHI_SQUARE_99, Report, Row, summarize, table};
use std::path::PathBuf;
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

/// Number of trials a row.
const TRIALS: u32 = 50;
/// Trials of a row whose paths are kept for the picture, which shows no more: so the memory does not
/// grow with their number, but for the outcome of each.
const PICTURED: usize = 200;

/// Runs the command.
pub fn run(args: &PostureArgs) -> Result<(), Error> {
    let mut context = Context::new(&args.common, "posture")?;
    args.robot.refuse_without_boards()?;
    if args.sensors.imu || args.sensors.no_rps {
        return Err(Error::input(
            "--imu, --no-rps: only with --on virtual; here each row sets the sensors, see --rows",
        ));
    }
    place(args, &mut context)?;
    if args.log.is_watched() {
        return watch(args, &context);
    }
    let selection = args.rows.unwrap_or(RowSelection::Main);
    let variants: &[Variant] = match selection {
        RowSelection::Main => &Variant::MAIN,
        RowSelection::All => &Variant::ALL,
        RowSelection::Pair => &Variant::PAIR,
        RowSelection::Joint => &Variant::JOINT,
    };
    let apply = |variant: &Variant| variant.apply(&context.scenario);
    let mut scenarios: Vec<Scenario> = variants.iter().map(apply).collect();
    check_keys(args, &context, &scenarios)?;
    // Refused before the trials rather than after them.
    recorder::check(&args.log)?;
    if selection == RowSelection::Main {
        scenarios.extend(paper::scenarios()?);
    }
    let mut blocks = trials(
        &context,
        variants,
        &scenarios,
        args.trials.unwrap_or(TRIALS) as usize,
    )?;
    let of_paper = blocks.split_off(variants.len());
    let (mut report, files) = publish(&context, variants, &Variant::PAIR, &blocks)?;
    let goal = context.scenario.mission.goal;
    for (variant, block) in paper::ROWS.iter().zip(&of_paper) {
        report.paper.push(summarize(variant, block, goal));
    }
    let recorded = record(args, &context)?;
    let text = screen(&context, &report, variants);
    context.finish(&text, &report, files, &recorded, failure(&report))
}

/// Puts the robot where the arguments say.
pub fn place(args: &PostureArgs, context: &mut Context) -> Result<(), Error> {
    if let Some(text) = &args.from {
        context.scenario.mission.start = parse_posture(text).map_err(Error::Input)?;
    }
    context.scenario.check()
}

/// Trials of each scenario. Those of an interrupted command are fewer.
fn trials(
    context: &Context,
    variants: &[Variant],
    scenarios: &[Scenario],
    count: usize,
) -> Result<Vec<Vec<Trial>>, Error> {
    let (shown, goal) = (Variant::PAIR, context.scenario.mission.goal);
    let is_shown = |row: usize| variants.get(row).is_some_and(|row| shown.contains(row));
    let rows = (scenarios.len(), count);
    let mut blocks = context.run_rows("trials", rows, |row, trial| {
        let keep = is_shown(row) && trial < PICTURED;
        let mut kept = Trial::default();
        kept.outcome = regulate(&scenarios[row], context.seed, trial as u64, |record| {
            if keep {
                kept.see(record, trial == 0);
            }
        })?;
        Ok(kept)
    })?;
    for (row, (scenario, block)) in scenarios.iter().zip(&mut blocks).enumerate() {
        // The median trial is drawn in full, and is known only now.
        if is_shown(row) && !block.is_empty() {
            let median = pictures::median_trial(block, goal);
            if block[median].records.is_empty() {
                let see = |record: &Record| block[median].see(record, true);
                regulate(scenario, context.seed, median as u64, see)?;
            }
        }
    }
    Ok(blocks)
}

/// The tables on the screen, and commands to type next.
fn screen(context: &Context, report: &Report, variants: &[Variant]) -> String {
    let world = context.scenario.world.label();
    let mut text = format!(
        "Posture regulation, {} trials a row, seed {}, world {world}; true errors\n\n{}",
        report.trials,
        context.seed,
        report::table(&report.rows, variants)
    );
    if !report.paper.is_empty() {
        text += &format!(
            "\nThe paper's algorithms in world paper (constants fitted, see docs/worlds.md)\n\n{}",
            paper::table(&report.paper)
        );
    }
    let folder = context.folder().display();
    text + &format!(
        "\nopen {folder}/report.html, {folder}/paths.png\n\
         type cargo cfmmr follow, cargo cfmmr posture --rows all, cargo cfmmr --help\n"
    )
}

/// Reason if no trial of a row ended as commanded.
fn failure(report: &Report) -> Option<String> {
    let row = report.rows.iter().find(|row| row.done == 0.0)?;
    let ends: Vec<&str> = row.ends.keys().map(String::as_str).collect();
    Some(format!(
        "no trial of row {} reached its goal: {}",
        row.fusion,
        ends.join(", ")
    ))
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

/// Refuses keys without effect in any row.
fn check_keys(args: &PostureArgs, context: &Context, rows: &[Scenario]) -> Result<(), Error> {
    let runs: Vec<Run> = rows.iter().map(|row| (row, Use::Regulate)).collect();
    let from = args.from.as_ref().map(|_| ("mission.start", "with --from"));
    let taken: Vec<_> = ROWS.iter().copied().chain(from).collect();
    context.check_keys(&taken, &runs)
}

/// Runs and shows the first trial with the sensor.
fn watch(args: &PostureArgs, context: &Context) -> Result<(), Error> {
    check_keys(args, context, &[Variant::PAIR[1].apply(&context.scenario)])?;
    let mut trial = Trial::default();
    let (outcome, recorded) = first_trial(args, context, |record| trial.see(record, true))?;
    trial.outcome = outcome;
    let shown = [Variant::PAIR[1]];
    let (report, files) = publish(context, &shown, &shown, &[vec![trial]])?;
    let text = screen(context, &report, &shown);
    context.finish(&text, &report, files, &recorded, failure(&report))
}

/// Runs the first trial with the sensor once more, and records it.
fn record(args: &PostureArgs, context: &Context) -> Result<Vec<PathBuf>, Error> {
    match args.log.any() && !context.is_interrupted() {
        true => Ok(first_trial(args, context, |_| ())?.1),
        false => Ok(Vec::new()),
    }
}

/// The first trial with the sensor, recorded and shown as asked for; how it went, and the files.
fn first_trial(
    args: &PostureArgs,
    context: &Context,
    observe: impl FnMut(&Record),
) -> Result<(Outcome, Vec<PathBuf>), Error> {
    let scenario = Variant::PAIR[1].apply(&context.scenario);
    let goal = (scenario.mission.goal, &[][..]);
    let stage = Stage::begin(&args.log, context, &scenario, goal)?;
    let mut simulation = stage.simulation()?;
    let driven = stage.run(&mut simulation, |robot| {
        regulate_on(robot, &scenario, observe)
    })?;
    Ok((driven.outcome, driven.recorded))
}

/// Data of a trial.
#[derive(Clone, Debug, Default)]
pub struct Trial {
    /// Result.
    pub outcome: Outcome,
    /// The midpoint's path, at 10 Hz.
    pub path: Vec<[f64; 2]>,
    /// Every epoch.
    pub records: Vec<Record>,
}

impl Trial {
    /// Takes in the state after one more epoch; `all` keeps it.
    pub fn see(&mut self, record: &Record, all: bool) {
        if self.path.len() * 10 <= records_seen(record) {
            self.path.push([record.midpoint[0], record.midpoint[1]]);
        }
        if all {
            self.records.push(*record);
        }
    }
}

/// Result and files of trials, a block of each variant; pictures and logs are those of the variants
/// that are `shown`.
pub fn publish(
    context: &Context,
    variants: &[Variant],
    shown: &[Variant],
    blocks: &[Vec<Trial>],
) -> Result<(Report, OutputDir), Error> {
    let goal = context.scenario.mission.goal;
    if blocks.iter().any(Vec::is_empty) {
        let text = "interrupted before each row had a trial: nothing is written";
        return Err(Error::Interrupted(text.to_owned()));
    }
    let pairs = variants.iter().zip(blocks);
    let rows: Vec<Row> = pairs
        .map(|(variant, block)| summarize(variant, block, goal))
        .collect();
    let mut files = context.output()?;
    let body = context.body();
    let mut panels = Vec::new();
    let mut columns = Vec::new();
    let applied: Vec<Scenario> = shown.iter().map(|v| v.apply(&context.scenario)).collect();
    let mut runs = Vec::new();
    for (variant, scenario) in shown.iter().zip(&applied) {
        let Some(row) = variants.iter().position(|v| v == variant) else {
            continue;
        };
        let picture = Picture::of(variant, scenario, &blocks[row]);
        panels.push(picture.paths(body.half_track_m));
        columns.push(picture.errors());
        let log = format!("log-{}.csv", variant.fusion());
        files.csv(&log, csv::of_records(&blocks[row][0].records));
        runs.push(picture.page(&rows[row]));
    }
    page::add(&mut files, &context.name, context.seed, &body, &runs);
    let figure = figures::paths("Robot paths during posture regulation", &body, &panels);
    files.text("paths.svg", figure.svg());
    files.bytes("paths.png", figure.png());
    let figure = figures::errors("Posture errors", &columns);
    files.text("errors.svg", figure.svg());
    files.bytes("errors.png", figure.png());
    files.csv("trials.csv", report::trials_csv(variants, blocks, goal));
    let report = Report {
        trials: blocks.iter().map(Vec::len).max().unwrap_or(0) as u32,
        rows,
        paper: Vec::new(),
    };
    Ok((report, files))
}

/// Epochs since the start of the simulation.
fn records_seen(record: &Record) -> usize {
    (record.time_s * 100.0).round() as usize
}
