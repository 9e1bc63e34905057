//! Parameters a user calibrates or tunes: one table of names, units and ranges, and the form in
//! which a board keeps them over a power cut.
//!
//! [`table`] holds the table; [`stored`] turns a value into the bytes of an item and decides, after a
//! start, which of the items found are to be used. Reading and writing a flash is left to whoever
//! has one.
//!
//! # Panic contract
//!
//! Nothing here panics, whatever bytes come. A value reaches a configuration only if it lies in its
//! range, and all of them together only if the nodes can be built from them.
//!
//! # Example
//!
//! ```
//! use core_algos::node::board::Role;
//! use core_algos::params::{Settings, find};
//!
//! let mut settings = Settings::default();
//! let radius = find("robot.geometry.wheel_radius_m").expect("a parameter");
//! radius.set(&mut settings, 0.0731)?;
//! assert_eq!(settings.robot.geometry.wheel_radius_m, 0.0731);
//! settings.check(Role::Front)?;
//! // Millimetres are refused, and nothing is changed.
//! assert_eq!(radius.set(&mut settings, 73.1).unwrap_err().field, radius.name);
//! assert_eq!(radius.get(&settings), 0.0731);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

pub mod stored;
pub mod table;

pub use stored::{Contents, Item, Report, Source};
pub use table::{COUNT, Parameter, TABLE, find};

use crate::config::{ConfigError, in_range};
use crate::node::board::{Board, Role};
use crate::node::robot::RobotConfig;
use crate::safety::{OperatingState, Permit};

/// Everything on a board that has parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Configuration of the nodes.
    pub robot: RobotConfig,
    /// Scale of the board's inertial sensor.
    pub inertial: Inertial,
}

/// Scale of an inertial sensor; its biases are found anew at every standstill.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// True yaw rate over the one read.
    pub gyro_gain: f32,
    /// True acceleration over the one read.
    pub accelerometer_gain: f32,
}

impl Default for Inertial {
    fn default() -> Self {
        Self {
            gyro_gain: 1.0,
            accelerometer_gain: 1.0,
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::new(RobotConfig::default())
    }
}

impl Settings {
    /// Settings of a board with this configuration.
    pub fn new(robot: RobotConfig) -> Self {
        Self {
            robot,
            inertial: Inertial::default(),
        }
    }

    /// Whether the nodes of a board can be built from them; the error names the field.
    pub fn check(&self, role: Role) -> Result<(), ConfigError> {
        in_range("gyro_gain", self.inertial.gyro_gain, 0.5, 2.0)?;
        let gain = self.inertial.accelerometer_gain;
        in_range("accelerometer_gain", gain, 0.5, 2.0)?;
        Board::new(&self.robot, role).map(|_| ())
    }
}

/// Proof that the motors are off: writing a flash holds the core, an erase for half a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Disarmed(());

impl Disarmed {
    /// The proof, if the state of the node allows no torque.
    pub const fn by(state: OperatingState) -> Option<Self> {
        match state.permit() {
            Permit::Off => Some(Self(())),
            _ => None,
        }
    }

    /// The proof on a board without motors, which knows from the bus whether they are off.
    pub const fn when(motors_off: bool) -> Option<Self> {
        if motors_off { Some(Self(())) } else { None }
    }
}
