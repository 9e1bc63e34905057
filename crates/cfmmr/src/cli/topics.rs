//! `cfmmr topics`: what a log holds, as Markdown.

use host_sim::base::error::Error;
use output::terminal;
use recording::topics::{Schema, TOPICS};
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
    for topic in &TOPICS {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "| `{}` | `{}` | {} | {} |",
            topic.name, topic.schema.name, topic.rate, topic.schema.text
        );
    }
    let mut seen: Vec<&str> = Vec::new();
    for topic in &TOPICS {
        let schema = &topic.schema;
        if schema.fields.is_empty() || seen.contains(&schema.name) {
            continue;
        }
        seen.push(schema.name);
        text += &fields(schema);
    }
    text
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

/// Prints the page.
pub fn run() -> Result<(), Error> {
    terminal::print_page(&markdown())
}
