//! Replay: runs the nodes on the inputs in a log, with the recorded or with other parameters.

use crate::BUILD;
use core_algos::node::robot::RobotConfig;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::base::input;
use host_sim::base::statistics::NIS_EXPECTED;
use host_sim::base::toml_file;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect;
use host_sim::scenario::effect::Use;
use output::files;
use output::table::Table;
use output::terminal::note;
use recording::log::MAGIC;
use recording::log::read;
use recording::log::read::{Event, Events, Run};
use recording::log::recover;
use recording::log::replay;
use recording::log::replay::{Comparison, Divergence, Quality, RecordedEstimates};
use serde::Serialize;
use std::io::{BufReader, BufWriter};
use std::path::{Path, PathBuf};
use toml::{Table as Toml, Value};

/// Options of a replay.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// Log file.
    pub log: PathBuf,
    /// True if the intact records of a damaged log are written to a new log, which is replayed.
    pub recover: bool,
    /// File for the recovered log [default: LOG with the ending .recovered.mcap].
    pub out: Option<PathBuf>,
    /// File with other parameters.
    pub with: Option<PathBuf>,
}

/// Length of a board's record in the log, and its interruptions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoardRecordSummary {
    /// Front, rear or beam.
    pub board: &'static str,
    /// Number of recorded ticks.
    pub ticks: usize,
    /// Each end of the record in the log: tick, ms, and reason.
    pub ends: Vec<(u32, String)>,
}

impl BoardRecordSummary {
    fn new(robot: Topology, role: Role) -> Self {
        Self {
            board: robot.name(role),
            ticks: 0,
            ends: Vec::new(),
        }
    }

    fn take(&mut self, event: &Event) {
        match event {
            Event::Tick(_) => self.ticks += 1,
            Event::Off(tick, reason) => self.ends.push((*tick, reason.clone())),
            _ => {}
        }
    }
}

/// Differences of a replay from the log, or estimate errors with other parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Ticks of the board with the longest record.
    pub ticks: usize,
    /// Length of each board's record.
    pub boards: Vec<BoardRecordSummary>,
    /// True if every bit is identical; `None` with other parameters.
    pub identical: Option<bool>,
    /// First difference of the replay from the record; `None` if identical or with other parameters.
    pub difference: Option<Divergence>,
    /// Errors of the recorded estimates.
    pub recorded: Quality,
    /// Errors of the estimates with other parameters.
    pub with: Option<Quality>,
}

/// Replays a log; returns the report and its text.
pub fn run(options: &ReplayOptions) -> Result<(ReplayReport, String), Error> {
    let name = options.log.display().to_string();
    let log = open(options, &name)?;
    let robot = log.robot;
    let boards = robot
        .boards()
        .map(|role| BoardRecordSummary::new(robot, role));
    let mut boards: Vec<_> = boards.collect();
    let mut recorded = RecordedEstimates::default();
    let mut comparison = Comparison::new(robot);
    let mut events: Events = vec![Vec::new(); robot.board_count()];
    let run = log.read(&mut |role, event| {
        boards[robot.place(role)].take(&event);
        recorded.take(role, &event);
        match &options.with {
            None => comparison.take(role, &event),
            // With other parameters the boards send other frames, so all boards are replayed together.
            Some(_) => events[robot.place(role)].push(event),
        }
    })?;
    let scenario = recorded_scenario(&run, &name)?;
    if !scenario.world.bus.quantise {
        return Err(Error::input(format!(
            "{name}: recorded with bus.quantise = false: messages differ from bus frames, \
             so the log cannot be replayed"
        )));
    }
    let mut report = ReplayReport {
        ticks: run.ticks,
        boards,
        identical: None,
        difference: None,
        recorded: Quality::of(&recorded.estimates, &run),
        with: None,
    };
    let mut text = String::new();
    match &options.with {
        None => {
            report.difference = comparison.first()?;
            report.identical = Some(report.difference.is_none());
            match &report.difference {
                None => text += &format!("identical over {} ticks\n", report.ticks),
                Some(divergence) => {
                    text += &format!("NOT identical: {divergence}\n");
                    let build = run.about.get("build");
                    if let Some(build) = build.filter(|build| *build != BUILD) {
                        text += &format!("recorded by {build}; this is {BUILD}\n");
                    }
                }
            }
        }
        Some(path) => {
            let file = path.display().to_string();
            let given =
                input::text(path).map_err(|error| Error::input(format!("{file}: {error}")))?;
            let changes = changes(&given, &file)?;
            effect::check_file(&given, &file, (&scenario, Use::Replay))?;
            let first = events.iter().flatten().find_map(Event::config);
            // All starts have equal parameters, so checking the first start is enough.
            let first = first.copied().unwrap_or_default();
            let changed = apply(&first, &changes, &file)?;
            let estimates = replay::replay_estimates(robot, &events, &|_| changed)?;
            report.with = Some(Quality::of(&estimates, &run));
        }
    }
    for board in report.boards.iter().filter(|board| board.ticks > 0) {
        text += &format!("{} board: {} ticks", board.board, board.ticks);
        for (tick, reason) in &board.ends {
            text += &format!("; off at {tick} ms: {reason}");
        }
        text += "\n";
    }
    text += &table(&report);
    Ok((report, text))
}

/// Log to be read.
struct Log {
    path: PathBuf,
    /// Name of the log in errors.
    name: String,
    /// Hint below an error of reading; empty for a recovered log.
    hint: String,
    robot: Topology,
}

impl Log {
    /// Reads the log and passes the events of the boards to `to`.
    fn read(&self, to: &mut dyn FnMut(Role, Event)) -> Result<Run, Error> {
        let file = BufReader::new(input::open(&self.path, input::MAX_LOG_BYTES)?);
        read::stream(file, self.robot, &self.name, to).map_err(|error| match self.hint.is_empty() {
            true => error,
            false => Error::input(format!("{error}; {}", self.hint)),
        })
    }
}

/// Opens the log, after recovery if requested.
fn open(options: &ReplayOptions, name: &str) -> Result<Log, Error> {
    let refuse = |error: std::io::Error| {
        Error::input(format!(
            "{name}: {error}: must be a log that `cfmmr posture --log FILE` wrote"
        ))
    };
    // Refuses a wrong or truncated file before reading all of it.
    match input::has_edges(&options.log, MAGIC).map_err(refuse)? {
        [false, _] => {
            return Err(Error::input(format!(
                "{name}: not an MCAP file: the first bytes are wrong"
            )));
        }
        [true, false] if !options.recover => {
            return Err(Error::input(format!(
                "{name}: truncated MCAP file: `cfmmr replay --recover {name}` recovers the intact records"
            )));
        }
        _ => {}
    }
    let (path, name, hint) = if options.recover {
        let copy = options
            .out
            .clone()
            .unwrap_or_else(|| recovered_name(&options.log));
        let bytes = input::bytes(&options.log, input::MAX_LOG_BYTES).map_err(refuse)?;
        recover(&bytes, name, &copy)?;
        let name = copy.display().to_string();
        (copy, name, String::new())
    } else {
        let hint = format!("`cfmmr replay --recover {name}` recovers the intact records");
        (options.log.clone(), name.to_owned(), hint)
    };
    let file = input::open(&path, input::MAX_LOG_BYTES).map_err(refuse)?;
    let robot = read::robot(BufReader::new(file), &name)?;
    Ok(Log {
        path,
        name,
        hint,
        robot,
    })
}

/// Name of a recovered log, from the name of a finished or unfinished log.
fn recovered_name(log: &Path) -> PathBuf {
    let name = log.file_name().unwrap_or_default().to_string_lossy();
    let unfinished = name
        .strip_prefix('.')
        .and_then(|name| name.strip_suffix(".partial"));
    let whole = unfinished.and_then(|name| Some(name.rsplit_once('.')?.0));
    let whole = whole.unwrap_or(&name);
    let stem = whole.strip_suffix(".mcap").unwrap_or(whole);
    log.with_file_name(format!("{stem}.recovered.mcap"))
}

/// Writes the intact records of a log into a new log, and prints notes on written and missing records.
fn recover(bytes: &[u8], name: &str, to: &Path) -> Result<(), Error> {
    let mut file = files::temporary_beside(to)?;
    let found = recover::recover(bytes, BufWriter::new(file.as_file_mut()))
        .map_err(|why| Error::input(format!("{name}: {why}")))?;
    file.persist(to)
        .map_err(|error| Error::Failure(format!("{}: {}", to.display(), error.error)))?;
    note(format!(
        "wrote {}: {} messages up to {:.3} s",
        to.display(),
        found.messages,
        found.last_ns as f64 * 1e-9
    ));
    const MOST: usize = 10;
    for what in found.missing.iter().take(MOST) {
        note(format!("missing: {what}"));
    }
    if let Some(more @ 1..) = found.missing.len().checked_sub(MOST) {
        note(format!("missing: {more} more"));
    }
    Ok(())
}

/// Scenario of a log; its table `plant` is dropped, because logs of version 0.1 have other keys there.
fn recorded_scenario(run: &Run, name: &str) -> Result<Scenario, Error> {
    let text = run.about.get("scenario").map_or("", String::as_str);
    let mut recorded: Toml =
        toml::from_str(text).map_err(|error| Error::input(format!("{name}: {error}")))?;
    recorded.remove("plant");
    toml_file::parse(&recorded.to_string(), name, &[])
}

/// Table `robot` of a scenario file, the only part that a replay can change.
fn changes(text: &str, file: &str) -> Result<Toml, Error> {
    // Parsed as a whole scenario first, because those errors name the line.
    let _: Scenario = toml_file::parse(text, file, &[])?;
    let mut given: Toml =
        toml::from_str(text).map_err(|error| Error::input(format!("{file}: {error}")))?;
    let robot = given.remove("robot");
    if let Some(other) = given.keys().next() {
        return Err(Error::input(format!(
            "{file}: {other}: no effect in a replay; only the table [robot] can change"
        )));
    }
    match robot {
        Some(Value::Table(robot)) => Ok(robot),
        _ => Err(Error::input(format!(
            "{file}: the table [robot] is missing"
        ))),
    }
}

/// Recorded parameters with changes.
fn apply(recorded: &RobotConfig, changes: &Toml, file: &str) -> Result<RobotConfig, Error> {
    let failed = |error: &dyn std::fmt::Display| Error::input(format!("{file}: robot: {error}"));
    let mut table = Toml::try_from(recorded).map_err(|error| failed(&error))?;
    toml_file::merge_config(&mut table, changes.clone());
    let config: RobotConfig = Value::Table(table)
        .try_into()
        .map_err(|error| failed(&error))?;
    config.build().map_err(|error| failed(&error))?;
    let (axles, of_log) = (config.geometry.axles, recorded.geometry.axles);
    if axles != of_log {
        return Err(Error::input(format!(
            "{file}: robot.geometry.axles = {axles}: must be {of_log}, the axles of the log"
        )));
    }
    Ok(config)
}

fn table(report: &ReplayReport) -> String {
    let mut table = Table::new([
        "",
        "position rms (mm)",
        "max (mm)",
        "final (mm)",
        "heading rms (°)",
        "final (°)",
        "relative position rms (mm)",
        "NEES",
        "NIS",
        "rejected",
    ]);
    let number = |value: Option<f64>, scale: f64, digits: usize| {
        value.map_or("–".to_owned(), |value| {
            format!("{:.digits$}", scale * value)
        })
    };
    let degrees = 1f64.to_degrees();
    let rows = [
        ("recorded", Some(&report.recorded)),
        ("with the given parameters", report.with.as_ref()),
    ];
    for (name, quality) in rows {
        let Some(quality) = quality else { continue };
        table.row([
            name.to_owned(),
            number(quality.position_rms_m, 1e3, 2),
            number(quality.position_max_m, 1e3, 2),
            number(quality.final_position_m, 1e3, 2),
            number(quality.heading_rms_rad, degrees, 3),
            number(quality.final_heading_rad, degrees, 3),
            number(quality.relative_rms_m, 1e3, 3),
            number(quality.mean_nees, 1.0, 2),
            format!("{:.2}", quality.mean_nis),
            format!("{:.1} %", 100.0 * quality.refused),
        ]);
    }
    format!(
        "\nEstimated less true state of the midpoint O, {} estimates\n\n{table}\n\
         NEES: normalised estimation error squared of O, expected 3; NIS: normalised innovation squared of the\n\
         beam, expected {NIS_EXPECTED}. rejected: innovations beyond the gate.\n",
        report.recorded.count
    )
}
