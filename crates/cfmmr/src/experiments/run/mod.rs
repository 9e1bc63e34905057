//! A run of the robot: a task that is carried out somewhere, and what comes of it.
//!
//! [`Run`] is a task with its scenario, its bounds and its recording. [`Run::at`] carries it out at a
//! [`Place`](place::Place), and [`Run::on`] by any [`Robot`]. The [`Report`] is the same everywhere;
//! [`Report::publish`] prints it and writes its files.
//!
//! | module | holds |
//! |---|---|
//! | [`place`], [`links`] | where the boards are, and links to them |
//! | [`mission`], [`plan`] | the task; bounds of the run and failures on the way |
//! | [`stage`] | recording and display |
//! | [`in_the_loop`] | boards behind links, each with its samples from this program |
//! | [`virtual_boards`] | the whole robot on virtual boards |
//! | [`real`] | a real robot, by the serial port of its front board |
//! | [`steps`], [`picture`] | tables, files and pictures |

pub mod in_the_loop;
pub mod links;
pub mod mission;
pub mod picture;
pub mod place;
pub mod plan;
pub mod real;
pub mod stage;
pub mod steps;
pub mod virtual_boards;

use crate::experiments::Context;
use core_algos::safety::OperatingState;
use host_sim::base::error::Error;
use host_sim::run::end::{EndKind, Ended, RunEnd};
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets::Event;
use mission::{Mission, Outcome};
use output::files::OutputDir;
use place::{Place, Site};
use plan::Plan;
use recording::csv;
use serde::Serialize;
use serde_json::Value;
use stage::{Driven, Stage, Watch};
use std::path::PathBuf;

/// A task that is about to be carried out.
pub struct Run<'a> {
    /// Command and output folder.
    pub context: &'a Context,
    /// The task.
    pub mission: &'a Mission,
    /// Robot and surroundings.
    pub scenario: Scenario,
    /// Bounds, and failures of boards on the way.
    pub plan: Plan,
    /// Recording and display.
    pub watch: &'a Watch,
}

/// What boards have to say after a run.
#[derive(Debug, Default)]
pub struct BoardsReport {
    /// Values for the result, by name.
    pub values: Value,
    /// Table and sentences.
    pub text: String,
    /// Files by name.
    pub files: Vec<(String, String)>,
    /// Problem that fails the run, if there is one.
    pub problem: Option<String>,
    /// True if the truth is not known, so that the result is that of the estimate, and `values` are all of it.
    pub estimated: bool,
}

impl BoardsReport {
    /// A report of these values.
    fn new(values: &impl Serialize, text: String) -> Result<Self, Error> {
        Ok(Self {
            values: serde_json::to_value(values)
                .map_err(|error| Error::Failure(error.to_string()))?,
            text,
            ..Self::default()
        })
    }
}

/// A run that is over.
pub struct Report {
    outcome: Outcome,
    boards: BoardsReport,
    recorded: Vec<PathBuf>,
    restless: Option<String>,
}

impl<'a> Run<'a> {
    /// A run without bounds and failures, in the scenario that the task makes of the command's.
    pub fn new(context: &'a Context, mission: &'a Mission, watch: &'a Watch) -> Self {
        Self {
            context,
            mission,
            scenario: mission.scenario(&context.scenario),
            plan: Plan::default(),
            watch,
        }
    }

    /// Carries out the task at a place, and publishes the result.
    pub fn at(&self, site: &Site) -> Result<(), Error> {
        match &site.place {
            Place::InProcess => {
                let nothing = |_: &mut Simulation, _: &Driven<Outcome>| Ok(BoardsReport::default());
                self.on(|stage| stage.simulation(), nothing)?.publish(self)
            }
            Place::Virtual => virtual_boards::run(self, site),
            Place::Serial(ports) => real::run(self, ports, site.baud),
        }
    }

    /// Has a robot carry out the task. `open` makes the robot, ready for its task, once the recording has begun; `report`
    /// says what is known of its boards after the run.
    pub fn on<R: Robot>(
        &self,
        open: impl FnOnce(&Stage) -> Result<R, Error>,
        report: impl FnOnce(&mut R, &Driven<Outcome>) -> Result<BoardsReport, Error>,
    ) -> Result<Report, Error> {
        let Self {
            context,
            mission,
            scenario,
            plan,
            watch,
        } = self;
        let (goal, path) = mission.goal(scenario);
        let stage = Stage::begin(watch, context, scenario, (goal, &path), mission.keyboard())?;
        let mut robot = open(&stage)?;
        let driven = stage.run(plan, &mut robot, |robot| mission.drive(robot, scenario))?;
        let boards = report(&mut robot, &driven)?;
        Ok(Report {
            outcome: driven.outcome,
            boards,
            recorded: driven.recorded,
            restless: driven.restless,
        })
    }
}

/// Result of a task and of the boards that carried it out.
#[derive(Serialize)]
struct Published {
    #[serde(flatten)]
    task: Value,
    #[serde(flatten)]
    boards: Value,
}

impl Report {
    /// Writes and prints the result. An error says why the task was not carried out, why the robot did not stop, or what
    /// is wrong with the boards.
    pub fn publish(self, run: &Run) -> Result<(), Error> {
        let Self {
            outcome,
            boards,
            recorded,
            restless,
        } = self;
        // A run that the user ends early need not carry out its task.
        let undone = outcome.failure();
        let undone = undone.filter(|_| outcome.end().kind != EndKind::Interrupted);
        let failed = undone.or(restless).or(boards.problem);
        let (text, task, mut files) = match boards.estimated {
            true => (String::new(), Value::Null, estimated(run, &outcome)?),
            false => run.mission.publish(run.context, outcome)?,
        };
        for (name, text) in boards.files {
            files.text(&name, text);
        }
        let gap = if text.is_empty() || boards.text.is_empty() {
            ""
        } else {
            "\n"
        };
        let text = format!("{text}{gap}{}", boards.text);
        let result = Published {
            task,
            boards: boards.values,
        };
        run.context.finish(&text, &result, files, &recorded, failed)
    }
}

/// Files of a run whose truth is not known.
fn estimated(run: &Run, outcome: &Outcome) -> Result<OutputDir, Error> {
    let mut files = run.context.output()?;
    let (goal, _) = run.mission.goal(&run.scenario);
    let (goal, rows, ends) = match outcome {
        Outcome::Script(steps) if !steps.steps.is_empty() => (
            steps.goal(),
            steps::summary(&steps.steps),
            steps::csv_of(&steps.steps),
        ),
        Outcome::Script(_) => (None, Vec::new(), csv::of_ends([&outcome.end()])),
        _ => (Some(goal), Vec::new(), csv::of_ends([&outcome.end()])),
    };
    files.csv("ends.csv", ends);
    let end = (&outcome.end(), goal);
    let title = run.context.name.clone();
    picture::draw(
        run.context,
        &mut files,
        &outcome.records(),
        end,
        title,
        rows,
    );
    Ok(files)
}

/// Publishes the end of a run whose robot never answered.
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

/// Lines on late ticks, boards lost and restarted, and nodes in a fault.
fn happenings(late_ticks: Option<u32>, events: &[Event], nodes: &[Status]) -> String {
    let faults = nodes.iter();
    let faults = faults.filter(|status| status.state == OperatingState::Fault);
    let late = late_ticks.map(|late| format!("{late} ticks began more than a tick late\n"));
    let lines = events.iter().map(|event| format!("{event}\n"));
    let lines = late.into_iter().chain(lines);
    lines
        .chain(faults.map(|status| format!("{status}\n")))
        .collect()
}
