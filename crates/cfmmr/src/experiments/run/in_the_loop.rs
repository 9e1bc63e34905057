//! Boards in the loop: this program simulates the sensors of virtual or real boards behind links, and runs the nodes of
//! boards without a link.

use super::links::{DEFAULT_FLASH, Links};
use super::mission::Outcome;
use super::place::BoardPlace;
use super::stage::Driven;
use super::{BoardValues, Boards, Run, events_text};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::bit_compare::{Difference, Trace};
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::recovery::{CHECK_DELAY_TICKS, Status};
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets;
use host_sim::targets::{Event, EventKind, InProcess, Target, TargetReport as BoardReport};
use output::table::Table;
use remote::Remote;
use remote::board_log;
use remote::board_log::BoardLog;
use serde::Serialize;
use std::path::PathBuf;

/// Use of the parameters in the boards' flash.
#[derive(Clone, Debug, Default)]
pub struct BoardUse {
    /// True if the parameters in the boards' flash replace the scenario's parameters.
    pub stored: bool,
    /// Folder of the flash files of virtual boards.
    pub flash: Option<PathBuf>,
}

/// Values of the boards in the result of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct InTheLoopValues {
    /// True if every output equals that of the in-process run; `None` without a comparison.
    identical: Option<bool>,
    /// First difference from the nodes in this program; `None` if identical or not compared.
    difference: Option<String>,
    /// Ticks of the run.
    ticks: usize,
    /// Wall-clock time from the first tick to the last, s.
    wall_s: f64,
    boards: Vec<BoardReport>,
    /// Boards lost and restarted.
    events: Vec<Event>,
    /// Heartbeats: the first of each node, and every change of state.
    nodes: Vec<Status>,
    /// Number of ticks that began more than one tick late, in a run in real time.
    late_ticks: Option<u32>,
}

/// Drives the mission with the given boards and publishes the result.
pub fn run(
    run: &Run,
    targets: Vec<Box<dyn Target>>,
    logs: &[BoardLog],
    compare: bool,
) -> Result<(), Error> {
    let output = || run.context.output();
    let (driven, mut boards) =
        board_log::keep_logs_on_error(drive(run, targets, compare), logs, output)?;
    boards.files.extend(board_log::files(logs));
    run.publish(driven, boards)
}

/// Connects to virtual or real boards; boards without a link run in this program. With `stored`, the boards' own
/// parameters are written into the scenario.
pub fn connect(
    (place, baud): (&BoardPlace, u32),
    boards: &BoardUse,
    scenario: &mut Scenario,
    logs: &[BoardLog],
) -> Result<Vec<Box<dyn Target>>, Error> {
    let kept = boards.stored.then(|| PathBuf::from(DEFAULT_FLASH));
    let flash = boards.flash.clone().or(kept);
    let robot = scenario.robot.topology();
    let links = Links::new(robot, place, baud, flash)?;
    let mut board = |role: Role| -> Result<Box<dyn Target>, Error> {
        let link = match scenario.mission.rps || !role.is_beam() {
            true => links.open(role, &logs[robot.place(role)])?,
            false => None,
        };
        let Some(link) = link else {
            return Ok(Box::new(InProcess::new(robot, role)));
        };
        let mut remote = Remote::new(robot, role, link);
        if boards.stored {
            remote.start_session()?;
            scenario.boards.put(role, &remote.own_parameters()?);
        }
        Ok(Box::new(remote))
    };
    let targets = robot.boards().map(&mut board);
    let targets = targets.collect::<Result<Vec<_>, _>>()?;
    scenario.check()?;
    Ok(targets)
}

/// Drives the mission on the boards; with `compare`, repeats the run in this program and compares.
fn drive(
    run: &Run,
    targets: Vec<Box<dyn Target>>,
    compare: bool,
) -> Result<(Driven<Outcome>, Boards), Error> {
    let Run {
        context,
        mission,
        plan,
        ..
    } = run;
    let scenario = &context.scenario;
    let simulation = |targets: Vec<Box<dyn Target>>| -> Result<Simulation, Error> {
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
    let (mut robot, driven) = run.on(|stage| simulation(stage.tap(targets)))?;
    let topology = scenario.robot.topology();
    let trace = robot.take_trace().unwrap_or_else(|| Trace::new(topology));
    let difference = match compare {
        true => {
            let mut reference = simulation(targets::in_process(topology))?;
            let control = reference.control_mut();
            control.span = plan.span;
            control.interrupt = Some(context.workers.interrupt().clone());
            mission.drive(&mut reference, scenario)?;
            let reference = reference.take_trace();
            let reference = reference.unwrap_or_else(|| Trace::new(topology));
            Some(trace.difference(&reference))
        }
        false => None,
    };
    let values = values(&mut robot, &trace, driven.wall_s, difference.as_ref());
    let excess = values.boards.iter().find_map(BoardReport::stack_excess);
    let different = difference.flatten();
    let different = different.map(|difference| format!("not identical: {difference}"));
    let boards = Boards {
        text: summary(&values),
        problem: excess.or(different),
        values: BoardValues::InTheLoop(values),
        ..Boards::default()
    };
    Ok((driven, boards))
}

fn values(
    simulation: &mut Simulation,
    trace: &Trace,
    wall_s: f64,
    difference: Option<&Option<Difference>>,
) -> InTheLoopValues {
    InTheLoopValues {
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

/// Summary of the boards after a run, as text.
fn summary(values: &InTheLoopValues) -> String {
    let mut table = Table::new([
        "board",
        "place",
        "image",
        "frames",
        "lost",
        "bytes a tick",
        "mean (µs)",
        "99 % (µs)",
        "max (µs)",
        "stack (bytes)",
    ]);
    for board in &values.boards {
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
    let simulated = values.ticks as f64 * 1e-3;
    let mut text = format!(
        "{table}\nlost: repeated requests; bytes: sent + received; times: from tick to answer, including other\n\
         boards; stack: largest use since the latest start, of the budget\n\n\
         {} ticks ({simulated:.1} s) in {:.1} s\n",
        values.ticks, values.wall_s
    );
    text += &events_text(values.late_ticks, &values.events, &values.nodes);
    if values
        .events
        .iter()
        .any(|event| event.what == EventKind::Cleared)
    {
        let pause = f64::from(CHECK_DELAY_TICKS) * 1e-3;
        text += &format!(
            "after a restart the host waited {pause} s, cleared the faults and repeated the task;\n\
             without the host the robot stays at rest\n"
        );
    }
    match (&values.difference, values.identical) {
        (Some(difference), _) => text += &format!("NOT identical: {difference}\n"),
        (None, Some(_)) => text += &format!("identical over {} ticks\n", values.ticks),
        (None, None) => {}
    }
    text
}
