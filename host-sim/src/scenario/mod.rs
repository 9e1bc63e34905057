//! Scenario: everything an experiment depends on, apart from the seed.
//!
//! A key is a field of the struct of its table: `plant` in the crate `plant` (`config.rs`), `robot` in
//! [`core_algos::node::robot`], the others in [`world`] and [`bus`](crate::bus). A world replaces the defaults of
//! `plant`, `spread`, `sensors` and `bus`, and the defaults of start accuracy and floor drift in `mission`.

pub mod belief;
pub mod board_parameters;
pub mod effect;
pub mod keys;
pub mod own;
pub mod variant;

use crate::base::error::{Error, Refusal, within};
use crate::base::table::table;
use crate::base::toml_file;
use crate::bus::virtual_bus::BusConfig;
use crate::scenario::board_parameters::Overlays;
use crate::scenario::own::Own;
use crate::world;
use crate::world::effect::leaves;
use crate::world::sensors::SensorConfig;
use crate::world::{PlacementAccuracy, Spread, World, table};
use core_algos::config::ConfigError;
use core_algos::control::regulator::Tolerance;
use core_algos::fusion::robot::Mode;
use core_algos::math::Posture;
use core_algos::node::lead::{FUSION_OF_CHAIN, Task, fusion_fits};
use core_algos::node::robot::{ConfiguredPlacement, RobotConfig};
use core_algos::params::Settings;
use declare::{Declared, Field};
use plant::PlantConfig;
use serde::{Deserialize, Serialize};
use std::path::Path;
use toml::{Table, Value};

table! {
    /// Task of the robot, and its time limits.
    pub struct Mission {
        /// Start posture of the robot's midpoint.
        pub start: [f64; 3] = [-1.342, -1.342, 0.0], "m, m, rad": Range(-50.0, 50.0);
        /// Goal posture of the robot's midpoint.
        pub goal: [f64; 3] = [0.0; 3], "m, m, rad": Range(-50.0, 50.0);
        /// True if the relative position sensor is fitted; without it the robot is lighter.
        pub rps: bool = true;
        /// Time at rest before the task begins.
        pub settle_s: f64 = 0.5, "s": Range(0.0, 60.0);
        /// Time after which a trial ends in any case.
        pub time_limit_s: f64 = 90.0, "s": Range(0.1, 36_000.0);
        /// Time for which the robot is recorded after it reports that the task is done.
        pub rest_s: f64 = 0.5, "s": Range(0.0, 60.0);
        /// Position tolerance of the goal and of the end of the path.
        pub tolerance_m: f64 = 0.1, "m": Range(1e-3, 100.0);
        /// Heading tolerance of the goal and of the end of the path.
        pub tolerance_rad: f64 = 0.0873, "rad": Range(1e-3, 3.2);
        /// Standard deviation of the start position along each axis, as configured in the robot.
        pub placement_m: f64 = 5e-3, "m": Range(0.0, 10.0);
        /// Standard deviation of the start heading, as configured in the robot.
        pub placement_rad: f64 = 1e-2, "rad": Range(0.0, 3.2);
        /// Standard deviation of the floor drift along each axis of the floor, as configured in the robot: displacement
        /// by the floor per distance rolled.
        pub floor_drift: f64 = 1.5e-2, "": Range(0.0, 0.5);
    }
}

impl Mission {
    /// Accuracy of placement and floor, as configured in the robot.
    pub fn configured_placement(&self) -> ConfiguredPlacement {
        ConfiguredPlacement {
            placement_m: self.placement_m as f32,
            placement_rad: self.placement_rad as f32,
            floor_drift: self.floor_drift as f32,
        }
    }

    /// Task of regulation to a goal, with the tolerance of the mission.
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

    /// Tolerance at the goal and at the end of a path.
    pub fn within(&self) -> Tolerance {
        Tolerance {
            position_m: self.tolerance_m as f32,
            heading_rad: self.tolerance_rad as f32,
        }
    }
}

/// Everything an experiment depends on, apart from the seed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "Layout", into = "Layout")]
pub struct Scenario {
    /// The task.
    pub mission: Mission,
    /// Configuration of the boards.
    pub robot: RobotConfig,
    /// Parameters of single boards.
    pub boards: Overlays,
    /// The true robot and its surroundings.
    pub world: World,
    /// Parts of the user; not in a scenario file.
    pub own: Own,
}

/// Layout of a scenario file: the tables of the world are on the top level, as `mission`, `robot` and `boards` are.
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

/// Keys of a scenario file, including the tables of the world. A table of `boards` has the keys of `robot`.
pub const FIELDS: &[Field] = &[
    table("mission", "The task.", Mission::KIND),
    table("robot", "Configuration of the boards.", RobotConfig::KIND),
    table("plant", "The true robot.", PlantConfig::KIND),
    table("spread", "Spread of the true robot.", Spread::KIND),
    table("sensors", "Sensors.", SensorConfig::KIND),
    table("bus", "The bus between the boards.", BusConfig::KIND),
];

impl Default for Layout {
    fn default() -> Self {
        Scenario::default().into()
    }
}

impl From<Layout> for Scenario {
    fn from(layout: Layout) -> Self {
        let topology = layout.robot.topology();
        Self {
            mission: layout.mission,
            robot: layout.robot,
            boards: layout.boards.of(topology),
            world: World {
                name: layout.world,
                plant: layout.plant,
                spread: layout.spread,
                sensors: layout.sensors,
                bus: layout.bus,
                placement: PlacementAccuracy::default(),
            },
            own: Own::default(),
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
    /// Reads a scenario file over a world, applies the changes, and checks every value. Without a file all keys have
    /// their defaults. Without `world` the file's world applies, or else the default world.
    pub fn load(
        world: Option<&str>,
        file: Option<&Path>,
        changes: &[String],
    ) -> Result<Self, Error> {
        let (text, name) = toml_file::read(file)?;
        Self::parse(world, &text, &name, changes)
    }

    /// The default scenario in a world; without `world` in the default world.
    pub fn in_world(world: Option<&str>) -> Result<Self, Error> {
        Self::parse(world, "", "scenario", &[])
    }

    /// [`Self::load`] from text; `name` is the name of the text in errors.
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
        let placement = &below.world.placement;
        below.mission.placement_m = placement.placement_m;
        below.mission.placement_rad = placement.placement_rad;
        below.mission.floor_drift = placement.floor_drift;
        let mut scenario: Self = toml_file::build(&below, text, name, changes)?;
        (scenario.world.name, scenario.world.placement) = (below.world.name, below.world.placement);
        scenario.check()?;
        Ok(scenario)
    }

    /// Checks that every value is within its range, for each board too.
    pub fn check(&self) -> Result<(), Error> {
        within("mission", self.mission.check_ranges())?;
        let topology = self.robot.topology();
        self.check_fusion()?;
        self.robot.build().map_err(|error| self.placed(&error))?;
        self.boards.check()?;
        for role in topology.boards() {
            let mut settings = Settings::new(self.robot);
            self.boards.apply(role, &mut settings)?;
            // Stored zeros of the gauges are not checked: they are counts of another converter than the default.
            let calibration = &mut settings.robot.beam.calibration;
            calibration.zero_counts = self.robot.beam.calibration.zero_counts;
            let board = format!("boards.{}: ", topology.name(role));
            let checked = settings.check(role);
            checked.map_err(|error| Refusal::of(&board, &error))?;
        }
        self.own.check_axles(topology)?;
        self.world.check(topology)
    }

    /// Refuses sensors and fusions that do not suit more than two axles, by name.
    fn check_fusion(&self) -> Result<(), Error> {
        let (mode, robot) = (self.robot.lead.fusion.mode, self.robot.topology());
        let axles = robot.axle_count();
        if !fusion_fits(mode, robot) {
            let mode = mode.name();
            return Err(Error::input(format!(
                "robot.lead.fusion.mode = {mode}: must be {FUSION_OF_CHAIN}; robot.geometry.axles is {axles}"
            )));
        }
        if !fusion_fits(self.fusion(), robot) {
            return Err(Error::input(format!(
                "mission.rps = false: must be true with more than two axles; robot.geometry.axles is {axles}"
            )));
        }
        Ok(())
    }

    /// Error of a robot parameter, with all keys that hold the refused value: fields of several tables share a name.
    fn placed(&self, error: &ConfigError) -> Refusal {
        let mut keys = Vec::new();
        let table = Table::try_from(self.robot).unwrap_or_default();
        leaves("robot", &table, &mut |key, value| {
            let name = key.rsplit('.').next();
            let is_refused = |value: &Value| {
                let held = value.as_float().map(|held| held as f32);
                held.or(value.as_integer().map(|held| held as f32)) == Some(error.value)
            };
            // The refused value of a list is an entry or the number of entries.
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
            true => Refusal::of("robot: ", error),
            false => {
                let mut refusal = Refusal::of("", error);
                refusal.field = refusal.field.replacen(error.field, &keys.join(" or "), 1);
                refusal
            }
        }
    }

    /// Fusion of the lead node. A robot without the relative position sensor fuses encoders and inertial sensors
    /// only.
    pub fn fusion(&self) -> Mode {
        match self.mission.rps {
            true => self.robot.lead.fusion.mode,
            false => Mode::Odometry,
        }
    }

    /// Configuration of the robot with derived values and [`Self::fusion`].
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
