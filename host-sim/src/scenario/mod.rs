//! A scenario: everything an experiment depends on, apart from the seed.
//!
//! A key is a field of the struct of its table: `plant` in the crate `plant` (`config.rs`), `robot` in
//! [`core_algos::node::robot`], the others in [`world`] and [`bus`](crate::bus). A world replaces the defaults
//! of `plant`, `spread`, `sensors` and `bus`.

pub mod belief;
pub mod board_parameters;
pub mod effect;

use crate::base::error::Error;
use crate::base::toml_file;
use crate::bus::virtual_bus::BusConfig;
use crate::scenario::board_parameters::Overlays;
use crate::world;
use crate::world::effect::leaves;
use crate::world::sensors::SensorConfig;
use crate::world::{Spread, ToldOfPlace, World};
use core_algos::config::ConfigError;
use core_algos::control::regulator::Tolerance;
use core_algos::fusion::robot::Mode;
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::node::robot::{RobotConfig, Told};
use core_algos::params::Settings;
use core_algos::topology::Role;
use plant::PlantConfig;
use serde::{Deserialize, Serialize};
use std::path::Path;
use toml::{Table, Value};

/// Task of the robot, and its time limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mission {
    /// Start posture of the robot's midpoint: m, m, rad.
    pub start: [f64; 3],
    /// Goal posture of the robot's midpoint: m, m, rad.
    pub goal: [f64; 3],
    /// True if the relative position sensor is fitted; without it the robot is lighter.
    pub rps: bool,
    /// Time at rest before the task begins, s.
    pub settle_s: f64,
    /// Time after which a trial ends in any case, s.
    pub time_limit_s: f64,
    /// Time the robot is watched after it reports that it is done, s.
    pub rest_s: f64,
    /// Tolerance of the goal or of the end of the path: position, m.
    pub tolerance_m: f64,
    /// The same of the heading, rad.
    pub tolerance_rad: f64,
    /// Standard deviation of the start along each axis, as the robot is told, m.
    pub placement_m: f64,
    /// Standard deviation of the start's heading, rad.
    pub placement_rad: f64,
    /// Standard deviation of the way that the floor takes the robot, over the way it rolls, along each axis of the floor.
    pub floor_drift: f64,
}

impl Mission {
    /// Accuracy of placement and floor, as the robot is told.
    pub fn told(&self) -> Told {
        Told {
            placement_m: self.placement_m as f32,
            placement_rad: self.placement_rad as f32,
            floor_drift: self.floor_drift as f32,
        }
    }

    /// Regulation to a goal with the tolerance of the mission.
    pub fn regulate(&self, goal: [f64; 3]) -> Task {
        Task::Regulate {
            goal: Posture::from(goal.map(|value| value as f32)),
            within: self.within(),
        }
    }

    /// True if a posture is within the tolerance of a goal.
    pub fn is_near(&self, at: [f64; 3], goal: [f64; 3]) -> bool {
        let turn = libm::remainder(at[2] - goal[2], std::f64::consts::TAU);
        libm::hypot(at[0] - goal[0], at[1] - goal[1]) <= self.tolerance_m
            && turn.abs() <= self.tolerance_rad
    }

    /// Tolerance of the goal, and of the end of a path.
    pub fn within(&self) -> Tolerance {
        Tolerance {
            position_m: self.tolerance_m as f32,
            heading_rad: self.tolerance_rad as f32,
        }
    }
}

impl Default for Mission {
    fn default() -> Self {
        Self {
            start: [-1.342, -1.342, 0.0],
            goal: [0.0, 0.0, 0.0],
            rps: true,
            settle_s: 0.5,
            time_limit_s: 90.0,
            rest_s: 0.5,
            tolerance_m: 0.1,
            tolerance_rad: 0.0873,
            placement_m: 5e-3,
            placement_rad: 1e-2,
            floor_drift: 1.5e-2,
        }
    }
}

/// Everything an experiment depends on, apart from the seed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "Layout", into = "Layout")]
pub struct Scenario {
    /// The task.
    pub mission: Mission,
    /// The configuration the boards run with: what the robot believes of itself.
    pub robot: RobotConfig,
    /// Parameters of single boards.
    pub boards: Overlays,
    /// The true robot and its surroundings.
    pub world: World,
}

/// A scenario as its file has it: the world's tables stand beside the others.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Layout {
    world: String,
    mission: Mission,
    robot: RobotConfig,
    boards: Overlays,
    plant: PlantConfig,
    spread: Spread,
    sensors: SensorConfig,
    bus: BusConfig,
}

impl Default for Layout {
    fn default() -> Self {
        Scenario::default().into()
    }
}

impl From<Layout> for Scenario {
    fn from(layout: Layout) -> Self {
        Self {
            mission: layout.mission,
            robot: layout.robot,
            boards: layout.boards,
            world: World {
                name: layout.world,
                plant: layout.plant,
                spread: layout.spread,
                sensors: layout.sensors,
                bus: layout.bus,
                told: ToldOfPlace::default(),
            },
        }
    }
}

impl From<Scenario> for Layout {
    fn from(scenario: Scenario) -> Self {
        let world = scenario.world;
        Self {
            world: world.name,
            mission: scenario.mission,
            robot: scenario.robot,
            boards: scenario.boards,
            plant: world.plant,
            spread: world.spread,
            sensors: world.sensors,
            bus: world.bus,
        }
    }
}

impl Scenario {
    /// Reads a scenario file (none: all defaults) over a world (none: that which it names, or the default
    /// one), with changes, and checks every value.
    pub fn load(
        world: Option<&str>,
        file: Option<&Path>,
        changes: &[String],
    ) -> Result<Self, Error> {
        let (text, name) = toml_file::read(file)?;
        Self::parse(world, &text, &name, changes)
    }

    /// The default scenario in a world, or in the default one.
    pub fn in_world(world: Option<&str>) -> Result<Self, Error> {
        Self::parse(world, "", "scenario", &[])
    }

    /// The same as [`Self::load`] from text; `name` stands in errors.
    pub fn parse(
        world: Option<&str>,
        text: &str,
        name: &str,
        changes: &[String],
    ) -> Result<Self, Error> {
        let mut below = Self::default();
        world::DEFAULT.clone_into(&mut below.world.name);
        let named: Self = toml_file::build(&below, text, name, changes)?;
        below.world = World::load(world.unwrap_or(&named.world.name))?;
        let told = &below.world.told;
        below.mission.placement_m = told.placement_m;
        below.mission.placement_rad = told.placement_rad;
        below.mission.floor_drift = told.floor_drift;
        let mut scenario: Self = toml_file::build(&below, text, name, changes)?;
        (scenario.world.name, scenario.world.told) = (below.world.name, below.world.told);
        scenario.check()?;
        Ok(scenario)
    }

    /// Checks every value.
    pub fn check(&self) -> Result<(), Error> {
        let mission = &self.mission;
        for (name, posture) in [("start", mission.start), ("goal", mission.goal)] {
            for (i, value) in posture.into_iter().enumerate() {
                range(&format!("mission.{name}[{i}]"), value, -50.0, 50.0)?;
            }
        }
        range("mission.settle_s", mission.settle_s, 0.0, 60.0)?;
        range("mission.time_limit_s", mission.time_limit_s, 0.1, 36_000.0)?;
        range("mission.rest_s", mission.rest_s, 0.0, 60.0)?;
        range("mission.tolerance_m", mission.tolerance_m, 1e-3, 100.0)?;
        range("mission.tolerance_rad", mission.tolerance_rad, 1e-3, 3.2)?;
        range("mission.placement_m", mission.placement_m, 0.0, 10.0)?;
        range("mission.placement_rad", mission.placement_rad, 0.0, 3.2)?;
        range("mission.floor_drift", mission.floor_drift, 0.0, 0.5)?;
        self.robot
            .build()
            .map_err(|error| Error::input(self.placed(&error)))?;
        for role in Role::ALL {
            let mut settings = Settings::new(self.robot);
            self.boards.apply(role, &mut settings)?;
            // The zeros of the gauges are counts of another converter than that of the default.
            let calibration = &mut settings.robot.beam.calibration;
            calibration.zero_counts = self.robot.beam.calibration.zero_counts;
            settings
                .check(role)
                .map_err(|error| Error::input(format!("boards.{}: {error}", role.name())))?;
        }
        self.world.check()
    }

    /// The refusal of a value of the robot under the keys that hold it: fields of several tables share a name.
    fn placed(&self, error: &ConfigError) -> String {
        let mut keys = Vec::new();
        let table = Table::try_from(self.robot).unwrap_or_default();
        leaves("robot", &table, &mut |key, value| {
            let name = key.rsplit('.').next();
            let is_refused = |value: &Value| {
                let held = value.as_float().map(|held| held as f32);
                held.or(value.as_integer().map(|held| held as f32)) == Some(error.value)
            };
            // Of a list an entry, or their number.
            let is_refused = match value {
                Value::Array(list) => {
                    list.len() as f32 == error.value || list.iter().any(is_refused)
                }
                value => is_refused(value),
            };
            if name == Some(error.field) && is_refused {
                keys.push(key.to_owned());
            }
        });
        match keys.is_empty() {
            true => format!("robot: {error}"),
            false => error
                .to_string()
                .replacen(error.field, &keys.join(" or "), 1),
        }
    }

    /// Fusion of the lead node. A robot without the relative position sensor has one of encoders and
    /// inertial sensors alone.
    pub fn fusion(&self) -> Mode {
        match self.mission.rps {
            true => self.robot.lead.fusion.mode,
            false => Mode::Odometry,
        }
    }

    /// The robot's configuration with its derived values and [`Self::fusion`].
    pub fn completed_robot(&self) -> RobotConfig {
        let mut robot = self.robot.completed();
        robot.lead.fusion.mode = self.fusion();
        robot
    }

    /// The scenario as TOML.
    pub fn to_toml(&self) -> Result<String, Error> {
        toml::to_string_pretty(self).map_err(|error| Error::Failure(error.to_string()))
    }
}

fn range(name: &str, value: f64, low: f64, high: f64) -> Result<(), Error> {
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(Error::input(format!(
            "{name} = {value}: must be a number from {low} to {high}"
        )))
    }
}
