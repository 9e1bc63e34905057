//! Command line: one file per subcommand, with its arguments. [`experiments`](crate::experiments) does the work.
//!
//! Start with [`Command`].

pub mod arguments;
pub mod calibrate;
pub mod campaign;
pub mod codes;
pub mod completions;
pub mod config;
pub mod consistency;
pub mod dbc;
pub mod doctor;
mod doctor_boards;
pub mod drive;
pub mod eval;
pub mod faults;
pub mod follow;
pub mod glossary;
pub mod hil;
pub mod keys;
mod outputs;
pub mod paper;
pub mod parameters;
pub mod params;
pub mod posture;
pub mod replay;
pub mod serial;
pub mod soak;
pub mod topics;
pub mod world;

use calibrate::CalibrateArgs;
use campaign::CampaignArgs;
use clap::{Arg, CommandFactory, FromArgMatches, Parser, Subcommand};
use completions::CompletionsArgs;
use config::ConfigArgs;
use consistency::ConsistencyArgs;
use dbc::DbcArgs;
use doctor::DoctorArgs;
use drive::DriveArgs;
use eval::EvalArgs;
use faults::FaultsArgs;
use follow::FollowArgs;
use glossary::GlossaryArgs;
use hil::HilArgs;
use host_sim::base::error::Error;
use keys::KeysArgs;
use output::terminal;
use output::terminal::note;
use paper::PaperArgs;
use params::ParamsArgs;
use posture::PostureArgs;
use replay::ReplayArgs;
use soak::SoakArgs;
use std::ffi::OsString;
use std::io::{self, IsTerminal};
use world::WorldArgs;

/// Control and sensing of a compliant-framed mobile robot of two to five axles: the code of the
/// boards drives a simulated robot.
///
/// Without a command, `cfmmr` runs `cfmmr posture`: the robot drives from (-1.342 m, -1.342 m, 0°)
/// to the origin, with and without strain gauges.
#[derive(Debug, Parser)]
#[command(name = "cfmmr", version, args_conflicts_with_subcommands = true)]
pub struct Cli {
    /// Subcommand; `None` runs `posture`.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Arguments of `posture` when no subcommand is given.
    #[command(flatten)]
    pub posture: PostureArgs,
}

impl Cli {
    /// Parses the command line of this process. Ends the process after a syntax error or a request for help. Fails if
    /// an output cannot be written.
    pub fn read() -> Result<Self, Error> {
        let home = std::env::var("HOME").ok().filter(|home| !home.is_empty());
        let words = std::env::args_os().map(|word| word_for_clap(word, home.as_deref()));
        let matches = command().try_get_matches_from(words);
        let matches = matches.unwrap_or_else(|error| exit_with(&error));
        outputs::check(&matches)?;
        Ok(Self::from_arg_matches(&matches).unwrap_or_else(|error| exit_with(&error)))
    }
}

/// Prints the parser's error or help and ends the process.
fn exit_with(error: &clap::Error) -> ! {
    let text = error.render().to_string();
    if error.use_stderr() {
        note(text.trim_end());
    } else if io::stdout().is_terminal() {
        error.exit();
    } else if let Err(error) = terminal::print(&text) {
        note(format!("cfmmr: {error}"));
        std::process::exit(error.exit_code().into());
    }
    std::process::exit(error.exit_code());
}

/// Rewrites an argument for clap, which takes -.4 and -90deg for options. Expands ~, which shells leave in --out=~/x.
fn word_for_clap(word: OsString, home: Option<&str>) -> OsString {
    let Some(text) = word.to_str() else {
        return word;
    };
    if let Some(digits) = text.strip_prefix("-.") {
        return word_for_clap(format!("-0.{digits}").into(), home);
    }
    // A space in front lets clap take a negative angle as a value; the parser of the angle removes the space.
    let is_angle = text.ends_with("deg") || text.ends_with('°');
    let number = text.strip_prefix('-').filter(|_| is_angle);
    if number.is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit())) {
        return format!(" {text}").into();
    }
    let (option, value) = match text.split_once('=') {
        Some((option, value)) if option.starts_with("--") => (&text[..=option.len()], value),
        _ => ("", text),
    };
    match (value.strip_prefix('~'), home) {
        (Some(rest), Some(home)) if rest.is_empty() || rest.starts_with('/') => {
            format!("{option}{home}{rest}").into()
        }
        _ => word,
    }
}

/// Parser of the command line. A negative number is a value, not an option, so an error states the allowed range.
pub fn command() -> clap::Command {
    let value = |argument: Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    Cli::command()
        .mut_args(value)
        .mut_subcommands(move |subcommand| subcommand.mut_args(value))
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Drive to the origin: paired trials with and without strain gauges, with each fusion
    Posture(PostureArgs),
    /// Run the paper's experiment and compare it with the figures that the paper prints
    Paper(PaperArgs),
    /// Follow a path: line, circle, figure eight or waypoints from a CSV file
    Follow(FollowArgs),
    /// Track a trajectory: a path of `follow` with a time law
    Track(FollowArgs),
    /// Drive the robot by a script or one step: goals, paths, speeds, stops
    Drive(DriveArgs),
    /// Run an experiment with boards in the loop: virtual or on serial ports
    Hil(HilArgs),
    /// Replay a log and compare it bit by bit, or estimate again with other parameters
    Replay(ReplayArgs),
    /// Run a Monte Carlo study over variations of a scenario, in any number of parts
    Campaign(CampaignArgs),
    /// Measure the consistency of the estimates (normalised estimation error squared)
    Consistency(ConsistencyArgs),
    /// Run one on-board algorithm on cases from standard input, one JSON object per line
    Eval(EvalArgs),
    /// Print the table of the parameters in a board's flash
    Parameters,
    /// List, get, set and save the parameters of boards
    Params(ParamsArgs),
    /// Calibrate wheels, strain gauges or gyros, and save the result
    Calibrate(CalibrateArgs),
    /// Print the table of fault codes and operating states
    Codes,
    /// Print the table of a log's topics
    Topics,
    /// Print the table of the serial protocol between host and board
    Serial,
    /// Print the scenario with all defaults as TOML
    Config(ConfigArgs),
    /// Print the keys of a scenario with unit, default, allowed values and meaning
    Keys(KeysArgs),
    /// Print a world: the true robot and its surroundings as distributions, each figure with its
    /// reason
    World(WorldArgs),
    /// Print the description of the CAN bus (DBC), or its load
    Dbc(DbcArgs),
    /// Inject each known fault into the simulated robot and print the outcomes
    Faults(FaultsArgs),
    /// Drive for hours and check consistency of the estimator, faults and memory
    Soak(SoakArgs),
    /// Print the meaning of a word, or the whole glossary
    Glossary(GlossaryArgs),
    /// Check toolchain, debug probe and serial ports, and print what to type
    Doctor(DoctorArgs),
    /// Print the completions of a shell: `source <(cfmmr completions bash)`
    Completions(CompletionsArgs),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_line_is_well_formed() {
        command().debug_assert();
    }

    #[test]
    fn negative_numbers_and_tilde_are_rewritten() {
        let read = |word: &str| {
            word_for_clap(word.into(), Some("/home/me"))
                .into_string()
                .unwrap()
        };
        for (word, read_as) in [
            ("~/x", "/home/me/x"),
            ("--out=~/x", "/home/me/x"),
            ("--out=~", "/home/me"),
            ("~", "/home/me"),
        ] {
            assert!(read(word).ends_with(read_as), "{word}");
        }
        assert_eq!(read("--out=~/x"), "--out=/home/me/x");
        assert_eq!(read("-.4"), "-0.4");
        assert_eq!(read("-90deg"), " -90deg");
        assert_eq!(read("-.5°"), " -0.5°");
        for word in ["./~", "~you/x", "a~/x", "--set=k=~/x", "posture"] {
            assert_eq!(read(word), word);
        }
        assert_eq!(word_for_clap("~/x".into(), None), "~/x");
    }

    #[test]
    fn posture_is_the_default_command() {
        let cli = Cli::parse_from(["cfmmr", "--trials", "3", "--from", "-1,-1,0"]);
        assert!(cli.command.is_none());
        assert_eq!(cli.posture.trials, Some(3));
        assert_eq!(cli.posture.from.as_deref(), Some("-1,-1,0"));
    }
}
