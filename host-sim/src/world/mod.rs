//! World: the true robot and its surroundings as distributions, and the draw of one robot.
//!
//! The parameters of the robot's boards are a separate type,
//! [`RobotConfig`](core_algos::node::robot::RobotConfig). World and boards are connected by the draw, the sensors and
//! the motors only.
//!
//! A world is a TOML file with the tables `plant`, `spread`, `sensors`, `bus` and `placement` ([`PlacementAccuracy`]). An
//! omitted key has its base value (`worlds/base.toml`; for a brush tyre [`plant::Brush`]). Four worlds are built in
//! ([`NAMES`]).

pub mod body;
pub mod drawn;
pub mod effect;
pub mod faults;
mod figures;
pub mod normal;
pub mod random;
pub mod sensors;
mod spread;

pub use figures::{Figure, figures};
pub use spread::{PlantErrors, Spread};

use crate::base::error::{Error, within};
use crate::base::input;
use crate::base::spelling;
use crate::base::table::table;
use crate::base::toml_file;
use crate::bus::virtual_bus::BusConfig;
use crate::world::drawn::{Drawn, FrameErrors};
use crate::world::random::{BOUND, Stream, generator, normal};
use crate::world::sensors::{AxleTruth, SensorConfig, Truth};
use core_algos::topology::{MAX_AXLES, Topology};
use declare::{ConfigError, Declared, Field, Kind};
use plant::{Plant, PlantConfig, Station};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Default world of an experiment.
pub const DEFAULT: &str = "careful";

/// Base values of all figures, with reasons.
const BASE: &str = include_str!("../../worlds/base.toml");
/// Name under which the base values alone are loaded as a world.
const BASE_NAME: &str = "base";

const _: () = assert!(plant::MAX_AXLES == MAX_AXLES);

/// Built-in worlds, name and text.
const BUILT_IN: [(&str, &str); 4] = [
    ("ideal", include_str!("../../worlds/ideal.toml")),
    ("paper", include_str!("../../worlds/paper.toml")),
    ("ordinary", include_str!("../../worlds/ordinary.toml")),
    ("careful", include_str!("../../worlds/careful.toml")),
];

/// Names of the built-in worlds.
pub const NAMES: [&str; BUILT_IN.len()] = {
    let mut names = [""; BUILT_IN.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = BUILT_IN[i].0;
        i += 1;
    }
    names
};

/// The true robot and its surroundings, as distributions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct World {
    /// Name given by the user: a built-in world or a path.
    #[serde(skip)]
    pub name: String,
    /// Plant: means of the constants that differ from robot to robot.
    pub plant: PlantConfig,
    /// Spread from robot to robot.
    pub spread: Spread,
    /// Sensors, and accuracy of the robot's assembly and placement.
    pub sensors: SensorConfig,
    /// The bus between the boards.
    pub bus: BusConfig,
    /// Standard deviations of start and floor drift, as configured in the boards.
    pub placement: PlacementAccuracy,
}

/// Keys of a world file.
pub const FIELDS: &[Field] = &[
    table("plant", "The plant.", PlantConfig::KIND),
    table("spread", "Spread from robot to robot.", Spread::KIND),
    table("sensors", "Sensors.", SensorConfig::KIND),
    table("bus", "The bus between the boards.", BusConfig::KIND),
    table(
        "placement",
        "Uncertainties configured in the robot.",
        PlacementAccuracy::KIND,
    ),
];

/// Entry of [`FIELDS`] for a table.
pub(crate) const fn table(name: &'static str, doc: &'static str, kind: Kind) -> Field {
    Field { name, doc, kind }
}

table! {
    /// Standard deviations of start posture and floor drift, as configured in the boards. A mission may give others.
    pub struct PlacementAccuracy {
        /// Standard deviation of the start position along each axis.
        pub placement_m: f64 = 5e-3, "m": NonNegative;
        /// Standard deviation of the start heading.
        pub placement_rad: f64 = 1e-2, "rad": NonNegative;
        /// Standard deviation of the floor drift along each axis of the floor: displacement by the floor per
        /// distance rolled.
        pub floor_drift: f64 = 1.5e-2, "": Range(0.0, 0.5);
    }
}

impl Default for World {
    /// The base world: tyres of constant creep, and only the errors that the estimators model.
    fn default() -> Self {
        Self {
            name: BASE_NAME.to_owned(),
            plant: PlantConfig::default(),
            spread: Spread::default(),
            sensors: SensorConfig::default(),
            bus: BusConfig::default(),
            placement: PlacementAccuracy::default(),
        }
    }
}

/// Drawn constants of the plant, each with the key of its standard deviation.
const DRAWN: [(&str, &str); 9] = [
    ("wheel_radius_m", "sensors.geometry.wheel_radius_sigma"),
    ("half_track_m", "sensors.geometry.track_sigma"),
    ("tyre.brush.slip_stiffness", "spread.slip_stiffness"),
    ("bending_stiffness_n_m2", "spread.bending_stiffness"),
    ("strip_length_m", "spread.strip_length_m"),
    ("side_slip", "spread.side_slip"),
    ("carpet_drift", "spread.carpet_drift"),
    ("backlash_rad", "spread.backlash_rad"),
    ("radius_load_sensitivity", "spread.radius_load_sensitivity"),
];

/// Input error of a world in which the draw of a constant can leave its allowed range.
fn beyond(error: &str) -> Error {
    let drawn = DRAWN.iter().find(|(field, _)| error.starts_with(field));
    let sigma = drawn.map_or(
        "the standard deviations in spread and sensors.geometry",
        |d| d.1,
    );
    Error::input(format!(
        "plant.{error}, also for a draw of {BOUND} standard deviations: lower {sigma}"
    ))
}

/// Text of a world, from a built-in name or a file. A built-in name precedes a file of that name.
pub fn text(name: &str) -> Result<String, Error> {
    if let Some((_, text)) = BUILT_IN.iter().find(|(known, _)| *known == name) {
        return Ok((*text).to_owned());
    }
    input::text(Path::new(name)).map_err(|error| {
        let names = NAMES.join(", ");
        let hint = spelling::hint(name, NAMES);
        Error::input(format!(
            "world = {name}: must be {names}, or a file: {error}{hint}"
        ))
    })
}

impl World {
    /// Loads a built-in world by name, or a world from a file, and checks every value.
    pub fn load(name: &str) -> Result<Self, Error> {
        let text = text(name)?;
        let mut world: Self = toml_file::parse(&text, name, &[])?;
        name.clone_into(&mut world.name);
        world.check_lists()?;
        effect::check_world(&text, &world)?;
        Ok(world)
    }

    /// World name beside results; ", changed" is appended if a value differs. The choice of inertial sensors belongs to
    /// the robot's equipment and does not count.
    pub fn label(&self) -> String {
        let named = match self.name.as_str() {
            BASE_NAME => Ok(Self::default()),
            name => Self::load(name),
        };
        let named = named.map(|mut named| {
            named.sensors.gyro.fitted = self.sensors.gyro.fitted;
            named.sensors.accelerometer.fitted = self.sensors.accelerometer.fitted;
            named
        });
        match named {
            Ok(named) if named == *self => self.name.clone(),
            _ => format!("{}, changed", self.name),
        }
    }

    /// Checks the world for every robot that its lists fit; the error is that of a robot of two axles.
    fn check_lists(&self) -> Result<(), Error> {
        let mut robots = (2..=MAX_AXLES).filter_map(Topology::new);
        let fits = |robot: &Topology| {
            self.plant.for_axles(robot.axle_count()).is_ok() && self.bus.fits(*robot)
        };
        self.check(robots.find(fits).unwrap_or(Topology::PAIR))
    }

    /// Checks that every value is within its range, and that extreme draws give a valid plant of `robot`.
    pub fn check(&self, robot: Topology) -> Result<(), Error> {
        within("plant", self.plant.build(robot.axle_count()).map(drop))?;
        within("spread", self.spread.check_ranges())?;
        self.sensors.check()?;
        for side in [-1.0, 1.0] {
            let plant = self.plant_of(&self.extreme(robot, side), true);
            plant.map_err(|error| beyond(&error.to_string()))?;
        }
        let length = self.plant.strip_length_m;
        let mut gauges = self.sensors.bridge.gauges_m.iter().enumerate();
        if let Some((i, place)) = gauges.find(|(_, place)| !(0.0..=length).contains(*place)) {
            return Err(Error::input(format!(
                "sensors.bridge.gauges_m[{i}] = {place}: must be a number from 0 to \
                 plant.strip_length_m, which is {length}"
            )));
        }
        within("placement", self.placement.check_ranges())?;
        within("bus", self.bus.check_ranges())?;
        let (late, boards) = (self.bus.late_ms.len(), robot.board_count());
        match self.bus.fits(robot) {
            true => Ok(()),
            false => Err(Error::input(format!(
                "bus.late_ms has {late} entries: must have {boards}, one per board of {} axles, or 1 for all boards",
                robot.axle_count()
            ))),
        }
    }

    /// Robot whose constants all lie at the lower (-1) or upper (1) bound of their draws.
    fn extreme(&self, robot: Topology, side: f64) -> Drawn {
        let mut drawn = Drawn::none(robot);
        let [radius, track] = self.sensors.geometry.extreme(side);
        drawn.wheel_radius_factor.fill([radius; 2]);
        drawn.track_factor.fill(track);
        drawn.plant = self.spread.extreme(robot, side);
        drawn
    }

    /// Draws the errors of one robot. All worlds draw the same random numbers and only scale them.
    pub fn draw(&self, topology: Topology, seed: u64, trial: u64) -> Drawn {
        let mut drawn = self.sensors.draw(topology, seed, trial);
        let mut random = generator(seed, trial, Stream::Plant);
        drawn.plant = self.spread.draw(topology, &mut random);
        let mut random = generator(seed, trial, Stream::BridgeMakeup);
        let common = normal(&mut random, self.sensors.bridge.common_gain_sigma);
        let frames = drawn.frames.iter_mut();
        for error in frames.flat_map(|frame| &mut frame.bridge_gain_error) {
            *error += common;
        }
        drawn.gauge_creep_error = normal(&mut random, self.sensors.bridge.creep_sigma);
        drawn
    }

    /// Plant of a drawn robot; `sensing` is true if the robot carries the mass of the strain sensing.
    pub fn plant_of(&self, robot: &Drawn, sensing: bool) -> Result<Plant, ConfigError> {
        self.plant_config_of(robot, sensing)?
            .build(robot.track_factor.len())
    }

    /// Constants of a drawn robot's plant; `sensing` is true if the robot carries the mass of the strain sensing.
    pub fn plant_config_of(
        &self,
        robot: &Drawn,
        sensing: bool,
    ) -> Result<PlantConfig, ConfigError> {
        let axles = robot.track_factor.len();
        let mut plant = self.plant.for_axles(axles)?;
        if !sensing {
            plant.sensing_mass_kg = 0.0;
        }
        for i in 0..axles {
            plant.half_track_m.entries_mut()[i] *= robot.track_factor[i];
            for j in 0..2 {
                plant.wheel_radius_m.entries_mut()[i][j] *= robot.wheel_radius_factor[i][j];
            }
        }
        robot.plant.apply(&mut plant);
        Ok(plant)
    }

    /// Inputs of the sensors, all zero.
    pub fn no_truth(&self, topology: Topology) -> Truth {
        Truth {
            axles: vec![AxleTruth::default(); topology.axle_count()],
            strains: vec![vec![0.0; self.sensors.bridge.gauges_m.len()]; topology.frame_count()],
        }
    }

    /// True positions of a drawn robot's gauges on the strip of each frame.
    pub fn gauges_of(&self, robot: &Drawn, plant: &Plant) -> Vec<Vec<Station>> {
        let on_frame = |(frame, errors): (usize, &FrameErrors)| {
            let nominal = self.sensors.bridge.gauges_m.iter();
            nominal
                .zip(errors.gauge_shift_m)
                .map(|(place, shift)| plant.gauge(frame, place + shift))
                .collect()
        };
        robot.frames.iter().enumerate().map(on_frame).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::simulation::Simulation;
    use crate::scenario::Scenario;
    use core_algos::node::robot::RobotConfig;
    use plant::{Brush, Creep, Tyre};

    #[test]
    fn built_in_worlds_are_valid_and_labelled_by_name() {
        for name in NAMES {
            let mut world = World::load(name).unwrap();
            assert_eq!(world.label(), name);
            world.sensors.gyro.fitted = true;
            assert_eq!(world.label(), name);
            world.plant.friction += 0.01;
            assert_eq!(world.label(), format!("{name}, changed"));
        }
        let base: World = toml_file::parse(BASE, "base.toml", &[]).unwrap();
        assert_eq!(base, World::default());
        assert_eq!(base.label(), "base");
        for name in ["nowhere", "base", "plain"] {
            let why = World::load(name).unwrap_err().to_string();
            assert!(why.contains("careful") && why.contains(name), "{why}");
        }
    }

    #[test]
    fn placement_table_has_the_earlier_name_told() {
        let parse = |text: &str| toml_file::parse::<World>(text, "own.toml", &[]);
        let expected = parse("[placement]\nfloor_drift = 0.2").unwrap();
        assert_eq!(expected.placement.floor_drift, 0.2);
        for text in ["[told]\nfloor_drift = 0.2", "told.floor_drift = 0.2"] {
            assert_eq!(parse(text).unwrap(), expected);
        }
        let both = "[told]\nfloor_drift = 0.2\n[placement]\nfloor_drift = 0.1";
        let error = parse(both).unwrap_err().to_string();
        assert!(
            error.contains("told") && error.contains("unknown"),
            "{error}"
        );
    }

    #[test]
    fn five_axles_have_independent_draws_that_begin_with_those_of_two() {
        let world = World::load("careful").unwrap();
        let two = world.draw(Topology::PAIR, 3, 1);
        let five = world.draw(Topology::new(5).unwrap(), 3, 1);
        assert_eq!(five.frames[..1], two.frames);
        assert_eq!(five.gyro_bias[..2], two.gyro_bias);
        assert_eq!(five.accelerometer_bias[..2], two.accelerometer_bias);
        for i in 0..4 {
            assert!(
                five.frames[i + 1..]
                    .iter()
                    .all(|other| *other != five.frames[i])
            );
            assert!(
                five.gyro_bias[i + 1..]
                    .iter()
                    .all(|other| *other != five.gyro_bias[i])
            );
        }
    }

    /// Every list of the plant except `carpet_drift`, a vector on the floor, has one entry for all axles or one per
    /// axle.
    #[test]
    fn a_list_of_axles_holds_one_entry_for_all_axles_or_one_per_axle() {
        let base: toml::Table = toml::from_str(BASE).unwrap();
        let lists = base["plant"].as_table().unwrap().iter();
        let lists = lists.filter_map(|(key, value)| Some((key, value.as_array()?)));
        let own = lists.filter(|(key, _)| *key != "carpet_drift");
        let slip = toml::Value::try_from([[20.0; 2]; 2]).unwrap();
        let slip = ("tyre.brush.slip_stiffness", slip.as_array().unwrap());
        let lists: Vec<_> = own
            .map(|(key, list)| (key.as_str(), list))
            .chain([slip])
            .collect();
        assert!(lists.len() == 10, "{lists:?}");
        for (key, list) in lists {
            let world = |count: usize| {
                let entries = toml::Value::Array(vec![list[0].clone(); count]);
                let text = format!("plant.{key} = {entries}");
                let world: World = toml_file::parse(&text, "own.toml", &[])?;
                world.check(Topology::PAIR).map(|()| world)
            };
            assert_eq!(world(1).unwrap(), world(2).unwrap(), "{key}");
            for count in [0, 3, 6] {
                let why = world(count).unwrap_err().to_string();
                let number = [
                    format!("{count} entries"),
                    format!("(number of entries) = {count}"),
                ];
                assert!(number.iter().any(|text| why.contains(text)), "{why}");
                assert!(
                    why.contains(key) && why.contains("1 for all axles"),
                    "{why}"
                );
            }
        }
    }

    #[test]
    fn invalid_world_is_refused_with_field_value_and_range() {
        let refuse = |text: &str| {
            let world: Result<World, _> = toml_file::parse(text, "own.toml", &[]);
            world
                .and_then(|world| world.check(Topology::PAIR))
                .unwrap_err()
                .to_string()
        };
        for (text, words) in [
            (
                "[bus]\nlate_ms = [1, 2]",
                ["bus.late_ms has 2 entries", "must have 3"],
            ),
            (
                "[bus]\nlate_ms = [1, 2, 3, 4]",
                ["bus.late_ms has 4 entries", "must have 3"],
            ),
            (
                "[spread]\nside_slip = -0.002",
                ["spread.side_slip", "-0.002"],
            ),
            ("[spread]\nside_slpi = 0.002", ["side_slpi", "unknown"]),
            ("[robot]\n", ["robot", "unknown"]),
            (
                "[plant]\nstrip_length_m = -0.37",
                ["plant.strip_length_m", "-0.37"],
            ),
            (
                "[sensors.bridge]\ncommon_gain_sigma = -1.0",
                ["common_gain_sigma", "-1"],
            ),
            (
                "[sensors.bridge]\ngauges_m = [0.1, 0.4]",
                ["gauges_m[1] = 0.4", "from 0 to"],
            ),
            ("[sensors.bridge]\ngauges_m = []", ["gauges_m", "1"]),
            (
                "[plant.tyre.brush]\nslip_stiffness = [[2.5, 2.5], [2.5, 2.5]]\n[spread]\nslip_stiffness = 0.3",
                [
                    "plant.tyre.brush.slip_stiffness[0][0] = 0.557",
                    "lower spread.slip_stiffness",
                ],
            ),
            (
                "[plant]\nbacklash_rad = [[0.15, 0.0], [0.0, 0.0]]\n[spread]\nbacklash_rad = 0.02",
                [
                    "plant.backlash_rad[0][0] = 0.25",
                    "lower spread.backlash_rad",
                ],
            ),
        ] {
            let why = refuse(text);
            assert!(words.iter().all(|word| why.contains(word)), "{text}: {why}");
        }
    }

    #[test]
    fn keys_of_version_0_1_are_refused_with_their_replacements() {
        let refusal = |text: &str| {
            let world: Result<World, _> = toml_file::parse(text, "old.toml", &[]);
            world.unwrap_err().to_string()
        };
        assert_eq!(
            refusal("[plant]\ntyre = 'brush'\nslip_stiffness = [[9.0, 9.0], [9.0, 9.0]]"),
            "old.toml: plant.tyre = \"brush\" is now plant.tyre.brush = {}; \
             plant.slip_stiffness is now plant.tyre.brush.slip_stiffness"
        );
        assert_eq!(
            refusal("plant = { creep_velocity_m_s = 0.01, rest_creep_velocity_m_s = 1e-4 }"),
            "old.toml: plant.creep_velocity_m_s is now plant.tyre.creep.velocity_m_s; \
             plant.rest_creep_velocity_m_s is now plant.tyre.brush.rest_velocity_m_s"
        );
        for (text, why) in [
            (
                "[plant.tyre]\ncreep = {}\nbrush = {}",
                "has brush and creep: must have one of them",
            ),
            (
                "plant.tyre = 3",
                "plant.tyre = 3: must be a table with creep or brush",
            ),
            (
                "plant.tyre.brush = [20]",
                "plant.tyre.brush = [20]: must be a table",
            ),
            (
                "plant.tyre.wood = {}",
                "plant.tyre.wood: unknown key; must be creep or brush",
            ),
        ] {
            assert!(refusal(text).contains(why), "{}", refusal(text));
        }
    }

    /// A given tyre law replaces another law, and over the same law omitted keys keep their values. Changes with two
    /// laws are refused.
    #[test]
    fn given_tyre_law_replaces_another_law() {
        let tyre = |changes: &[&str]| {
            let changes: Vec<String> = changes.iter().map(|&c| c.to_owned()).collect();
            let text = "[plant.tyre.creep]\nvelocity_m_s = 0.02";
            let world: Result<World, _> = toml_file::parse(text, "own.toml", &changes);
            world.map(|world| world.plant.tyre)
        };
        let creep = |velocity_m_s| Tyre::Creep(Creep { velocity_m_s });
        let velocity = "plant.tyre.creep.velocity_m_s=0.5";
        let rest = "plant.tyre.brush.rest_velocity_m_s=1e-3";
        for (changes, expected) in [
            (&[][..], creep(0.02)),
            (&["plant.tyre.creep={}"], creep(0.02)),
            (&["plant.tyre={creep={}}"], creep(0.02)),
            (&[velocity, "plant.tyre.creep={}"], creep(0.5)),
            (&["plant.tyre.brush={}"], Tyre::brush(20.0)),
            (
                &[rest],
                Tyre::Brush(Brush {
                    rest_velocity_m_s: 1e-3,
                    ..Brush::default()
                }),
            ),
        ] {
            assert_eq!(tyre(changes).unwrap(), expected, "{changes:?}");
        }
        for both in [[velocity, rest], [rest, "plant.tyre.creep={}"]] {
            let why = tyre(&both).unwrap_err().to_string();
            assert_eq!(
                why,
                "--set: plant.tyre has brush and creep: must have one of them"
            );
        }
    }

    /// Visits one changed copy of the table per value: a number larger by at least a tenth, a flag inverted.
    fn for_each_number(table: &mut toml::Table, visit: &mut dyn FnMut(&toml::Table, &str)) {
        fn paths(value: &toml::Value, at: Vec<String>, found: &mut Vec<Vec<String>>) {
            let mut inner = |key: String, value: &toml::Value| {
                paths(value, [at.as_slice(), &[key]].concat(), found);
            };
            match value {
                toml::Value::Table(table) => table.iter().for_each(|(k, v)| inner(k.clone(), v)),
                toml::Value::Array(list) => {
                    let numbered = list.iter().enumerate();
                    numbered.for_each(|(i, v)| inner(i.to_string(), v));
                }
                _ => found.push(at),
            }
        }
        let mut found = Vec::new();
        paths(&table.clone().into(), Vec::new(), &mut found);
        for path in found {
            let mut changed = toml::Value::Table(table.clone());
            let mut value = &mut changed;
            for key in &path {
                value = match value {
                    toml::Value::Array(list) => &mut list[key.parse::<usize>().unwrap()],
                    table => &mut table[key.as_str()],
                };
            }
            match value {
                toml::Value::Float(number) => *number = *number * 1.1 + 1e-3,
                toml::Value::Integer(number) => *number += 1 + *number / 10,
                toml::Value::Boolean(flag) => *flag = !*flag,
                _ => {}
            }
            visit(changed.as_table().unwrap(), &path.join("."));
        }
    }

    /// Parameters of the boards do not change the drawn robot. The drawn robot changes only the bridge zeros of the
    /// boards.
    #[test]
    fn board_parameters_and_true_robot_are_independent() {
        let plain = Scenario::default();
        let before = Simulation::new(&plain, 7, 3).unwrap().truth();
        let mut changed = 0;
        let mut table = toml::Table::try_from(plain.robot).unwrap();
        for_each_number(&mut table, &mut |table, number| {
            let robot: Result<RobotConfig, _> = table.clone().try_into();
            let Ok(robot) = robot else { return };
            let mut scenario = plain.clone();
            scenario.robot = robot;
            // Boards and true robot share the number of axles.
            if scenario.robot.topology() != plain.robot.topology() {
                return;
            }
            let Ok(robot) = Simulation::new(&scenario, 7, 3) else {
                return;
            };
            assert!(robot.truth() == before, "{number} moves the true robot");
            changed += u32::from(scenario.robot != plain.robot);
        });
        assert!(changed > 100, "{changed}");
        let mut other = plain.clone();
        other.world = World::load("ordinary").unwrap();
        let robot = Simulation::new(&other, 7, 3).unwrap();
        assert!(robot.truth() != before);
        // The boards get the bridge zeros, measured against a straight edge, and nothing else of the drawn robot.
        let configs = [&plain, &other].map(|scenario| {
            let mut config =
                crate::run::rig::board_config(scenario, &scenario.world.draw(Topology::PAIR, 7, 3));
            config.beam.calibration.zero_counts = plain.robot.beam.calibration.zero_counts;
            config
        });
        assert_eq!(configs[0], configs[1]);
    }

    #[test]
    fn draws_have_the_standard_deviations_of_the_world() {
        let world = World::load("careful").unwrap();
        let n = 4000;
        let draws: Vec<_> = (0..n)
            .map(|trial| world.draw(Topology::PAIR, 5, trial))
            .collect();
        let sigma = |value: &dyn Fn(&Drawn) -> f64| {
            (draws.iter().map(|d| value(d).powi(2)).sum::<f64>() / n as f64).sqrt()
        };
        for (found, wanted) in [
            (sigma(&|d| d.plant.side_slip[1]), 2e-3),
            (sigma(&|d| d.plant.carpet_drift[0]), 5e-3),
            (sigma(&|d| d.plant.slip_stiffness_factor[0][1].ln()), 0.3),
            (sigma(&|d| d.plant.bending_stiffness_factor - 1.0), 0.05),
            // Error of the bridge itself and error common to all bridges together.
            (
                sigma(&|d| d.frames[0].bridge_gain_error[2]),
                0.5e-2_f64.hypot(1e-2),
            ),
            (
                sigma(&|d| d.frames[0].bridge_drift[4]),
                2e-6_f64.hypot(3e-6),
            ),
            (sigma(&|d| d.gauge_creep_error), 5e-3),
            (sigma(&|d| d.wheel_radius_factor[0][0] - 1.0), 3e-3),
            (sigma(&|d| d.placement[2]), 5e-3),
        ] {
            assert!((found / wanted - 1.0).abs() < 0.05, "{found} for {wanted}");
        }
    }
}
