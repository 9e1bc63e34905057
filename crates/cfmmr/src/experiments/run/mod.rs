//! A run of the robot: a task that is carried out somewhere, and what comes of it.
//!
//! [`Run`] is a task with its bounds and its recording. [`Run::at`] carries it out at a [`Place`], and
//! [`in_the_loop::run`] with each board behind a link of its own. Table, files and JSON are the same
//! everywhere; boards add what they have to say.
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
use host_sim::run::end::{EndKind, Ended};
use host_sim::run::recovery::Status;
use host_sim::run::robot::Robot;
use host_sim::scenario::Scenario;
use host_sim::targets::Event;
use mission::{Mission, Outcome};
use place::{Place, Site};
use plan::Plan;
use serde::Serialize;
use serde_json::Value;
use stage::{Driven, Stage, Watch};

/// A task that is about to be carried out.
pub struct Run<'a> {
    /// Scenario, command and output folder.
    pub context: &'a Context,
    /// The task.
    pub mission: &'a Mission,
    /// Bounds, and failures of boards on the way.
    pub plan: Plan,
    /// Recording and display.
    pub watch: &'a Watch,
}

impl Run<'_> {
    /// Carries out the task at a place, and publishes the result.
    pub fn at(&self, site: &Site) -> Result<(), Error> {
        check(&self.context.scenario, self.mission, &self.plan, self.watch)?;
        match &site.place {
            Place::InProcess => {
                let (_, driven) = self.on(|stage| stage.simulation())?;
                self.publish(driven, Boards::default())
            }
            Place::Virtual => virtual_boards::run(self, site),
            Place::Serial(_) => real::run(self, site),
        }
    }

    /// Has a robot carry out the task. `open` makes the robot, ready for its task, once the recording has begun.
    fn on<R: Robot>(
        &self,
        open: impl FnOnce(&Stage) -> Result<R, Error>,
    ) -> Result<(R, Driven<Outcome>), Error> {
        let Self {
            context,
            mission,
            plan,
            watch,
        } = self;
        let scenario = &context.scenario;
        let (goal, path) = mission.goal(scenario);
        let stage = Stage::begin(watch, context, scenario, (goal, &path), mission.keyboard())?;
        let mut robot = open(&stage)?;
        let driven = stage.run(plan, &mut robot, |robot| mission.drive(robot, scenario))?;
        Ok((robot, driven))
    }

    /// Writes and prints the result of a simulated robot.
    fn publish(&self, driven: Driven<Outcome>, boards: Boards) -> Result<(), Error> {
        let failed = failure(&driven, boards.problem);
        let (text, task, mut files) = self.mission.publish(self.context, driven.outcome)?;
        for (name, text) in boards.files {
            files.text(&name, text);
        }
        let gap = if boards.text.is_empty() { "" } else { "\n" };
        let text = format!("{text}{gap}{}", boards.text);
        let result = Published {
            task,
            boards: boards.values,
        };
        let recorded = &driven.recorded;
        self.context.finish(&text, &result, files, recorded, failed)
    }
}

/// Refuses failures without effect, and a recording or a display that is not possible.
pub fn check(
    scenario: &Scenario,
    mission: &Mission,
    plan: &Plan,
    watch: &Watch,
) -> Result<(), Error> {
    plan.check(scenario, mission.limit_s(scenario))?;
    watch.check()
}

/// What the boards of a simulated robot have to say after a run.
#[derive(Debug, Default)]
struct Boards {
    /// Values for the result.
    values: BoardValues,
    /// Table and sentences.
    text: String,
    /// Files by name.
    files: Vec<(String, String)>,
    /// Problem that fails the run, if there is one.
    problem: Option<String>,
}

/// Values of the boards for the result.
#[derive(Debug, Default, Serialize)]
#[serde(untagged)]
enum BoardValues {
    /// Of boards in this program.
    #[default]
    None,
    /// Of boards in the loop.
    InTheLoop(in_the_loop::Values),
    /// Of virtual boards.
    Virtual(virtual_boards::Values),
}

/// Result of a task and of the boards that carried it out.
#[derive(Serialize)]
struct Published {
    #[serde(flatten)]
    task: Value,
    #[serde(flatten)]
    boards: BoardValues,
}

/// Why a run failed: its task was not carried out, the robot did not stop, or its boards have a problem. A run that the
/// user ends early need not carry out its task.
fn failure(driven: &Driven<Outcome>, problem: Option<String>) -> Option<String> {
    let undone = driven.outcome.failure();
    let undone = undone.filter(|_| driven.outcome.end().kind != EndKind::Interrupted);
    let all = [undone, driven.restless.clone(), problem];
    let all: Vec<String> = all.into_iter().flatten().collect();
    (!all.is_empty()).then(|| all.join("; "))
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
