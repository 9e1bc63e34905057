//! `cfmmr keys`: the keys of a scenario with unit, default, allowed values and meaning.

use clap::Args;
use host_sim::base::error::Error;
use host_sim::scenario::keys::{allowed, json, keys, shortest_decimal};
use output::terminal;
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

/// Default value of a key, as a table cell in Markdown.
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
    use declare::Kind;
    use host_sim::scenario::keys::Key;

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
