//! Recording and display of a run.

use crate::BUILD;
use crate::dashboard::{self, Dashboard};
use crate::experiments::Context;
use crate::experiments::arguments::LogArgs;
use host_sim::base::error::Error;
use host_sim::run::end::Ended;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::robot::{Observer, Robot, Span};
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets;
use host_sim::targets::Target;
use recording::{About, Session};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Instant;

/// The dashboard, if it is asked for.
fn open_dashboard(
    args: &LogArgs,
    about: &About,
    goal: [f64; 3],
    keyboard: &Keyboard,
    interrupt: &Arc<AtomicBool>,
) -> Result<Option<Box<dyn Observer>>, Error> {
    if !args.dashboard && !keyboard.drives() {
        return Ok(None);
    }
    let title = format!("cfmmr {}, seed {}", about.command, about.seed);
    Ok(Some(Box::new(Dashboard::open(
        title,
        goal,
        keyboard.clone(),
        interrupt.clone(),
    )?)))
}

/// Checks before a long computation that the run can be shown and recorded.
pub fn check(args: &LogArgs) -> Result<(), Error> {
    if args.dashboard {
        dashboard::check()?;
    }
    args.destinations().check()
}

/// The stage of a run: its bounds, its recording and its display.
pub struct Stage<'a> {
    args: &'a LogArgs,
    about: About<'a>,
    goal: [f64; 3],
    session: Option<Session>,
    interrupt: &'a Arc<AtomicBool>,
    /// Bounds of the time.
    pub span: Span,
    /// True if no tick may begin before its time on the clock.
    pub real_time: bool,
    /// Keys of the dashboard.
    pub keyboard: Keyboard,
}

/// A run that has ended.
pub struct Driven<T> {
    /// Result of the task.
    pub outcome: T,
    /// Files that were recorded.
    pub recorded: Vec<PathBuf>,
    /// Time from the first tick to the last, s.
    pub wall_s: f64,
    /// Why the robot did not stop after the run, if so.
    pub restless: Option<String>,
}

impl<'a> Stage<'a> {
    /// Begins the recording of a run to a goal, along a path if it has points.
    pub fn begin(
        args: &'a LogArgs,
        context: &'a Context,
        scenario: &'a Scenario,
        (goal, path): ([f64; 3], &[[f64; 3]]),
    ) -> Result<Self, Error> {
        check(args)?;
        let about = About {
            command: &context.name,
            build: BUILD,
            seed: context.seed,
            trial: 0,
            scenario,
        };
        let interrupt = context.interrupt();
        let session = Session::begin(&args.destinations(), &about)?;
        if let Some(session) = &session {
            if goal[0].is_finite() {
                session.plan(goal, path);
            }
            session.await_viewer(interrupt)?;
        }
        Ok(Self {
            args,
            about,
            goal,
            session,
            interrupt,
            span: Span::default(),
            real_time: args.is_watched(),
            keyboard: Keyboard::default(),
        })
    }

    /// The boards, whose inputs and outputs are recorded.
    pub fn tap(&self, targets: [Box<dyn Target>; 3]) -> [Box<dyn Target>; 3] {
        match &self.session {
            Some(session) => session.tap(targets, self.about.scenario),
            None => targets,
        }
    }

    /// A robot with its boards in this process.
    pub fn simulation(&self) -> Result<Simulation, Error> {
        let About {
            scenario,
            seed,
            trial,
            ..
        } = self.about;
        Simulation::on(self.tap(targets::in_process()), scenario, seed, trial)
    }

    /// Has a robot carry out its task, and ends the recording.
    pub fn run<R: Robot, T: Ended>(
        &self,
        robot: &mut R,
        drive: impl FnOnce(&mut R) -> Result<T, Error>,
    ) -> Result<Driven<T>, Error> {
        if let Some(session) = &self.session {
            robot.observe(Box::new(session.clone()));
        }
        if let Some(shown) = open_dashboard(
            self.args,
            &self.about,
            self.goal,
            &self.keyboard,
            self.interrupt,
        )? {
            robot.observe(shown);
        }
        let control = robot.control_mut();
        control.span = self.span;
        control.interrupt = Some(self.interrupt.clone());
        control.pace = self
            .real_time
            .then(|| RealTimeLimiter::new(self.keyboard.clone()));
        let start = Instant::now();
        let outcome = drive(robot)?;
        let wall_s = start.elapsed().as_secs_f64();
        let end = outcome.end();
        // A simulated robot whose run is over is left where it is.
        let stops = self.interrupt.load(Relaxed) || robot.plant().is_none();
        let stopped = if stops { robot.stop() } else { Ok(()) };
        let restless = stopped.err().map(|error| error.to_string());
        // Displays close.
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
            restless,
        })
    }
}
