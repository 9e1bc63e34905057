//! The figures of a world with unit and reason.
//!
//! A comment in a world file is the reason of the entries below it, up to the next comment, empty line or table.

use super::effect::leaves;
use super::{BASE, DEFAULT, FIELDS, World, text};
use crate::base::error::Error;
use crate::base::toml_file;
use serde::Serialize;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// Value of a world file with unit and reason.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Key of the figure in a world file.
    pub key: String,
    /// Value of the figure.
    pub value: Value,
    /// Unit; empty for a pure number or a word.
    pub unit: &'static str,
    /// Reason of the value; empty if the file gives none.
    pub reason: String,
    /// True if the world's file omits the key, so that the base value applies.
    pub base: bool,
}

/// All figures of a world: first the figures in its own file, then the base values.
pub fn figures(name: &str) -> Result<Vec<Figure>, Error> {
    let world = World::load(name)?;
    let table = Table::try_from(&world).map_err(|error| Error::Failure(error.to_string()))?;
    // Reasons of the tyre keys start with the default world: it has the brush tyre, base.toml the creep tyre.
    let mut base = reasons(&text(DEFAULT)?);
    base.retain(|key, _| key.starts_with("plant.tyre."));
    base.extend(reasons(BASE));
    let own = reasons(&text(name)?);
    let mut figures = Vec::new();
    leaves("", &table, &mut |key, value| {
        let reason = own.get(key).or_else(|| base.get(key));
        figures.push(Figure {
            key: key.to_owned(),
            value: value.clone(),
            unit: declare::find(FIELDS, key).map_or("", |field| field.kind.unit()),
            reason: reason.cloned().unwrap_or_default(),
            base: !own.contains_key(key),
        });
    });
    figures.sort_by_key(|figure| figure.base);
    Ok(figures)
}

/// Reasons in the text of a valid world, by key.
fn reasons(text: &str) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let (mut table, mut above, mut reason) = (String::new(), Vec::new(), String::new());
    for line in text.lines().map(str::trim) {
        if let Some(comment) = line.strip_prefix('#') {
            above.push(comment.trim());
            continue;
        }
        if let Some((name, _)) = line.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            table = format!("{}.", name.trim());
        } else if let Some((key, _)) = line.split_once('=') {
            if !above.is_empty() {
                reason = above.join(" ");
            }
            let key = toml_file::current_key(format!("{table}{}", key.trim()));
            found.insert(key, reason.clone());
            above.clear();
            continue;
        }
        // A comment before an empty line or a table is no reason.
        above.clear();
        reason.clear();
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::NAMES;

    #[test]
    fn each_figure_of_a_built_in_world_has_a_base_value_and_a_reason() {
        let base = reasons(BASE);
        for name in NAMES {
            let figures = figures(name).unwrap();
            assert!(figures.len() > 85, "{}", figures.len());
            for Figure { key, reason, .. } in figures {
                assert!(reason.len() > 3, "{name}: {key}");
                // Base.toml lacks the keys of the brush tyre.
                let tyre = key.starts_with("plant.tyre.");
                assert!(tyre || base.contains_key(&key), "no base value: {key}");
                assert!(declare::find(FIELDS, &key).is_some(), "{key}");
            }
        }
    }

    #[test]
    fn reason_of_an_earlier_table_name_has_the_current_key() {
        for text in [
            "[told]\n# By eye.\nplacement_m = 1",
            "# By eye.\ntold.placement_m = 1",
        ] {
            assert_eq!(reasons(text)["placement.placement_m"], "By eye.");
        }
    }

    #[test]
    fn comment_is_reason_of_entries_until_next_comment() {
        let text = "# Of the file.\n\n[a.b]\n# First,\n# and more.\nx = 1\ny = 2\n# Third.\nz = \"w\"\n\nv = 3\n";
        let reasons = reasons(text);
        let reason = |key: &str| reasons[key].as_str();
        assert_eq!(reason("a.b.x"), "First, and more.");
        assert_eq!(reason("a.b.y"), "First, and more.");
        assert_eq!(reason("a.b.z"), "Third.");
        assert_eq!(reason("a.b.v"), "");
    }
}
