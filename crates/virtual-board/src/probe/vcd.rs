//! Signals over time as a Value Change Dump (IEEE 1364-2005, 18.2), which GTKWave, PulseView and
//! others open. Times are in nanoseconds: PulseView makes a sample of each.
//!
//! Signals are registered first, each in a scope (`front/pins`, say). Changes may be told in any
//! order of time; [`Dump::flush`] sorts what is due and writes it. One that does not change anything is
//! not written.

use crate::time::Time;
use std::collections::BTreeMap;
use std::io;
use vcd::{IdCode, SimulationCommand, TimescaleUnit, VarType, Writer};

/// What a text shows while there is nothing to show.
pub const NOTHING: &str = "-";

/// What a signal is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A level.
    Wire,
    /// A text (a GTKWave extension; PulseView leaves it out, and takes no file with vectors).
    Text,
}

/// A registered signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Signal(usize);

/// What a signal shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Value {
    /// A level.
    Level(bool),
    /// Nobody drives it.
    HighZ,
    /// Not known.
    Unknown,
    /// A text; spaces become underscores, which the format needs.
    Text(String),
}

/// A change of a signal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// When.
    pub at: Time,
    /// Of what.
    pub signal: Signal,
    /// To what.
    pub value: Value,
}

#[derive(Debug)]
struct Entry {
    scope: Vec<String>,
    name: String,
    form: Form,
    id: Option<IdCode>,
    last: Option<Value>,
}

/// A file that is being written.
pub struct Dump<W: io::Write> {
    writer: Writer<W>,
    entries: Vec<Entry>,
    pending: Vec<Change>,
    begun: bool,
    /// The latest time written, ns.
    written: Option<u64>,
}

impl<W: io::Write> Dump<W> {
    /// A file without signals.
    pub fn new(writer: W) -> Self {
        Self {
            writer: Writer::new(writer),
            entries: Vec::new(),
            pending: Vec::new(),
            begun: false,
            written: None,
        }
    }

    /// Registers a signal; `scope` names the scopes from the outermost, with `/` between. Registered
    /// after the first [`Self::flush`] it is missing in the file.
    pub fn register(&mut self, scope: &str, name: &str, form: Form) -> Signal {
        self.entries.push(Entry {
            scope: scope
                .split('/')
                .filter(|s| !s.is_empty())
                .map(word)
                .collect(),
            name: word(name),
            form,
            id: None,
            last: None,
        });
        Signal(self.entries.len() - 1)
    }

    /// Notes a change.
    pub fn change(&mut self, at: Time, signal: Signal, value: Value) {
        self.pending.push(Change { at, signal, value });
    }

    /// Writes all changes before a time; none before it may follow. One that does is written at the
    /// time reached.
    pub fn flush(&mut self, until: Time) -> io::Result<()> {
        if !self.begun {
            self.begin()?;
        }
        // Stable: what happens at one time stays in the order told.
        self.pending.sort_by_key(|c| c.at);
        let due = self.pending.partition_point(|c| c.at < until);
        let rest = self.pending.split_off(due);
        for change in std::mem::replace(&mut self.pending, rest) {
            self.write(change)?;
        }
        Ok(())
    }

    /// Writes everything and ends the file at a time.
    pub fn finish(mut self, at: Time) -> io::Result<()> {
        self.flush(Time::NEVER)?;
        let end = nanos(at);
        if self.written.is_none_or(|written| written < end) {
            self.writer.timestamp(end)?;
        }
        self.writer.flush()
    }

    /// The header: scopes as a tree, signals in the order registered.
    fn begin(&mut self) -> io::Result<()> {
        self.begun = true;
        self.writer.version("virtual-board")?;
        self.writer.timescale(1, TimescaleUnit::NS)?;
        let mut scopes: BTreeMap<Vec<String>, Vec<usize>> = BTreeMap::new();
        for (index, entry) in self.entries.iter().enumerate() {
            scopes.entry(entry.scope.clone()).or_default().push(index);
        }
        let mut open: Vec<String> = Vec::new();
        for (scope, signals) in scopes {
            let common = open.iter().zip(&scope).take_while(|(a, b)| a == b).count();
            for _ in common..open.len() {
                self.writer.upscope()?;
            }
            for name in &scope[common..] {
                self.writer.add_module(name)?;
            }
            open = scope;
            for index in signals {
                let entry = &mut self.entries[index];
                let (kind, width) = match entry.form {
                    Form::Wire => (VarType::Wire, 1),
                    Form::Text => (VarType::String, 1),
                };
                entry.id = Some(self.writer.add_var(kind, width, &entry.name, None)?);
            }
        }
        for _ in open {
            self.writer.upscope()?;
        }
        self.writer.enddefinitions()?;
        self.writer.timestamp(0)?;
        self.written = Some(0);
        self.writer.begin(SimulationCommand::Dumpvars)?;
        for index in 0..self.entries.len() {
            self.put(index, &Value::Unknown)?;
        }
        self.writer.end()
    }

    fn write(&mut self, change: Change) -> io::Result<()> {
        let Change { at, signal, value } = change;
        let Some(entry) = self.entries.get_mut(signal.0) else {
            return Ok(());
        };
        if entry.id.is_none() || entry.last.as_ref() == Some(&value) {
            return Ok(());
        }
        let time = nanos(at).max(self.written.unwrap_or(0));
        if self.written != Some(time) {
            self.writer.timestamp(time)?;
            self.written = Some(time);
        }
        self.put(signal.0, &value)?;
        self.entries[signal.0].last = Some(value);
        Ok(())
    }

    fn put(&mut self, index: usize, value: &Value) -> io::Result<()> {
        let entry = &self.entries[index];
        let Some(id) = entry.id else { return Ok(()) };
        let bit = |value: &Value| match value {
            Value::Level(level) => vcd::Value::from(*level),
            Value::HighZ => vcd::Value::Z,
            Value::Unknown | Value::Text(_) => vcd::Value::X,
        };
        match (entry.form, value) {
            (Form::Wire, value) => self.writer.change_scalar(id, bit(value)),
            (Form::Text, Value::Text(text)) => self.writer.change_string(id, &word(text)),
            (Form::Text, _) => self.writer.change_string(id, NOTHING),
        }
    }
}

/// A time in the unit of the file.
fn nanos(at: Time) -> u64 {
    at.0 / 1000
}

/// A word as the format allows: printable, without spaces, not empty.
fn word(text: &str) -> String {
    let words = text
        .chars()
        .map(|c| if c.is_ascii_graphic() { c } else { '_' });
    let word: String = words.collect();
    if word.is_empty() { "_".into() } else { word }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vcd::{Command, Parser};

    fn dump() -> Vec<u8> {
        let mut file = Vec::new();
        let mut dump = Dump::new(&mut file);
        let pin = dump.register("front/pins", "PA8", Form::Wire);
        let frame = dump.register("bus", "frame", Form::Text);
        let active = dump.register("front", "exception", Form::Text);
        let rear = dump.register("rear/pins", "PA8", Form::Wire);
        let level = Value::Level;
        let text = |text: &str| Value::Text(text.into());
        // Rounded down to nanoseconds.
        dump.change(Time(3_000_000), pin, level(false));
        dump.change(Time(1_000_000), pin, level(true));
        dump.change(Time(2_000_000), pin, level(true));
        dump.change(Time(1_500_900), active, text("SysTick"));
        dump.flush(Time(2_500_000)).unwrap();
        dump.change(Time(3_000_999), frame, text("0x123 [8] de ad"));
        // Too late: it comes at the time reached.
        dump.change(Time(500_000), rear, Value::HighZ);
        let late = dump.register("late", "x", Form::Wire);
        dump.change(Time(4_000_000), late, level(true));
        dump.finish(Time(9_000_500)).unwrap();
        file
    }

    /// Times and changes as another reader has them.
    fn read(file: &[u8]) -> (Vec<String>, vcd::Header) {
        let mut parser = Parser::new(file);
        let header = parser.parse_header().unwrap();
        let commands = parser.map(|command| match command.unwrap() {
            Command::Timestamp(time) => format!("at {time}"),
            Command::ChangeScalar(id, value) => format!("{id} {value}"),
            Command::ChangeString(id, value) => format!("{id} {value}"),
            other => format!("{other:?}"),
        });
        (commands.collect(), header)
    }

    #[test]
    fn changes_come_sorted_and_only_where_something_changes() {
        let (commands, header) = read(&dump());
        assert_eq!(header.timescale, Some((1, TimescaleUnit::NS)));
        let id = |path: &[&str]| header.find_var(path).unwrap().code;
        let [pin, rear] = ["front", "rear"].map(|b| id(&[b, "pins", "PA8"]));
        let (frame, active) = (id(&["bus", "frame"]), id(&["front", "exception"]));
        let begin = commands.iter().position(|c| c.contains("End")).unwrap();
        let expected = [
            "at 1000".into(),
            format!("{pin} 1"),
            "at 1500".into(),
            format!("{active} SysTick"),
            format!("{rear} z"),
            "at 3000".into(),
            format!("{pin} 0"),
            format!("{frame} 0x123_[8]_de_ad"),
            "at 9000".into(),
        ];
        assert_eq!(commands[begin + 1..], expected);
        // Before that, everything is unknown at time 0.
        assert_eq!(commands[0], "at 0");
        assert!(commands[2..begin].contains(&format!("{pin} x")));
        assert_eq!(begin, 6);
    }
}
