//! `cfmmr params`: lists and changes the parameters in the boards' flash.

use super::arguments::{AxlesArg, BoardArgs, JsonArgs};
use crate::experiments::result::{Json, Provenance};
use crate::experiments::run::links::{Links, flash_of};
use crate::experiments::run::place::{board_named, board_names};
use clap::{Args, Subcommand};
use core_algos::link::Identity;
use core_algos::params::{BoardKind, Parameter, Settings, Source, TABLE};
use core_algos::topology::{MAX_AXLES, Role, Topology};
use host_sim::base::error::Error;
use host_sim::base::input;
use host_sim::base::numbers::whole;
use host_sim::scenario::board_parameters;
use host_sim::scenario::board_parameters::{Overlays, Values};
use output::files;
use output::table::Table;
use output::terminal::print;
use remote::Remote;
use remote::board_log::BoardLog;
use remote::link::Loopback;
use remote::parameters::BoardParameter;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Arguments of `params`.
#[derive(Clone, Debug, Args)]
pub struct ParamsArgs {
    /// Action
    #[command(subcommand)]
    pub action: ParamsAction,
}

/// Action on the parameters of boards.
#[derive(Clone, Debug, Subcommand)]
pub enum ParamsAction {
    /// List all parameters with units and ranges
    List(ParamsTarget),
    /// Show the named parameters
    Get(ParamsGet),
    /// Check new values; with --save, save them in the flash
    Set(ParamsSet),
    /// Export the parameters that differ from the image's defaults
    Export(ParamsExport),
    /// Check the parameters in a file; with --save, save them in the flash
    Import(ParamsImport),
}

/// Boards that the command reads or changes.
#[derive(Clone, Debug, Args)]
pub struct ParamsTarget {
    /// Options that select where the boards run; by default in this process, with their flash in files.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Keep the flash of in-process and virtual boards in files in this folder
    #[arg(long, value_name = "DIR", default_value = "out/flash")]
    pub flash: PathBuf,
    /// Name the boards as those of a robot with this number of axles [default: 2]
    #[arg(long, value_name = "N", value_parser = whole::<u8>(2..=MAX_AXLES as u8))]
    pub axles: Option<u8>,
    /// Select these boards, separated by commas: front, axle-2, …, rear, beam, or beam-1, … of more than two axles
    /// [default: all]
    #[arg(long, value_delimiter = ',', value_name = "LIST")]
    pub board: Vec<String>,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

impl ParamsTarget {
    /// Robot whose boards the command names.
    fn robot(&self) -> Topology {
        AxlesArg { axles: self.axles }.topology()
    }

    /// Selected boards; none if all are selected.
    fn named(&self, robot: Topology) -> Result<Vec<Role>, Error> {
        let role = |name: &String| {
            board_named(robot, name).ok_or_else(|| {
                let axles = robot.axle_count();
                Error::input(format!(
                    "--board {name}: must be {} of a robot of {axles} axles; --axles N names more",
                    board_names(robot)
                ))
            })
        };
        self.board.iter().map(role).collect()
    }
}

/// Arguments of `params get`.
#[derive(Clone, Debug, Args)]
pub struct ParamsGet {
    /// Names of parameters, see `cfmmr parameters`
    #[arg(value_name = "NAME", required = true)]
    pub names: Vec<String>,
    /// Boards of the command, and destination of its result.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// Arguments of `params set`.
#[derive(Clone, Debug, Args)]
pub struct ParamsSet {
    /// New values, for example robot.geometry.wheel_radius_m=0.0731
    #[arg(value_name = "NAME=VALUE", required = true)]
    pub values: Vec<String>,
    /// Save the parameters in the flash
    #[arg(long)]
    pub save: bool,
    /// Boards of the command, and destination of its result.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// Arguments of `params export`.
#[derive(Clone, Debug, Args)]
pub struct ParamsExport {
    /// Write to this file instead of the terminal
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Export all parameters
    #[arg(long)]
    pub all: bool,
    /// Boards of the command, and destination of its result.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// Arguments of `params import`.
#[derive(Clone, Debug, Args)]
pub struct ParamsImport {
    /// File that `params export` or `calibrate` wrote
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Save the parameters in the flash
    #[arg(long)]
    pub save: bool,
    /// Boards of the command, and destination of its result.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// Runs `cfmmr params`.
pub fn run(args: &ParamsArgs) -> Result<(), Error> {
    match &args.action {
        ParamsAction::List(target) => show(target, &TABLE.iter().collect::<Vec<_>>()),
        ParamsAction::Get(get) => run_get(get),
        ParamsAction::Set(set) => run_set(set),
        ParamsAction::Export(export) => run_export(export),
        ParamsAction::Import(import) => run_import(import),
    }
}

/// Parameter of a board in the JSON output.
#[derive(Debug, Serialize)]
struct ParameterRow {
    board: &'static str,
    name: &'static str,
    unit: &'static str,
    value: f32,
    from: f32,
    to: f32,
    default: f32,
    source: Source,
    saved: bool,
    meaning: &'static str,
    /// Names of the values 0, 1, … of a choice; empty for a number.
    choices: Vec<&'static str>,
}

#[derive(Debug, Serialize)]
struct ParameterChange {
    board: &'static str,
    name: &'static str,
    unit: &'static str,
    before: f32,
    after: f32,
    saved: bool,
}

/// Calls `act` for each selected board in a session of its own. A session ends before the next begins, because boards
/// without a port are reached over the bus through a board that has no session.
fn at_each(
    target: &ParamsTarget,
    mut act: impl FnMut(Role, &mut Remote) -> Result<(), Error>,
) -> Result<(), Error> {
    target.boards.check()?;
    let robot = target.robot();
    let named = target.named(robot)?;
    let links = Links::new(
        robot,
        &target.boards.on,
        target.boards.baud(),
        Some(target.flash.clone()),
    )?;
    for role in robot.boards() {
        if !named.is_empty() && !named.contains(&role) {
            continue;
        }
        let name = robot.name(role);
        let link = match links.reach(role, &BoardLog::new(name))? {
            Some(link) => link,
            None => {
                let build = env!("CARGO_PKG_VERSION");
                let file = flash_of(&target.flash, name);
                Box::new(Loopback::keeping(robot, Identity { build, role }, &file)?)
            }
        };
        let mut remote = Remote::new(robot, role, link);
        if target.boards.on.has_ports() {
            remote.end_earlier_session()?;
        }
        remote.start_session()?;
        act(role, &mut remote)?;
        remote.end_session()?;
    }
    Ok(())
}

fn write_json(json: &Json, parameters: &impl Serialize) -> Result<(), Error> {
    #[derive(Serialize)]
    struct Values<'a, T> {
        parameters: &'a T,
    }
    json.write(&Provenance::default(), &Values { parameters })
}

fn show(target: &ParamsTarget, wanted: &[&'static Parameter]) -> Result<(), Error> {
    let json = target.json.open()?;
    let robot = target.robot();
    let mut rows = Vec::new();
    at_each(target, |role, remote| {
        let base = Settings::of(BoardKind::of(role));
        for kept in remote.parameters()? {
            let BoardParameter {
                parameter,
                value,
                source,
                saved,
            } = kept;
            if wanted.iter().any(|other| other.id == parameter.id) {
                rows.push(ParameterRow {
                    board: robot.name(role),
                    name: parameter.name,
                    unit: parameter.unit,
                    value,
                    from: parameter.range.0,
                    to: parameter.range.1,
                    default: parameter.get(&base),
                    source,
                    saved,
                    meaning: parameter.meaning(),
                    choices: parameter
                        .choices()
                        .iter()
                        .map(|choice| choice.name)
                        .collect(),
                });
            }
        }
        Ok(())
    })?;
    // No table: the names of the parameters are too long for a column.
    let mut text = String::new();
    let mut names: Vec<&str> = rows.iter().map(|row| row.name).collect();
    names.dedup();
    let new = |n: usize| !names[..n].contains(&names[n]);
    for n in (0..names.len()).filter(|&n| new(n)) {
        let of_name: Vec<&ParameterRow> = rows.iter().filter(|row| row.name == names[n]).collect();
        let ParameterRow {
            name,
            unit,
            from,
            to,
            default,
            choices,
            ..
        } = of_name[0];
        let numbered = choices.iter().enumerate();
        let choices: String = numbered.map(|(i, name)| format!("; {i} {name}")).collect();
        let gap = if unit.is_empty() { "" } else { " " };
        text += &format!("{name}: {from} to {to}{gap}{unit}, default {default}{choices}\n");
        for row in of_name {
            let state = state(row.source, row.saved);
            text += &format!("  {:<6} {:<12} {state}\n", row.board, row.value);
        }
    }
    write_json(&json, &rows)?;
    json.print(&text)
}

/// Source of a parameter's value in words; "not saved" if the flash does not hold the value.
fn state(source: Source, saved: bool) -> &'static str {
    match (source, saved) {
        (_, false) => "not saved",
        (Source::Default, true) => "default",
        (Source::Stored, true) => "stored",
        (Source::Damaged, true) => "default: the stored value is damaged",
        (Source::OtherVersion, true) => "default: the stored value has another version",
        (Source::OutOfRange, true) => "default: the stored value is out of range",
    }
}

fn run_get(get: &ParamsGet) -> Result<(), Error> {
    let names = get
        .names
        .iter()
        .map(|name| board_parameters::parameter(name));
    show(&get.target, &names.collect::<Result<Vec<_>, _>>()?)
}

fn run_set(set: &ParamsSet) -> Result<(), Error> {
    if set.target.board.is_empty() {
        return Err(Error::input(
            "--board: must name the boards to change, for example --board rear",
        ));
    }
    let values = set.values.iter().map(|text| parse(text));
    let values = values.collect::<Result<Values, _>>()?;
    change(&set.target, set.save, |_| Ok(values.clone()))
}

fn refused(parameter: &Parameter, value: &str) -> Error {
    let names: Vec<&str> = parameter
        .choices()
        .iter()
        .map(|choice| choice.name)
        .collect();
    let (low, high) = parameter.range;
    let allowed = match names.is_empty() {
        true => String::new(),
        false => format!("{} or ", names.join(", ")),
    };
    Error::input(format!(
        "{} = {value}: must be {allowed}a number from {low} to {high}",
        parameter.name
    ))
}

/// Parses `NAME=VALUE` and checks the range.
fn parse(text: &str) -> Result<(&'static Parameter, f32), Error> {
    let Some((name, value)) = text.split_once('=') else {
        return Err(Error::input(format!(
            "{text}: must be NAME=VALUE, for example robot.geometry.wheel_radius_m=0.0731"
        )));
    };
    let parameter = board_parameters::parameter(name.trim())?;
    let value = value.trim();
    let mut choices = parameter.choices().iter();
    let number = match choices.position(|choice| choice.name == value) {
        Some(number) => number as f32,
        None => value.parse().map_err(|_| refused(parameter, value))?,
    };
    Ok((parameter, parameter.validate(number)?))
}

fn run_import(import: &ParamsImport) -> Result<(), Error> {
    let name = import.file.display().to_string();
    let text =
        input::text(&import.file).map_err(|error| Error::input(format!("{name}: {error}")))?;
    let overlays = Overlays::parse(&text, &name)?;
    change(&import.target, import.save, |role| overlays.values(role))
}

/// Saves the values on their boards; returns the number of values written to the flash.
pub fn save(boards: &BoardArgs, flash: &Path, overlays: &Overlays) -> Result<u32, Error> {
    let mut target = ParamsTarget {
        boards: boards.clone(),
        flash: flash.to_owned(),
        axles: Some(overlays.topology.axle_count() as u8),
        board: Vec::new(),
        json: JsonArgs::default(),
    };
    for role in overlays.topology.boards() {
        if !overlays.values(role)?.is_empty() {
            target.board.push(overlays.topology.name(role).to_owned());
        }
    }
    let mut written = 0;
    at_each(&target, |role, remote| {
        for (parameter, value) in overlays.values(role)? {
            remote.set_parameter(parameter, value)?;
        }
        written += u32::from(remote.save_parameters()?);
        Ok(())
    })?;
    Ok(written)
}

/// Sets values, prints old and new values, and saves if `save`. All values have been checked before the first is set.
fn change(
    target: &ParamsTarget,
    save: bool,
    wanted: impl Fn(Role) -> Result<Values, Error>,
) -> Result<(), Error> {
    let json = target.json.open()?;
    let robot = target.robot();
    let mut changes = Vec::new();
    let mut written = 0;
    let done = at_each(target, |role, remote| {
        let before = remote.parameters()?;
        for (parameter, value) in wanted(role)? {
            let old = before.iter().find(|kept| kept.parameter.id == parameter.id);
            remote.set_parameter(parameter, value)?;
            changes.push(ParameterChange {
                board: robot.name(role),
                name: parameter.name,
                unit: parameter.unit,
                before: old.map_or(f32::NAN, |kept| kept.value),
                after: value,
                saved: save,
            });
        }
        if save {
            written += u32::from(remote.save_parameters()?);
        }
        Ok(())
    });
    if done.is_err() && changes.is_empty() {
        return done;
    }
    let mut table = Table::new(["parameter", "board", "before", "after", "unit"]);
    for change in &changes {
        table.row([
            change.name.to_owned(),
            change.board.to_owned(),
            change.before.to_string(),
            change.after.to_string(),
            change.unit.to_owned(),
        ]);
    }
    if done.is_ok() {
        write_json(&json, &changes)?;
    }
    // Printed after an error as well: the table shows the values that were set before the error.
    let note = match save {
        true => format!("{written} values written to the flash"),
        false => {
            "checked and not saved: the boards keep their old values; save with --save".to_owned()
        }
    };
    json.print(&format!("{table}{note}\n"))?;
    done
}

fn run_export(export: &ParamsExport) -> Result<(), Error> {
    let json = export.target.json.open()?;
    let mut overlays = Overlays::new(export.target.robot());
    at_each(&export.target, |role, remote| {
        let kept = remote.parameters()?;
        let some = kept.iter().filter(|kept| export.all || kept.is_own());
        let values: Values = some.map(|kept| (kept.parameter, kept.value)).collect();
        overlays.put(role, &values);
        Ok(())
    })?;
    let text = overlays.to_toml()?;
    write_json(&json, &overlays)?;
    match &export.out {
        Some(path) => {
            files::write_file(path, &text)?;
            print(&format!("wrote {}\n", path.display()))
        }
        None => json.print(&text),
    }
}
