//! Configurations of sensors and fusion.

use crate::scenario::Scenario;
use crate::scenario::effect::Taken;
use core_algos::fusion::robot::Mode;
use core_algos::node::lead::fusion_fits;
use core_algos::topology::Topology;

/// Sensors and fusion of a robot, one row in the table of `posture`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variant {
    /// True if the relative position sensor is fitted.
    pub rps: bool,
    /// True if the axles carry gyroscopes and accelerometers.
    pub imu: bool,
    /// Fusion of the lead node.
    pub mode: Mode,
}

impl Variant {
    const fn new(rps: bool, imu: bool, mode: Mode) -> Self {
        Self { rps, imu, mode }
    }

    /// All rows of the table, first without and then with inertial sensors.
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
    /// Encoders alone and the joint filter, without inertial sensors.
    pub const PAIR: [Self; 2] = [Self::ALL[0], Self::ALL[3]];
    /// The joint filter, without and with inertial sensors.
    pub const JOINT: [Self; 2] = [Self::ALL[3], Self::ALL[7]];

    /// Sensors and fusion of a scenario.
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            rps: scenario.mission.rps,
            imu: scenario.world.sensors.gyro.fitted,
            mode: scenario.fusion(),
        }
    }

    /// Scenario with this configuration. The accelerometer is fitted or removed with the gyro.
    pub fn apply(&self, scenario: &Scenario) -> Scenario {
        let mut scenario = scenario.clone();
        scenario.mission.rps = self.rps;
        let sensors = &mut scenario.world.sensors;
        if sensors.gyro.fitted != self.imu {
            sensors.gyro.fitted = self.imu;
            sensors.accelerometer.fitted = self.imu;
        }
        scenario.robot.lead.fusion.mode = self.mode;
        scenario
    }

    /// True if the fusion works on `robot`.
    pub fn fits(&self, robot: Topology) -> bool {
        fusion_fits(self.mode, robot)
    }

    /// Name of the fusion, as in `robot.lead.fusion.mode`.
    pub fn fusion(&self) -> &'static str {
        match self.mode {
            Mode::Odometry => "odometry",
            Mode::Intersection => "intersection",
            Mode::IntersectionIpec => "intersection-ipec",
            Mode::Joint => "joint",
        }
    }

    /// Sensors in addition to the encoders; "encoders" if there are none.
    pub fn sensors(&self) -> &'static str {
        match (self.rps, self.imu) {
            (false, false) => "encoders",
            (false, true) => "IMU",
            (true, false) => "gauges",
            (true, true) => "gauges, IMU",
        }
    }

    /// Names of sensors and fusion.
    pub fn label(&self) -> String {
        format!("{}, {}", self.sensors(), self.fusion())
    }

    /// True if the 95 % error is only an upper bound: without gauges and gyros, assumed errors of the tyres determine
    /// the covariance, not measurements.
    pub fn is_bound(&self) -> bool {
        !self.rps && !self.imu
    }
}

/// Reason why a key that each row sets has no effect.
const SET: &str = "here: each row sets it, see --rows";

/// Keys that each row sets.
pub const ROWS: Taken = &[
    ("mission.rps", SET),
    ("robot.lead.fusion.mode", SET),
    ("sensors.gyro.fitted", SET),
    ("sensors.accelerometer.fitted", SET),
];
