//! A run on the terminal while it goes: states of the nodes, faults and what to do about them,
//! links, estimate and motion.
//!
//! [`view`] is what is shown, [`draw`] the picture of it, a pure function; [`terminal`] draws it from
//! a thread of its own, so that neither a slow terminal nor a board that does not answer holds up the
//! other.

pub mod draw;
pub mod terminal;
pub mod view;

use crate::base::error::Error;
use crate::run::robot::{Observer, Record, Robot};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use terminal::Terminal;
use view::View;

/// Epochs between two views: 20 a second.
const EPOCHS: u64 = 5;

/// An observer that shows the run on the terminal.
pub struct Dashboard {
    terminal: Terminal,
    title: String,
    goal: [f64; 3],
    epochs: u64,
    /// The true midpoint an epoch ago, when the latest estimate holds.
    before: Option<[f64; 3]>,
    /// Set by the key q: ends the run.
    interrupt: Arc<AtomicBool>,
}

impl Dashboard {
    /// Takes the terminal until this is dropped.
    pub fn open(
        title: impl Into<String>,
        goal: [f64; 3],
        interrupt: Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        let title = title.into();
        let first = View {
            title: title.clone(),
            goal,
            ..View::default()
        };
        Ok(Self {
            terminal: Terminal::open(first)?,
            title,
            goal,
            epochs: 0,
            before: None,
            interrupt,
        })
    }
}

impl Observer for Dashboard {
    fn epoch(&mut self, robot: &dyn Robot, record: &Record) -> Result<(), Error> {
        if self.terminal.is_left() {
            self.interrupt.store(true, Relaxed);
        }
        let truth = self.before.replace(record.midpoint);
        if self.epochs.is_multiple_of(EPOCHS) {
            self.terminal.show(View {
                title: self.title.clone(),
                goal: self.goal,
                truth: truth.unwrap_or(record.midpoint),
                ..View::of(robot, record)
            });
        }
        self.epochs += 1;
        Ok(())
    }
}
