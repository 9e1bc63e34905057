//! `cfmmr soak`: drives for hours and checks the drift of the NIS and the growth of memory.

use super::arguments::{AxlesArg, JsonArgs, WorldChoice};
use crate::experiments::result::Provenance;
use crate::experiments::run::place::BoardPlace;
use crate::experiments::soak;
use crate::experiments::soak::{
    Drift, MAX_MEMORY_GROWTH_KIB, MAX_RELATIVE_ERROR_M, MAX_RELATIVE_ERROR_RAD, MIN_TREND_TICKS,
    SoakReport, Window,
};
use clap::Args;
use host_sim::base::error::Error;
use host_sim::base::numbers::whole;
use host_sim::base::statistics::NIS_EXPECTED;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::scenario::own;
use host_sim::scenario::own::Own;
use output::progress::Progress;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::interrupt::watch_for_interrupt;
use remote::virtual_robot::report::BoardReport;
use remote::virtual_robot::{Options, VirtualRobot};
use serde::Serialize;
use std::fmt::Write;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

/// Arguments of `soak`.
#[derive(Clone, Debug, Args)]
pub struct SoakArgs {
    /// Option that selects the world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Option that sets the number of axles.
    #[command(flatten)]
    pub axles: AxlesArg,
    /// Drive for this number of ticks of 1 ms
    #[arg(long, default_value_t = 10_000_000, value_parser = whole::<u64>(10_000..=4_000_000_000))]
    pub ticks: u64,
    /// Run on boards in-process, or virtual (images on virtual boards, built if needed)
    #[arg(long, value_name = "PLACE", default_value = "in-process", value_parser = BoardPlace::parse)]
    pub on: BoardPlace,
    /// Use this seed for all random draws; equal seeds give identical output
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
}

/// Number of time windows in the report.
const WINDOWS: u64 = 10;

/// Content of the JSON file: the soak and the boards' reports.
#[derive(Clone, Debug, Serialize)]
struct Measured {
    #[serde(flatten)]
    report: SoakReport,
    /// Simulated time divided by wall-clock time.
    real_time_factor: f64,
    /// Reports of virtual boards.
    boards: Vec<BoardReport>,
    problems: Vec<String>,
}

/// Row of a time window in the report's table.
fn row(window: &Window) -> String {
    let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.2}"));
    let error = window.position_m.map(|error| 1e2 * error);
    format!(
        "| {} | {:.3} | {} of {} | {} | {} | {:.1} | {:.1} | {:.2} | {:.2} | {} | {} | {} |\n",
        window.end,
        window.nis,
        window.gated,
        window.innovations,
        number(window.nees),
        number(error),
        1e2 * window.sigma_m,
        window.sigma_rad.to_degrees(),
        1e3 * window.relative_m,
        1e3 * window.relative_rad,
        window.reached,
        window.missed,
        window
            .resident_kib
            .map_or(String::new(), |kib| kib.to_string()),
    )
}

/// Report as Markdown.
fn markdown(measured: &Measured, scenario: &Scenario) -> String {
    let report = &measured.report;
    let (command, boards) = match measured.boards.is_empty() {
        true => (
            "> docs/soak.md",
            "The boards run in the program without a restart",
        ),
        false => (
            "--on virtual",
            "The boards are virtual and run without a restart",
        ),
    };
    let window = report
        .windows
        .first()
        .map_or(report.ticks, |window| window.end);
    let mut text = format!(
        "# Soak\n\n\
         Printed by `cfmmr soak --ticks {} {command}`. {:.2} hours of robot time ({} ticks) from goal to\n\
         goal in a square of 3 m, with all sensors and noise. World: {} (`bus.loss` = {}).\n\
         {boards}. Position is by dead reckoning only.\n\n\
         - *ticks*: each row is a window of {window} ticks that ends at this tick. *missed*: goals not reached in the window.\n\
         - *σ*: largest estimated standard deviation of position and heading.\n\
         - *error*: position error at the goals, rms. *pair*: error of the relative posture of the axles, rms.\n\
         - *NEES*: normalised square of the error, expected 3. *NIS*: of the beam's innovation, expected {NIS_EXPECTED}.\n\
           Successive values are correlated.\n\
         - *memory*: resident memory of the process with the pages of the program file, so the value differs between\n\
           builds and machines. The limit is on its growth.\n\n\
         | ticks | NIS | gated | NEES | error (cm) | σ (cm) | σ (°) | pair (mm) | pair (mrad) | goals reached | missed | memory (KiB) |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|\n",
        report.ticks,
        soak::seconds(report.ticks) / 3600.0,
        report.ticks,
        scenario.world.label() + &own::title(&scenario.own.names()),
        scenario.world.bus.loss,
    );
    for window in &report.windows {
        text += &row(window);
    }
    if let Some(Drift { mean, gain, error }) = report.nis {
        let _ = writeln!(
            text,
            "\nNIS: mean {mean:.3}; least-squares trend {gain:.3} ± {error:.3} over the run."
        );
    }
    for board in &measured.boards {
        let _ = writeln!(
            text,
            "\n{} board: longest tick {} µs, missed {}, load {:.0} %, findings {}, resets {}.",
            board.name,
            board.longest_tick_us,
            board.missed_ticks,
            100.0 * board.load,
            board.findings.len(),
            board.resets.len()
        );
    }
    let faults: Vec<String> = report
        .faults
        .iter()
        .map(|(reason, count)| format!("{reason}: {count}"))
        .collect();
    let faults = match faults.is_empty() {
        true => "none".to_owned(),
        false => faults.join(", "),
    };
    let _ = writeln!(
        text,
        "\nStops for a fault: {faults}. Speed: {:.1} times real time.",
        measured.real_time_factor
    );
    text += &verdict(report.ticks, &measured.problems);
    text
}

/// Verdict below the report's table: the limits that hold, or the failures.
fn verdict(ticks: u64, problems: &[String]) -> String {
    let trend = match ticks >= MIN_TREND_TICKS {
        true => "The NIS does not rise by more than three standard errors and a tenth of its mean; a fall is\n\
                 allowed, because the filter learns the robot's constants."
            .to_owned(),
        false => format!("The trend of the NIS is checked from {MIN_TREND_TICKS} ticks on."),
    };
    match problems {
        [] => format!(
            "{trend}\n\
             The rms error of the relative posture stays within {} mm and {} mrad. Memory grows by at most {MAX_MEMORY_GROWTH_KIB} KiB after the first window.\n",
            1e3 * MAX_RELATIVE_ERROR_M,
            1e3 * MAX_RELATIVE_ERROR_RAD
        ),
        problems => format!("Failed: {}.\n", problems.join("; ")),
    }
}

/// Runs `cfmmr soak`.
pub fn run(args: &SoakArgs, own: &Own) -> Result<(), Error> {
    let json = args.json.open()?;
    if !args.ticks.is_multiple_of(10) {
        return Err(Error::input(format!(
            "--ticks {}: must be a multiple of 10, the ticks of an epoch",
            args.ticks
        )));
    }
    if matches!(args.on, BoardPlace::Serial(_)) {
        return Err(Error::input(
            "--on: must be in-process or virtual: a soak compares estimates with the true posture",
        ));
    }
    let in_process = args.on == BoardPlace::InProcess;
    if !in_process {
        own.check_outside("--on virtual")?;
    }
    let mut scenario = soak::scenario(
        args.choice.world.as_deref(),
        &args.axles.changes(&[])?,
        in_process,
    )?;
    own.check_axles(scenario.robot.topology())?;
    scenario.own = own.clone();
    let interrupt = watch_for_interrupt()?;
    let progress = Progress::new(soak::pieces(), "soak");
    let started = Instant::now();
    let mut advance = || {
        progress.advance();
        !interrupt.load(Relaxed)
    };
    let run = (args.ticks, WINDOWS, args.seed);
    let (report, boards) = if in_process {
        let mut robot = Simulation::new(&scenario, args.seed, 0)?;
        let report = soak::run(&mut robot, &scenario, run, &mut advance)?;
        (report, Vec::new())
    } else {
        let images = Images::open(None, None)?;
        let logs = BoardLog::of_boards(scenario.robot.topology());
        let options = Options {
            threads: Options::threads(),
            ..Options::default()
        };
        let mut robot = VirtualRobot::new(&scenario, &images, args.seed, 0, &options, &logs)?;
        let report = soak::run(&mut robot, &scenario, run, &mut advance)?;
        (report, robot.reports())
    };
    drop(progress);
    let of_boards = boards.iter().filter_map(|board| board.problem(false));
    let measured = Measured {
        real_time_factor: soak::seconds(report.ticks) / started.elapsed().as_secs_f64(),
        problems: report.problems().into_iter().chain(of_boards).collect(),
        report,
        boards,
    };
    json.write(&Provenance::of(&scenario, args.seed), &measured)?;
    let printed = json.print_page(&markdown(&measured, &scenario));
    match measured.problems.as_slice() {
        _ if interrupt.load(Relaxed) => Err(Error::Interrupted(
            "interrupted: the table ends at the interrupt".to_owned(),
        )),
        [] => printed,
        problems => Err(Error::Failure(problems.join("; "))),
    }
}
