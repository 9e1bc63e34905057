//! `cfmmr calibrate`: wheels, strain gauges and gyros of the simulated robot, whose errors it does not
//! know, on boards wherever they are.

use crate::base::error::Error;
use crate::base::numbers::whole;
use crate::base::table::Table;
use crate::base::{output, toml_file};
use crate::experiments::arguments::{BoardArgs, WorldChoice};
use crate::experiments::boards::Links;
use crate::experiments::calibrate::wheels::{self, Errors, systematic};
use crate::experiments::calibrate::{Bench, Run, believed, gauges, square, turns};
use crate::experiments::params::save;
use crate::experiments::print;
use crate::paths::Path;
use crate::scenario::Scenario;
use crate::scenario::board_parameters::{Overlays, Values};
use crate::scenario::effect::{Given, Use};
use crate::targets::board_log::BoardLog;
use crate::targets::{InProcess, Remote, Target};
use crate::world::sensors::SAMPLE_PERIOD_S;
use clap::{Args, ValueEnum};
use core_algos::params::{Parameter, Settings, find};
use core_algos::topology::Role;
use rayon::prelude::*;
use serde::Serialize;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

/// What is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CalibrateWhat {
    /// Radius, ratio and track of the wheels of each axle: a straight way, then squares both ways
    /// (UMBmark)
    Wheels,
    /// Zeros and gains of the strain gauges: strip held straight, then on formers
    Gauges,
    /// Scale and bias of the gyros: known turns, and rests
    Imu,
}

/// Arguments of `calibrate`.
#[derive(Clone, Debug, Args)]
pub struct CalibrateArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// What to calibrate
    #[arg(value_enum)]
    pub what: CalibrateWhat,
    /// Where the boards are; with none of these, in this process with their flash in files.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Directory of files with the flash of boards that are emulated or in this process
    #[arg(long, value_name = "DIR", default_value = "out/flash")]
    pub flash: PathBuf,
    /// Scenario file in TOML, see `cfmmr config`
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change one entry of the scenario; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed of the robot's errors and of all noise
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// The robots of several seeds, separated by commas: rms errors before and after; nothing is saved
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        value_parser = whole::<u64>(0..=u64::MAX),
        conflicts_with_all = ["seed", "yes", "out", "emulated", "front", "rear", "beam"]
    )]
    pub seeds: Vec<u64>,
    /// Squares each way and at each speed
    #[arg(long, default_value_t = 6, value_parser = whole::<u32>(1..=100))]
    pub laps: u32,
    /// Save without asking
    #[arg(long)]
    pub yes: bool,
    /// Write what was found to this file, for `params import` and as a scenario
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Speeds at which the squares are driven, m/s: creep goes with the time.
const SPEEDS_M_S: [f32; 2] = [0.2, 0.1];
/// Way to the left and to the right.
const WAYS: [f64; 2] = [1.0, -1.0];
/// Length of the straight way, m.
const STRAIGHT_M: f64 = 4.0;
/// Curvatures of the formers, 1/m.
const FORMERS: [f64; 4] = [1.0, -1.0, 2.0, -2.0];

/// One parameter that was calibrated.
#[derive(Clone, Debug, Serialize)]
struct Row {
    board: &'static str,
    name: &'static str,
    unit: &'static str,
    before: f64,
    after: f64,
    /// As the simulator knows it.
    truth: f64,
}

/// Something that shows what the calibration did to the robot.
#[derive(Clone, Debug, Serialize)]
struct Effect {
    what: String,
    unit: &'static str,
    before: f64,
    after: f64,
}

/// What came of it.
#[derive(Clone, Debug, Default, Serialize)]
struct Report {
    world: String,
    seed: u64,
    parameters: Vec<Row>,
    effects: Vec<Effect>,
    notes: Vec<String>,
    saved: bool,
    #[serde(skip)]
    found: Overlays,
}

/// Runs the command.
pub fn run(args: &CalibrateArgs) -> Result<(), Error> {
    let scenario = Scenario::load(
        args.choice.world.as_deref(),
        args.scenario.as_deref(),
        &args.set,
    )?;
    let (file, _) = toml_file::read(args.scenario.as_deref())?;
    Given::new(&args.set, &file)?.check(&[], &[(&scenario, Use::Calibrate)])?;
    if !args.seeds.is_empty() {
        return run_several(args, &scenario);
    }
    let mut report = calibrate(args, &scenario, args.seed)?;
    if args.boards.any_port() {
        report.notes.push(
            "these are the constants of the simulated robot: a board that is put back into a real one \
             must not keep them (cfmmr params export before, import after)"
                .to_owned(),
        );
    }
    print(&text(&report))?;
    if let Some(path) = &args.out {
        output::write_file(path, report.found.to_toml()?)?;
        print(&format!("wrote {}\n", path.display()))?;
    }
    report.saved = wanted(args)?;
    if report.saved {
        let written = save(&args.boards, &args.flash, &report.found)?;
        print(&format!("{written} values written to the flash\n"))?;
    }
    if let Some(path) = &args.json {
        output::write_file(path, output::json(&report))?;
    }
    Ok(())
}

fn calibrate(args: &CalibrateArgs, scenario: &Scenario, seed: u64) -> Result<Report, Error> {
    let mut bench = Bench::new(scenario, seed, boards(args)?);
    let mut report = match args.what {
        CalibrateWhat::Wheels => calibrate_wheels(scenario, &mut bench, args.laps)?,
        CalibrateWhat::Gauges => calibrate_gauges(scenario, &mut bench)?,
        CalibrateWhat::Imu => calibrate_gyros(scenario, &mut bench)?,
    };
    report.seed = seed;
    report.world = scenario.world.label();
    Ok(report)
}

/// Whether to save.
fn wanted(args: &CalibrateArgs) -> Result<bool, Error> {
    if args.yes {
        return Ok(true);
    }
    if !io::stdin().is_terminal() || !io::stdout().is_terminal() {
        print("not saved: no terminal to ask at, and --yes was not given\n")?;
        return Ok(false);
    }
    print("save to the boards? [y/N] ")?;
    io::stdout().flush()?;
    let mut answer = String::new();
    io::stdin().read_line(&mut answer)?;
    let yes = matches!(answer.trim(), "y" | "Y" | "yes");
    if !yes {
        print("not saved\n")?;
    }
    Ok(yes)
}

/// The boards that are not in this process; none if all are.
fn boards(args: &CalibrateArgs) -> Result<Option<[Box<dyn Target>; 3]>, Error> {
    if !args.boards.any() {
        return Ok(None);
    }
    let links = Links::new(&args.boards, None)?;
    let board = |role: Role| -> Result<Box<dyn Target>, Error> {
        Ok(match links.open(role, &BoardLog::default())? {
            Some(link) => Box::new(Remote::new(role, link)),
            None => Box::new(InProcess::new(role)),
        })
    };
    Ok(Some([
        board(Role::Front)?,
        board(Role::Rear)?,
        board(Role::Beam)?,
    ]))
}

fn parameter(name: &str) -> Result<&'static Parameter, Error> {
    find(name).ok_or_else(|| Error::Failure(format!("{name}: no such parameter")))
}

/// The scenario with what was found laid over it.
fn with(scenario: &Scenario, found: &Overlays) -> Result<Scenario, Error> {
    let mut scenario = scenario.clone();
    for role in Role::ALL {
        scenario.boards.put(role, &found.values(role)?);
    }
    scenario.check()?;
    Ok(scenario)
}

impl Report {
    /// Adds a parameter; what is found must be in its range.
    fn find(
        &mut self,
        role: Role,
        name: &str,
        before: f64,
        after: f64,
        truth: f64,
    ) -> Result<(), Error> {
        let parameter = parameter(name)?;
        let value = parameter.validate(after as f32)?;
        self.found.put(role, &Values::from([(parameter, value)]));
        self.parameters.push(Row {
            board: role.name(),
            name: parameter.name,
            unit: parameter.unit,
            before,
            after,
            truth,
        });
        Ok(())
    }

    fn effect(&mut self, what: impl Into<String>, unit: &'static str, [before, after]: [f64; 2]) {
        let what = what.into();
        self.effects.push(Effect {
            what,
            unit,
            before,
            after,
        });
    }
}

/// Squares both ways at both speeds, the nominal one first.
struct Squares(Vec<(f32, f64, Run)>);

impl Squares {
    fn drive(scenario: &Scenario, bench: &mut Bench, laps: u32) -> Result<Self, Error> {
        let (mut runs, mut number) = (Vec::new(), 10);
        for speed in SPEEDS_M_S {
            let mut scenario = scenario.clone();
            scenario.robot.lead.course.path.nominal_speed_m_s = speed;
            for way in WAYS {
                for _ in 0..laps {
                    number += 1;
                    let run = bench.drive(&scenario, &square(way)?, number)?;
                    runs.push((speed, way, run));
                }
            }
        }
        Ok(Self(runs))
    }

    /// UMBmark's measure at the nominal speed of some return errors.
    fn systematic(&self, error: impl Fn(&Run) -> [f64; 2]) -> f64 {
        let of = |wanted: f64| -> Vec<[f64; 2]> {
            let runs = self.0.iter();
            runs.filter(|(speed, way, _)| *speed == SPEEDS_M_S[0] && *way == wanted)
                .map(|(_, _, run)| error(run))
                .collect()
        };
        systematic([&of(WAYS[0]), &of(WAYS[1])])
    }
}

fn calibrate_wheels(scenario: &Scenario, bench: &mut Bench, laps: u32) -> Result<Report, Error> {
    let mut report = Report::default();
    let line = Path::line(STRAIGHT_M).map_err(|error| Error::Failure(error.to_string()))?;
    let straight = [
        bench.drive(scenario, &line, 1)?,
        bench.drive(scenario, &line, 2)?,
    ];
    let before = Squares::drive(scenario, bench, laps)?;
    let mut creep = [0.0; 2];
    for (i, role) in [Role::Front, Role::Rear].into_iter().enumerate() {
        let length = |[x, y, _]: [f64; 3]| x.hypot(y);
        let scales = straight
            .iter()
            .map(|run| length(run.axles[i].end) / length(run.axles[i].lap.end()));
        let scale = scales.sum::<f64>() / straight.len() as f64;
        let returns: Vec<_> = before
            .0
            .iter()
            .map(|(_, _, run)| run.axles[i].clone())
            .collect();
        let old = believed(scenario, role)?;
        let errors: Errors = wheels::fit(&returns, 2.0 * old.half_track_m).ok_or_else(|| {
            Error::Failure(format!("{} axle: the squares do not fit", role.name()))
        })?;
        creep[i] = errors.creep;
        let new = old.corrected(scale, &errors);
        let robot = bench.robot();
        let nominal = &scenario.world.plant;
        let radii: [f64; 2] =
            std::array::from_fn(|k| nominal.wheel_radius_m[i][k] * robot.wheel_radius_factor[i][k]);
        let track = nominal.half_track_m[i] * robot.track_factor[i];
        for (name, old, new, truth) in [
            (
                "wheel_radius_m",
                old.radius_m,
                new.radius_m,
                0.5 * (radii[0] + radii[1]),
            ),
            ("wheel_ratio", old.ratio, new.ratio, radii[1] / radii[0]),
            ("half_track_m", old.half_track_m, new.half_track_m, track),
        ] {
            report.find(role, &format!("robot.geometry.{name}"), old, new, truth)?;
        }
    }
    let after = Squares::drive(&with(scenario, &report.found)?, bench, laps)?;
    let both = [&before, &after];
    for (i, name) in ["front axle alone", "rear axle alone"]
        .into_iter()
        .enumerate()
    {
        let measured = both.map(|runs| 1e3 * runs.systematic(|run| run.axles[i].error()));
        report.effect(format!("E_max,syst, {name}"), "mm", measured);
        let left =
            both.map(|runs| 1e3 * runs.systematic(|run| run.axles[i].without_creep(creep[i])));
        report.effect(format!("E_max,syst, {name}, less creep"), "mm", left);
    }
    let robot = both.map(|runs| 1e3 * runs.systematic(|run| run.robot));
    report.effect("E_max,syst, robot's estimate", "mm", robot);
    report.notes.push(format!(
        "creep under the frame's moment: {:+.4} (front) and {:+.4} (rear) rad/s per rad of bend; no \
         parameter corrects it, the joint filter estimates it",
        creep[0], creep[1]
    ));
    Ok(report)
}

fn calibrate_gauges(scenario: &Scenario, bench: &mut Bench) -> Result<Report, Error> {
    let mut report = Report::default();
    let bridge = &scenario.world.sensors.bridge;
    let middle = f64::from(bridge.full_scale_counts());
    let held = bench.hold(scenario, &FORMERS)?;
    let count = scenario.robot.beam.strip.gauges_m.count();
    let mut blank = Overlays::default();
    let (mut zeros, mut gains) = (Vec::new(), Vec::new());
    for i in 0..count {
        let found = gauges::fit(&held, i, bridge.strain_per_count());
        let (zero, gain) = found
            .ok_or_else(|| Error::Failure(format!("gauge {i}: the postures do not differ")))?;
        zeros.push(zero);
        gains.push(gain);
        let zero = parameter(&format!("robot.beam.calibration.zero_counts[{i}]"))?;
        let gain = parameter(&format!("robot.beam.calibration.gain[{i}]"))?;
        blank.put(Role::Beam, &[(zero, middle as f32), (gain, 1.0)]);
    }
    let robot = bench.robot().clone();
    let truth = robot.zero_counts(bridge);
    for (i, zero) in zeros.iter().enumerate() {
        let name = format!("robot.beam.calibration.zero_counts[{i}]");
        report.find(Role::Beam, &name, middle, *zero, middle + truth[i])?;
    }
    for (i, gain) in gains.iter().enumerate() {
        let name = format!("robot.beam.calibration.gain[{i}]");
        let truth = 1.0 / (1.0 + robot.bridge_gain_error[i]);
        report.find(Role::Beam, &name, 1.0, *gain, truth)?;
    }
    // A lap, with the zeros of the straight edge but the converter's gains first: without any zeros
    // the robot would not find its way.
    let mut zeroed = Overlays::default();
    zeroed.put(Role::Beam, &report.found.values(Role::Beam)?);
    for i in 0..count {
        let gain = parameter(&format!("robot.beam.calibration.gain[{i}]"))?;
        zeroed.put(Role::Beam, &[(gain, 1.0)]);
    }
    let lap = square(1.0)?;
    let ends = [&zeroed, &report.found];
    let mut errors = Vec::new();
    for overlays in ends {
        errors.push(bench.drive(&with(scenario, overlays)?, &lap, 3)?.beam);
    }
    for (k, (what, unit)) in [
        ("frame's end on a lap, x", "mm"),
        ("frame's end on a lap, y", "mm"),
        ("frame's end on a lap, heading", "mrad"),
    ]
    .into_iter()
    .enumerate()
    {
        report.effect(
            format!("{what}, rms"),
            unit,
            [0, 1].map(|i| 1e3 * errors[i][k]),
        );
    }
    // What the zeros do is known without driving: the mean strain they leave turns the frame's end.
    let length = f64::from(scenario.robot.geometry.frame_length_m);
    let half = f64::from(scenario.robot.geometry.half_thickness_m);
    let unzeroed = robot.bridge_offset[..count].iter().sum::<f64>() / count as f64;
    let strain = bridge.strain_per_count();
    let left = (0..count)
        .map(|i| (truth[i] + middle - zeros[i]) * strain)
        .sum::<f64>()
        / count as f64;
    let turn = |strain: f64| 1e3 * (strain * length / half).abs();
    report.effect(
        "straight frame read as turned by",
        "mrad",
        [turn(unzeroed), turn(left)],
    );
    report.notes.push(
        "on the lap the frame is as it was measured before with zeros alone, and with zeros and gains"
            .to_owned(),
    );
    Ok(report)
}

fn calibrate_gyros(scenario: &Scenario, bench: &mut Bench) -> Result<Report, Error> {
    let mut report = Report::default();
    let turned = bench.turn(scenario)?;
    for (i, role) in [Role::Front, Role::Rear].into_iter().enumerate() {
        let mut settings = Settings::new(scenario.robot);
        scenario.boards.apply(role, &mut settings)?;
        let gain = turns::gain(&turned[i], SAMPLE_PERIOD_S)
            .ok_or_else(|| Error::Failure(format!("{} gyro: it did not turn", role.name())))?;
        let truth = 1.0 / (1.0 + bench.robot().gyro_scale_error[i]);
        let before = settings.inertial.gyro_gain.into();
        report.find(role, "inertial.gyro_gain", before, gain, truth)?;
        let bias = turned[i].iter().map(turns::Turn::bias).sum::<f64>() / turned[i].len() as f64;
        report.notes.push(format!(
            "{} gyro: bias {:+.3} mrad/s at rest (true {:+.3}); not stored, each board finds it anew",
            role.name(),
            1e3 * bias,
            1e3 * bench.robot().gyro_bias[i]
        ));
    }
    let mut fitted = scenario.clone();
    fitted.world.sensors.gyro.fitted = true;
    let lap = square(1.0)?;
    let before = bench.drive(&fitted, &lap, 4)?;
    let after = bench.drive(&with(&fitted, &report.found)?, &lap, 4)?;
    for (i, name) in ["front", "rear"].into_iter().enumerate() {
        let errors = [&before, &after].map(|run| 1e3 * run.heading[i].abs());
        report.effect(format!("{name} axle's heading after a lap"), "mrad", errors);
    }
    let errors = [&before, &after].map(|run| 1e3 * run.robot[0].hypot(run.robot[1]));
    report.effect("robot's estimate after a lap", "mm", errors);
    Ok(report)
}

/// What calibrating several robots left, by seed those that it failed on.
#[derive(Debug, Serialize)]
struct Several {
    world: String,
    seeds: Vec<u64>,
    /// Root mean squares.
    rms: Vec<Effect>,
    failed: Vec<(u64, String)>,
}

/// Calibrates the robots of several seeds, and prints a table in Markdown.
fn run_several(args: &CalibrateArgs, scenario: &Scenario) -> Result<(), Error> {
    let mut several = Several {
        world: scenario.world.label(),
        seeds: Vec::new(),
        rms: Vec::new(),
        failed: Vec::new(),
    };
    let mut reports = Vec::new();
    let calibrated = args.seeds.par_iter();
    let calibrated: Vec<_> = calibrated
        .map(|&seed| (seed, calibrate(args, scenario, seed)))
        .collect();
    for (seed, result) in calibrated {
        match result {
            Ok(report) => {
                several.seeds.push(seed);
                reports.push(report);
            }
            // What the user got wrong is wrong for all of them.
            Err(error @ Error::Input(_)) => return Err(error),
            Err(error) => several.failed.push((seed, error.to_string())),
        }
    }
    several.rms = rms(&reports);
    let mut text = String::from("| rms | unit | before | after |\n|---|---|---|---|\n");
    for row in &several.rms {
        let [before, after] = [row.before, row.after].map(two_digits);
        text += &format!("| {} | {} | {before} | {after} |\n", row.what, row.unit);
    }
    let (all, world) = (args.seeds.len(), &several.world);
    text += &format!("\n{} of {all} robots, world {world}.", reports.len());
    for (seed, error) in &several.failed {
        text += &format!(" Seed {seed}: {error}.");
    }
    print(&format!("{text}\n"))?;
    if let Some(path) = &args.json {
        output::write_file(path, output::json(&several))?;
    }
    match reports.is_empty() {
        true => Err(Error::Failure("no robot was calibrated".to_owned())),
        false => Ok(()),
    }
}

/// Over all robots, and over the boards and gauges that have the same parameter.
fn rms(reports: &[Report]) -> Vec<Effect> {
    let mut sums: Vec<(Effect, f64)> = Vec::new();
    let mut add = |what: &str, unit, [before, after]: [f64; 2]| {
        let known = sums.iter().position(|(sum, _)| sum.what == what);
        let place = known.unwrap_or_else(|| {
            let (what, before, after) = (what.to_owned(), 0.0, 0.0);
            let sum = Effect {
                what,
                unit,
                before,
                after,
            };
            sums.push((sum, 0.0));
            sums.len() - 1
        });
        let (sum, count) = &mut sums[place];
        sum.before += before * before;
        sum.after += after * after;
        *count += 1.0;
    };
    for report in reports {
        for row in &report.parameters {
            let errors = [row.before - row.truth, row.after - row.truth];
            let name = row.name.split('[').next().unwrap_or(row.name);
            add(&format!("`{name}`"), row.unit, errors);
        }
        for effect in &report.effects {
            add(&effect.what, effect.unit, [effect.before, effect.after]);
        }
    }
    let finish = |(mut sum, count): (Effect, f64)| {
        (sum.before, sum.after) = ((sum.before / count).sqrt(), (sum.after / count).sqrt());
        sum
    };
    sums.into_iter().map(finish).collect()
}

/// A number with two digits that count, or as a whole one.
fn two_digits(value: f64) -> String {
    let digits = 1.0 - value.abs().max(1e-9).log10().floor();
    format!("{value:.0$}", digits.max(0.0) as usize)
}

fn text(report: &Report) -> String {
    let digits = |row: &Row| if row.unit == "counts" { 2 } else { 6 };
    let mut table = Table::new([
        "parameter",
        "board",
        "unit",
        "before",
        "after",
        "true",
        "error before",
        "error after",
    ]);
    for row in &report.parameters {
        let n = digits(row);
        table.row([
            row.name.to_owned(),
            row.board.to_owned(),
            row.unit.to_owned(),
            format!("{:.n$}", row.before),
            format!("{:.n$}", row.after),
            format!("{:.n$}", row.truth),
            format!("{:+.n$}", row.before - row.truth),
            format!("{:+.n$}", row.after - row.truth),
        ]);
    }
    let mut effects = Table::new(["error", "unit", "before", "after"]);
    for effect in &report.effects {
        effects.row([
            effect.what.clone(),
            effect.unit.to_owned(),
            format!("{:.2}", effect.before),
            format!("{:.2}", effect.after),
        ]);
    }
    let notes: String = report
        .notes
        .iter()
        .map(|note| format!("{note}\n"))
        .collect();
    format!("{table}\n{effects}\nworld {}\n{notes}", report.world)
}
