//! Scenario files and `--set` changes: an accepted scenario is unchanged after writing and reading; an error names the
//! key or line.
#![no_main]

use cfmmr_fuzz::numbers::Bytes;
use host_sim::base::error::Error;
use host_sim::base::toml_file;
use host_sim::scenario::Scenario;
use libfuzzer_sys::fuzz_target;
use std::collections::HashSet;
use std::sync::LazyLock;
use toml::{Table, Value};

/// All keys of a scenario, as for `--set`.
static KEYS: LazyLock<Vec<String>> = LazyLock::new(|| {
    let mut keys = Vec::new();
    collect(
        "",
        &Table::try_from(Scenario::default()).unwrap(),
        &mut keys,
    );
    keys
});

fn collect(path: &str, table: &Table, keys: &mut Vec<String>) {
    for (key, value) in table {
        let key = format!("{path}{key}");
        match value {
            Value::Table(inner) => collect(&format!("{key}."), inner, keys),
            _ => keys.push(key),
        }
    }
}

fuzz_target!(|data: &[u8]| {
    let mut bytes = Bytes(data);
    match bytes.byte() % 2 {
        0 => {
            let text = String::from_utf8_lossy(bytes.0);
            check(&text, toml_file::parse(&text, "scenario", &[]), &[]);
        }
        _ => {
            let mut changes = Vec::new();
            while !bytes.is_empty() && changes.len() < 8 {
                let key = &KEYS[usize::from(u16::from_le_bytes(bytes.array())) % KEYS.len()];
                let value = match bytes.byte() % 16 {
                    0 => String::from_utf8_lossy(bytes.take(8)).into_owned(),
                    1 => ["nan", "inf", "-inf", "true", "[]", "{}"][usize::from(bytes.byte()) % 6]
                        .to_owned(),
                    2 => bytes.byte().to_string(),
                    3 => format!(
                        "[{:?}, {:?}, {:?}]",
                        bytes.number(),
                        bytes.number(),
                        bytes.number()
                    ),
                    _ => format!("{:?}", bytes.number()),
                };
                changes.push(format!("{key}={value}"));
            }
            check("", toml_file::parse("", "scenario", &changes), &changes);
        }
    }
});

fn check(text: &str, read: Result<Scenario, Error>, changes: &[String]) {
    let input = text.len() + changes.iter().map(String::len).sum::<usize>();
    match read.and_then(|scenario| scenario.check().map(|()| scenario)) {
        Ok(scenario) => {
            let written = scenario.to_toml().expect("a scenario can be written");
            let again: Scenario = toml_file::parse(&written, "written", &[]).expect("and read");
            assert_eq!(again, scenario);
        }
        Err(error) => {
            assert_eq!(error.exit_code(), 2, "{error}");
            let message = error.to_string();
            assert!(message.len() <= 1000 + 8 * input, "{message}");
            // The error of a file names the line, the error of a change its key or a part of the key.
            let named = message.contains("line ")
                || message
                    .split([' ', ':', '=', '`', '[', '.'])
                    .any(|word| NAMES.contains(word));
            assert!(named, "{message}");
        }
    }
}

/// Names of all tables and entries.
static NAMES: LazyLock<HashSet<&str>> =
    LazyLock::new(|| KEYS.iter().flat_map(|key| key.split('.')).collect());
