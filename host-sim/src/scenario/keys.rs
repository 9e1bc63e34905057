//! Keys of a scenario, from the declarations of its tables.

use crate::base::error::Error;
use crate::base::{spelling, toml_file};
use crate::scenario::{FIELDS, Scenario};
use declare::{Allowed, Field, Kind};
use serde_json::{Value as Json, json};
use toml::{Table, Value};

/// Key with its table and default.
pub struct Key {
    /// Table and field, joined by dots.
    pub name: String,
    /// Table of the key.
    pub table: String,
    /// Declaration of the key.
    pub field: &'static Field,
    /// Default without a world; `None` if the key is not set.
    pub default: Option<Value>,
}

/// All keys, or the keys of a table; the keys of a table precede those of its subtables.
pub fn keys(wanted: Option<&str>) -> Result<Vec<Key>, Error> {
    let failed = |error: toml::ser::Error| Error::Failure(error.to_string());
    let defaults = toml_file::known_keys(&Scenario::default()).map_err(failed)?;
    let mut keys = Vec::new();
    collect("", FIELDS, Some(&defaults), &mut keys);
    let Some(wanted) = wanted else {
        return Ok(keys);
    };
    let is_wanted = |key: &Key| {
        let rest = key.name.strip_prefix(wanted);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    };
    let known = keys.iter().flat_map(|key| [&key.table, &key.name]);
    let hint = spelling::hint(wanted, known.map(String::as_str));
    keys.retain(is_wanted);
    match keys.is_empty() {
        true => Err(Error::input(format!(
            "{wanted}: no key or table of a scenario{hint}; `cfmmr keys` prints all"
        ))),
        false => Ok(keys),
    }
}

fn collect(table: &str, fields: &'static [Field], defaults: Option<&Table>, keys: &mut Vec<Key>) {
    let is_table = |field: &&Field| matches!(field.kind, Kind::Table(_));
    for field in fields.iter().filter(|field| !is_table(field)) {
        keys.push(Key {
            name: format!("{table}.{}", field.name),
            table: table.to_owned(),
            field,
            default: defaults.and_then(|defaults| defaults.get(field.name).cloned()),
        });
    }
    for field in fields.iter().filter(is_table) {
        if let Kind::Table(inner) = field.kind {
            let table = match table {
                "" => field.name.to_owned(),
                _ => format!("{table}.{}", field.name),
            };
            let defaults = defaults.and_then(|defaults| defaults.get(field.name)?.as_table());
            collect(&table, inner, defaults, keys);
        }
    }
}

/// Allowed values in words.
pub fn allowed(kind: Kind) -> String {
    match kind {
        Kind::Number { allowed, whole, .. } => {
            let text = allowed.to_string();
            match whole {
                true => text.replacen("a number", "a whole number", 1).replacen(
                    "a finite number",
                    "a whole number",
                    1,
                ),
                false => text,
            }
        }
        Kind::Flag => "`true` or `false`".to_owned(),
        Kind::Choice(choices) => {
            let named = |choice: &declare::Choice| {
                format!(
                    "`\"{}\"`: {}",
                    choice.name,
                    choice.meaning().trim_end_matches('.')
                )
            };
            choices.iter().map(named).collect::<Vec<_>>().join("; ")
        }
        Kind::Table(_) => String::new(),
    }
}

/// Shortest decimal form of a single precision number (0.1, not 0.10000000149); other numbers stay.
pub fn shortest_decimal(number: f64) -> f64 {
    match f64::from(number as f32) == number {
        true => (number as f32).to_string().parse().unwrap_or(number),
        false => number,
    }
}

/// Default as a JSON value.
fn json_value(value: &Value) -> Json {
    match value {
        Value::Float(number) => shortest_decimal(*number).into(),
        Value::Array(list) => list.iter().map(json_value).collect(),
        value => serde_json::to_value(value).unwrap_or_default(),
    }
}

/// The keys of a table, or all keys, as a JSON list.
pub fn json(wanted: Option<&str>) -> Result<String, Error> {
    let mut list = Vec::new();
    for Key {
        name,
        field,
        default,
        ..
    } in keys(wanted)?
    {
        let mut key = json!({
            "key": name,
            "unit": field.kind.unit(),
            "default": default.as_ref().map(json_value),
            "allowed": allowed(field.kind).replace('`', ""),
            "meaning": field.meaning(),
        });
        match field.kind {
            Kind::Number { allowed, whole, .. } => {
                key["whole"] = whole.into();
                if let Allowed::Range(low, high) = allowed {
                    let bounds = [low, high].map(|bound| Value::Float(bound.into()));
                    key["range"] = bounds.iter().map(json_value).collect();
                }
            }
            Kind::Choice(choices) => {
                key["choices"] = choices.iter().map(|choice| choice.name).collect();
            }
            Kind::Flag | Kind::Table(_) => {}
        }
        list.push(key);
    }
    serde_json::to_string_pretty(&list).map_err(|error| Error::Failure(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::effect;

    /// Compares the declared keys with the keys of a serialised scenario.
    #[test]
    fn declared_keys_are_those_of_a_file() {
        let keys = keys(None).unwrap();
        let declared: Vec<String> = keys.iter().map(|key| key.name.clone()).collect();
        let file = Table::try_from(Scenario::default()).unwrap();
        for key in effect::keys(&file) {
            let known = declared.contains(&key) || key == "world";
            assert!(known, "{key} is not declared");
        }
        // A text for a key without default is refused for its type, not as an unknown key.
        for (key, declared) in keys.iter().zip(&declared) {
            if key.default.is_none() {
                let change = format!("{declared}=\"nothing\"");
                let why = Scenario::parse(None, "", "test", &[change]).unwrap_err();
                assert!(!why.to_string().contains("unknown"), "{why}");
            }
        }
    }
}
