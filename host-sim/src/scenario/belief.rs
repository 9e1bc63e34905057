//! Constants with two values in a scenario: the true value of the world, and the value configured in the boards.

use crate::scenario::Scenario;

/// A constant of the world and the board parameter of the same quantity.
pub struct Pair {
    /// Key of the true value.
    pub truth: &'static str,
    /// Key of the board parameter.
    pub belief: &'static str,
    values: fn(&Scenario) -> (Vec<f64>, Vec<f64>),
}

/// Declares pairs: keys, true values, values of the board parameters.
macro_rules! pairs {
    ($($truth:literal, $belief:literal: |$scenario:ident| $true_values:expr, $believed:expr;)*) => {
        &[$(Pair {
            truth: $truth,
            belief: $belief,
            values: |$scenario| ($true_values, $believed.into_iter().map(f64::from).collect()),
        }),*]
    };
}

/// All pairs of a true value and a board parameter.
pub const PAIRS: &[Pair] = pairs! {
    "plant.strip_length_m", "robot.geometry.frame_length_m":
        |it| vec![it.world.plant.strip_length_m], [it.robot.geometry.frame_length_m];
    "plant.bending_stiffness_n_m2", "robot.geometry.bending_stiffness_n_m2":
        |it| vec![it.world.plant.bending_stiffness_n_m2], [it.robot.geometry.bending_stiffness_n_m2];
    "plant.rigid_root_m", "robot.geometry.rigid_end_m":
        |it| vec![it.world.plant.rigid_root_m], [it.robot.geometry.rigid_end_m];
    "plant.rigid_tip_m", "robot.geometry.rigid_end_m":
        |it| vec![it.world.plant.rigid_tip_m], [it.robot.geometry.rigid_end_m];
    "plant.half_track_m", "robot.geometry.half_track_m":
        |it| it.world.plant.half_track_m.entries().to_vec(), [it.robot.geometry.half_track_m];
    "plant.wheel_radius_m", "robot.geometry.wheel_radius_m":
        |it| it.world.plant.wheel_radius_m.entries().as_flattened().to_vec(), [it.robot.geometry.wheel_radius_m];
    "plant.mass_kg", "robot.axle.controller.mass_kg":
        |it| it.world.plant.mass_kg.entries().to_vec(), [it.robot.axle.controller.mass_kg];
    "plant.yaw_inertia_kg_m2", "robot.axle.controller.yaw_inertia_kg_m2":
        |it| it.world.plant.yaw_inertia_kg_m2.entries().to_vec(), [it.robot.axle.controller.yaw_inertia_kg_m2];
    "plant.wheel_inertia_kg_m2", "robot.axle.controller.wheel_inertia_kg_m2":
        |it| vec![it.world.plant.wheel_inertia_kg_m2], [it.robot.axle.controller.wheel_inertia_kg_m2];
    "sensors.encoder.counts_per_revolution", "robot.geometry.encoder_counts_per_revolution":
        |it| vec![f64::from(it.world.sensors.encoder.counts_per_revolution)],
        [it.robot.geometry.encoder_counts_per_revolution];
    "sensors.bridge.half_thickness_m", "robot.geometry.half_thickness_m":
        |it| vec![it.world.sensors.bridge.half_thickness_m], [it.robot.geometry.half_thickness_m];
    "sensors.bridge.gauges_m", "robot.beam.strip.gauges_m":
        |it| it.world.sensors.bridge.gauges_m.to_vec(), it.robot.beam.strip.gauges_m.iter();
};

/// Largest relative difference of values that count as equal: single precision keeps seven digits.
const SAME: f64 = 1e-6;

impl Pair {
    /// Notice that the board parameter differs from the true value; `None` if both agree. A single parameter is
    /// compared with the mean of a list.
    fn notice(&self, scenario: &Scenario) -> Option<String> {
        let (truth, belief) = (self.values)(scenario);
        let is_same = |a: &f64, b: &f64| (a - b).abs() <= SAME * a.abs().max(b.abs());
        let agree = match belief.as_slice() {
            [one] => is_same(&(truth.iter().sum::<f64>() / truth.len() as f64), one),
            list => truth.len() == list.len() && truth.iter().zip(list).all(|(a, b)| is_same(a, b)),
        };
        let shown = |values: &[f64]| match values {
            [one] => (*one as f32).to_string(),
            list => format!(
                "{:?}",
                list.iter().map(|value| *value as f32).collect::<Vec<_>>()
            ),
        };
        (!agree).then(|| {
            format!(
                "{} = {} is the true value, {} = {} is configured: set both, unless the configuration should be wrong",
                self.truth,
                shown(&truth),
                self.belief,
                shown(&belief)
            )
        })
    }
}

/// One notice per board parameter that differs from the true value.
pub fn notices(scenario: &Scenario) -> Vec<String> {
    let used = |pair: &&Pair| scenario.mission.rps || !pair.truth.starts_with("sensors.bridge");
    let pairs = PAIRS.iter().filter(used);
    pairs.filter_map(|pair| pair.notice(scenario)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::NAMES;

    #[test]
    fn board_parameters_equal_the_true_means_in_built_in_worlds() {
        for name in NAMES {
            let scenario = Scenario::in_world(Some(name)).unwrap();
            assert_eq!(notices(&scenario), Vec::<String>::new(), "{name}");
        }
    }

    #[test]
    fn change_of_one_key_of_a_pair_gives_notice_and_of_both_none() {
        for pair in PAIRS {
            let mut scenario = Scenario::in_world(None).unwrap();
            let table = toml::Table::try_from(&scenario).unwrap();
            let at = |key: &str| {
                let mut parts = key.split('.');
                let first = &table[parts.next().unwrap()];
                parts.fold(first, |value, part| &value[part]).clone()
            };
            // Gauge positions, moved so that they stay on the strip.
            fn inwards(value: &toml::Value) -> toml::Value {
                match value {
                    toml::Value::Float(value) => toml::Value::Float(value * 0.9 + 0.01),
                    toml::Value::Array(list) => {
                        toml::Value::Array(list.iter().map(inwards).collect())
                    }
                    other => other.clone(),
                }
            }
            fn moved(value: &toml::Value) -> toml::Value {
                match value {
                    toml::Value::Float(0.0) => toml::Value::Float(0.005),
                    toml::Value::Float(value) => toml::Value::Float(value * 1.1),
                    toml::Value::Integer(value) => toml::Value::Integer(value / 2),
                    toml::Value::Array(list) => {
                        toml::Value::Array(list.iter().map(moved).collect())
                    }
                    other => other.clone(),
                }
            }
            let change = if pair.truth.ends_with("gauges_m") {
                inwards
            } else {
                moved
            };
            let truth = format!("{}={}", pair.truth, change(&at(pair.truth)));
            let belief = format!("{}={}", pair.belief, change(&at(pair.belief)));
            let with = |changes: &[String]| Scenario::parse(None, "", "test", changes);
            scenario = with(std::slice::from_ref(&truth)).unwrap();
            let found = notices(&scenario);
            assert!(
                found
                    .iter()
                    .any(|text| text.contains(pair.truth) && text.contains(pair.belief)),
                "{found:?}"
            );
            scenario = with(&[truth, belief]).unwrap();
            let both = notices(&scenario);
            assert!(
                both.iter().all(|text| !text.contains(pair.truth)),
                "{both:?}"
            );
        }
    }

    #[test]
    fn page_of_worlds_lists_each_pair() {
        let page = include_str!("../../../docs/worlds.md");
        for pair in PAIRS {
            for key in [pair.truth, pair.belief] {
                assert!(page.contains(&format!("`{key}`")), "{key}");
            }
        }
    }
}
