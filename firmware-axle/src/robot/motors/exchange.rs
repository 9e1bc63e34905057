//! What the tick and the current loop tell each other: the latest command and the latest feedback.

use core::cell::Cell;

use core_algos::safety::Condition;
use critical_section::Mutex;
use firmware_common::critical;

static COMMAND: Mutex<Cell<Option<Command>>> = Mutex::new(Cell::new(None));
static FEEDBACK: Mutex<Cell<Feedback>> = Mutex::new(Cell::new(NOTHING));

/// What the tick asks of the motors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Command {
    /// Whether the motors may be on.
    pub on: bool,
    /// Whether a latched fault is to be forgotten.
    pub clear: bool,
    /// Wheel torques (left, right), N m, forward positive.
    pub torque_nm: [f32; 2],
    /// Wheel speeds (left, right), rad/s, for the back-EMF.
    pub speed_rad_s: [f32; 2],
    /// Largest currents, A.
    pub limit_a: [f32; 2],
}

/// What the motors report; it holds for the last tick.
#[derive(Clone, Copy, Debug)]
pub struct Feedback {
    /// Currents, root mean square over the tick, A.
    pub current_a: [f32; 2],
    /// Supply, V.
    pub supply_v: f32,
    /// Between the drivers, °C; `None` if the thermistor is open or short.
    pub temperature_c: Option<f32>,
    /// Whether the drivers are awake.
    pub on: bool,
    /// Whether the zeros of the current sensors are known.
    pub ready: bool,
    /// Whether the emergency stop is pressed at present.
    pub stopped: bool,
    /// Whether a motor's current does not answer to its voltage.
    pub unresponsive: bool,
    /// Longest run of the current loop since the start, core cycles.
    pub longest_cycles: u32,
    /// Why the motors were switched off; lasts until it is cleared.
    pub fault: Option<Condition>,
}

/// Before the first tick.
const NOTHING: Feedback = Feedback {
    current_a: [0.0; 2],
    supply_v: 0.0,
    temperature_c: None,
    on: false,
    ready: false,
    stopped: false,
    unresponsive: false,
    longest_cycles: 0,
    fault: None,
};

/// Leaves a command for the current loop.
pub fn put_command(command: Command) {
    critical::all(|cs| COMMAND.borrow(cs).set(Some(command)));
}

/// Takes the command away; `None` if none came since.
pub fn take_command() -> Option<Command> {
    critical::all(|cs| COMMAND.borrow(cs).take())
}

/// Leaves what was measured for the tick.
pub fn put_feedback(feedback: Feedback) {
    critical::all(|cs| FEEDBACK.borrow(cs).set(feedback));
}

/// What was measured in the last tick.
pub fn feedback() -> Feedback {
    critical::all(|cs| FEEDBACK.borrow(cs).get())
}
