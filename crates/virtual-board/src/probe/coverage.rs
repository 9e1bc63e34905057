//! Source lines that ran, by the addresses that were executed and the line table of the image.
//!
//! The image is not instrumented: it is the one that is flashed. A line with code is covered if any
//! instruction that came from it was executed. What the optimiser removed has no code and does not
//! count; what it merged from two lines counts for the line that the table names.

use crate::board::Board;
use crate::image::Image;
use std::collections::BTreeMap;
use std::fmt::{self, Write};

/// Lines with code of each file, and in how many runs each was covered.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Coverage {
    files: BTreeMap<String, BTreeMap<u32, u64>>,
}

/// Lines of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Lines with code.
    pub lines: usize,
    /// Those of them that ran.
    pub covered: usize,
}

impl Count {
    /// Covered lines, %; of nothing all.
    pub fn percent(&self) -> f64 {
        if self.lines == 0 {
            return 100.0;
        }
        100.0 * self.covered as f64 / self.lines as f64
    }
}

impl Coverage {
    /// Of one run: the addresses of the instructions that were executed, in any order.
    pub fn of(image: &Image, executed: impl IntoIterator<Item = u32>) -> Self {
        let mut executed: Vec<u32> = executed.into_iter().collect();
        executed.sort_unstable();
        let mut coverage = Self::default();
        for (range, place) in image.lines_of_code() {
            let first = executed.partition_point(|&a| a < range.start);
            let ran = executed.get(first).is_some_and(|&a| a < range.end);
            let lines = coverage.files.entry(place.file.to_owned()).or_default();
            let hits = lines.entry(place.line).or_default();
            *hits = (*hits).max(u64::from(ran));
        }
        coverage
    }

    /// Of a board with this image, since its profile began ([`crate::core::Core::set_profiling`]): no
    /// line ran if it did not.
    pub fn of_board(image: &Image, board: &Board) -> Self {
        let profile = board.core().profile();
        let executed = profile.map(|profile| profile.instructions().map(|(pc, _)| pc));
        Self::of(image, executed.into_iter().flatten())
    }

    /// Adds another run, or another image.
    pub fn merge(&mut self, other: &Self) {
        for (file, lines) in &other.files {
            let mine = self.files.entry(file.clone()).or_default();
            for (&line, &hits) in lines {
                *mine.entry(line).or_default() += hits;
            }
        }
    }

    /// Keeps the files below a directory and names them from there.
    pub fn below(&self, directory: &str) -> Self {
        let directory = format!("{}/", directory.trim_end_matches('/'));
        let files = self.files.iter().filter_map(|(file, lines)| {
            let name = file.strip_prefix(&directory)?;
            Some((name.to_owned(), lines.clone()))
        });
        Self {
            files: files.collect(),
        }
    }

    /// Keeps the files whose names are wanted.
    pub fn retain(&mut self, mut wanted: impl FnMut(&str) -> bool) {
        self.files.retain(|file, _| wanted(file));
    }

    /// Counts of each file.
    pub fn counts(&self) -> impl Iterator<Item = (&str, Count)> {
        self.files.iter().map(|(file, lines)| {
            let covered = lines.values().filter(|&&hits| hits > 0).count();
            let lines = lines.len();
            (file.as_str(), Count { lines, covered })
        })
    }

    /// Counts of all files together.
    pub fn total(&self) -> Count {
        self.counts().fold(Count::default(), |sum, (_, c)| Count {
            lines: sum.lines + c.lines,
            covered: sum.covered + c.covered,
        })
    }

    /// The `.info` file of lcov, which genhtml and code-review tools read.
    pub fn lcov(&self) -> String {
        let mut text = String::from("TN:\n");
        for ((file, lines), (_, count)) in self.files.iter().zip(self.counts()) {
            text += &format!("SF:{file}\n");
            for (line, hits) in lines {
                // Writing to a string does not fail.
                let _ = writeln!(text, "DA:{line},{hits}");
            }
            let Count { lines, covered } = count;
            text += &format!("LF:{lines}\nLH:{covered}\nend_of_record\n");
        }
        text
    }
}

/// A table by file.
impl fmt::Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = self.files.keys().map(|n| n.chars().count());
        let width = names.max().unwrap_or(0).max("file".len());
        writeln!(
            f,
            "{:width$} {:>7} {:>7} {:>7}",
            "file", "lines", "ran", "%"
        )?;
        let total = std::iter::once(("total", self.total()));
        for (file, count) in self.counts().chain(total) {
            let Count { lines, covered } = count;
            let percent = count.percent();
            writeln!(f, "{file:width$} {lines:>7} {covered:>7} {percent:>7.1}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::tests::Builder;

    fn image() -> Image {
        let rows = [
            (0x0800_0100, "src/a.rs", 10),
            (0x0800_0104, "src/b.rs", 7),
            // Inlined: the same line again elsewhere.
            (0x0800_0108, "src/a.rs", 11),
            (0x0800_010c, "src/b.rs", 7),
            (0x0800_0110, "src/a.rs", 14),
            (0x0800_0114, "src/a.rs", 20),
        ];
        Builder::new(&[0; 64]).lines(&rows, 0x0800_0118).image()
    }

    #[test]
    fn a_line_is_covered_if_any_of_its_code_ran() {
        let coverage = Coverage::of(
            &image(),
            [0x0800_0116, 0x0800_0100, 0x0800_010e, 0x0800_0118],
        );
        let coverage = coverage.below("/source");
        let counts: Vec<_> = coverage
            .counts()
            .map(|(f, c)| (f, c.lines, c.covered))
            .collect();
        assert_eq!(counts, [("src/a.rs", 4, 2), ("src/b.rs", 1, 1)]);
        assert_eq!(coverage.total().percent(), 60.0);
    }

    #[test]
    fn runs_add_up() {
        let image = image();
        let mut sum = Coverage::of(&image, [0x0800_0100]);
        sum.merge(&Coverage::of(&image, [0x0800_0100, 0x0800_0108]));
        sum.merge(&Coverage::of(&image, []));
        let lcov = sum.below("/").lcov();
        let expected = "TN:\nSF:source/src/a.rs\nDA:10,2\nDA:11,1\nDA:14,0\nDA:20,0\nLF:4\nLH:2\n\
                        end_of_record\nSF:source/src/b.rs\nDA:7,0\nLF:1\nLH:0\nend_of_record\n";
        assert_eq!(lcov, expected);
        sum.retain(|file| file.ends_with("b.rs"));
        assert_eq!(
            sum.total(),
            Count {
                lines: 1,
                covered: 0
            }
        );
    }

    #[test]
    fn a_table_ends_with_the_total() {
        let coverage = Coverage::of(&image(), [0x0800_0100]).below("/source");
        let table = coverage.to_string();
        assert_eq!(
            table.lines().last(),
            Some("total          5       1    20.0")
        );
    }
}
