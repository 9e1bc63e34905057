//! Run of a robot: a mission, the boards that drive it, and the published result.
//!
//! [`Run`] is a mission with its time limits and recording. [`Run::at`] drives the mission on the boards that a
//! [`BoardPlace`] selects, [`in_the_loop::run`] with each board behind its own link. Table, files and JSON have one
//! form for all boards; reports of virtual or linked boards are added.
//!
//! | module | holds |
//! |---|---|
//! | [`place`], [`links`] | selection of the boards (in-process, virtual, real), and links to boards |
//! | [`mission`], [`plan`] | the mission; time limits of the run, and failures of boards |
//! | [`stage`] | recording and display |
//! | [`in_the_loop`] | boards behind links, with sensors simulated by this program |
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
use place::{BoardPlace, Site};
use plan::Plan;
use serde::Serialize;
use serde_json::Value;
use stage::{Driven, Outputs, Stage};

/// Mission with its time limits and recording, to be driven once.
pub struct Run<'a> {
    /// Scenario, command and output folder.
    pub context: &'a Context,
    /// Mission that the robot drives.
    pub mission: &'a Mission,
    /// Time limits, and failures of boards during the run.
    pub plan: Plan,
    /// Recording and display.
    pub outputs: &'a Outputs,
}

impl Run<'_> {
    /// Drives the mission on the boards that `site` selects, and publishes the result.
    pub fn at(&self, site: &Site) -> Result<(), Error> {
        check(
            &self.context.scenario,
            self.mission,
            &self.plan,
            self.outputs,
        )?;
        let own = &self.context.scenario.own;
        match &site.place {
            BoardPlace::InProcess => {}
            BoardPlace::Virtual => own.check_outside("--on virtual")?,
            BoardPlace::Serial(_) => own.check_outside("--on serial")?,
        }
        match &site.place {
            BoardPlace::InProcess => {
                let (_, driven) = self.on(|stage| stage.simulation())?;
                self.publish(driven, Boards::default())
            }
            BoardPlace::Virtual => virtual_boards::run(self, site),
            BoardPlace::Serial(_) => real::run(self, site),
        }
    }

    /// Begins the recording, makes the robot by `open`, and drives the mission.
    fn on<R: Robot>(
        &self,
        open: impl FnOnce(&Stage) -> Result<R, Error>,
    ) -> Result<(R, Driven<Outcome>), Error> {
        let Self {
            context,
            mission,
            plan,
            outputs,
        } = self;
        let scenario = &context.scenario;
        let (goal, path) = mission.goal(scenario);
        let stage = Stage::begin(
            outputs,
            context,
            scenario,
            (goal, &path),
            mission.keyboard(),
        )?;
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

/// Refuses board failures without effect, and an impossible recording or display.
pub fn check(
    scenario: &Scenario,
    mission: &Mission,
    plan: &Plan,
    outputs: &Outputs,
) -> Result<(), Error> {
    plan.check(scenario, mission.limit_s(scenario))?;
    outputs.check()
}

/// Reports of the boards of a simulated robot after a run.
#[derive(Debug, Default)]
struct Boards {
    /// Report on the boards for the JSON output.
    values: BoardValues,
    /// Report on the boards, as text.
    text: String,
    /// Name and content of each file about the boards.
    files: Vec<(String, String)>,
    /// Problem that fails the run.
    problem: Option<String>,
}

/// Report on the boards for the JSON output, by kind of board.
#[derive(Debug, Default, Serialize)]
#[serde(untagged)]
enum BoardValues {
    /// No values: the boards run in this program.
    #[default]
    None,
    InTheLoop(in_the_loop::InTheLoopValues),
    Virtual(virtual_boards::VirtualBoardValues),
}

/// JSON output of a run: the mission's report and the boards' report.
#[derive(Serialize)]
struct Published {
    #[serde(flatten)]
    task: Value,
    #[serde(flatten)]
    boards: BoardValues,
}

/// Reasons for a failed run: the mission failed, the robot did not stop, or a board has a problem. A mission that the
/// user interrupted has not failed.
fn failure(driven: &Driven<Outcome>, problem: Option<String>) -> Option<String> {
    let mission_failure = driven.outcome.failure();
    let mission_failure =
        mission_failure.filter(|_| driven.outcome.end().kind != EndKind::Interrupted);
    let all = [mission_failure, driven.stop_error.clone(), problem];
    let all: Vec<String> = all.into_iter().flatten().collect();
    (!all.is_empty()).then(|| all.join("; "))
}

/// Text lines on late ticks, lost and restarted boards, and nodes in a fault state.
fn events_text(late_ticks: Option<u32>, events: &[Event], nodes: &[Status]) -> String {
    let faults = nodes.iter();
    let faults = faults.filter(|status| status.state == OperatingState::Fault);
    let late = late_ticks.map(|late| format!("{late} ticks began more than one tick late\n"));
    let lines = events.iter().map(|event| format!("{event}\n"));
    let lines = late.into_iter().chain(lines);
    lines
        .chain(faults.map(|status| format!("{status}\n")))
        .collect()
}
