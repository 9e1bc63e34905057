//! Rules by which a key of a world has no effect.

use crate::base::error::Error;
use crate::world::World;
use plant::Tyre;
use toml::{Table, Value};

/// Declares rules: keys, condition, reason.
macro_rules! rules {
    ($($keys:literal: $idle:expr => $reason:literal;)*) => {
        &[$(($keys, $idle, $reason)),*]
    };
}

pub(crate) use rules;

/// Keys or tables separated by spaces, the condition under which they have no effect, and the reason.
pub type Rules<Condition> = &'static [(&'static str, Condition, &'static str)];

/// Rules whose condition depends on the world alone.
const WORLD: Rules<fn(&World) -> bool> = rules! {
    "plant.tyre.creep": |world| matches!(world.plant.tyre, Tyre::Brush(_)) => "with plant.tyre.brush; give plant.tyre.creep alone";
    "plant.tyre.brush spread.slip_stiffness":
        |world| matches!(world.plant.tyre, Tyre::Creep(_)) => "with plant.tyre.creep; give plant.tyre.brush";
    "plant.static_decay_m_s": |world| world.plant.static_excess == 0.0 => "with plant.static_excess = 0";
    "plant.load_transfer_time_s":
        |world| world.plant.center_of_mass_height_m == 0.0 => "with plant.center_of_mass_height_m = 0";
    "plant.rotor_inertia_share":
        |world| world.plant.backlash_rad.entries().iter().all(|both| *both == [0.0; 2]) && world.spread.backlash_rad == 0.0 =>
            "without backlash: plant.backlash_rad and spread.backlash_rad are 0";
    "plant.cogging_periods plant.cogging_phase_rad":
        |world| world.plant.cogging_torque_n_m == 0.0 => "with plant.cogging_torque_n_m = 0";
    "plant.downhill_rad": |world| world.plant.slope_rad == 0.0 => "with plant.slope_rad = 0";
    "plant.payload_position_m": |world| world.plant.payload_kg.entries().iter().all(|mass| *mass == 0.0) => "with plant.payload_kg = 0";
    "sensors.bridge.warming_time_s sensors.bridge.zero_per_k_sigma_strain \
     sensors.bridge.gain_per_k":
        |world| world.sensors.bridge.warming_k == 0.0 => "with sensors.bridge.warming_k = 0";
    "sensors.bridge.creep_time_s":
        |world| world.sensors.bridge.creep_share == 0.0 && world.sensors.bridge.creep_sigma == 0.0 =>
            "with sensors.bridge.creep_share = 0 and creep_sigma = 0";
};

/// Refuses a world file that sets a key without effect.
pub fn check_world(text: &str, world: &World) -> Result<(), Error> {
    let keys = keys(&toml::from_str(text).unwrap_or_default());
    let idle = |key: &String| Some(format!("{key}: no effect {}", in_world(key, world)?));
    match keys.iter().find_map(idle) {
        Some(text) => Err(Error::input(format!("world = {}: {text}", world.name))),
        None => Ok(()),
    }
}

/// Reason that a key has no effect in a world; `None` if the key has an effect.
pub fn in_world(key: &str, world: &World) -> Option<&'static str> {
    let mut rules = WORLD.iter().filter(|(keys, ..)| listed(key, keys));
    rules
        .find(|(_, idle, _)| idle(world))
        .map(|(.., reason)| *reason)
}

/// True if `key` is one of `keys`, or an entry of a table or list in `keys`.
pub fn listed(key: &str, keys: &str) -> bool {
    keys.split_whitespace().any(|other| within(key, other))
}

/// True if `key` is `prefix`, or an entry of that table or list.
pub fn within(key: &str, prefix: &str) -> bool {
    key.strip_prefix(prefix)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

/// Keys of all values that are not tables.
pub fn keys(table: &Table) -> Vec<String> {
    let mut keys = Vec::new();
    leaves("", table, &mut |key, _| keys.push(key.to_owned()));
    keys
}

/// Visits all values that are not tables with their keys.
pub fn leaves(prefix: &str, table: &Table, visit: &mut impl FnMut(&str, &Value)) {
    for (name, value) in table {
        let key = match prefix {
            "" => name.clone(),
            _ => format!("{prefix}.{name}"),
        };
        match value {
            Value::Table(inner) => leaves(&key, inner, visit),
            _ => visit(&key, value),
        }
    }
}
