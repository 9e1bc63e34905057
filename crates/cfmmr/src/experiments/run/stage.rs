//! Recording and display of a run.

use super::plan::Plan;
use crate::BUILD;
use crate::dashboard::{self, Dashboard};
use crate::experiments::Context;
use host_sim::base::error::Error;
use host_sim::run::end::Ended;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::robot::{Observer, Robot};
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets;
use host_sim::targets::Target;
use recording::{About, Destinations, Session};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Instant;

/// Recording and display options of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Files and address of the recording.
    pub destinations: Destinations,
    /// True if the run is shown on the terminal.
    pub dashboard: bool,
}

impl Outputs {
    /// Fails if the run cannot be shown or recorded; called before a long computation.
    pub fn check(&self) -> Result<(), Error> {
        if self.dashboard {
            dashboard::check()?;
        }
        self.destinations.check()
    }

    /// True if the run is recorded or served.
    pub fn records(&self) -> bool {
        self.destinations.any()
    }

    /// True if the run is shown or served, and so runs in real time.
    pub fn is_live(&self) -> bool {
        self.dashboard || self.destinations.live.is_some()
    }
}

/// Recording, dashboard and server of one run.
pub struct Stage<'a> {
    outputs: &'a Outputs,
    about: About<'a>,
    goal: [f64; 3],
    session: Option<Session>,
    interrupt: &'a Arc<AtomicBool>,
    keyboard: Keyboard,
}

/// Outcome of a run that has ended, and its recorded files.
pub struct Driven<T> {
    /// Outcome of the mission.
    pub outcome: T,
    /// Recorded files.
    pub recorded: Vec<PathBuf>,
    /// Wall-clock time from the first tick to the last, s.
    pub wall_s: f64,
    /// Reason if the robot did not stop after the run.
    pub stop_error: Option<String>,
}

impl<'a> Stage<'a> {
    /// Begins the recording of a run to a goal; `path` may be empty. Waits for the first viewer of a live run.
    pub fn begin(
        outputs: &'a Outputs,
        context: &'a Context,
        scenario: &'a Scenario,
        (goal, path): ([f64; 3], &[[f64; 3]]),
        keyboard: Keyboard,
    ) -> Result<Self, Error> {
        let about = About {
            command: &context.name,
            build: BUILD,
            seed: context.seed,
            trial: 0,
            scenario,
        };
        let interrupt = context.workers.interrupt();
        let session = Session::begin(&outputs.destinations, &about)?;
        if let Some(session) = &session {
            if goal[0].is_finite() {
                session.plan(goal, path);
            }
            session.await_viewer(interrupt)?;
        }
        Ok(Self {
            outputs,
            about,
            goal,
            session,
            interrupt,
            keyboard,
        })
    }

    /// Wraps the boards so that their inputs and outputs are recorded.
    pub fn tap(&self, targets: Vec<Box<dyn Target>>) -> Vec<Box<dyn Target>> {
        match &self.session {
            Some(session) => session.tap(targets, self.about.scenario),
            None => targets,
        }
    }

    /// Simulated robot with in-process boards.
    pub fn simulation(&self) -> Result<Simulation, Error> {
        let About {
            scenario,
            seed,
            trial,
            ..
        } = self.about;
        let boards = targets::in_process_with(scenario.robot.topology(), &scenario.own);
        Simulation::on(self.tap(boards), scenario, seed, trial)
    }

    /// Drives the mission with a robot and ends the recording.
    pub fn run<R: Robot, T: Ended>(
        &self,
        plan: &Plan,
        robot: &mut R,
        drive: impl FnOnce(&mut R) -> Result<T, Error>,
    ) -> Result<Driven<T>, Error> {
        if let Some(session) = &self.session {
            robot.observe(Box::new(session.clone()));
        }
        if let Some(shown) = self.dashboard()? {
            robot.observe(shown);
        }
        // A real robot already runs in real time.
        let is_simulated = robot.plant().is_some();
        let real_time = plan.real_time || self.outputs.is_live() || self.keyboard.drives();
        let control = robot.control_mut();
        control.span = plan.span;
        control.interrupt = Some(self.interrupt.clone());
        control.pace =
            (real_time && is_simulated).then(|| RealTimeLimiter::new(self.keyboard.clone()));
        let start = Instant::now();
        let outcome = drive(robot)?;
        let wall_s = start.elapsed().as_secs_f64();
        let end = outcome.end();
        // A simulated robot is stopped after an interrupt only.
        let stops = self.interrupt.load(Relaxed) || !is_simulated;
        let stopped = if stops { robot.stop() } else { Ok(()) };
        let stop_error = stopped.err().map(|error| error.to_string());
        // Dropped before the recording ends, so that the displays close.
        let observers = std::mem::take(&mut robot.control_mut().observers);
        for mut observer in observers {
            observer.ended(&end.text());
        }
        let recorded = match &self.session {
            Some(session) => session.close(&end)?,
            None => Vec::new(),
        };
        Ok(Driven {
            outcome,
            recorded,
            wall_s,
            stop_error,
        })
    }

    /// Opens the dashboard if `--dashboard` is given or the keyboard drives.
    fn dashboard(&self) -> Result<Option<Box<dyn Observer>>, Error> {
        if !self.outputs.dashboard && !self.keyboard.drives() {
            return Ok(None);
        }
        let title = format!("cfmmr {}, seed {}", self.about.command, self.about.seed);
        let interrupt = self.interrupt.clone();
        let robot = self.about.scenario.robot.topology();
        let shown = Dashboard::open(title, robot, self.goal, self.keyboard.clone(), interrupt)?;
        Ok(Some(Box::new(shown)))
    }
}
