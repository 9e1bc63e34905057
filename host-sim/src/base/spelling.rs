//! Spelling suggestions for names and keys.

use crate::base::error::Error;
use std::path::Path;
use toml::{Table, Value};

/// Least similarity at which a name is suggested, 0 to 1.
const MIN_SIMILARITY: f64 = 0.75;

/// Longest word that is compared, bytes.
const LONGEST: usize = 100;

/// Text of an error after the path of an unknown key.
pub const UNKNOWN: &str = ": unknown key";

/// Beginning of a suggestion in an error.
const DID_YOU_MEAN: &str = "did you mean ";

/// Known name most similar to `word`; `None` if no other name is similar enough.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let pairs = known.into_iter().map(|name| (similarity(word, name), name));
    let alike = pairs.filter(|(like, _)| (MIN_SIMILARITY..1.0).contains(like));
    alike
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| name)
}

/// Similarity of two words, 0 to 1. The run time grows with the product of the lengths, so a word longer than
/// [`LONGEST`] has similarity 0.
fn similarity(word: &str, name: &str) -> f64 {
    match word.len() <= LONGEST {
        true => strsim::normalized_damerau_levenshtein(word, name),
        false => 0.0,
    }
}

/// `; did you mean NAME?` if a known name is similar to `word`, else an empty text.
pub fn hint<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let suggestion = nearest(word, known);
    suggestion.map_or_else(String::new, |name| format!("; {DID_YOU_MEAN}{name}?"))
}

/// Replaces the list of expected keys in a TOML error by a suggestion, if an expected key resembles the unknown key.
pub fn with_sibling(text: String) -> String {
    let parts = text
        .split_once("unknown field `")
        .and_then(|(before, rest)| Some((before, rest.split_once('`')?)));
    let Some((before, (key, known))) = parts else {
        return text;
    };
    // The error lists the expected keys after the unknown key, each in backticks.
    match nearest(key, known.split('`').skip(1).step_by(2)) {
        Some(name) => format!("{before}unknown field `{key}`\n{DID_YOU_MEAN}{name}?\n"),
        None => text,
    }
}

/// Suggestion for an unknown TOML key: a similar key, or else the nearest keys of all tables; empty if no key is near.
/// `defaults` holds all keys.
pub fn unknown_key(key: &str, defaults: &Table) -> String {
    if let Some(path) = closest(key, defaults) {
        return format!("; {DID_YOU_MEAN}{path}?");
    }
    let near = nearest_keys(key, defaults);
    match near.is_empty() {
        true => String::new(),
        false => format!("; nearest keys: {}", near.join(", ")),
    }
}

/// Adds advice to an error about a scenario; `defaults` is a scenario with all keys.
pub fn on_scenario(error: Error, file: Option<&Path>, defaults: &Table) -> Error {
    let Error::Input(text) = error else {
        return error;
    };
    let unread = file.filter(|file| !file.is_file());
    if let Some(file) = unread {
        let found = text.strip_prefix(&*file.to_string_lossy()).unwrap_or(&text);
        return Error::input(format!(
            "--scenario {}{found}: must be a TOML file; `cfmmr config > FILE` writes one with all \
             defaults",
            file.display()
        ));
    }
    if text.contains("counts_per_revolution: invalid value: integer `-") {
        return Error::input(format!(
            "{text}; if an encoder counts backwards, swap its wires A and B (docs/wiring.md)"
        ));
    }
    let Some((before, _)) = text.split_once(UNKNOWN) else {
        return Error::Input(text);
    };
    let key = before.rsplit(' ').next().unwrap_or_default();
    let elsewhere = match closest(key, defaults) {
        // A valid key of a scenario, in a file of another kind.
        Some(path) if path == key => format!("{key} belongs in a scenario file. "),
        _ => String::new(),
    };
    Error::input(format!(
        "{}\n{elsewhere}`cfmmr keys` prints all keys with their defaults",
        text.trim_end()
    ))
}

/// Replaces the Rust types after "expected" by plain words.
pub fn in_plain_words(text: &str) -> String {
    let mut parts = text.split("expected ");
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|c: char| !c.is_ascii_alphanumeric());
        let (name, rest) = part.split_at(end.unwrap_or(part.len()));
        let word = match name {
            "f32" | "f64" => "a number",
            "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number of at least 0",
            "i32" => "a whole number",
            other => other,
        };
        plain += &format!("expected {word}{rest}");
    }
    plain
}

/// Replaces Rust's name of a list at the end of an error by plain words and an example of this `form`.
pub fn with_list(text: &str, form: Option<String>) -> String {
    let words = text.rsplit_once("expected ");
    let listed = words.and_then(|(before, name)| {
        let list = match name.strip_prefix("an array of length ") {
            Some(count) => format!("a list of {count} entries"),
            None if name == "a sequence" => "a list".to_owned(),
            None if name == "fewer elements in array" => "fewer entries".to_owned(),
            None => return None,
        };
        Some(format!("{before}expected {list}"))
    });
    let example = form.map_or_else(String::new, |form| format!(", for example {form}"));
    listed.map_or_else(|| text.to_owned(), |listed| listed + &example)
}

/// Path of the key with the most similar name; of equal names, the most similar path. `None` if no name is similar
/// enough.
fn closest(key: &str, defaults: &Table) -> Option<String> {
    let last = |path: &str| path.rsplit('.').next().unwrap_or_default().to_owned();
    let mut all = Vec::new();
    paths("", defaults, true, &mut all);
    let scored = all.into_iter().map(|path| {
        let like = similarity(&last(key), &last(&path));
        (like + 1e-3 * similarity(key, &path), path)
    });
    let alike = scored.filter(|(like, _)| *like >= MIN_SIMILARITY);
    alike
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, path)| path)
}

/// Longest word that is taken for a unit and not compared, bytes.
const LONGEST_UNIT: usize = 2;

/// Largest number of suggested keys.
const MOST_NEAR: usize = 4;

/// Paths that share the most words with `key`, apart from the name of its table; best match first.
fn nearest_keys(key: &str, defaults: &Table) -> Vec<String> {
    let words = |path: &str| -> Vec<String> {
        let all = path.split(['.', '_']);
        all.filter(|word| word.len() > LONGEST_UNIT)
            .map(str::to_owned)
            .collect()
    };
    let (table, rest) = key.split_once('.').unwrap_or(("", key));
    let mut all = Vec::new();
    paths("", defaults, false, &mut all);
    let mut scored: Vec<(f64, String)> = Vec::new();
    for path in all {
        let known = words(&path);
        let best = |word: &String| {
            let like = known.iter().map(|other| similarity(word, other));
            like.fold(0.0, f64::max)
        };
        let shared: f64 = words(rest)
            .iter()
            .map(best)
            .filter(|like| *like >= MIN_SIMILARITY)
            .sum();
        if shared > 0.0 {
            let same_table = f64::from(u8::from(known.first().is_some_and(|first| first == table)));
            // Of equal matches, the shorter key comes first.
            scored.push((shared + same_table - 0.01 * known.len() as f64, path));
        }
    }
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored
        .into_iter()
        .take(MOST_NEAR)
        .map(|(_, path)| path)
        .collect()
}

/// Appends the paths of all keys, and the paths of tables if `tables` is true.
fn paths(above: &str, table: &Table, tables: bool, all: &mut Vec<String>) {
    for (key, value) in table {
        let path = match above {
            "" => key.clone(),
            above => format!("{above}.{key}"),
        };
        match value {
            Value::Table(below) => {
                paths(&path, below, tables, all);
                if tables {
                    all.push(path);
                }
            }
            _ => all.push(path),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn defaults() -> Table {
        toml::from_str("[plant]\nfriction = 1.0\nmass_kg = 2.0\n[bus]\nloss = 0.0\n").unwrap()
    }

    fn advice(text: &str) -> String {
        on_scenario(Error::input(text), None, &defaults()).to_string()
    }

    #[test]
    fn unknown_key_gets_similar_or_nearest_keys_as_suggestion() {
        let suggestion = |key| unknown_key(key, &defaults());
        assert_eq!(
            suggestion("plant.frictoin"),
            "; did you mean plant.friction?"
        );
        assert_eq!(suggestion("los"), "; did you mean bus.loss?");
        assert_eq!(
            suggestion("plant.axle.mass"),
            "; nearest keys: plant.mass_kg"
        );
        assert_eq!(suggestion("plant.gravity"), "");
        let text = advice("scenario: plant.gravity: unknown key");
        assert!(
            !text.contains("mean") && text.contains("cfmmr keys"),
            "{text}"
        );
        let text = advice("own.toml: bus: unknown key");
        assert!(text.contains("bus belongs in a scenario file"), "{text}");
    }

    #[test]
    fn type_names_become_plain_words_and_other_text_stays() {
        for (text, plain) in [
            (
                "invalid type: string \"high\", expected f64\n",
                "expected a number\n",
            ),
            (
                "invalid type: float, expected u32 in it",
                "expected a whole number of at least 0 in it",
            ),
            ("expected u16ish", "expected u16ish"),
        ] {
            assert!(
                in_plain_words(text).ends_with(plain),
                "{}",
                in_plain_words(text)
            );
        }
        let failure = Error::Failure("unknown field `los`".to_owned());
        let same = on_scenario(failure, None, &defaults());
        assert_eq!((same.exit_code(), same.to_string().lines().count()), (1, 1));
    }

    #[test]
    fn missing_file_error_names_the_command_that_writes_one() {
        let error = Error::input("none.toml: no such file");
        let text = on_scenario(error, Some(Path::new("none.toml")), &defaults()).to_string();
        assert!(
            text.starts_with("--scenario none.toml: no such file: must be"),
            "{text}"
        );
        assert!(text.contains("cfmmr config > FILE"));
    }
}
