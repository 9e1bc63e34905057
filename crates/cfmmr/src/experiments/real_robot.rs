//! `posture`, `follow` and `track` with `--on serial:front=PORT`: a real robot, which gets its task at the serial port of
//! its front board. Its true posture is not known: errors are those of its own estimate.

use crate::experiments::Context;
use crate::experiments::arguments::LogArgs;
use crate::experiments::arguments::{Place as Boards, RobotArgs};
use crate::experiments::driven;
use crate::experiments::mission::{Mission, Outcome, Plan};
use crate::experiments::recorder;
use crate::experiments::recorder::Stage;
use core_algos::math::Posture;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::run::end::{Ended, RunEnd};
use host_sim::run::final_error::FinalError;
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::run::script::StepEnd;
use output::table::Table;
use recording::csv;
use remote::link::Link;
use remote::serial::Serial;
use remote::serial_robot::{Connect, OtherBoard, SerialRobot};
use serde::Serialize;
use std::path::Path;

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

/// Runs the task of a command.
pub fn run(
    context: &Context,
    mission: &Mission,
    (log, args): (&LogArgs, &RobotArgs),
) -> Result<(), Error> {
    args.refuse_of_virtual_boards()?;
    context.check_mission_keys()?;
    let plan = Plan::new(&args.plan, 0.0)?;
    recorder::check(log)?;
    let Boards::Serial([Some(front), rear, beam]) = &args.boards.on else {
        return Err(Error::input(
            "--on serial: must be serial:front=PORT[,rear=PORT][,beam=PORT]: the front board's port is that of the \
             robot; the other boards are recorded at theirs",
        ));
    };
    let others = [(Role::Rear, rear), (Role::Beam, beam)];
    if others.iter().any(|(_, port)| port.is_some()) && !log.any() {
        return Err(Error::input(
            "--on serial: rear=PORT, beam=PORT: only with --log, --csv or --live, which record those boards",
        ));
    }
    let (path, baud) = (front.clone(), args.boards.baud);
    let open = move |role: Role, path: &Path| {
        let port = Serial::open(path, baud);
        let named = |error| Error::input(format!("--on serial:{}={error}", role.name()));
        port.map(|port| Box::new(port) as Box<dyn Link>)
            .map_err(named)
    };
    // Opened before the log: a port that is not there is bad input.
    let mut first = Some(open(Role::Front, &path)?);
    let connect: Connect = Box::new(move || match first.take() {
        Some(port) => Ok(port),
        None => open(Role::Front, &path),
    });
    let others = others
        .into_iter()
        .filter_map(|(role, path)| Some((role, path.as_ref()?)));
    let others = others.map(|(role, path)| Ok(OtherBoard::new(role, open(role, path)?)));
    let others = others.collect::<Result<Vec<_>, Error>>()?;
    let scenario = mission.scenario(context);
    let [x, y, phi] = scenario.mission.start.map(|value| value as f32);
    let told = scenario.mission.told();
    let place = scenario.robot.put_down(Posture::new(x, y, phi), &told);
    let (goal, path) = mission.goal(&scenario);
    let mut stage = Stage::begin(log, context, &scenario, (goal, &path))?;
    stage.span = plan.span;
    mission.prepare(&mut stage);
    // Time is the computer's.
    stage.real_time = false;
    let record = log.any().then_some((&scenario, others));
    let opened = SerialRobot::open(connect, mission.is_placed().then_some(place), record);
    let mut robot = match opened {
        Err(Error::NoAnswer(why)) => return no_answer(context, why),
        opened => opened?,
    };
    let driven = stage.run(&mut robot, |robot| mission.drive(robot, &scenario))?;
    let report = report(&robot, &driven, goal);
    publish(context, &report, &driven, goal)
}

/// Result of a robot that never answered.
fn no_answer(context: &Context, why: String) -> Result<(), Error> {
    #[derive(Serialize)]
    struct Report<'a> {
        end: &'a RunEnd,
    }
    let end = RunEnd::no_answer(why);
    let mut files = context.output()?;
    files.csv("ends.csv", csv::of_ends([&end]));
    let text = format!("end: {}\n", end.text());
    context.finish(&text, &Report { end: &end }, files, &[], end.failure())
}

fn publish(
    context: &Context,
    report: &Report,
    driven: &recorder::Driven<Outcome>,
    goal: [f64; 3],
) -> Result<(), Error> {
    let mut files = context.output()?;
    let outcome = &driven.outcome;
    let restless = report.restless.clone();
    let failed = outcome.failure().or(restless);
    let commanded = match outcome {
        Outcome::Script(driven) => driven.goal(),
        _ => Some(goal),
    };
    let end = (&report.end, commanded);
    let rows = driven::summary(&report.steps);
    let ends = match report.steps.is_empty() {
        true => csv::of_ends([&report.end]),
        false => driven::csv_of(&report.steps),
    };
    files.csv("ends.csv", ends);
    driven::draw(
        context,
        &mut files,
        &outcome.records(),
        end,
        context.name.clone(),
        rows,
    );
    context.finish(&table(report), report, files, &driven.recorded, failed)
}

fn report(robot: &SerialRobot, driven: &recorder::Driven<Outcome>, goal: [f64; 3]) -> Report {
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
        Outcome::Script(driven) => driven.steps.clone(),
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
        false => format!("{}\n{table}\n", driven::table(&report.steps)),
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
