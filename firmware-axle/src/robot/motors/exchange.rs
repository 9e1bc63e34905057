//! Exchange between tick and current loop: the latest command and the latest feedback.

use core::cell::Cell;

use critical_section::Mutex;
use firmware_common::critical;

use crate::rules::{Command, Feedback};

static COMMAND: Mutex<Cell<Option<Command>>> = Mutex::new(Cell::new(None));
static FEEDBACK: Mutex<Cell<Feedback>> = Mutex::new(Cell::new(Feedback::NOTHING));

/// Sets the command for the current loop.
pub fn put_command(command: Command) {
    critical::all(|cs| COMMAND.borrow(cs).set(Some(command)));
}

/// Takes the latest command; `None` if it was taken already.
pub fn take_command() -> Option<Command> {
    critical::all(|cs| COMMAND.borrow(cs).take())
}

/// Sets the measurements for the tick.
pub fn put_feedback(feedback: Feedback) {
    critical::all(|cs| FEEDBACK.borrow(cs).set(feedback));
}

/// Measurements of the current loop at the latest tick.
pub fn feedback() -> Feedback {
    critical::all(|cs| FEEDBACK.borrow(cs).get())
}
