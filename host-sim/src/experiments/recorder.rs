//! Recording and display of a run in this process.

use crate::base::error::Error;
use crate::recording::{About, LogArgs, Session};
use crate::run::robot::Observer;
use crate::run::simulation::Simulation;
use crate::targets;
use crate::view::dashboard::Dashboard;
use crate::view::dashboard::terminal::Terminal;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// The dashboard, if it is asked for.
pub fn dashboard(
    args: &LogArgs,
    about: &About,
    goal: [f64; 3],
    interrupt: &Arc<AtomicBool>,
) -> Result<Option<Box<dyn Observer>>, Error> {
    if !args.dashboard {
        return Ok(None);
    }
    let title = format!("cfmmr {}, seed {}", about.command, about.seed);
    Ok(Some(Box::new(Dashboard::open(
        title,
        goal,
        interrupt.clone(),
    )?)))
}

/// Checks before a long computation that the run can be shown and recorded.
pub fn check(args: &LogArgs) -> Result<(), Error> {
    if args.dashboard {
        Terminal::check()?;
    }
    args.check()
}

/// A run in this process that is recorded or shown, if that is asked for.
pub struct Recorder<'a> {
    args: &'a LogArgs,
    about: &'a About<'a>,
    goal: [f64; 3],
    session: Option<Session>,
    interrupt: &'a Arc<AtomicBool>,
}

impl<'a> Recorder<'a> {
    /// Begins the recording of a run to `goal`, along a path if it has points.
    pub fn begin(
        args: &'a LogArgs,
        about: &'a About<'a>,
        goal: [f64; 3],
        path: &[[f64; 3]],
        interrupt: &'a Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        check(args)?;
        let session = Session::begin(args, about)?;
        if let Some(session) = &session {
            session.plan(goal, path);
            session.await_viewer(interrupt)?;
        }
        Ok(Self {
            args,
            about,
            goal,
            interrupt,
            session,
        })
    }

    /// The run.
    pub fn simulation(&self) -> Result<Simulation, Error> {
        let About {
            scenario,
            seed,
            trial,
            ..
        } = *self.about;
        let mut targets = targets::in_process();
        if let Some(session) = &self.session {
            targets = session.tap(targets, scenario);
        }
        let mut simulation = Simulation::on(targets, scenario, seed, trial)?;
        if let Some(session) = &self.session {
            simulation.observe(Box::new(session.clone()));
        }
        simulation.stop_on(self.interrupt.clone());
        if let Some(shown) = dashboard(self.args, self.about, self.goal, self.interrupt)? {
            simulation.observe(shown);
        }
        if self.args.is_watched() {
            simulation.keep_pace();
        }
        Ok(simulation)
    }

    /// Ends the recording; gives the files.
    pub fn close(self) -> Result<Vec<PathBuf>, Error> {
        match &self.session {
            Some(session) => session.close(ended(self.interrupt, None)),
            None => Ok(Vec::new()),
        }
    }
}

/// Reason in a log of a run that ended before its task.
pub fn ended<'a>(interrupt: &AtomicBool, failure: Option<&'a str>) -> Option<&'a str> {
    failure.or(interrupt.load(Relaxed).then_some("interrupted"))
}
