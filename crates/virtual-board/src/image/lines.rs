//! Source lines of addresses, from the line table of the debug information (DWARF 2 to 5).

use gimli::{Dwarf, EndianSlice, LittleEndian, SectionId, Unit};
use std::collections::HashMap;
use std::fmt;

/// File and line of source code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SourceLine<'a> {
    /// File, with its directory at compile time.
    pub file: &'a str,
    /// Line number, from 1.
    pub line: u32,
}

impl fmt::Display for SourceLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file, self.line)
    }
}

/// Contiguous code of one source line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct LineRow {
    start: u32,
    end: u32,
    file: u32,
    line: u32,
}

/// Line table of an image, in the order of addresses.
#[derive(Debug, Default)]
pub(super) struct Lines {
    rows: Vec<LineRow>,
    files: Vec<String>,
}

type Slice<'a> = EndianSlice<'a, LittleEndian>;

impl Lines {
    /// Reads the table from the sections of a file. `is_loaded` excludes addresses of code removed by the linker and
    /// still in the table. Unreadable parts are omitted.
    pub fn read<'a>(section: impl Fn(&str) -> &'a [u8], is_loaded: impl Fn(u32) -> bool) -> Self {
        let load = |id: SectionId| -> Result<Slice<'a>, gimli::Error> {
            Ok(EndianSlice::new(section(id.name()), LittleEndian))
        };
        let Ok(dwarf) = Dwarf::load(load) else {
            return Self::default();
        };
        let mut reading = Reading {
            lines: Self::default(),
            index: HashMap::new(),
            is_loaded,
        };
        let mut units = dwarf.units();
        while let Ok(Some(header)) = units.next() {
            if let Ok(unit) = dwarf.unit(header) {
                // A damaged unit ends early; other units are not affected.
                let _ = reading.unit(&dwarf, &unit);
            }
        }
        let mut lines = reading.lines;
        lines.rows.sort_by_key(|r| (r.start, r.end));
        lines.rows.dedup_by_key(|r| r.start);
        lines
    }

    pub fn find(&self, pc: u32) -> Option<SourceLine<'_>> {
        let after = self.rows.partition_point(|r| r.start <= pc);
        let row = self.rows.get(after.checked_sub(1)?)?;
        (pc < row.end).then(|| self.source_line(row)).flatten()
    }

    /// Source line of a row; `None` for line 0, which marks code without a source line.
    fn source_line(&self, row: &LineRow) -> Option<SourceLine<'_>> {
        let file = self.files.get(row.file as usize)?;
        (row.line > 0).then_some(SourceLine {
            file,
            line: row.line,
        })
    }
}

struct Reading<F> {
    lines: Lines,
    index: HashMap<String, u32>,
    is_loaded: F,
}

impl<F: Fn(u32) -> bool> Reading<F> {
    fn unit<'a>(
        &mut self,
        dwarf: &Dwarf<Slice<'a>>,
        unit: &Unit<Slice<'a>>,
    ) -> Result<(), gimli::Error> {
        let Some(program) = unit.line_program.clone() else {
            return Ok(());
        };
        let mut files = HashMap::new();
        let mut rows = program.rows();
        let mut last: Option<LineRow> = None;
        while let Some((header, row)) = rows.next_row()? {
            let address = row.address() as u32;
            if let Some(mut done) = last.take() {
                done.end = address;
                if done.start < done.end && (self.is_loaded)(done.start) {
                    self.lines.rows.push(done);
                }
            }
            if row.end_sequence() {
                continue;
            }
            let number = row.file_index();
            let file = match files.get(&number) {
                Some(&file) => file,
                None => {
                    let name = name(dwarf, unit, header, number)?;
                    let file = self.file(name);
                    files.insert(number, file);
                    file
                }
            };
            last = Some(LineRow {
                start: address,
                end: address,
                file,
                line: row.line().map_or(0, |l| l.get() as u32),
            });
        }
        Ok(())
    }

    fn file(&mut self, name: String) -> u32 {
        let files = &mut self.lines.files;
        *self.index.entry(name).or_insert_with_key(|name| {
            files.push(name.clone());
            files.len() as u32 - 1
        })
    }
}

/// Name of a file, with its directories.
fn name<'a>(
    dwarf: &Dwarf<Slice<'a>>,
    unit: &Unit<Slice<'a>>,
    header: &gimli::LineProgramHeader<Slice<'a>>,
    number: u64,
) -> Result<String, gimli::Error> {
    let mut path = String::new();
    if let Some(directory) = &unit.comp_dir {
        path = directory.to_string_lossy().into_owned();
    }
    if let Some(file) = header.file(number) {
        // Directory 0 is the directory of the unit.
        let directory = file.directory(header);
        let directory = directory.filter(|_| file.directory_index() != 0);
        for part in directory.into_iter().chain([file.path_name()]) {
            join(&mut path, &dwarf.attr_string(unit, part)?.to_string_lossy());
        }
    }
    Ok(path)
}

fn join(path: &mut String, part: &str) {
    if part.starts_with('/') {
        path.clear();
    } else if !path.is_empty() && !path.ends_with('/') {
        path.push('/');
    }
    path.push_str(part);
}
