//! A real robot, which gets its task at the serial port of its front board. Its true posture is not known: errors are those
//! of its own estimate.

use super::links::open_port;
use super::mission::Outcome;
use super::stage::Driven;
use super::{BoardsReport, Run, no_answer, steps};
use core_algos::math::Posture;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::end::{Ended, RunEnd};
use host_sim::run::final_error::FinalError;
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::run::script::StepEnd;
use output::table::Table;
use remote::serial_robot::{Connect, OtherBoard, SerialRobot};
use serde::Serialize;
use std::path::PathBuf;

/// Result.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Report {
    /// Build of the front board's image.
    build: String,
    /// End of the run.
    end: RunEnd,
    /// Why the robot did not confirm that it stopped, if so.
    restless: Option<String>,
    /// Time of all steps, s.
    duration_s: f64,
    /// Distance of the estimated midpoint from the goal, m.
    e_estimated_m: f64,
    /// Estimated heading less that of the goal, rad.
    heading_estimated_rad: f64,
    /// Largest distance of the estimated midpoint from the path, m.
    max_cross_track_m: Option<f64>,
    /// Bus frames that the front board reported, and those that it had no room for.
    frames: u64,
    /// Lost frames.
    lost: u16,
    /// Times the port was opened again.
    reconnected: u32,
    /// Heartbeats: every change of state.
    nodes: Vec<Status>,
    /// Steps of a script.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    steps: Vec<StepEnd>,
}

/// Carries out a task, and publishes the result.
pub fn run(run: &Run, ports: &[Option<PathBuf>; 3], baud: u32) -> Result<(), Error> {
    let Run {
        mission,
        scenario,
        watch,
        ..
    } = run;
    watch.check()?;
    // Opened before the recording: a port that is not there is bad input.
    let (connect, others) = open(ports, baud, watch.records())?;
    let [x, y, phi] = scenario.mission.start.map(|value| value as f32);
    let told = scenario.mission.told();
    let place = scenario.robot.put_down(Posture::new(x, y, phi), &told);
    let place = mission.is_placed().then_some(place);
    let record = watch.records().then_some((scenario, others));
    let report = run.on(
        |_| SerialRobot::open(connect, place, record),
        |robot, driven| {
            let values = report(robot, driven, mission.goal(scenario).0);
            let mut report = BoardsReport::new(&values, table(&values))?;
            report.estimated = true;
            Ok(report)
        },
    );
    match report {
        Err(Error::NoAnswer(why)) => no_answer(run.context, why),
        report => report?.publish(run),
    }
}

/// The port of the front board, and those of the boards that are recorded.
fn open(
    ports: &[Option<PathBuf>; 3],
    baud: u32,
    records: bool,
) -> Result<(Connect, Vec<OtherBoard>), Error> {
    let [Some(front), rear, beam] = ports else {
        return Err(Error::input(
            "--on serial: must be serial:front=PORT[,rear=PORT][,beam=PORT]: the front board's port is that of the \
             robot; the other boards are recorded at theirs",
        ));
    };
    let others = [(Role::Rear, rear), (Role::Beam, beam)];
    if others.iter().any(|(_, port)| port.is_some()) && !records {
        return Err(Error::input(
            "--on serial: rear=PORT, beam=PORT: only with --log, --csv or --live, which record those boards",
        ));
    }
    let path = front.clone();
    let mut first = Some(open_port(Role::Front, &path, baud)?);
    let connect: Connect = Box::new(move || match first.take() {
        Some(port) => Ok(port),
        None => open_port(Role::Front, &path, baud),
    });
    let others = others
        .into_iter()
        .filter_map(|(role, path)| Some((role, path.as_ref()?)));
    let others = others.map(|(role, path)| Ok(OtherBoard::new(role, open_port(role, path, baud)?)));
    Ok((connect, others.collect::<Result<_, Error>>()?))
}

fn report(robot: &SerialRobot, driven: &Driven<Outcome>, goal: [f64; 3]) -> Report {
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
        Outcome::Script(steps) => steps.steps.clone(),
        _ => Vec::new(),
    };
    Report {
        build: robot.build().to_owned(),
        end: outcome.end(),
        restless: driven.restless.clone(),
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

fn table(report: &Report) -> String {
    let mut table = Table::new(["robot at its front board", ""]);
    let mut row = |name: &str, value: String| {
        table.row([name.to_owned(), value]);
    };
    row("build", report.build.clone());
    row("end", report.end.text());
    if report.e_estimated_m.is_finite() {
        row(
            "estimate less goal",
            format!(
                "{:.1} cm, {:.2}°",
                100.0 * report.e_estimated_m,
                report.heading_estimated_rad.to_degrees()
            ),
        );
    }
    if !report.end.notices.is_empty() {
        row("notices", report.end.notice_names().join(", "));
    }
    if let Some(distance) = report.max_cross_track_m {
        row(
            "largest estimated distance from the path",
            format!("{:.1} mm", 1e3 * distance),
        );
    }
    row(
        "bus frames",
        format!("{} reported, {} lost", report.frames, report.lost),
    );
    let mut text = match report.steps.is_empty() {
        true => format!("{table}\n"),
        false => format!("{}\n{table}\n", steps::table(&report.steps)),
    };
    let role = Role::Front.name();
    if report.lost > 0 {
        text += &format!("the {role} board had no room for {} frames\n", report.lost);
    }
    if report.reconnected > 0 {
        text += &format!(
            "its serial port was opened again, times: {}\n",
            report.reconnected
        );
    }
    text
}
