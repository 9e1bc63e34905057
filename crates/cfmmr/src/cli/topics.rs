//! `cfmmr topics`: prints the table of a log's topics, as Markdown.

use crate::experiments::run::place::ROBOT;
use host_sim::base::error::Error;
use output::terminal;
use recording::topics::{Schema, topics};
use std::fmt::Write;

/// The text of `docs/topics.md`.
pub fn markdown() -> String {
    let mut text = String::from(
        "# Topics of a log\n\n\
         Printed by `cfmmr topics`. Foxglove's schemas are encoded as protobuf, the others as JSON; the\n\
         file contains each schema. Times are simulated time since the start. [logs.md](logs.md)\n\
         describes recording, viewing and replay.\n\n\
         | topic | schema | rate | contents |\n|---|---|---|---|\n",
    );
    let topics = topics(ROBOT);
    for topic in &topics {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "| `{}` | `{}` | {} | {} |",
            topic.name, topic.schema.name, topic.rate, topic.schema.text
        );
    }
    let mut listed: Vec<&str> = Vec::new();
    for topic in &topics {
        let schema = &topic.schema;
        if schema.fields.is_empty() || listed.contains(&schema.name) {
            continue;
        }
        listed.push(schema.name);
        text += &fields(schema);
    }
    text + TABLES
}

fn fields(schema: &Schema) -> String {
    let mut text = format!(
        "\n## {}\n\n{}.\n\n| field | unit and meaning |\n|---|---|\n",
        schema.name, schema.text
    );
    for field in schema.fields {
        let optional = if field.optional { "; may be null" } else { "" };
        let _ = writeln!(text, "| `{}` | {}{optional} |", field.name, field.text);
    }
    text
}

/// Columns of the CSV tables, which are fields of topics.
const TABLES: &str = "
## Tables

`--csv DIR` writes `epochs.csv`, `axles.csv` and `beam.csv`. Each experiment writes the columns of `epochs.csv` beside its
pictures (`log.csv`, `log-joint.csv`). A column has the path of the value in a log. A list has a column for each entry,
counted from 0. Null is an empty cell, true 1, false 0. Bytes, hexadecimal texts and frames (`received`) have no columns.

`lead.*` in row k of `epochs.csv` is the estimate of epoch k - 1: for the error of the estimate, subtract `truth.*` of
row k - 1. A log has the time of the estimate in `epoch_s` of `/lead`.

| table | columns |
|---|---|
| `epochs.csv` | `time_s`; fields of `/truth` without `time_s`, as `truth.robot.x_m`; fields of `/lead` without `tick` and `epoch_s`, as `lead.robot.covariance[0][0]` |
| `axles.csv` | `time_s`, `board`; fields of `/boards/front/tick` and `/boards/rear/tick` as `encoder[0]` |
| `beam.csv` | `time_s`; fields of `/boards/beam/tick` as `counts[0]` |
";

/// Prints the page.
pub fn run() -> Result<(), Error> {
    terminal::print_page(&markdown())
}
