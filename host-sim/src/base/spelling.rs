//! Spelling suggestions for names and keys.

use crate::base::error::Error;
use std::path::Path;
use toml::{Table, Value};

/// Likeness, from 0 to 1, from which on a name is offered in place of another.
const ALIKE: f64 = 0.75;

/// Longest word that is compared, bytes.
const LONGEST: usize = 100;

/// Beginning of a suggestion.
const MEANT: &str = "did you mean ";

/// The known name that is most like a word, if one is like it.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let pairs = known.into_iter().map(|name| (likeness(word, name), name));
    let alike = pairs.filter(|(like, _)| (ALIKE..1.0).contains(like));
    alike
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| name)
}

/// Likeness of two words, from 0 to 1. Its time grows with the product of their lengths.
fn likeness(word: &str, name: &str) -> f64 {
    match word.len() <= LONGEST {
        true => strsim::normalized_damerau_levenshtein(word, name),
        false => 0.0,
    }
}

/// `; did you mean NAME?` for a word that is like a known name, else nothing.
pub fn hint<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let meant = nearest(word, known);
    meant.map_or_else(String::new, |name| format!("; {MEANT}{name}?"))
}

/// Puts a suggestion in place of the list of keys in the error of a TOML file whose unknown key is like
/// one of its table.
pub fn with_sibling(text: String) -> String {
    let parts = text
        .split_once("unknown field `")
        .and_then(|(before, rest)| Some((before, rest.split_once('`')?)));
    let Some((before, (key, known))) = parts else {
        return text;
    };
    // After the key stand the allowed ones, each between backticks.
    match nearest(key, known.split('`').skip(1).step_by(2)) {
        Some(name) => format!("{before}unknown field `{key}`\n{MEANT}{name}?\n"),
        None => text,
    }
}

/// Adds a suggestion to an error about a scenario; `defaults` is a whole scenario.
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
    let mut text = in_plain_words(&text);
    if let Some(key) = unknown(&text) {
        let meant = closest(&key, defaults).map(|path| match path == key {
            // A table of a scenario, given in another file.
            true => format!("{key} belongs into a scenario file. "),
            false => format!("{MEANT}{path}? "),
        });
        // With the path of the key, which a suggestion from its table alone lacks.
        if let (Some(_), Some((before, _))) = (&meant, text.split_once(MEANT)) {
            text = before.to_owned();
        }
        text = format!(
            "{}\n{}`cfmmr config` prints all keys with their defaults",
            text.trim_end(),
            meant.unwrap_or_default()
        );
    }
    Error::Input(text)
}

/// Types as people call them.
fn in_plain_words(text: &str) -> String {
    let mut parts = text.split("expected ");
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|c: char| !c.is_ascii_alphanumeric());
        let (name, rest) = part.split_at(end.unwrap_or(part.len()));
        let word = match name {
            "f32" | "f64" => "a number",
            "u8" | "u16" | "u32" | "u64" | "usize" | "i32" => "a whole number",
            other => other,
        };
        plain += &format!("expected {word}{rest}");
    }
    plain
}

/// The key that an error says is unknown.
fn unknown(text: &str) -> Option<String> {
    let (_, rest) = text.split_once("unknown field `")?;
    rest.split('`').next().map(str::to_owned)
}

/// The path of the key that is most like this one, anywhere in the scenario.
fn closest(key: &str, defaults: &Table) -> Option<String> {
    let mut all = Vec::new();
    paths("", defaults, &mut all);
    let mut best: Option<(f64, String)> = None;
    for path in all {
        let like = likeness(key, path.rsplit('.').next().unwrap_or(&path));
        if like >= ALIKE && best.as_ref().is_none_or(|(most, _)| like > *most) {
            best = Some((like, path));
        }
    }
    best.map(|(_, path)| path)
}

fn paths(above: &str, table: &Table, all: &mut Vec<String>) {
    for (key, value) in table {
        let path = match above {
            "" => key.clone(),
            above => format!("{above}.{key}"),
        };
        if let Value::Table(below) = value {
            paths(&path, below, all);
        }
        all.push(path);
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
    fn a_key_that_is_not_known_gets_the_one_that_was_meant() {
        let text = advice("a.toml: unknown field `frictoin`, expected one of `mass_kg`\n\n");
        assert!(text.contains("did you mean plant.friction?"), "{text}");
        let text = advice("scenario: unknown field `los`");
        assert!(text.contains("did you mean bus.loss?"), "{text}");
        let text = advice("scenario: unknown field `gravity`");
        assert!(
            !text.contains("mean") && text.contains("cfmmr config"),
            "{text}"
        );
    }

    #[test]
    fn types_stand_in_plain_words_and_the_rest_as_it_is() {
        for (text, plain) in [
            (
                "invalid type: string \"high\", expected f64\n",
                "expected a number\n",
            ),
            (
                "invalid type: float, expected u32 in it",
                "expected a whole number in it",
            ),
            ("expected u16ish", "expected u16ish"),
        ] {
            assert!(advice(text).ends_with(plain), "{}", advice(text));
        }
        let failure = Error::Failure("unknown field `los`".to_owned());
        let same = on_scenario(failure, None, &defaults());
        assert_eq!((same.exit_code(), same.to_string().lines().count()), (1, 1));
    }

    #[test]
    fn a_missing_file_is_told_with_how_to_make_one() {
        let error = Error::input("none.toml: no such file");
        let text = on_scenario(error, Some(Path::new("none.toml")), &defaults()).to_string();
        assert!(
            text.starts_with("--scenario none.toml: no such file: must be"),
            "{text}"
        );
        assert!(text.contains("cfmmr config > FILE"));
    }
}
