//! `cfmmr posture`: posture regulation with and without the relative position sensor, as the
//! paper's experiment has it.

mod pictures;

use crate::base::error::Error;
use crate::base::numbers::whole;
use crate::base::output::{Cell, Csv, OutputDir};
use crate::base::statistics::{self, Summary};
use crate::base::table::{Table, plus_minus};
use crate::experiments::Context;
use crate::experiments::arguments::{Common, parse_posture};
use crate::experiments::recorder::{self, Recorder};
use crate::recording::{About, LogArgs, csv};
use crate::run::final_error::FinalError;
use crate::run::regulate::{Outcome, regulate, regulate_on};
use crate::run::robot::Record;
use crate::scenario::Scenario;
use crate::scenario::effect::{Run, Taken, Use};
use crate::view::{figures, page};
use clap::{Args, ValueEnum};
use core_algos::fusion::robot::Mode;
use core_algos::safety::Condition;
use pictures::Picture;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Which fusion runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RowSelection {
    /// Without sensor, covariance intersection, with error correction, joint filter; each also
    /// with inertial sensors.
    All,
    /// Only without the relative position sensor and with it (joint filter), no inertial sensors.
    Pair,
}

/// Arguments of `posture`.
#[derive(Clone, Debug, Args)]
pub struct PostureArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Where the run is recorded.
    #[command(flatten)]
    pub log: LogArgs,
    /// Number of paired trials in each row
    #[arg(long, default_value_t = 50, value_parser = whole::<u32>(1..=1_000_000), conflicts_with_all = ["dashboard", "live"])]
    pub trials: u32,
    /// Start posture of the robot's midpoint: metres, metres, heading in radians or with `deg`
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Rows of the table
    #[arg(long, value_enum, default_value_t = RowSelection::All, conflicts_with_all = ["dashboard", "live"])]
    pub rows: RowSelection,
}

/// A configuration of sensors and fusion: one row of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variant {
    /// Whether the relative position sensor is fitted.
    pub rps: bool,
    /// Whether the axles carry gyroscopes and accelerometers.
    pub imu: bool,
    /// Which fusion runs.
    pub mode: Mode,
}

impl Variant {
    const fn new(rps: bool, imu: bool, mode: Mode) -> Self {
        Self { rps, imu, mode }
    }

    /// The rows of the whole table, pairs with and without inertial sensors.
    pub const ALL: [Self; 8] = [
        Self::new(false, false, Mode::Odometry),
        Self::new(true, false, Mode::Intersection),
        Self::new(true, false, Mode::IntersectionIpec),
        Self::new(true, false, Mode::Joint),
        Self::new(false, true, Mode::Odometry),
        Self::new(true, true, Mode::Intersection),
        Self::new(true, true, Mode::IntersectionIpec),
        Self::new(true, true, Mode::Joint),
    ];

    /// Only with and without the relative position sensor.
    pub const PAIR: [Self; 2] = [Self::ALL[0], Self::ALL[3]];

    /// The configuration that a scenario has.
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            rps: scenario.mission.rps,
            imu: scenario.world.sensors.gyro.fitted,
            mode: match scenario.mission.rps {
                true => scenario.robot.lead.fusion.mode,
                false => Mode::Odometry,
            },
        }
    }

    /// The scenario with this configuration.
    pub fn apply(&self, scenario: &Scenario) -> Scenario {
        let mut scenario = scenario.clone();
        scenario.mission.rps = self.rps;
        scenario.world.sensors.gyro.fitted = self.imu;
        scenario.world.sensors.accelerometer.fitted = self.imu;
        scenario.robot.lead.fusion.mode = self.mode;
        scenario
    }

    /// Short name of the fusion, as in the JSON result.
    pub fn fusion(&self) -> &'static str {
        match self.mode {
            Mode::Odometry => "odometry",
            Mode::Intersection => "ci",
            Mode::IntersectionIpec => "ci+ipec",
            Mode::Joint => "joint",
        }
    }

    /// The configuration in words.
    pub fn label(&self) -> String {
        let name = match self.mode {
            Mode::Odometry => "without RPS",
            Mode::Intersection => "RPS, covariance intersection",
            Mode::IntersectionIpec => "RPS, intersection + IPEC",
            Mode::Joint => "RPS, joint filter",
        };
        match self.imu {
            true => format!("{name}, IMU"),
            false => name.to_owned(),
        }
    }
}

/// One row of the result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Whether the relative position sensor was fitted.
    pub rps: bool,
    /// Whether inertial sensors were fitted.
    pub imu: bool,
    /// Which fusion ran.
    pub fusion: &'static str,
    /// Distance of O from the goal.
    pub e_m: Summary,
    /// Heading error of O.
    pub heading_rad: Summary,
    /// θ of the paper.
    pub theta_rad: Summary,
    /// α of the paper.
    pub alpha_rad: Summary,
    /// Share of trials within 3 cm and 3°.
    pub within_3cm_3deg: f64,
    /// Share of trials the robot itself reported as done.
    pub done: f64,
    /// Mean of the squared error of the estimate of O over its claimed covariance; 3 if the claim is right.
    pub nees: f64,
    /// Share of trials whose error of the estimate of O lies in the claimed 99 % ellipsoid.
    pub inside_share: f64,
    /// How trials ended: `reached`, `reached, uncertain`, the code of the first stop, or `time limit`, and
    /// how many.
    pub ends: BTreeMap<String, u32>,
    /// Trials reported as reached for certain that were not within 3 cm and 3°.
    pub false_successes: u32,
    /// Half axis of the ellipse in which the robot claims to be with 95 %.
    pub claimed_m: Summary,
    /// Half the interval in which it claims its heading to be with 95 %.
    pub claimed_rad: Summary,
    /// Error of the estimated position of the front axle as seen from the rear axle.
    pub drift_m: Summary,
    /// Root mean square of the frame's force in a trial.
    pub force_rms_n: Summary,
    /// Time of a trial.
    pub duration_s: Summary,
}

/// The result of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Seed.
    pub seed: u64,
    /// Trials in each row.
    pub trials: u32,
    /// The rows.
    pub rows: Vec<Row>,
}

/// Summarises the trials of one configuration.
pub fn summarize(variant: &Variant, outcomes: &[Outcome], goal: [f64; 3]) -> Row {
    let errors: Vec<FinalError> = outcomes
        .iter()
        .map(|outcome| FinalError::of(outcome.midpoint, goal))
        .collect();
    let of = |pick: fn(&FinalError) -> f64| -> Summary {
        Summary::of(&errors.iter().map(pick).collect::<Vec<_>>())
    };
    let outcome = |pick: fn(&Outcome) -> f64| -> Vec<f64> { outcomes.iter().map(pick).collect() };
    let near = errors.iter().filter(|error| error.is_near()).count();
    let mut ends = BTreeMap::new();
    for outcome in outcomes {
        *ends.entry(end_of(outcome)).or_default() += 1;
    }
    let pairs = outcomes.iter().zip(&errors);
    let false_successes = pairs.filter(|(o, error)| o.done && !o.uncertain && !error.is_near());
    Row {
        rps: variant.rps,
        imu: variant.imu,
        fusion: variant.fusion(),
        e_m: of(|error| error.e_m),
        heading_rad: of(|error| error.heading_rad),
        theta_rad: of(|error| error.theta_rad),
        alpha_rad: of(|error| error.alpha_rad),
        within_3cm_3deg: near as f64 / errors.len().max(1) as f64,
        done: statistics::share(&outcome(|o| f64::from(u8::from(o.done))), |v| v > 0.5),
        nees: Summary::of(&outcome(|o| o.nees)).mean,
        inside_share: statistics::share(&outcome(|o| o.nees), |nees| nees <= CHI_SQUARE_99),
        ends,
        false_successes: false_successes.count() as u32,
        claimed_m: Summary::of(&outcome(|o| o.claimed[0])),
        claimed_rad: Summary::of(&outcome(|o| o.claimed[1])),
        drift_m: Summary::of(&outcome(|o| o.relative_error[0].hypot(o.relative_error[1]))),
        force_rms_n: Summary::of(&outcome(|o| o.force_rms_n)),
        duration_s: Summary::of(&outcome(|o| o.duration_s)),
    }
}

/// Of three degrees of freedom, 99 %.
pub const CHI_SQUARE_99: f64 = 11.345;

/// How a trial ended, in a word.
fn end_of(outcome: &Outcome) -> String {
    match (&outcome.fault, outcome.done) {
        (Some(status), _) => status.reason.map_or_else(
            || status.state.name().to_owned(),
            |code| code.entry().name.to_owned(),
        ),
        (None, true) if outcome.uncertain => Condition::ReachedUncertain.entry().name.to_owned(),
        (None, true) => "reached".to_owned(),
        (None, false) if outcome.gave_up => "gave up".to_owned(),
        (None, false) => "time limit".to_owned(),
    }
}

/// Trials of a row whose paths are kept for the picture, which shows no more: so the memory does not
/// grow with their number, but for the outcome of each.
const PICTURED: usize = 200;

/// Runs the command.
pub fn run(args: &PostureArgs) -> Result<(), Error> {
    let mut context = Context::new(&args.common, "posture")?;
    if let Some(text) = &args.from {
        context.scenario.mission.start = parse_posture(text).map_err(Error::Input)?;
        context.scenario.check()?;
    }
    if args.log.is_watched() {
        return watch(args, &context);
    }
    let variants: &[Variant] = match args.rows {
        RowSelection::All => &Variant::ALL,
        RowSelection::Pair => &Variant::PAIR,
    };
    let scenarios: Vec<Scenario> = variants
        .iter()
        .map(|variant| variant.apply(&context.scenario))
        .collect();
    check_keys(args, &context, &scenarios)?;
    let trials = args.trials as usize;
    let goal = context.scenario.mission.goal;

    // Refused now rather than after the trials.
    recorder::check(&args.log)?;

    // Paths are kept for the two configurations the pictures show.
    let shown = Variant::PAIR;
    let mut results = context.run("trials", variants.len() * trials, |index| {
        let (row, trial) = (index / trials, index % trials);
        let keep = shown.contains(&variants[row]) && trial < PICTURED;
        let mut kept = Trial::default();
        kept.outcome = regulate(&scenarios[row], context.seed, trial as u64, |record| {
            if keep {
                kept.see(record, trial == 0);
            }
        })?;
        Ok(kept)
    })?;
    // The median trial is drawn in full, and is known only now.
    for (row, block) in results.chunks_mut(trials.max(1)).enumerate() {
        if shown.contains(&variants[row]) {
            let median = pictures::median_trial(block, goal);
            if block[median].records.is_empty() {
                let see = |record: &Record| block[median].see(record, true);
                regulate(&scenarios[row], context.seed, median as u64, see)?;
            }
        }
    }
    let (text, report, files) = publish(&context, variants, &shown, &results, goal)?;
    let recorded = record(args, &context)?;
    context.finish_with(&text, &report, files, recorded)
}

/// Keys that each row sets.
pub const ROWS: Taken = &[
    ("mission.rps", "here: each row sets it, see --rows"),
    (
        "robot.lead.fusion.mode",
        "here: each row sets it, see --rows",
    ),
    ("sensors.gyro.fitted", "here: each row sets it, see --rows"),
    (
        "sensors.accelerometer.fitted",
        "here: each row sets it, see --rows",
    ),
];

/// Refuses keys without effect in any row.
fn check_keys(args: &PostureArgs, context: &Context, rows: &[Scenario]) -> Result<(), Error> {
    let runs: Vec<Run> = rows.iter().map(|row| (row, Use::Regulate)).collect();
    let from = args.from.as_ref().map(|_| ("mission.start", "with --from"));
    let taken: Vec<_> = ROWS.iter().copied().chain(from).collect();
    context.check_keys(&taken, &runs)
}

/// Runs the first trial with the sensor alone, for those who look on.
fn watch(args: &PostureArgs, context: &Context) -> Result<(), Error> {
    check_keys(args, context, &[Variant::PAIR[1].apply(&context.scenario)])?;
    context.output()?;
    let mut trial = Trial::default();
    let (outcome, recorded) = first_trial(args, context, |record| trial.see(record, true))?;
    trial.outcome = outcome;
    let shown = [Variant::PAIR[1]];
    let goal = context.scenario.mission.goal;
    let (text, report, files) = publish(context, &shown, &shown, &[trial], goal)?;
    context.finish_with(&text, &report, files, recorded)
}

/// Runs the first trial with the sensor once more, and records it.
fn record(args: &PostureArgs, context: &Context) -> Result<Vec<PathBuf>, Error> {
    match args.log.any() {
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
    let about = About {
        command: "posture",
        seed: context.seed,
        trial: 0,
        scenario: &scenario,
    };
    let recorder = Recorder::begin(&args.log, &about, scenario.mission.goal, &[])?;
    let mut simulation = recorder.simulation()?;
    let outcome = regulate_on(&mut simulation, &scenario, observe)?;
    drop(simulation);
    Ok((outcome, recorder.close()?))
}

/// What is kept of a trial.
#[derive(Clone, Debug, Default)]
pub struct Trial {
    /// How it ended.
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

/// Table, result and files of trials, as many of each variant; pictures and logs are those of the
/// variants that are `shown`.
pub fn publish(
    context: &Context,
    variants: &[Variant],
    shown: &[Variant],
    results: &[Trial],
    goal: [f64; 3],
) -> Result<(String, Report, OutputDir), Error> {
    let trials = results.len() / variants.len().max(1);
    let rows: Vec<Row> = variants
        .iter()
        .enumerate()
        .map(|(row, variant)| {
            let outcomes: Vec<Outcome> = results[row * trials..(row + 1) * trials]
                .iter()
                .map(|trial| trial.outcome.clone())
                .collect();
            summarize(variant, &outcomes, goal)
        })
        .collect();
    let text = table(&rows, variants, (&context.scenario.world.label(), trials));

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
        let block = &results[row * trials..(row + 1) * trials];
        let Some(first) = block.first() else {
            continue;
        };
        let picture = Picture::of(variant, scenario, block);
        panels.push(picture.paths(body.half_track_m));
        columns.push(picture.errors());
        let log = format!("log-{}.csv", variant.fusion());
        files.csv(&log, csv::of_records(&first.records));
        runs.push(picture.page(&rows[row]));
    }
    page::add(&mut files, &context.name, context.seed, &body, &runs);
    let figure = figures::paths("Robot paths during posture regulation", &body, &panels);
    files.text("paths.svg", figure.svg());
    files.bytes("paths.png", figure.png());
    let figure = figures::errors("Posture errors", &columns);
    files.text("errors.svg", figure.svg());
    files.bytes("errors.png", figure.png());
    files.csv("trials.csv", trials_csv(variants, results, goal));
    let report = Report {
        seed: context.seed,
        trials: trials as u32,
        rows,
    };
    Ok((text, report, files))
}

/// End of each trial.
fn trials_csv(variants: &[Variant], results: &[Trial], goal: [f64; 3]) -> Csv {
    let trials = results.len() / variants.len().max(1);
    let mut csv = Csv::new([
        "rps",
        "imu",
        "fusion",
        "trial",
        "x_m",
        "y_m",
        "phi_rad",
        "e_m",
        "heading_rad",
        "theta_rad",
        "alpha_rad",
        "force_rms_n",
        "duration_s",
        "done",
    ]);
    for (index, Trial { outcome, .. }) in results.iter().enumerate() {
        let variant = &variants[index / trials];
        let error = FinalError::of(outcome.midpoint, goal);
        csv.row::<Cell>([
            variant.rps.into(),
            variant.imu.into(),
            variant.fusion().into(),
            (index % trials).into(),
            outcome.midpoint[0].into(),
            outcome.midpoint[1].into(),
            outcome.midpoint[2].into(),
            error.e_m.into(),
            error.heading_rad.into(),
            error.theta_rad.into(),
            error.alpha_rad.into(),
            outcome.force_rms_n.into(),
            outcome.duration_s.into(),
            outcome.done.into(),
        ]);
    }
    csv
}

/// Epochs since the start of the simulation.
fn records_seen(record: &Record) -> usize {
    (record.time_s * 100.0).round() as usize
}

/// The table beside the paper's, with what is to be said of it.
fn table(rows: &[Row], variants: &[Variant], (world, trials): (&str, usize)) -> String {
    let mut table = Table::new([
        "",
        "e (cm)",
        "θ (°)",
        "α (°)",
        "heading (°)",
        "|heading| (°)",
        "3 cm, 3°",
        "drift (mm)",
        "force (N)",
        "NEES",
        "claims (cm)",
    ]);
    table.row([
        "paper, without RPS",
        "10.6 ± 3.4",
        "-31.7 ± 9.4",
        "-45.4 ± 12.2",
    ]);
    table.row([
        "paper, with RPS",
        "9.5 ± 2.1",
        "-13.3 ± 14.2",
        "-21.6 ± 14.9",
    ]);
    table.rule();
    let degrees = |summary: &Summary, digits| {
        plus_minus(summary.mean.to_degrees(), summary.sd.to_degrees(), digits)
    };
    for (row, variant) in rows.iter().zip(variants) {
        table.row([
            variant.label(),
            plus_minus(100.0 * row.e_m.mean, 100.0 * row.e_m.sd, 2),
            degrees(&row.theta_rad, 1),
            degrees(&row.alpha_rad, 1),
            degrees(&row.heading_rad, 2),
            format!("{:.2}", row.heading_rad.mean_abs.to_degrees()),
            format!("{:.0} %", 100.0 * row.within_3cm_3deg),
            format!("{:.2}", 1e3 * row.drift_m.mean),
            format!("{:.2}", row.force_rms_n.mean),
            format!("{:.1}", row.nees),
            format!("{:.1}", 100.0 * row.claimed_m.mean),
        ]);
    }
    let mut text = format!(
        "True final posture error, mean ± standard deviation, world {world}, {trials} trials a row\n\n{table}\n\
         e, θ, α: distance to the goal and directions of the line of sight to it, against the \
         goal's and the\nrobot's heading. θ and α lose meaning at small e: at a few millimetres \
         they are the direction of a\nresidue; the heading of O is the better figure there. drift: \
         error of the estimated position of the\nfront axle seen from the rear; force: of the \
         frame, rms; NEES: squared error of the estimate of O over the covariance that it claims, \
         3 if the\nclaim is right; claims: half axis of the ellipse in which the robot says it is \
         with 95 %. Where\nthat is more than robot.lead.limits allow it says that it has reached its goal, uncertain.\n"
    );
    for (row, variant) in rows.iter().zip(variants) {
        let others: Vec<String> = row
            .ends
            .iter()
            .filter(|(end, _)| *end != "reached")
            .map(|(end, count)| format!("{count} {end}"))
            .collect();
        if !others.is_empty() {
            text += &format!("{}: {}.\n", variant.label(), others.join("; "));
        }
        if row.false_successes > 0 {
            text += &format!(
                "{}: {} reached, the robot says, and not within 3 cm and 3°.\n",
                variant.label(),
                row.false_successes,
            );
        }
    }
    let base = rows.iter().find(|row| !row.rps && !row.imu);
    let with = rows
        .iter()
        .find(|row| row.rps && !row.imu && row.fusion == "joint");
    if let (Some(base), Some(with)) = (base, with) {
        let less = |with: f64, base: f64| 100.0 * (1.0 - with / base);
        text += &format!(
            "\nWith RPS (joint filter) against without: e {:.0} % less, |heading| {:.0} % less, \
             frame force {:.0} % less.\nThe paper: e 10 % less, θ 58 % less, α 52 % less.\n",
            less(with.e_m.mean, base.e_m.mean),
            less(with.heading_rad.mean_abs, base.heading_rad.mean_abs),
            less(with.force_rms_n.mean, base.force_rms_n.mean),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::control::kinematic::PolarError;
    use core_algos::math::Posture;

    #[test]
    fn errors_agree_with_the_controllers_own() {
        // The on-board polar error in f32 is another implementation of the same definitions.
        for (posture, goal) in [
            ([-1.3, -1.3, 0.2], [0.0, 0.0, 0.0]),
            ([0.5, 0.1, 3.0], [1.0, -1.0, -2.5]),
        ] {
            let error = FinalError::of(posture, goal);
            let f = |p: [f64; 3]| Posture::from(p.map(|v| v as f32));
            let board = PolarError::between(f(posture), f(goal));
            assert!((error.e_m - f64::from(board.distance_m)).abs() < 1e-5);
            assert!((error.theta_rad - f64::from(board.theta)).abs() < 1e-5);
            assert!((error.alpha_rad - f64::from(board.alpha)).abs() < 1e-5);
            assert!((error.heading_rad - f64::from(board.heading())).abs() < 1e-5);
        }
    }
}
