//! Boards behind links, virtual or real, each with its samples from this program; boards without a link run in this program.

use super::links::{DEFAULT_FLASH, Links};
use super::place::Site;
use super::{BoardsReport, Run, happenings};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::bit_compare::{Difference, Trace};
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::recovery::{PAUSE, Status};
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets;
use host_sim::targets::{Event, InProcess, Report as BoardReport, Target, What};
use output::table::Table;
use remote::Remote;
use remote::board_log;
use remote::board_log::BoardLog;
use serde::Serialize;
use std::path::PathBuf;

/// What is done with the boards beside the run.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// True if the parameters in the boards' flash are laid over those of the scenario.
    pub stored: bool,
    /// Folder of the files with the stores of virtual boards.
    pub flash: Option<PathBuf>,
    /// True if the nodes run in this program too, and every bit is compared.
    pub compare: bool,
}

/// What is known of the boards after the run.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Report {
    /// True if every bit equals the run in process; `None` without a comparison.
    identical: Option<bool>,
    /// First difference.
    difference: Option<String>,
    /// Ticks of the run.
    ticks: usize,
    /// Time the run took, s: from the first tick to the last.
    wall_s: f64,
    /// The boards.
    boards: Vec<BoardReport>,
    /// Boards lost and restarted.
    events: Vec<Event>,
    /// Heartbeats: the first of each node, and every change of state.
    nodes: Vec<Status>,
    /// Ticks that began more than a tick late, when pace was to be kept.
    late_ticks: Option<u32>,
}

/// Carries out a task, and publishes the result.
pub fn run(mut run: Run, site: &Site, options: &Options) -> Result<(), Error> {
    run.plan
        .check(&run.scenario, run.mission.limit_s(&run.scenario))?;
    run.watch.check()?;
    let logs = Role::ALL.map(|_| BoardLog::default());
    let report = connect(site, options, &mut run.scenario, &logs)
        .and_then(|targets| on(&run, targets, options.compare));
    let mut report = board_log::kept(report, &logs, || run.context.output())?;
    report.boards.files.extend(board_log::files(&logs));
    report.publish(&run)
}

/// The boards of a place. What they keep is laid over the scenario, if that is wanted.
fn connect(
    site: &Site,
    options: &Options,
    scenario: &mut Scenario,
    logs: &[BoardLog; 3],
) -> Result<[Box<dyn Target>; 3], Error> {
    let kept = options.stored.then(|| PathBuf::from(DEFAULT_FLASH));
    let flash = options.flash.clone().or(kept);
    let links = Links::new(&site.place, site.baud, flash)?;
    let mut board = |role: Role| -> Result<Box<dyn Target>, Error> {
        let link = match scenario.mission.rps || role != Role::Beam {
            true => links.open(role, &logs[role as usize])?,
            false => None,
        };
        let Some(link) = link else {
            return Ok(Box::new(InProcess::new(role)));
        };
        let mut remote = Remote::new(role, link);
        if options.stored {
            remote.greet()?;
            scenario.boards.put(role, &remote.own_parameters()?);
        }
        Ok(Box::new(remote))
    };
    let targets = [board(Role::Front)?, board(Role::Rear)?, board(Role::Beam)?];
    scenario.check()?;
    Ok(targets)
}

/// The run on these boards, and again in this program if that is to be compared.
fn on(run: &Run, targets: [Box<dyn Target>; 3], compare: bool) -> Result<super::Report, Error> {
    let Run {
        context,
        mission,
        scenario,
        plan,
        ..
    } = run;
    let simulation = |targets: [Box<dyn Target>; 3]| -> Result<Simulation, Error> {
        let mut simulation = Simulation::on(targets, scenario, context.seed, 0)?;
        simulation
            .boards()
            .plan(plan.failures.clone(), plan.restart_after);
        if plan.restart_after.is_some() {
            simulation.recover();
        }
        simulation.record_trace();
        Ok(simulation)
    };
    run.on(
        |stage| simulation(stage.tap(targets)),
        |robot, driven| {
            let trace = robot.take_trace().unwrap_or_default();
            let difference = match compare {
                true => {
                    let mut reference = simulation(targets::in_process())?;
                    reference.control_mut().span = plan.span;
                    reference.control_mut().interrupt = Some(context.workers.interrupt().clone());
                    mission.drive(&mut reference, scenario)?;
                    Some(trace.difference(&reference.take_trace().unwrap_or_default()))
                }
                false => None,
            };
            let values = report(robot, &trace, driven.wall_s, difference.as_ref());
            let mut report = BoardsReport::new(&values, summary(&values))?;
            let excess = values.boards.iter().find_map(BoardReport::stack_excess);
            let different = difference.flatten();
            let different = different.map(|difference| format!("not identical: {difference}"));
            report.problem = excess.or(different);
            Ok(report)
        },
    )
}

fn report(
    simulation: &mut Simulation,
    trace: &Trace,
    wall_s: f64,
    difference: Option<&Option<Difference>>,
) -> Report {
    Report {
        identical: difference.map(Option::is_none),
        difference: difference
            .and_then(Option::as_ref)
            .map(Difference::to_string),
        ticks: trace.ticks(),
        wall_s,
        events: simulation.boards().events().to_vec(),
        boards: simulation.boards().reports(),
        nodes: simulation.monitor().changes().to_vec(),
        late_ticks: simulation
            .control()
            .pace
            .as_ref()
            .map(RealTimeLimiter::late),
    }
}

/// Summary of the boards.
fn summary(report: &Report) -> String {
    let mut table = Table::new([
        "board",
        "where",
        "image",
        "frames",
        "lost",
        "bytes a tick",
        "mean (µs)",
        "99 % (µs)",
        "max (µs)",
        "stack (bytes)",
    ]);
    for board in &report.boards {
        let mut row = vec![
            board.role.to_owned(),
            board.target.to_owned(),
            board.build.clone(),
            board.frames.to_string(),
            board.lost.to_string(),
            format!(
                "{:.0} + {:.0}",
                board.sent_per_tick, board.received_per_tick
            ),
        ];
        match &board.latency {
            Some(latency) => row.extend([
                format!("{:.0}", latency.mean_us),
                latency.p99_us.to_string(),
                latency.max_us.to_string(),
            ]),
            None => row.extend([const { String::new() }; 3]),
        }
        if let Some(stack) = &board.stack {
            row.push(format!("{} of {}", stack.used_bytes, stack.budget_bytes));
        }
        table.row(row);
    }
    let table = table.transposed();
    let simulated = report.ticks as f64 * 1e-3;
    let mut text = format!(
        "{table}\nlost: requests repeated; bytes: sent + received; times: from a tick to its answer, other\n\
         boards' included; stack: most used since the latest start, of its budget\n\n\
         {} ticks ({simulated:.1} s) in {:.1} s\n",
        report.ticks, report.wall_s
    );
    text += &happenings(report.late_ticks, &report.events, &report.nodes);
    if report
        .events
        .iter()
        .any(|event| event.what == What::Cleared)
    {
        let pause = f64::from(PAUSE) * 1e-3;
        text += &format!(
            "after a restart the host waited {pause} s, cleared the faults and repeated the task;\n\
             without the host the robot stays at rest\n"
        );
    }
    match (&report.difference, report.identical) {
        (Some(difference), _) => text += &format!("NOT identical: {difference}\n"),
        (None, Some(_)) => text += &format!("identical over {} ticks\n", report.ticks),
        (None, None) => {}
    }
    text
}
