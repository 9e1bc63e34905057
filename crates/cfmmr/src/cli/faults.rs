//! `cfmmr faults`: injects every known fault at several times and with several seeds.

use super::arguments::{AxlesArg, ImageArgs, JsonArgs, ONLY_VIRTUAL, WorldChoice, refuse};
use crate::experiments::result::Provenance;
use crate::experiments::run::place::BoardPlace;
use crate::experiments::{faults, pool};
use clap::Args;
use core_algos::topology::Topology;
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
use remote::virtual_robot::faults::{Campaign, Entry, catalogue};

/// Page with the expected table, which `--check` compares with the result.
const PAGE: &str = "docs/faults.md";

/// Arguments of `faults`.
#[derive(Clone, Debug, Args)]
pub struct FaultsArgs {
    /// Option that selects the world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Option that sets the number of axles; with three or more the faults occur at the second axle or the frame behind
    /// it.
    #[command(flatten)]
    pub axles: AxlesArg,
    /// Run each fault with this number of seeds
    #[arg(long, default_value_t = 2, value_parser = whole::<u32>(1..=1000))]
    pub seeds: u32,
    /// Run only faults whose name contains this text; may be repeated
    #[arg(long, value_name = "TEXT")]
    pub only: Vec<String>,
    /// Run on boards in-process (faults of samples, frames and plant) or virtual (also faults of registers, pins,
    /// supplies and wires, with the boards' images)
    #[arg(long, value_name = "PLACE", default_value = "in-process", value_parser = BoardPlace::parse)]
    pub on: BoardPlace,
    /// Run each fault at one time with one seed, and a selection of the instants of power failure
    #[arg(long, conflicts_with = "seeds")]
    pub quick: bool,
    /// Use N threads; the number does not change the result [default: one per core]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
    /// Exit 1 if a row differs from docs/faults.md, or with --quick, if docs/faults.md lacks an outcome
    #[arg(long)]
    pub check: bool,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
    /// Options that select the images of virtual boards.
    #[command(flatten)]
    pub images: ImageArgs,
}

/// Faults that `--only` selects; in-process boards leave out the faults that need firmware images.
fn chosen<'a>(all: &'a [Entry], args: &FaultsArgs) -> Result<Vec<&'a Entry>, Error> {
    let images = args.on == BoardPlace::Virtual;
    let possible: Vec<&Entry> = all
        .iter()
        .filter(|entry| images || !entry.needs_images())
        .collect();
    let unknown = |only: &&String| {
        !possible
            .iter()
            .any(|entry| entry.name.contains(only.as_str()))
    };
    if let Some(only) = args.only.iter().find(unknown) {
        let names: Vec<&str> = possible.iter().map(|entry| entry.name.as_str()).collect();
        return Err(Error::input(format!(
            "--only {only}: no fault has this text in its name; the faults are: {}{}",
            names.join(", "),
            if images {
                ""
            } else {
                "; --on virtual has more"
            }
        )));
    }
    let is_chosen = |entry: &&Entry| {
        args.only.is_empty()
            || args
                .only
                .iter()
                .any(|only| entry.name.contains(only.as_str()))
    };
    Ok(possible.into_iter().filter(is_chosen).collect())
}

/// Settings that all runs share.
fn settings(args: &FaultsArgs) -> Result<Campaign, Error> {
    let images = match args.on {
        BoardPlace::Virtual => Some(args.images.open()?),
        BoardPlace::InProcess => None,
        BoardPlace::Serial(_) => {
            return Err(Error::input(
                "--on: must be in-process or virtual: real boards have no fault injection",
            ));
        }
    };
    if images.is_none() {
        refuse(&args.images.given(), ONLY_VIRTUAL)?;
    }
    Ok(Campaign {
        scenario: faults::scenario(args.choice.world.as_deref(), &args.axles.changes(&[])?)?,
        images,
        quick: args.quick,
    })
}

/// Runs `cfmmr faults`.
pub fn run(args: &FaultsArgs) -> Result<(), Error> {
    let trials = settings(args)?;
    let robot = trials.scenario.robot.topology();
    if args.check && robot != Topology::PAIR {
        return Err(Error::input(format!(
            "--check: {PAGE} is of a robot of two axles; leave out --axles"
        )));
    }
    let all = catalogue(robot);
    let entries = chosen(&all, args)?;
    let json = args.json.open()?;
    let committed = match args.check {
        true => std::fs::read_to_string(PAGE)
            .map_err(|error| Error::input(format!("{PAGE}: {error}")))?,
        false => String::new(),
    };
    let pool = pool(args.threads)?;
    let seeds = if args.quick { 1 } else { u64::from(args.seeds) };
    let report = pool.install(|| faults::campaign(&trials, &entries, seeds))?;
    json.write(&Provenance::of(&trials.scenario, 1), &report)?;
    let text = report.markdown() + &report.failures_text();
    json.print_page(&text)?;
    if report.interrupted {
        let text = "interrupted: the table contains the finished runs only";
        return Err(Error::Interrupted(text.to_owned()));
    }
    match report.wrong() {
        0 => {}
        wrong => return Err(Error::Failure(format!("{wrong} runs failed"))),
    }
    match report.unexpected(&committed, args.quick) {
        Some(row) if args.check => Err(Error::Failure(format!(
            "differs from {PAGE} (tools/scripts/regenerate.py faults rewrites the page):\n{row}"
        ))),
        _ => Ok(()),
    }
}
