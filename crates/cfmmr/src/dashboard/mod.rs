//! Dashboard of a run on the terminal: states of the nodes, faults with remedies, links, estimate and motion.
//!
//! [`view`] holds the data, [`draw`] draws them (a pure function), [`terminal`] shows the picture. The terminal has a
//! thread of its own: a slow terminal does not delay the run, and a board without answer does not delay the display.

pub mod draw;
mod map;
pub mod terminal;
pub mod view;

use crate::thinned::Thinned;
use core_algos::topology::Topology;
use host_sim::base::error::Error;
use host_sim::run::keyboard::Keyboard;
use host_sim::run::recovery::Monitor;
use host_sim::run::robot::{Observer, Record, Robot};
use output::terminal::is_interactive;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::Duration;
use terminal::Terminal;
use view::View;

/// Epochs between two views: 20 a second.
const EPOCHS_PER_VIEW: u64 = 5;

/// Largest number of points of the trail.
const MAX_TRAIL_POINTS: usize = 400;
/// Polling interval of the keys after the run.
const KEY_POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Fails if standard input or output is not a terminal.
pub fn check() -> Result<(), Error> {
    match is_interactive() {
        true => Ok(()),
        false => Err(Error::input(
            "--dashboard: standard input and output must be a terminal; leave out --dashboard with \
             a file or a pipe",
        )),
    }
}

/// Observer that shows the run on the terminal.
pub struct Dashboard {
    terminal: Terminal,
    keyboard: Keyboard,
    /// Latest view, with the title and the goal of the run.
    view: View,
    epochs: u64,
    /// True midpoint one epoch ago, the instant of the latest estimate.
    before: Option<[f64; 3]>,
    /// Estimated path of the midpoint.
    trail: Thinned<[f64; 2]>,
    /// Ends the run if true.
    interrupt: Arc<AtomicBool>,
}

impl Dashboard {
    /// Opens the dashboard; dropping the dashboard restores the terminal.
    pub fn open(
        title: impl Into<String>,
        robot: Topology,
        goal: [f64; 3],
        keyboard: Keyboard,
        interrupt: Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        let view = View {
            title: title.into(),
            goal,
            ..View::before(&Monitor::new(robot))
        };
        Ok(Self {
            terminal: Terminal::open(view.clone(), keyboard.clone())?,
            keyboard,
            view,
            epochs: 0,
            before: None,
            trail: Thinned::new(MAX_TRAIL_POINTS),
            interrupt,
        })
    }
}

impl Observer for Dashboard {
    fn epoch(&mut self, robot: &dyn Robot, record: &Record) -> Result<(), Error> {
        // No interrupt after q in a drive by keyboard: its script stops the robot and ends the run.
        let by_itself = self.keyboard.drives() && !self.keyboard.is_interrupted();
        if self.keyboard.is_ended() && !by_itself {
            self.interrupt.store(true, Relaxed);
        }
        let truth = self.before.replace(record.midpoint);
        if self.epochs.is_multiple_of(EPOCHS_PER_VIEW) {
            let at = record.lead.fused.robot.posture;
            self.trail.push([at.x, at.y].map(f64::from));
            self.view = View {
                title: std::mem::take(&mut self.view.title),
                goal: self.view.goal,
                truth: truth.unwrap_or(record.midpoint),
                trail: self.trail.clone().into_values(),
                ..View::of(robot, record)
            };
            self.terminal.show(self.view.clone());
        }
        self.epochs += 1;
        Ok(())
    }

    /// Shows the last view until the user presses q.
    fn ended(&mut self, text: &str) {
        self.view.end = Some(text.to_owned());
        self.terminal.show(self.view.clone());
        while !self.keyboard.is_ended() && !self.interrupt.load(Relaxed) {
            thread::sleep(KEY_POLL_INTERVAL);
        }
    }
}
