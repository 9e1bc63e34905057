//! `cfmmr parameters`: prints the table of the parameters in a board's flash, as Markdown.

use core_algos::params::{Parameter, TABLE};
use host_sim::base::error::Error;
use output::terminal;
use std::fmt::Write;

/// All parameters as a page in Markdown, which `cfmmr parameters` prints.
pub fn markdown() -> String {
    let mut text = String::from(
        "# Parameters\n\n\
         Printed by `cfmmr parameters`. Each board keeps these parameters in its flash, so each axle has its\n\
         own wheels and track. A parameter that was never saved has its default; on the beam board the\n\
         default depends on the converter (a reading is the sum of 96 conversions). Names are keys of a\n\
         scenario, except `inertial` and `drive` (motors, drivers and supply, see [wiring.md](wiring.md)).\n\
         The identifier is the key in the flash; a value saved under another version is not used.\n\
         [store.md](store.md) describes the effect of a power cut or a damaged flash.\n\n\
         | id | version | name | unit | from | to | default | meaning |\n|---|---|---|---|---|---|---|---|\n",
    );
    for parameter in &TABLE {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "| {} | {} | `{}` | {} | {} | {} | {} | {}{} |",
            parameter.id,
            parameter.version,
            parameter.name,
            parameter.unit,
            parameter.range.0,
            parameter.range.1,
            parameter.default(),
            meaning(parameter).replace('|', "\\|"),
            choices(parameter),
        );
    }
    text
}

/// Meaning of a parameter. If several parameters have the same text, the meaning of the parameter's table is added.
fn meaning(parameter: &Parameter) -> String {
    let path = |parameter: &Parameter| parameter.name.split('[').next();
    let meaning = parameter.meaning();
    let shared = TABLE
        .iter()
        .any(|other| other.meaning() == meaning && path(other) != path(parameter));
    match shared {
        true => format!("{meaning}: {}", parameter.table_meaning()),
        false => meaning.to_owned(),
    }
}

/// Number, name and meaning of each value of a parameter with named values; empty for other parameters.
fn choices(parameter: &Parameter) -> String {
    let names = parameter.choices().iter().enumerate();
    let named: Vec<String> = names
        .map(|(i, choice)| {
            let meaning = choice.meaning().trim_end_matches('.');
            format!("{i} `{}` ({meaning})", choice.name)
        })
        .collect();
    match named.is_empty() {
        true => String::new(),
        false => format!(": {}", named.join(", ")),
    }
}

/// Prints the page.
pub fn run() -> Result<(), Error> {
    terminal::print_page(&markdown())
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::params::Settings;
    use host_sim::base::toml_file;
    use host_sim::scenario::Scenario;

    #[test]
    fn every_row_has_the_cells_of_the_header() {
        let text = markdown() + &crate::cli::keys::markdown(None).unwrap();
        let cells = |row: &str| row.replace("\\|", "").matches('|').count();
        let mut header = 0;
        for line in text.lines().filter(|line| line.starts_with('|')) {
            if line.starts_with("| id") || line.starts_with("| key") {
                header = cells(line);
            }
            assert_eq!(cells(line), header, "{line}");
        }
    }

    /// A scenario key with the name of a parameter sets this parameter.
    #[test]
    fn names_are_those_of_a_scenario() {
        // Parameters with named values are left out: a scenario states them as words, not as numbers.
        let numbers = TABLE.iter().filter(|p| p.range.1 > 3.0 || !p.whole);
        for parameter in numbers.filter(|p| p.name.starts_with("robot.")) {
            let mut settings = Settings::default();
            let value = match parameter.whole {
                true => 4096f32.clamp(parameter.range.0, parameter.range.1),
                false => 0.5 * (parameter.range.0 + parameter.range.1),
            };
            parameter.set(&mut settings, value).unwrap();
            let change = match parameter.name.split_once('[') {
                None => format!("{}={value}", parameter.name),
                Some((list, index)) => {
                    let index: usize = index.trim_end_matches(']').parse().unwrap();
                    let all = TABLE.iter().filter(|p| p.name.starts_with(list));
                    let mut values: Vec<f32> = all.map(|p| p.default()).collect();
                    values[index] = value;
                    format!("{list}={values:?}")
                }
            };
            let scenario: Scenario = toml_file::parse("", "test", &[change]).unwrap();
            assert_eq!(scenario.robot, settings.robot, "{}", parameter.name);
        }
    }
}
