//! The figures of a world with unit and reason, which are comments of its file.
//!
//! The comment above an entry is its reason, and that of the entries that follow it without a comment of
//! their own; what stands behind an entry of `base.toml` is the unit in every world.

use super::effect::leaves;
use super::{BASE, World, text};
use crate::base::error::Error;
use serde::Serialize;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// A figure of a world.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Its key in the file.
    pub key: String,
    /// Its value.
    pub value: Value,
    /// Its unit; nothing of a pure number or a word.
    pub unit: String,
    /// Why it has this value; nothing if the file does not say.
    pub reason: String,
    /// True if the world leaves it out, so that it has its base value.
    pub base: bool,
}

/// Comments of an entry.
#[derive(Clone, Debug, Default, PartialEq)]
struct Annotation {
    unit: String,
    reason: String,
}

/// All figures of a world, those of its own file first.
pub fn figures(name: &str) -> Result<Vec<Figure>, Error> {
    let world = World::load(name)?;
    let table = Table::try_from(&world).map_err(|error| Error::Failure(error.to_string()))?;
    let (own, base) = (comments(&text(name)?), comments(BASE));
    let mut figures = Vec::new();
    leaves("", &table, &mut |key, value| {
        let below = base.get(key).cloned().unwrap_or_default();
        figures.push(Figure {
            key: key.to_owned(),
            value: value.clone(),
            unit: below.unit,
            reason: own.get(key).map_or(below.reason, |own| own.reason.clone()),
            base: !own.contains_key(key),
        });
    });
    figures.sort_by_key(|figure| figure.base);
    Ok(figures)
}

/// The comments of a file that reads as a world, by key.
fn comments(text: &str) -> BTreeMap<String, Annotation> {
    let mut found = BTreeMap::new();
    let (mut table, mut above, mut reason) = (String::new(), Vec::new(), String::new());
    for line in text.lines().map(str::trim) {
        if let Some(comment) = line.strip_prefix('#') {
            above.push(comment.trim());
            continue;
        }
        if let Some((name, _)) = line.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            table = format!("{}.", name.trim());
        } else if let Some((key, value)) = line.split_once('=') {
            if !above.is_empty() {
                reason = above.join(" ");
            }
            let unit = value.split_once('#').map_or("", |(_, unit)| unit.trim());
            let annotation = Annotation {
                unit: unit.to_owned(),
                reason: reason.clone(),
            };
            found.insert(format!("{table}{}", key.trim()), annotation);
            above.clear();
            continue;
        }
        // A comment before an empty line or a table is none of an entry.
        above.clear();
        reason.clear();
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::NAMES;

    /// Every figure there is has a reason in every world, and what has a unit in its name bears it.
    #[test]
    fn each_figure_of_a_built_in_world_has_value_unit_and_reason() {
        let base = comments(BASE);
        for name in NAMES {
            let figures = figures(name).unwrap();
            assert!(figures.len() > 85, "{}", figures.len());
            for figure in figures {
                assert!(figure.reason.len() > 3, "{name}: {}", figure.key);
                let ends = [
                    ("_m", "m"),
                    ("_rad", "rad"),
                    ("_s", "s"),
                    ("_kg", "kg"),
                    ("_ms", "ms"),
                ];
                let wanted = ends.iter().find(|(end, _)| figure.key.ends_with(end));
                if let Some((_, unit)) = wanted {
                    assert!(
                        figure.unit.ends_with(unit),
                        "{}: {}",
                        figure.key,
                        figure.unit
                    );
                }
                assert!(
                    base.contains_key(&figure.key),
                    "no base value: {}",
                    figure.key
                );
            }
        }
    }

    #[test]
    fn a_comment_is_the_reason_of_what_follows_it_without_another() {
        let text = "# Of the file.\n\n[a.b]\n# First,\n# and more.\nx = 1 # m\ny = 2\n# Third.\nz = \"w\"\n\nv = 3\n";
        let annotation = comments(text);
        let reason = |key: &str| annotation[key].reason.as_str();
        assert_eq!(reason("a.b.x"), "First, and more.");
        assert_eq!(annotation["a.b.x"].unit, "m");
        assert_eq!(reason("a.b.y"), "First, and more.");
        assert_eq!(reason("a.b.z"), "Third.");
        assert_eq!(reason("a.b.v"), "");
    }
}
