//! Results as JSON, with their provenance.

use crate::BUILD;
use host_sim::base::error::Error;
use host_sim::run::end::RunEnd;
use host_sim::scenario::Scenario;
use output::files;
use output::terminal;
use output::terminal::{note, wrapped};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Options with a value that do not change the result.
const WITHOUT_EFFECT: [&str; 3] = ["--threads", "--out", "--json"];

/// Everything that a result depends on, written beside the result.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub struct Provenance<'a> {
    /// Command line, without options that do not change the result.
    command: String,
    version: &'static str,
    /// Hash of the sources.
    build: &'static str,
    /// Commit of the sources, if they were under version control.
    commit: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    seed: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    world: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scenario: Option<&'a Scenario>,
    /// Parts of the user.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    own: Vec<&'static str>,
}

impl Default for Provenance<'_> {
    /// Provenance of this command without scenario and seed.
    fn default() -> Self {
        Self {
            command: command_line(arguments()),
            version: env!("CARGO_PKG_VERSION"),
            build: BUILD,
            commit: option_env!("COMMIT"),
            seed: None,
            world: None,
            scenario: None,
            own: Vec::new(),
        }
    }
}

impl<'a> Provenance<'a> {
    /// Provenance of runs of a scenario.
    pub fn of(scenario: &'a Scenario, seed: u64) -> Self {
        Self {
            seed: Some(seed),
            world: Some(scenario.world.label()),
            scenario: Some(scenario),
            own: scenario.own.names(),
            ..Self::default()
        }
    }

    /// Provenance of a computation that depends on the content of its input files, not on their names.
    pub fn of_files(command: &str) -> Self {
        Self {
            command: command.to_owned(),
            ..Self::default()
        }
    }

    /// JSON text of a result with its provenance.
    pub fn json(&self, result: &impl Serialize) -> String {
        #[derive(Serialize)]
        struct Whole<'a, T> {
            run: &'a Provenance<'a>,
            #[serde(flatten)]
            result: &'a T,
        }
        files::json(&Whole { run: self, result })
    }
}

/// Arguments of the program; bytes that are not UTF-8 are replaced by �.
fn arguments() -> impl Iterator<Item = String> {
    let given = std::env::args_os().skip(1);
    given.map(|word| word.to_string_lossy().into_owned())
}

/// Command line for the provenance: as typed, without options that do not change the result.
fn command_line(arguments: impl Iterator<Item = String>) -> String {
    let mut words = vec!["cfmmr".to_owned()];
    let mut arguments = arguments.peekable();
    while let Some(word) = arguments.next() {
        match WITHOUT_EFFECT.iter().find(|name| word.starts_with(*name)) {
            Some(name) if word == *name => drop(arguments.next()),
            Some(name) if word[name.len()..].starts_with('=') => {}
            _ => words.push(word),
        }
    }
    words.join(" ")
}

/// Prints a warning on standard error if the end is uncertain; `what` names the run.
pub fn warn(end: &RunEnd, what: &str) {
    if let Some(warning) = end.warning() {
        note(format!("cfmmr: {what}: {warning}"));
    }
}

/// Lines below the table of a run: end and notices. Prints a warning on standard error if the end is uncertain.
pub fn end_lines(end: &RunEnd, what: &str) -> String {
    warn(end, what);
    let notices = end.notices_text().map(|text| wrapped(&text));
    format!("end: {}\n{}", end.text(), notices.unwrap_or_default())
}

/// Destination of the result as JSON.
#[derive(Clone, Debug, Default)]
pub struct Json {
    file: Option<PathBuf>,
}

impl Json {
    /// Destination: a file, standard output for the name `-`, or none for `None`. Fails if the file cannot be written.
    pub fn to(file: Option<PathBuf>) -> Result<Self, Error> {
        let json = Self { file };
        match &json.file {
            Some(path) if !json.is_standard_output() => files::try_file(path)
                .map_err(|error| Error::input(format!("--json {}: {error}", path.display())))?,
            _ => {}
        }
        Ok(json)
    }

    /// Writes the result, if there is a destination.
    pub fn write(&self, run: &Provenance, result: &impl Serialize) -> Result<(), Error> {
        match &self.file {
            None => Ok(()),
            Some(_) if self.is_standard_output() => terminal::print(&run.json(result)),
            Some(path) => Ok(files::write_file(path, run.json(result))?),
        }
    }

    /// Prints text for people: to standard error if standard output carries the result.
    pub fn print(&self, text: &str) -> Result<(), Error> {
        match self.is_standard_output() {
            true => note(text.trim_end()),
            false => terminal::print(text)?,
        }
        Ok(())
    }

    /// Prints a page for people; see [`Self::print`].
    pub fn print_page(&self, markdown: &str) -> Result<(), Error> {
        match self.is_standard_output() {
            true => self.print(markdown),
            false => terminal::print_page(markdown),
        }
    }

    fn is_standard_output(&self) -> bool {
        self.file.as_deref() == Some(Path::new("-"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_line_omits_options_that_do_not_change_the_result() {
        for (typed, kept) in [
            (
                "posture --seed 3 --threads 2 --out a",
                "cfmmr posture --seed 3",
            ),
            ("--json=x --trials 2 --out=b", "cfmmr --trials 2"),
            ("params get --json -", "cfmmr params get"),
            ("world careful --toml", "cfmmr world careful --toml"),
        ] {
            let words = typed.split(' ').map(str::to_owned);
            assert_eq!(command_line(words), kept);
        }
    }
}
