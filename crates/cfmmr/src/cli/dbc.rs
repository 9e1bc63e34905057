//! `cfmmr dbc`: the bus description, and the load of the bus.

use super::arguments::AxlesArg;
use clap::Args;
use core_algos::bus::layout::{self, BIT_RATE};
use core_algos::topology::Topology;
use host_sim::base::error::Error;
use output::files;
use output::table::Table;
use output::terminal;
use recording::dbc;
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `dbc`.
#[derive(Clone, Debug, Args)]
pub struct DbcArgs {
    /// Write to this file instead of the terminal
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Option that sets the number of axles.
    #[command(flatten)]
    pub axles: AxlesArg,
    /// Print the worst-case bus load by message
    #[arg(long, conflicts_with = "out")]
    pub load: bool,
    /// Print the messages as a table
    #[arg(long, conflicts_with_all = ["out", "load"])]
    pub table: bool,
}

/// Prints the description or the load, or writes the description to a file.
pub fn run(args: &DbcArgs) -> Result<(), Error> {
    let robot = args.axles.topology();
    if args.load {
        return terminal::print(&load(robot));
    }
    if args.table {
        return terminal::print_page(&page(robot));
    }
    match &args.out {
        Some(path) => {
            files::write_file(path, dbc::description(robot))?;
            terminal::print(&format!("wrote {}\n", path.display()))
        }
        None => terminal::print(&dbc::description(robot)),
    }
}

/// Table of all bus messages, in Markdown.
fn page(robot: Topology) -> String {
    let mut text = String::from(
        "| id | message | from | period (ms) | timeout (ms) | meaning |\n|---|---|---|---|---|---|\n",
    );
    let time = |ms: u16| {
        if ms == 0 {
            String::new()
        } else {
            ms.to_string()
        }
    };
    for sent in layout::messages(robot) {
        let layout = sent.layout;
        text += &format!(
            "| {:#05x} | `{}` | {} | {} | {} | {} |\n",
            sent.id,
            sent,
            robot.node_name(sent.sender),
            time(sent.period_ms()),
            time(sent.timeout_ms()),
            dbc::plain(layout.meaning),
        );
    }
    text
}

/// Bus load in total and of each message, as text.
fn load(robot: Topology) -> String {
    let mut table = Table::new(["id", "message", "sender", "bytes", "bits", "period", "load"]);
    let rate = BIT_RATE as f32;
    for sent in layout::messages(robot) {
        let layout = sent.layout;
        let (period, share) = if sent.period_ms() == 0 {
            (String::from("on request"), String::new())
        } else {
            (
                format!("{} ms", sent.period_ms()),
                format!("{:.2} %", 100.0 * sent.bits_per_second() / rate),
            )
        };
        table.row([
            format!("{:#05x}", sent.id),
            sent.to_string(),
            robot.node_name(sent.sender).into(),
            layout.bytes().to_string(),
            layout::frame_bits(layout.bytes()).to_string(),
            period,
            share,
        ]);
    }
    let mut text = table.to_string();
    let _ = writeln!(
        text,
        "\nWorst-case load with stuff bits at {} kbit/s: {:.1} %",
        BIT_RATE / 1000,
        100.0 * layout::load(robot, rate)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn load_sums_the_table() {
        for axles in 2..=5 {
            sums(&load(Topology::new(axles).unwrap()));
        }
    }

    /// Asserts that the loads of the messages add up to the total.
    fn sums(text: &str) {
        let shares = text.lines().filter_map(|line| {
            let share = line.strip_suffix(" %")?.split_whitespace().last()?;
            (!line.starts_with("Worst")).then(|| share.parse::<f64>().ok())?
        });
        let sum: f64 = shares.sum();
        let total = text.trim_end().strip_suffix(" %").unwrap();
        let total: f64 = total.rsplit(' ').next().unwrap().parse().unwrap();
        assert!((sum - total).abs() < 0.3, "{sum} {total}");
    }
}
