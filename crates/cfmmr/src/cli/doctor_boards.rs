//! `cfmmr doctor --on serial:front=PORT`: build, stack and faults that the boards of a robot report.

use super::arguments::BoardArgs;
use crate::experiments::result::{Json, Provenance};
use crate::experiments::run::links::Links;
use crate::experiments::run::place::BoardPlace;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::targets::Target;
use output::table::Table;
use remote::Remote;
use remote::board_log::BoardLog;
use serde::Serialize;

/// Health counters that a real board reports.
#[derive(Debug, Default, Serialize)]
struct BoardRow {
    board: &'static str,
    build: String,
    stack_used: Option<u32>,
    stack_size: Option<u32>,
    /// Number of panics since power-on; the three counts below also begin at power-on.
    panics: Option<u32>,
    processor_faults: Option<u32>,
    watchdog_resets: Option<u32>,
    stack_overflows: Option<u32>,
    /// Message of the fault before the latest start.
    last_fault: String,
    /// Reason for a missing report.
    error: Option<String>,
}

/// Reports of all boards, for the JSON output.
#[derive(Debug, Serialize)]
struct BoardsReport {
    ok: bool,
    boards: Vec<BoardRow>,
}

/// Reads the boards' reports; fails if a board does not answer or had a fault.
pub fn run(robot: Topology, args: &BoardArgs, json: &Json) -> Result<(), Error> {
    if !matches!(args.on, BoardPlace::Serial(_)) {
        return Err(Error::input(
            "--on: must be serial:front=PORT: only real boards have a state before a run",
        ));
    }
    let links = Links::new(robot, &args.on, args.baud(), None)?;
    let mut boards = Vec::new();
    // Ports that did not answer; boards behind them are skipped.
    let mut silent_ports = Vec::new();
    for role in robot.boards() {
        let port = links.port_of(role);
        let row = match port.filter(|port| silent_ports.contains(port)) {
            Some(port) => Err(Error::NoAnswer(format!(
                "{} board: not read: the port of the {} board does not answer",
                robot.name(role),
                robot.name(port)
            ))),
            None => of_board(&links, role),
        };
        let row = match row {
            Ok(row) => row,
            Err(error) if error.exit_code() == 2 => return Err(error),
            Err(error) => {
                silent_ports.extend(port.filter(|port| *port == role));
                BoardRow {
                    error: Some(error.to_string()),
                    ..BoardRow::default()
                }
            }
        };
        let board = robot.name(role);
        boards.push(BoardRow { board, ..row });
    }
    let sound = |row: &BoardRow| {
        let counts = [
            row.panics,
            row.processor_faults,
            row.watchdog_resets,
            row.stack_overflows,
        ];
        row.error.is_none() && counts.iter().flatten().all(|count| *count == 0)
    };
    let failed = boards.iter().filter(|row| !sound(row));
    let failed: Vec<&str> = failed.map(|row| row.board).collect();
    let failed = failed.join(", ");
    let report = BoardsReport {
        ok: failed.is_empty(),
        boards,
    };
    json.write(&Provenance::default(), &report)?;
    json.print(&text(&report.boards))?;
    match report.ok {
        true => Ok(()),
        false => Err(Error::Failure(format!(
            "boards with a fault or without an answer: {failed}"
        ))),
    }
}

fn of_board(links: &Links, role: Role) -> Result<BoardRow, Error> {
    let name = links.robot.name(role);
    let Some(link) = links.reach(role, &BoardLog::new(name))? else {
        return Ok(BoardRow::default());
    };
    let mut remote = Remote::new(links.robot, role, link);
    remote.shorten_wait();
    let relayed = links.port_of(role) != Some(role);
    let record = remote.crash_record().map_err(|error| match error {
        Error::NoAnswer(why) if relayed => Error::NoAnswer(format!(
            "{why}: no board, or more than one, has this place (board.place)"
        )),
        error => error,
    })?;
    let [panics, processor, watchdog, overflows] = record.counts;
    let stack = remote.stack();
    Ok(BoardRow {
        build: remote.report().build,
        stack_used: stack.map(|stack| stack.used_bytes),
        stack_size: stack.map(|stack| stack.size_bytes),
        panics: Some(panics),
        processor_faults: Some(processor),
        watchdog_resets: Some(watchdog),
        stack_overflows: Some(overflows),
        last_fault: record.message.as_str().to_owned(),
        ..BoardRow::default()
    })
}

fn text(boards: &[BoardRow]) -> String {
    let mut table = Table::new([
        "board",
        "build",
        "stack (bytes)",
        "panics",
        "processor faults",
        "watchdog resets",
        "stack overflows",
    ]);
    let number = |value: Option<u32>| value.map_or(String::new(), |value| value.to_string());
    let mut notes = String::new();
    for row in boards {
        let stack = row.stack_used.zip(row.stack_size);
        table.row([
            row.board.to_owned(),
            row.build.clone(),
            stack.map_or(String::new(), |(used, size)| format!("{used} of {size}")),
            number(row.panics),
            number(row.processor_faults),
            number(row.watchdog_resets),
            number(row.stack_overflows),
        ]);
        if let Some(error) = &row.error {
            notes += &format!("{error}\n");
        }
        if !row.last_fault.is_empty() {
            notes += &format!("{} board, last fault: {}\n", row.board, row.last_fault);
        }
    }
    format!("{}\n{notes}", table.transposed())
}
