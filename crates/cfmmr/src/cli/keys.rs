//! `cfmmr keys`: the keys of a scenario with unit, default, allowed values and meaning.

use clap::Args;
use declare::{Allowed, Field, Kind};
use host_sim::base::error::Error;
use host_sim::base::{spelling, toml_file};
use host_sim::scenario::{FIELDS, Scenario};
use output::terminal;
use serde_json::{Value, json};
use std::fmt::Write;

/// Arguments of `keys`.
#[derive(Clone, Debug, Args)]
pub struct KeysArgs {
    /// Table or key, for example robot.limits [default: all]
    pub key: Option<String>,
    /// Print JSON, one object per key
    #[arg(long)]
    pub json: bool,
}

/// Key with its table and default.
struct Key {
    name: String,
    table: String,
    field: &'static Field,
    default: Option<toml::Value>,
}

/// All keys, or the keys of a table; the keys of a table precede those of its subtables.
fn keys(wanted: Option<&str>) -> Result<Vec<Key>, Error> {
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

fn collect(
    table: &str,
    fields: &'static [Field],
    defaults: Option<&toml::Table>,
    keys: &mut Vec<Key>,
) {
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
fn allowed(kind: Kind) -> String {
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
fn shortest_decimal(number: f64) -> f64 {
    match f64::from(number as f32) == number {
        true => (number as f32).to_string().parse().unwrap_or(number),
        false => number,
    }
}

/// Default value of a key, in Markdown.
fn markdown_value(value: &toml::Value) -> String {
    match value {
        toml::Value::Float(number) => format!("`{:?}`", shortest_decimal(*number)),
        toml::Value::Array(list) => {
            let entries: Vec<String> = list.iter().map(markdown_value).collect();
            format!("`[{}]`", entries.join(", ").replace('`', ""))
        }
        value => format!("`{value}`"),
    }
}

/// Keys as a page of Markdown tables: all, or those of table `wanted`.
pub fn markdown(wanted: Option<&str>) -> Result<String, Error> {
    let mut text = String::from(
        "# Keys of a scenario\n\n\
         Change a key with `--set TABLE.KEY=VALUE` or a file given with `--scenario`. Defaults of `plant`,\n\
         `spread`, `sensors` and `bus` apply without a world; `cfmmr config` prints the values of a world.\n\
         A key without a default is not set. Bounds of a list apply to each entry. A scenario has one of\n\
         `plant.tyre.creep` (default without a world) and `plant.tyre.brush`: a key of one table replaces the\n\
         other table. Further keys: `world`, the name of a world; `boards.front`, `boards.rear` and\n\
         `boards.beam`, tables with parameters of one board (`cfmmr parameters`).\n",
    );
    let mut table = None;
    for key in keys(wanted)? {
        if table.as_ref() != Some(&key.table) {
            // Writing to a string does not fail.
            let _ = write!(
                text,
                "\n## {}\n\n| key | unit | default | allowed | meaning |\n|---|---|---|---|---|\n",
                key.table
            );
        }
        let default = key.default.as_ref().map_or(String::new(), markdown_value);
        let _ = writeln!(
            text,
            "| `{}` | {} | {default} | {} | {} |",
            key.field.name,
            key.field.kind.unit(),
            allowed(key.field.kind),
            key.field.meaning().replace('|', "\\|"),
        );
        table = Some(key.table);
    }
    Ok(text)
}

/// Default value of a key, in JSON.
fn json_value(value: &toml::Value) -> Value {
    match value {
        toml::Value::Float(number) => shortest_decimal(*number).into(),
        toml::Value::Array(list) => list.iter().map(json_value).collect(),
        value => serde_json::to_value(value).unwrap_or_default(),
    }
}

fn json(wanted: Option<&str>) -> Result<String, Error> {
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
                    let bounds = [low, high].map(|bound| toml::Value::Float(bound.into()));
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

/// Prints the page or the JSON.
pub fn run(args: &KeysArgs) -> Result<(), Error> {
    match args.json {
        true => terminal::print(&(json(args.key.as_deref())? + "\n")),
        false => terminal::print_page(&markdown(args.key.as_deref())?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_sim::world::effect;

    /// Compares the declared keys with the keys of a serialised scenario.
    #[test]
    fn declared_keys_are_those_of_a_file() {
        let keys = keys(None).unwrap();
        let declared: Vec<String> = keys.iter().map(|key| key.name.clone()).collect();
        let file = toml::Table::try_from(Scenario::default()).unwrap();
        for key in effect::keys(&file) {
            let known = declared.contains(&key) || key == "world";
            assert!(known, "{key} is not declared");
        }
        // The file lacks keys without default, so each is set to a text: the error is about the type, not about an
        // unknown key.
        for (key, declared) in keys.iter().zip(&declared) {
            if key.default.is_none() {
                let change = format!("{declared}=\"nothing\"");
                let why = Scenario::parse(None, "", "test", &[change]).unwrap_err();
                assert!(!why.to_string().contains("unknown"), "{why}");
            }
        }
    }

    #[test]
    fn keys_of_a_table_begin_with_its_name() {
        let limits = keys(Some("robot.limits")).unwrap();
        assert!(limits.len() > 1);
        let is_inside = |key: &Key| key.name.starts_with("robot.limits.");
        assert!(limits.iter().all(is_inside));
        let one = keys(Some("plant.friction")).unwrap();
        assert_eq!(one.len(), 1);
        for (wrong, hint) in [
            ("plant.frictoin", "plant.friction"),
            ("robot.limit", "robot.limits"),
        ] {
            let error = keys(Some(wrong)).err().unwrap().to_string();
            assert!(error.contains(hint), "{error}");
        }
    }

    #[test]
    fn every_key_has_a_meaning_and_a_default_that_is_allowed() {
        for key in keys(None).unwrap() {
            let name = key.field.name;
            let meaning = key.field.meaning();
            assert!(meaning.ends_with('.'), "{name}");
            assert!(!meaning.contains("[`"), "{name}: a link leads nowhere here");
            let numbers = match &key.default {
                Some(toml::Value::Float(number)) => vec![*number],
                Some(toml::Value::Integer(number)) => vec![*number as f64],
                _ => vec![],
            };
            if let Kind::Number { allowed, .. } = key.field.kind {
                for number in numbers {
                    assert!(allowed.check(name, number as f32).is_ok(), "{name}");
                }
            }
        }
    }
}
