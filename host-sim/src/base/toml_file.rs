//! Builds a scenario or world from TOML text and command-line changes; refuses unknown keys.
//!
//! The text is laid over the defaults of the whole type `T`. An omitted key has the default of `T`, which may differ
//! from the default of its table.

use crate::base::error::Error;
use crate::base::input;
use crate::base::spelling;
use crate::base::spelling::UNKNOWN;
use plant::{Brush, Creep, Tyre};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_path_to_error::{Path, Segment};
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// Key of the tyre in the table `plant`; the tyre has exactly one of the tables [`LAWS`].
const TYRE: &str = "tyre";
/// Tyre laws, each a table below [`TYRE`].
const LAWS: [&str; 2] = ["creep", "brush"];
/// Keys of version 0.1 in the table `plant`, each with its replacement.
const RENAMED: [(&str, &str); 3] = [
    ("creep_velocity_m_s", "tyre.creep.velocity_m_s"),
    ("slip_stiffness", "tyre.brush.slip_stiffness"),
    ("rest_creep_velocity_m_s", "tyre.brush.rest_velocity_m_s"),
];
/// Tables with an earlier name that is read too: earlier name, name.
const EARLIER_TABLES: [(&str, &str); 1] = [("told", "placement")];
/// Largest number of names in a dotted key on the command line; `a.b.c` has 3.
const DEPTH: usize = 16;
/// Longest text in which the line with too deep nesting is searched, bytes.
const LONGEST_SEARCHED: usize = 100_000;

/// Text of a file and its name in errors; the text is empty without a file.
pub fn read(file: Option<&std::path::Path>) -> Result<(String, String), Error> {
    let Some(path) = file else {
        return Ok((String::new(), "scenario".to_owned()));
    };
    let name = path.display().to_string();
    let text = input::text(path).map_err(|error| Error::input(format!("{name}: {error}")))?;
    Ok((text, name))
}

/// Builds `T` from TOML text laid over its defaults. `name` is the name of the text in errors.
pub fn parse<T>(text: &str, name: &str, changes: &[String]) -> Result<T, Error>
where
    T: Default + Serialize + DeserializeOwned,
{
    build(&T::default(), text, name, changes)
}

/// Lays TOML text over `below`, applies the `KEY=VALUE` changes in order, and builds `T`. `name` is the name of the
/// text in errors.
pub fn build<T>(below: &T, text: &str, name: &str, changes: &[String]) -> Result<T, Error>
where
    T: Serialize + DeserializeOwned,
{
    let given = toml::from_str(text);
    let mut given: Table = given.map_err(|error| refusal(name, text, &error))?;
    check_tyre(&given, name)?;
    merge_config(&mut given, self::changes(changes)?);
    let mut table = Table::try_from(below).map_err(|error| Error::Failure(error.to_string()))?;
    rename_tables(&mut given, &table);
    let written = given.clone();
    merge_config(&mut table, given);
    let built: T = serde_path_to_error::deserialize(Value::Table(table)).map_err(|error| {
        // With changes, the refused value may come from the command line: no line of the text is named.
        let line = match changes {
            [] => line(text, error.path()).map(|line| format!("line {line}: ")),
            _ => None,
        };
        let (line, path) = (line.unwrap_or_default(), error.path().to_string());
        let form = known_keys(below).map(|known| form_at(&known, error.path()));
        let message = spelling::with_list(error.inner().message(), form.unwrap_or_default());
        match message.starts_with("unknown field") {
            true => {
                let key = whole_key(path, &written);
                let suggestion = known_keys(below).map(|known| spelling::unknown_key(&key, &known));
                let suggestion = suggestion.unwrap_or_default();
                Error::input(format!("{name}: {line}{key}{UNKNOWN}{suggestion}"))
            }
            false => shown(spelling::in_plain_words(&format!(
                "{name}: {line}{path}: {message}"
            ))),
        }
    })?;
    // Checked as stored: a number that is finite in the text may be too large for its field.
    let stored = Value::try_from(&built).map_err(|error| Error::Failure(error.to_string()))?;
    match not_finite(&stored) {
        Some((path, value)) => Err(Error::input(format!(
            "{name}: {path} = {value}: must be a finite number within its field's precision"
        ))),
        None => Ok(built),
    }
}

/// Gives tables with an earlier name their name if `known` has it. A table given under both names remains and is refused.
fn rename_tables(given: &mut Table, known: &Table) {
    for (earlier, name) in EARLIER_TABLES {
        if known.contains_key(name)
            && !given.contains_key(name)
            && let Some(table) = given.remove(earlier)
        {
            given.insert(name.to_owned(), table);
        }
    }
}

/// Key with the name of its table in place of the table's earlier name.
pub fn current_key(key: String) -> String {
    let renamed = EARLIER_TABLES.iter().find_map(|(earlier, name)| {
        let rest = key.strip_prefix(earlier)?;
        rest.starts_with('.').then(|| format!("{name}{rest}"))
    });
    renamed.unwrap_or(key)
}

/// Refuses keys of version 0.1, naming their replacements, and a tyre with an unknown law or two laws.
fn check_tyre(given: &Table, name: &str) -> Result<(), Error> {
    let Some(plant) = given.get("plant").and_then(Value::as_table) else {
        return Ok(());
    };
    let form = match plant.get(TYRE) {
        None => None,
        Some(Value::Table(laws)) => {
            let mut laws = laws.iter();
            match (laws.next(), laws.next()) {
                (Some((first, _)), Some((second, _))) => Some(format!(
                    "plant.tyre has {first} and {second}: must have one of them"
                )),
                (Some((law, value)), None) if LAWS.contains(&law.as_str()) && !value.is_table() => {
                    Some(format!("plant.tyre.{law} = {value}: must be a table"))
                }
                (Some((law, _)), None) if !LAWS.contains(&law.as_str()) => Some(format!(
                    "plant.tyre.{law}: unknown key; must be creep or brush"
                )),
                _ => None,
            }
        }
        Some(Value::String(law)) if LAWS.contains(&law.as_str()) => Some(format!(
            "plant.tyre = \"{law}\" is now plant.tyre.{law} = {{}}"
        )),
        Some(other) => Some(format!(
            "plant.tyre = {other}: must be a table with creep or brush"
        )),
    };
    let renamed = RENAMED.iter().filter(|(old, _)| plant.contains_key(*old));
    let renamed = renamed.map(|(old, new)| format!("plant.{old} is now plant.{new}"));
    let texts: Vec<String> = form.into_iter().chain(renamed).collect();
    match texts.is_empty() {
        true => Ok(()),
        false => Err(shown(format!("{name}: {}", texts.join("; ")))),
    }
}

/// All keys that `T` may have, with values; includes the tyre law that `whole` does not use.
pub fn known_keys<T: Serialize>(whole: &T) -> Result<Table, toml::ser::Error> {
    let mut table = Table::try_from(whole)?;
    let plant = table.get_mut("plant").and_then(Value::as_table_mut);
    if let Some(Value::Table(laws)) = plant.and_then(|plant| plant.get_mut(TYRE)) {
        for other in [Tyre::Creep(Creep::default()), Tyre::Brush(Brush::default())] {
            for (law, values) in Table::try_from(other)? {
                laws.entry(law).or_insert(values);
            }
        }
    }
    Ok(table)
}

/// Default value of the list at `path` as text, an example of its form. `None` if the default is not a list with
/// entries.
fn form_at(known: &Table, path: &Path) -> Option<String> {
    let mut parts = path.iter();
    let Some(Segment::Map { key }) = parts.next() else {
        return None;
    };
    let first = known.get(key)?;
    let form = parts.try_fold(first, |value, part| match part {
        Segment::Map { key } => value.get(key),
        Segment::Enum { variant } => value.get(variant),
        // The first entry stands for all: the entries of a list have one form.
        Segment::Seq { .. } => value.get(0),
        Segment::Unknown => None,
    })?;
    form.as_array()
        .is_some_and(|entries| !entries.is_empty())
        .then(|| short(form))
}

/// A value as TOML, with numbers in single precision.
fn short(value: &Value) -> String {
    match value {
        Value::Float(number) => format!("{:?}", *number as f32),
        Value::Array(entries) => {
            let entries: Vec<String> = entries.iter().map(short).collect();
            format!("[{}]", entries.join(", "))
        }
        other => other.to_string(),
    }
}

/// Full key of an entry whose `path` ends at an unknown table: the first key in that table, and in the tables below it,
/// is appended.
fn whole_key(mut path: String, written: &Table) -> String {
    let mut value = path
        .split('.')
        .try_fold(written, |table, part| table.get(part)?.as_table());
    while let Some((key, below)) = value.and_then(|table| table.iter().next()) {
        path = format!("{path}.{key}");
        value = below.as_table();
    }
    path.chars().take(LONGEST_LINE).collect()
}

/// Line, from 1, of the entry at `path`, or of the deepest part of `path` that the text contains. `None` if the text
/// contains no part.
fn line(text: &str, path: &Path) -> Option<usize> {
    let root = DeValue::Table(DeTable::parse(text).ok()?.into_inner());
    let (mut value, mut start) = (&root, None);
    for segment in path {
        let inner = match segment {
            Segment::Map { key } => value.get(key),
            Segment::Seq { index } => value.get(*index),
            Segment::Enum { variant } => value.get(variant.as_str()),
            Segment::Unknown => None,
        };
        let Some(inner) = inner else { break };
        (value, start) = (inner.get_ref(), Some(inner.span().start));
    }
    Some(1 + text[..start?].matches('\n').count())
}

/// Length to which a line of an error is cut, characters.
const LONGEST_LINE: usize = 400;

/// Input error with the text of a TOML error: suggests a correctly spelt key and cuts long lines.
fn shown(text: String) -> Error {
    let text = spelling::with_sibling(text);
    let lines = text.lines();
    let cut = lines.map(|line| line.chars().take(LONGEST_LINE).collect());
    Error::input(cut.collect::<Vec<String>>().join("\n"))
}

/// Input error from an error of the TOML parser; names file, line and key.
pub fn refusal(name: &str, text: &str, error: &toml::de::Error) -> Error {
    if error.span().is_some() {
        return shown(format!("{name}: {error}"));
    }
    // The parser's error about too deep nesting has no position. The reported line is the first line at which the text
    // up to that line gives this error. Every line is tried, so a text above `LONGEST_SEARCHED` gets no line.
    let message = error.message();
    let refused = |end: usize| {
        toml::from_str::<Table>(&text[..end])
            .is_err_and(|part| part.span().is_none() && part.message() == message)
    };
    let ends = text
        .match_indices('\n')
        .map(|(start, end)| start + end.len());
    let line = match text.len() {
        ..=LONGEST_SEARCHED => ends.chain([text.len()]).position(refused),
        _ => None,
    };
    let line = line.map_or_else(String::new, |before| format!("line {}: ", before + 1));
    Error::input(format!("{name}: {line}{message}"))
}

/// Path and value of the first number that is not finite. Later range checks miss a given number that a derived value
/// has replaced. `None` if all numbers are finite.
fn not_finite(value: &Value) -> Option<(String, f64)> {
    let within = |key: &str, inner: &Value| {
        let (path, number) = not_finite(inner)?;
        let dot = if path.is_empty() || path.starts_with('[') {
            ""
        } else {
            "."
        };
        Some((format!("{key}{dot}{path}"), number))
    };
    match value {
        Value::Float(number) if !number.is_finite() => Some((String::new(), *number)),
        Value::Array(values) => {
            let mut numbered = values.iter().enumerate();
            numbered.find_map(|(i, inner)| within(&format!("[{i}]"), inner))
        }
        Value::Table(table) => table.iter().find_map(|(key, inner)| within(key, inner)),
        _ => None,
    }
}

/// Merges `given` into `table`, table by table. A given tyre law removes another law from `table`.
pub fn merge_config(table: &mut Table, given: Table) {
    for (key, value) in given {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => {
                if key == TYRE && !above.is_empty() {
                    below.retain(|other, _| above.contains_key(other));
                }
                merge_config(below, above);
            }
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// Table of `KEY=VALUE` changes; the last change of a key counts.
pub fn changes(changes: &[String]) -> Result<Table, Error> {
    let mut table = Table::new();
    for change in changes {
        apply(&mut table, change)?;
        check_tyre(&table, "--set")?;
    }
    Ok(table)
}

fn apply(table: &mut Table, change: &str) -> Result<(), Error> {
    let Some((key, value)) = change.split_once('=') else {
        return Err(Error::input(format!(
            "--set {change}: must be KEY=VALUE, for example mission.rps=false"
        )));
    };
    // A bare word is a string: --set mission.fusion=joint needs no quotes within quotes.
    let value = toml::from_str::<Table>(&format!("v = {value}"))
        .ok()
        .and_then(|mut table| table.remove("v"))
        .unwrap_or_else(|| Value::String(value.to_owned()));
    let mut keys: Vec<&str> = key.trim().split('.').collect();
    if keys.len() > DEPTH {
        return Err(Error::input(format!(
            "--set {change}: a key of {} parts: must be at most {DEPTH}",
            keys.len()
        )));
    }
    let last = keys.pop().unwrap_or_default();
    let mut target = table;
    for part in keys {
        target = target
            .entry(part)
            .or_insert_with(|| Value::Table(Table::new()))
            .as_table_mut()
            .ok_or_else(|| Error::input(format!("--set {change}: {part} is not a table")))?;
    }
    match (target.get_mut(last), value) {
        (Some(Value::Table(below)), Value::Table(above)) => merge_tables(below, above),
        (_, value) => _ = target.insert(last.to_owned(), value),
    }
    Ok(())
}

/// Merges `above` into `table`, table by table; tyre laws are not special here, unlike in [`merge_config`].
fn merge_tables(table: &mut Table, above: Table) {
    for (key, value) in above {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge_tables(below, above),
            (_, value) => _ = table.insert(key, value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Inner {
        loss: f64,
        kind: String,
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Outer {
        bus: Inner,
        rps: bool,
    }

    impl Default for Outer {
        fn default() -> Self {
            let kind = "slow".to_owned();
            Self {
                bus: Inner { loss: 0.0, kind },
                rps: false,
            }
        }
    }

    fn changed(changes: &[&str]) -> Result<Outer, Error> {
        let changes: Vec<String> = changes.iter().map(|&c| c.to_owned()).collect();
        parse("[bus]\nloss = 0.25\n", "test", &changes)
    }

    #[test]
    fn changes_override_the_file() {
        let outer = changed(&["bus.kind=fast", "rps=true", "bus.loss=0.5"]).unwrap();
        assert_eq!(outer.bus.loss, 0.5);
        assert_eq!(outer.bus.kind, "fast");
        assert!(outer.rps);
        assert_eq!(changed(&[]).unwrap().bus.loss, 0.25);
    }

    #[test]
    fn omitted_key_has_default_of_the_whole_type() {
        assert_eq!(changed(&[]).unwrap().bus.kind, "slow");
        assert_eq!(changed(&["rps=true"]).unwrap().bus.kind, "slow");
    }

    #[test]
    fn number_that_is_not_finite_in_its_field_is_refused() {
        #[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(default)]
        struct Narrow {
            sigmas: [f32; 2],
            inner: Inner,
        }
        let text = |change: &str| {
            let read = parse::<Narrow>("", "test", &[change.to_owned()]);
            read.unwrap_err().to_string()
        };
        assert!(text("inner.loss=nan").contains("test: inner.loss = NaN: must be"));
        assert!(text("inner.loss=-inf").contains("inner.loss = -inf"));
        assert!(text("sigmas=[1, 1e39]").contains("sigmas[1] = inf"));
        let large = parse::<Narrow>("inner.loss = 1e300", "test", &[]).unwrap();
        assert_eq!(large.inner.loss, 1e300);
    }

    #[test]
    fn number_for_a_list_key_gives_the_form_of_the_list() {
        #[derive(Debug, Serialize, Deserialize)]
        #[serde(default)]
        struct Lists {
            wheels: Vec<[f64; 2]>,
            sigmas: [f32; 3],
            delays: Vec<u32>,
            free: Vec<f64>,
        }
        impl Default for Lists {
            fn default() -> Self {
                let (wheels, delays) = (vec![[0.5; 2]], vec![0; 2]);
                let (sigmas, free) = ([1e-3, 1e-3, 4e-3], Vec::new());
                Self {
                    wheels,
                    sigmas,
                    delays,
                    free,
                }
            }
        }
        for (change, expected) in [
            ("wheels=10", "a list, for example [[0.5, 0.5]]"),
            ("wheels=[10]", "a list of 2 entries, for example [0.5, 0.5]"),
            (
                "sigmas=1.0",
                "a list of 3 entries, for example [0.001, 0.001, 0.004]",
            ),
            (
                "sigmas=[1]",
                "a list of 3 entries, for example [0.001, 0.001, 0.004]",
            ),
            (
                "sigmas=[1, 2, 3, 4]",
                "fewer entries, for example [0.001, 0.001, 0.004]",
            ),
            ("delays=fast", "a list, for example [0, 0]"),
            ("free=1", "a list"),
        ] {
            let read = parse::<Lists>("", "test", &[change.to_owned()]);
            let text = read.unwrap_err().to_string();
            assert!(text.ends_with(&format!("expected {expected}")), "{text}");
        }
    }

    #[test]
    fn number_for_a_key_of_each_axle_gives_the_form_of_the_list() {
        #[derive(Debug, Default, Serialize, Deserialize)]
        #[serde(default)]
        struct Robot {
            plant: plant::PlantConfig,
        }
        for (key, form) in [
            ("tyre.brush.slip_stiffness", "[[20.0, 20.0]]"),
            ("mass_kg", "[4.76]"),
            ("wheel_radius_m", "[[0.073, 0.073]]"),
        ] {
            let read = parse::<Robot>("", "test", &[format!("plant.{key}=10")]);
            let text = read.unwrap_err().to_string();
            let expected = format!("expected a list, for example {form}");
            assert!(text.contains(key) && text.ends_with(&expected), "{text}");
        }
    }

    #[test]
    fn errors_name_the_key() {
        let text = |changes: &[&str]| changed(changes).unwrap_err().to_string();
        assert!(text(&["bus.los=1"]).contains("los"));
        assert!(text(&["bus.loss=many"]).contains("bus.loss"));
        assert!(text(&["rps"]).contains("KEY=VALUE"));
        assert!(text(&["rps.x.y=1", "rps=2"]).contains("rps"));
        let long = vec!["a"; 10_000].join(".");
        assert!(text(&[&format!("{long}=1")]).contains("10000 parts: must be at most 16"));
        let deep = format!("[bus]\nloss = 1\n[{long}]\nloss = 2\n");
        let error = parse::<Outer>(&deep, "file.toml", &[]).unwrap_err();
        assert_eq!(error.to_string(), "file.toml: line 3: recursion limit");
        let error = parse::<Outer>(&deep.replace('\n', "\r\n"), "file.toml", &[]).unwrap_err();
        assert_eq!(error.to_string(), "file.toml: line 3: recursion limit");
        let error = parse::<Outer>("[bus]\nlos = 1\n", "file.toml", &[]).unwrap_err();
        let text = error.to_string();
        assert_eq!(
            text,
            "file.toml: line 2: bus.los: unknown key; did you mean bus.loss?"
        );
        let error = parse::<Outer>("bus.wire.loss_kind = 1", "file.toml", &[]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "file.toml: line 1: bus.wire.loss_kind: unknown key; nearest keys: bus.kind, bus.loss"
        );
        let refused = |text: &str| {
            let read = parse::<Outer>(text, "file.toml", &[]);
            read.unwrap_err().to_string()
        };
        for (text, place) in [
            ("rps = true\n[bus]\nloss = 'x'", "line 3: bus.loss: "),
            ("bus.kind = 'fast'\nrps = 2", "line 2: rps: "),
            ("\nbus = 3", "line 2: bus: "),
            ("[bus]\nloss = 1\nkind = [\n 1,\n]", "line 3: bus.kind: "),
        ] {
            let error = refused(text);
            assert!(error.starts_with(&format!("file.toml: {place}")), "{error}");
        }
        let long = format!("[bus]\n{} = 1\n", "a".repeat(100_000));
        assert!(refused(&long).len() < 1000);
        assert_eq!(error.exit_code(), 2);
    }
}
