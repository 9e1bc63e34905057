//! Parameters of single boards, laid over the parameters of all boards. They are part of a scenario, or a file that
//! `cfmmr params` reads and writes and `cfmmr calibrate` writes.
//!
//! ```toml
//! [boards.rear]
//! robot.geometry.wheel_radius_m = 0.07304  # m, 0.01 to 0.5
//! [boards.beam]
//! robot.beam.calibration.gain = [1.002, 0.999, 1.0, 1.004, 0.998]
//! ```

use crate::base::error::Error;
use crate::base::toml_file;
use core_algos::params::{Parameter, Settings, TABLE, find};
use core_algos::topology::{MAX_AXLES, Role, Topology};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::{BTreeMap, HashMap};
use std::fmt::Write;
use toml::{Table, Value};

/// Parameters with their values.
pub type Values = Vec<(&'static Parameter, f32)>;

/// Names of boards in a file, of robots with any number of axles.
const NAMES: [&str; 10] = [
    "front", "axle-2", "axle-3", "axle-4", "rear", "beam", "beam-1", "beam-2", "beam-3", "beam-4",
];

/// Parameters by board, named as in `cfmmr parameters`. A file gives the parameter of a gauge as an entry of a list, or
/// alone under a key such as `"gain[0]"`.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlays {
    /// Topology of the robot.
    pub topology: Topology,
    /// Tables by the boards' names.
    tables: BTreeMap<&'static str, Table>,
}

impl Default for Overlays {
    fn default() -> Self {
        Self::new(Topology::PAIR)
    }
}

impl Serialize for Overlays {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let names = self.topology.boards().map(|role| self.topology.name(role));
        let empty = Table::new();
        let table = |name| (name, self.tables.get(name).unwrap_or(&empty));
        to.collect_map(names.map(table))
    }
}

impl<'de> Deserialize<'de> for Overlays {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        /// Board with a name in [`NAMES`].
        #[derive(PartialEq, Eq, Hash)]
        struct Board(&'static str);

        impl<'de> Deserialize<'de> for Board {
            fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
                let name = String::deserialize(from)?;
                let known = NAMES.into_iter().find(|board| *board == name);
                let unknown = || D::Error::unknown_field(&name, &NAMES);
                known.map(Self).ok_or_else(unknown)
            }
        }

        let mut overlays = Self::default();
        for (board, table) in HashMap::<Board, Table>::deserialize(from)? {
            overlays.tables.insert(board.0, table);
        }
        // Empty tables, as in the defaults of another robot, name no board.
        overlays.tables.retain(|_, table| !table.is_empty());
        Ok(overlays)
    }
}

impl Overlays {
    /// Overlays without parameters.
    pub fn new(topology: Topology) -> Self {
        Self {
            topology,
            tables: BTreeMap::new(),
        }
    }

    /// The parameters, for the boards of `topology`.
    pub fn of(self, topology: Topology) -> Self {
        Self { topology, ..self }
    }

    /// Refuses parameters of a board that the robot does not have.
    pub fn check(&self) -> Result<(), Error> {
        let robot = self.topology;
        let own: Vec<_> = robot.boards().map(|role| robot.name(role)).collect();
        match self.tables.keys().find(|name| !own.contains(name)) {
            None => Ok(()),
            Some(name) => Err(Error::input(format!(
                "boards.{name}: a robot of {} axles has no such board; its boards are {}",
                robot.axle_count(),
                own.join(", ")
            ))),
        }
    }

    /// Reads a file that holds board parameters only; `name` is the file's name in errors.
    pub fn parse(text: &str, name: &str) -> Result<Self, Error> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            boards: Overlays,
        }
        let file: File =
            toml::from_str(text).map_err(|error| toml_file::refusal(name, text, &error))?;
        // The smallest robot that has all boards of the file.
        let robots = (2..=MAX_AXLES).filter_map(Topology::new);
        let mut robots = robots.map(|robot| file.boards.clone().of(robot));
        let boards = robots.find(|boards| boards.check().is_ok());
        let boards = boards
            .ok_or(())
            .or_else(|()| file.boards.check().map(|()| file.boards))?;
        for role in boards.topology.boards() {
            boards.values(role)?;
        }
        Ok(boards)
    }

    /// Parameters of a board; an error names the key.
    pub fn values(&self, role: Role) -> Result<Values, Error> {
        let board = self.topology.name(role);
        let mut values = Vec::new();
        for (key, value) in self.tables.get(board).into_iter().flatten() {
            flatten(board, key, value, &mut values)?;
        }
        Ok(values)
    }

    /// Sets the parameters of a board in the settings of the board.
    pub fn apply(&self, role: Role, settings: &mut Settings) -> Result<(), Error> {
        for (parameter, value) in self.values(role)? {
            let set = parameter.set(settings, value);
            set.map_err(|error| named(self.topology.name(role), &error.to_string()))?;
        }
        Ok(())
    }

    /// Adds or replaces parameters of a board.
    pub fn put(&mut self, role: Role, values: &[(&'static Parameter, f32)]) {
        if values.is_empty() {
            return;
        }
        let table = self.tables.entry(self.topology.name(role)).or_default();
        for (parameter, value) in values {
            let mut keys: Vec<&str> = parameter.name.split('.').collect();
            let last = keys.pop().unwrap_or_default();
            let mut place = &mut *table;
            for key in keys {
                let entry = place.entry(key).or_insert_with(|| Table::new().into());
                let Value::Table(inner) = entry else {
                    return;
                };
                place = inner;
            }
            // The list is removed: a list beside a single entry would give one gauge two values.
            if let Some((list, _)) = last.split_once('[') {
                place.remove(list);
            }
            place.insert(last.to_owned(), Value::Float(shortest(*value)));
        }
    }

    /// Text of a parameter file, with units and ranges as comments.
    pub fn to_toml(&self) -> Result<String, Error> {
        let mut text = String::new();
        for role in self.topology.boards() {
            let values = self.values(role)?;
            if values.is_empty() {
                continue;
            }
            let gap = if text.is_empty() { "" } else { "\n" };
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{gap}[boards.{}]", self.topology.name(role));
            for (parameter, value) in values {
                let (low, high) = parameter.range;
                let name = match parameter.name.rsplit_once('.') {
                    Some((path, last)) if last.ends_with(']') => format!("{path}.\"{last}\""),
                    _ => parameter.name.to_owned(),
                };
                let unit = match parameter.unit {
                    "" => String::new(),
                    unit => format!("{unit}, "),
                };
                let _ = writeln!(
                    text,
                    "{name} = {value:?}  # {unit}{low} to {high}: {}",
                    parameter.meaning()
                );
            }
        }
        Ok(text)
    }
}

/// Parameter named `name`; the error suggests similar names.
pub fn parameter(name: &str) -> Result<&'static Parameter, Error> {
    find(name).ok_or_else(|| {
        let last = name.rsplit('.').next().unwrap_or(name);
        let like = TABLE.iter().filter(|p| p.name.contains(last));
        let like: Vec<&str> = like.map(|p| p.name).take(3).collect();
        let hint = match like.is_empty() || last.is_empty() {
            true => "see `cfmmr parameters`".to_owned(),
            false => format!("did you mean {}?", like.join(", ")),
        };
        Error::input(format!("{name}: no such parameter; {hint}"))
    })
}

/// Double with the same shortest decimal form as `value`.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(value.into())
}

fn named(board: &str, text: &str) -> Error {
    Error::input(format!("boards.{board}: {text}"))
}

fn flatten(board: &str, name: &str, value: &Value, values: &mut Values) -> Result<(), Error> {
    let number = match value {
        Value::Table(table) => {
            let mut entries = table.iter();
            return entries.try_for_each(|(key, inner)| {
                flatten(board, &format!("{name}.{key}"), inner, values)
            });
        }
        Value::Array(list) => {
            let mut entries = list.iter().enumerate();
            return entries
                .try_for_each(|(i, inner)| flatten(board, &format!("{name}[{i}]"), inner, values));
        }
        Value::Float(number) => *number as f32,
        Value::Integer(number) => *number as f32,
        other => return Err(named(board, &format!("{name} = {other}: must be a number"))),
    };
    let parameter = parameter(name).map_err(|error| named(board, &error.to_string()))?;
    let valid = parameter.validate(number);
    values.push((
        parameter,
        valid.map_err(|error| named(board, &error.to_string()))?,
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::params::BoardKind;

    #[test]
    fn written_parameters_are_read_back_bit_by_bit() {
        let mut overlays = Overlays::default();
        for (i, role) in Topology::PAIR.boards().enumerate() {
            let some = TABLE.iter().skip(i).step_by(3);
            let values: Values = some
                .map(|p| {
                    let (low, high) = p.range;
                    let value = low + 0.3 * (high - low);
                    (p, if p.whole { value.floor() } else { value })
                })
                .collect();
            overlays.put(role, &values);
        }
        let text = overlays.to_toml().unwrap();
        let read = Overlays::parse(&text, "file").unwrap();
        for role in Topology::PAIR.boards() {
            let bits = |overlays: &Overlays| -> Vec<(u8, u32)> {
                let mut all: Vec<_> = overlays.values(role).unwrap();
                all.sort_by_key(|(p, _)| p.id);
                all.iter().map(|(p, v)| (p.id, v.to_bits())).collect()
            };
            assert!(bits(&read).len() >= TABLE.len() / 3);
            assert_eq!(bits(&read), bits(&overlays), "{text}");
        }
    }

    #[test]
    fn each_board_of_three_axles_has_its_table() {
        let robot = Topology::new(3).unwrap();
        let mut overlays = Overlays::new(robot);
        let radius = find("robot.geometry.wheel_radius_m").unwrap();
        overlays.put(Role::axle(1), &[(radius, 0.07)]);
        let text = overlays.to_toml().unwrap();
        assert!(text.starts_with("[boards.axle-2]\n"), "{text}");
        assert!(overlays.values(Role::axle(2)).unwrap().is_empty());
    }

    /// The name `rear` is a board of every robot; inner boards are refused on a shorter robot.
    #[test]
    fn boards_that_the_robot_does_not_have_are_refused_by_name() {
        let table =
            |board: &str| format!("[boards.{board}]\nrobot.geometry.wheel_radius_m = 0.07\n");
        for (board, axles) in [("rear", 2), ("axle-2", 3), ("beam-1", 3), ("beam-4", 5)] {
            let overlays = Overlays::parse(&table(board), "file").unwrap();
            assert_eq!(overlays.topology.axle_count(), axles, "{board}");
        }
        let overlays = Overlays::parse(&table("axle-2"), "file").unwrap();
        let error = overlays.of(Topology::PAIR).check().unwrap_err().to_string();
        assert!(
            error.contains("boards.axle-2") && error.contains("front, rear, beam"),
            "{error}"
        );
    }

    #[test]
    fn list_entry_and_single_entry_set_same_parameter_and_last_counts() {
        let list = "[boards.beam]\nrobot.beam.calibration.gain = [1.0, 1.5, 1, 1.0, 1.0]\n";
        let mut overlays = Overlays::parse(list, "file").unwrap();
        let mut settings = Settings::of(BoardKind::Beam);
        overlays.apply(Role::beam(0), &mut settings).unwrap();
        assert_eq!(settings.robot.beam.calibration.gain.padded()[1], 1.5);
        overlays.put(
            Role::beam(0),
            &[(find("robot.beam.calibration.gain[1]").unwrap(), 1.25)],
        );
        overlays.apply(Role::beam(0), &mut settings).unwrap();
        assert_eq!(settings.robot.beam.calibration.gain.padded()[1], 1.25);
    }

    #[test]
    fn invalid_entries_are_refused_by_board_key_and_range() {
        for (text, words) in [
            (
                "[boards.rear]\nrobot.geometry.wheel_radius_m = 9",
                ["boards.rear", "wheel_radius_m = 9", "0.01 to 0.5"],
            ),
            (
                "[boards.rear]\nrobot.geometry.wheel_radius_m = nan",
                ["boards.rear", "wheel_radius_m = NaN", "0.01 to 0.5"],
            ),
            (
                "[boards.front]\nrobot.wheel_radius_m = 0.07",
                [
                    "boards.front",
                    "no such parameter",
                    "robot.geometry.wheel_radius_m",
                ],
            ),
            (
                "[boards.beam]\nrobot.geometry.wheel_radius_m = true",
                ["boards.beam", "wheel_radius_m", "must be a number"],
            ),
            ("[boards.middle]\n", ["file", "middle", "front"]),
            ("[robot]\n", ["file", "robot", "boards"]),
        ] {
            let error = Overlays::parse(text, "file").unwrap_err();
            assert_eq!(error.exit_code(), 2);
            for word in words {
                assert!(error.to_string().contains(word), "no {word} in {error}");
            }
        }
    }
}
