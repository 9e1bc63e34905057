//! Configurations of sensors and fusion.

use crate::scenario::Scenario;
use core_algos::fusion::robot::Mode;

/// A configuration of sensors and fusion: one row of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variant {
    /// True if the relative position sensor is fitted.
    pub rps: bool,
    /// True if the axles carry gyroscopes and accelerometers.
    pub imu: bool,
    /// Fusion.
    pub mode: Mode,
}

impl Variant {
    const fn new(rps: bool, imu: bool, mode: Mode) -> Self {
        Self { rps, imu, mode }
    }

    /// The rows of the whole table, pairs with and without inertial sensors.
    pub const ALL: [Self; 8] = [
        Self::new(false, false, Mode::Odometry),
        Self::new(true, false, Mode::Intersection),
        Self::new(true, false, Mode::IntersectionIpec),
        Self::new(true, false, Mode::Joint),
        Self::new(false, true, Mode::Odometry),
        Self::new(true, true, Mode::Intersection),
        Self::new(true, true, Mode::IntersectionIpec),
        Self::new(true, true, Mode::Joint),
    ];

    /// Encoders alone, the paper's fusion, the joint filter.
    pub const MAIN: [Self; 3] = [Self::ALL[0], Self::ALL[2], Self::ALL[3]];
    /// Only with and without the relative position sensor.
    pub const PAIR: [Self; 2] = [Self::ALL[0], Self::ALL[3]];
    /// The joint filter, without and with inertial sensors.
    pub const JOINT: [Self; 2] = [Self::ALL[3], Self::ALL[7]];

    /// The configuration that a scenario has.
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            rps: scenario.mission.rps,
            imu: scenario.world.sensors.gyro.fitted,
            mode: scenario.fusion(),
        }
    }

    /// The scenario with this configuration.
    pub fn apply(&self, scenario: &Scenario) -> Scenario {
        let mut scenario = scenario.clone();
        scenario.mission.rps = self.rps;
        scenario.world.sensors.gyro.fitted = self.imu;
        scenario.world.sensors.accelerometer.fitted = self.imu;
        scenario.robot.lead.fusion.mode = self.mode;
        scenario
    }

    /// Short name of the fusion, as in the JSON result.
    pub fn fusion(&self) -> &'static str {
        match self.mode {
            Mode::Odometry => "odometry",
            Mode::Intersection => "ci",
            Mode::IntersectionIpec => "ci+ipec",
            Mode::Joint => "joint",
        }
    }

    /// The configuration in words.
    pub fn label(&self) -> String {
        let name = match self.mode {
            Mode::Odometry => "encoders",
            Mode::Intersection => "gauges, intersection",
            Mode::IntersectionIpec => "gauges, paper's fusion",
            Mode::Joint => "gauges, joint filter",
        };
        match self.imu {
            true => format!("{name}, IMU"),
            false => name.to_owned(),
        }
    }
}
