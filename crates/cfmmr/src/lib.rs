//! The program `cfmmr`.
//!
//! | module | holds |
//! |---|---|
//! | [`cli`] | the command line, and commands that print |
//! | [`experiments`] | commands that run or configure a robot |
//! | [`dashboard`] | a run on the terminal |
//!
//! The feature `full` adds logs with replay and live server, the dashboard, page layout on the terminal, and the text
//! of the boards' logs. Without this feature, `--log`, `--live`, `--dashboard` and `replay` name the command to type,
//! and pages are printed as Markdown.

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

#[cfg(test)]
#[macro_use]
#[path = "../../../core-algos/src/properties.rs"]
mod properties;

pub mod cli;
#[cfg(feature = "full")]
pub mod dashboard;
#[cfg(not(feature = "full"))]
#[path = "no_dashboard.rs"]
pub mod dashboard;
pub mod experiments;
mod thinned;

use cli::{Cli, Command};
use host_sim::base::error::Error;
use host_sim::run::path_run::PathMode;
use host_sim::scenario::own::Own;
use output::terminal::note;
use std::process::ExitCode;

/// Name and version of the program, with a hash of its sources.
pub const BUILD: &str = env!("BUILD");

/// Runs the command line of this process with parts of the user, on boards in this process. Returns the exit code of
/// the process.
///
/// `posture`, `follow`, `track`, `drive`, `campaign`, `consistency` and `soak` use the parts. Other commands that simulate
/// the robot print on standard error that they run without the parts.
pub fn main_with(own: Own) -> ExitCode {
    match Cli::read().and_then(|cli| run(&cli, &own)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note(format!("cfmmr: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(cli: &Cli, own: &Own) -> Result<(), Error> {
    let built_in = matches!(
        cli.command,
        Some(Command::Paper(_) | Command::Replay(_) | Command::Calibrate(_) | Command::Faults(_))
    );
    let names = own.names();
    if built_in && !names.is_empty() {
        let names = names.join(" and ");
        note(format!(
            "cfmmr: this command runs without the user's {names}"
        ));
    }
    match &cli.command {
        None => cli::posture::run(&cli.posture, own),
        Some(Command::Posture(args)) => cli::posture::run(args, own),
        Some(Command::Paper(args)) => cli::paper::run(args),
        Some(Command::Follow(args)) => cli::follow::run(args, PathMode::Follow, own),
        Some(Command::Track(args)) => cli::follow::run(args, PathMode::Track, own),
        Some(Command::Drive(args)) => cli::drive::run(args, own),
        Some(Command::Hil(args)) => cli::hil::run(args, own),
        Some(Command::Replay(args)) => cli::replay::run(args),
        Some(Command::Consistency(args)) => cli::consistency::run(args, own),
        Some(Command::Eval(args)) => cli::eval::run(args),
        Some(Command::Calibrate(args)) => cli::calibrate::run(args),
        Some(Command::Params(args)) => cli::params::run(args),
        Some(Command::Parameters) => cli::parameters::run(),
        Some(Command::Codes) => cli::codes::run(),
        Some(Command::Dbc(args)) => cli::dbc::run(args),
        Some(Command::Topics) => cli::topics::run(),
        Some(Command::Serial) => cli::serial::run(),
        Some(Command::Config(args)) => cli::config::run(args),
        Some(Command::Keys(args)) => cli::keys::run(args),
        Some(Command::World(args)) => cli::world::run(args),
        Some(Command::Faults(args)) => cli::faults::run(args),
        Some(Command::Soak(args)) => cli::soak::run(args, own),
        Some(Command::Campaign(args)) => cli::campaign::run(args, own),
        Some(Command::Glossary(args)) => cli::glossary::run(args),
        Some(Command::Doctor(args)) => cli::doctor::run(args),
        Some(Command::Completions(args)) => cli::completions::run(args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use core_algos::control::controller::{ControllerOutput, KinematicController};
    use core_algos::control::regulator::Input;
    use std::fs;
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    /// Drives ahead to 1 cm before the goal.
    struct Ahead;

    impl KinematicController for Ahead {
        fn step(&mut self, input: &Input) -> ControllerOutput {
            let done = input.goal.relative_to(input.posture).x < 0.01;
            ControllerOutput {
                v: 0.15,
                kappa: 0.0,
                done,
            }
        }
    }

    fn typed(folder: &Path, line: &str) -> Cli {
        let line = line.replace("OUT", folder.to_str().unwrap());
        Cli::try_parse_from(["cfmmr"].into_iter().chain(line.split(' '))).unwrap()
    }

    #[test]
    fn boards_outside_of_the_process_are_refused_with_an_own_controller() {
        let folder = tempfile::tempdir().unwrap();
        let own = Own::default().with_controller(|| Ahead);
        for (line, place) in [
            ("posture --on virtual --out OUT/a", "--on virtual"),
            ("follow --on virtual --out OUT/b", "--on virtual"),
            (
                "posture --on serial:front=/dev/null --out OUT/c",
                "--on serial",
            ),
            ("hil --on virtual --out OUT/d", "hil"),
            ("soak --on virtual", "--on virtual"),
        ] {
            let error = run(&typed(folder.path(), line), &own).unwrap_err();
            let expected = format!("{place}: not with the user's controller");
            assert!(error.to_string().starts_with(&expected), "{line}: {error}");
            assert_eq!(error.exit_code(), 2);
        }
    }

    #[test]
    fn own_controller_drives_posture_and_campaign_and_is_in_their_results() {
        let folder = tempfile::tempdir().unwrap();
        let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
        let made = Arc::new(AtomicU32::new(0));
        let counter = made.clone();
        let own = Own::default().with_controller(move || {
            counter.fetch_add(1, Relaxed);
            Ahead
        });
        let line = "posture --trials 2 --rows pair --from=-0.4,0,0 --out OUT/posture";
        run(&typed(folder.path(), line), &own).unwrap();
        // Two rows of two trials; the median is the first trial, or is driven again.
        assert!(made.load(Relaxed) >= 4);
        let result: serde_json::Value = serde_json::from_str(&read("posture/result.json")).unwrap();
        assert_eq!(result["run"]["own"], serde_json::json!(["controller"]));
        assert!(read("posture/report.html").contains("user's controller"));

        let study = "name = \"test\"\ntrials = 2\n[scenario.mission]\nstart = [-0.4, 0.0, 0.0]\n";
        fs::write(folder.path().join("study.toml"), study).unwrap();
        let line = "campaign OUT/study.toml --out OUT/study";
        run(&typed(folder.path(), line), &own).unwrap();
        assert_eq!(made.swap(0, Relaxed) % 2, 0);
        assert!(read("study/study.toml").contains("own = [\"controller\"]"));
        let merge = typed(folder.path(), "campaign merge OUT/study");
        run(&merge, &Own::default()).unwrap();
        let result: serde_json::Value =
            serde_json::from_str(&read("study/merged/result.json")).unwrap();
        assert_eq!(result["own"], serde_json::json!(["controller"]));
        // A program without the controller does not add runs.
        let built_in = Own::default();
        let error = run(&typed(folder.path(), line), &built_in).unwrap_err();
        assert!(error.to_string().contains("different study"), "{error}");
        let line = "campaign OUT/study/study.toml --out OUT/study";
        let error = run(&typed(folder.path(), line), &built_in).unwrap_err();
        assert!(
            error.to_string().starts_with("own = [controller]"),
            "{error}"
        );
    }
}
