//! Real robot, commanded through the serial port of its front board. The true posture is unknown, so errors are
//! computed from the robot's estimate.

use super::links::open_port;
use super::mission::Outcome;
use super::picture::draw;
use super::place::Site;
use super::stage::Driven;
use super::{Run, failure, steps};
use crate::experiments::Context;
use core_algos::math::Posture;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::run::end::{Ended, RunEnd};
use host_sim::run::final_error::FinalError;
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::run::script::StepEnd;
use output::table::Table;
use recording::csv;
use remote::serial_robot::{Connect, OtherBoard, SerialRobot};
use serde::Serialize;

/// JSON report on a real robot, whose true posture is unknown.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct RealRobotValues {
    /// Build of the front board's image.
    build: String,
    end: RunEnd,
    /// Reason if the robot did not confirm that it stopped.
    #[serde(rename = "restless")]
    stop_error: Option<String>,
    /// Time of all steps, s.
    duration_s: f64,
    /// Distance of the estimated midpoint from the goal, m.
    e_estimated_m: f64,
    /// Estimated heading less goal heading, rad.
    heading_estimated_rad: f64,
    /// Largest distance of the estimated midpoint from the path, m.
    max_cross_track_m: Option<f64>,
    /// Bus frames reported by the front board.
    frames: u64,
    /// Bus frames lost because the front board's buffer was full.
    lost: u16,
    /// Number of times the port was reopened.
    reconnected: u32,
    /// Heartbeats at each change of a node's state.
    nodes: Vec<Status>,
    /// Executed steps of a script; empty for other missions.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    steps: Vec<StepEnd>,
}

/// Drives the mission with the real robot and publishes the report.
pub(super) fn run(run: &Run, site: &Site) -> Result<(), Error> {
    let Run {
        context,
        mission,
        outputs,
        ..
    } = run;
    let scenario = &context.scenario;
    let robot = scenario.robot.topology();
    // Ports are opened before the recording begins: a missing port is an input error.
    let (connect, others) = open(robot, site, outputs.records())?;
    let [x, y, phi] = scenario.mission.start.map(|value| value as f32);
    let configured = scenario.mission.configured_placement();
    let start = scenario
        .robot
        .placement(Posture::new(x, y, phi), &configured);
    let start = mission.is_placed().then_some(start);
    let record = outputs.records().then_some((scenario, others));
    match run.on(|_| SerialRobot::open(robot, connect, start, record)) {
        Ok((robot, driven)) => publish(run, &robot, &driven),
        Err(Error::NoAnswer(why)) => no_answer(context, why),
        Err(error) => Err(error),
    }
}

/// Opens the port of the front board, and the ports of the other recorded boards.
fn open(robot: Topology, site: &Site, records: bool) -> Result<(Connect, Vec<OtherBoard>), Error> {
    let (place, baud) = (&site.place, site.baud);
    place.check(robot)?;
    let Some(front) = place.port(robot, Role::LEAD) else {
        return Err(Error::input(
            "--on serial: must be serial:front=PORT[,rear=PORT][,beam=PORT]: the front board's port commands the \
             robot; the other ports only record",
        ));
    };
    let others = robot.boards().filter(|role| *role != Role::LEAD);
    let others = others.filter_map(|role| Some((role, place.port(robot, role)?)));
    if others.clone().next().is_some() && !records {
        return Err(Error::input(
            "--on serial: rear=PORT, beam=PORT: only with --log, --csv or --live, which record those boards",
        ));
    }
    let path = front.to_owned();
    let name = robot.name(Role::LEAD);
    let mut first = Some(open_port(name, &path, baud)?);
    let connect: Connect = Box::new(move || match first.take() {
        Some(port) => Ok(port),
        None => open_port(name, &path, baud),
    });
    let others = others.map(|(role, path)| {
        let port = open_port(robot.name(role), path, baud)?;
        Ok(OtherBoard::new(robot, role, port))
    });
    Ok((connect, others.collect::<Result<_, Error>>()?))
}

/// Writes and prints the report, with errors computed from the robot's estimates.
fn publish(run: &Run, robot: &SerialRobot, driven: &Driven<Outcome>) -> Result<(), Error> {
    let Run {
        context, mission, ..
    } = run;
    let outcome = &driven.outcome;
    let (goal, _) = mission.goal(&context.scenario);
    let values = values(robot, driven, goal);
    let shown = match outcome {
        Outcome::Script(steps) => steps.goal(),
        _ => Some(goal),
    };
    let ends = match values.steps.is_empty() {
        true => csv::of_ends([&values.end]),
        false => steps::csv_of(&values.steps),
    };
    let mut files = context.output()?;
    files.csv("ends.csv", ends);
    let end = (&values.end, shown);
    let rows = steps::summary(&values.steps);
    let title = context.name.clone();
    draw(context, &mut files, &outcome.records(), end, title, rows);
    let failed = failure(driven, None);
    context.finish(&table(&values), &values, files, &driven.recorded, failed)
}

/// Publishes the end of a run in which the robot never answered.
fn no_answer(context: &Context, why: String) -> Result<(), Error> {
    #[derive(Serialize)]
    struct NoAnswerValues<'a> {
        end: &'a RunEnd,
    }
    let end = RunEnd::no_answer(why);
    let mut files = context.output()?;
    files.csv("ends.csv", csv::of_ends([&end]));
    let text = format!("end: {}\n", end.text());
    context.finish(
        &text,
        &NoAnswerValues { end: &end },
        files,
        &[],
        end.failure(),
    )
}

fn values(robot: &SerialRobot, driven: &Driven<Outcome>, goal: [f64; 3]) -> RealRobotValues {
    let outcome = &driven.outcome;
    let fused = robot.record().lead.fused.robot;
    let at = fused.posture;
    let estimate = [at.x, at.y, at.phi].map(f64::from);
    let error = FinalError::of(estimate, goal);
    let path = match outcome {
        Outcome::Posture(_) | Outcome::Script(_) => None,
        Outcome::Path(outcome, _) => Some(outcome.estimate.max_cross_track_m),
    };
    let steps = match outcome {
        Outcome::Script(steps) => steps.ends.clone(),
        _ => Vec::new(),
    };
    RealRobotValues {
        build: robot.build().to_owned(),
        end: outcome.end(),
        stop_error: driven.stop_error.clone(),
        duration_s: outcome.duration_s(),
        e_estimated_m: error.e_m,
        heading_estimated_rad: error.heading_rad,
        max_cross_track_m: path,
        frames: robot.bus().sent,
        lost: robot.lost(),
        reconnected: robot.reconnected(),
        nodes: robot.monitor().changes().to_vec(),
        steps,
    }
}

fn table(values: &RealRobotValues) -> String {
    let mut table = Table::new(["real robot", ""]);
    let mut row = |name: &str, value: String| {
        table.row([name.to_owned(), value]);
    };
    row("build", values.build.clone());
    row("end", values.end.text());
    if values.e_estimated_m.is_finite() {
        row(
            "estimate less goal",
            format!(
                "{:.1} cm, {:.2}°",
                100.0 * values.e_estimated_m,
                values.heading_estimated_rad.to_degrees()
            ),
        );
    }
    if !values.end.notices.is_empty() {
        row("notices", values.end.notice_names().join(", "));
    }
    if let Some(distance) = values.max_cross_track_m {
        row(
            "largest estimated distance from the path",
            format!("{:.1} mm", 1e3 * distance),
        );
    }
    row(
        "bus frames",
        format!("{} reported, {} lost", values.frames, values.lost),
    );
    let mut text = match values.steps.is_empty() {
        true => format!("{table}\n"),
        false => format!("{}\n{table}\n", steps::table(&values.steps)),
    };
    if values.lost > 0 {
        text += &format!(
            "the front board's buffer was full: {} frames are lost\n",
            values.lost
        );
    }
    if values.reconnected > 0 {
        text += &format!(
            "the front board's port was reopened, times: {}\n",
            values.reconnected
        );
    }
    text
}
