//! Plain text tables with aligned columns, no wider than the terminal.

use crate::terminal;
use std::fmt;

/// Text table. The first column is aligned left and the others right; [`Table::left_aligned`] aligns all columns left.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    left: bool,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    pub fn new<S: Into<String>>(header: impl IntoIterator<Item = S>) -> Self {
        Self {
            left: false,
            header: header.into_iter().map(Into::into).collect(),
            rows: Vec::new(),
        }
    }

    /// The table with all columns aligned left, for words.
    #[must_use]
    pub fn left_aligned(self) -> Self {
        Self { left: true, ..self }
    }

    /// The table with rows and columns exchanged, for few rows of many columns.
    #[must_use]
    pub fn transposed(self) -> Self {
        let rows = [vec![self.header], self.rows].concat();
        let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
        let column = |n: usize| {
            rows.iter()
                .map(move |row| row.get(n).cloned().unwrap_or_default())
        };
        let mut table = Self::new(column(0));
        for n in 1..columns {
            table.row(column(n));
        }
        table
    }

    /// Adds a row. Cells beyond the header get a column without a name; missing cells stay empty.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> &mut Self {
        self.rows.push(cells.into_iter().map(Into::into).collect());
        self
    }

    /// Adds a line across the table.
    pub fn rule(&mut self) -> &mut Self {
        self.rows.push(Vec::new());
        self
    }

    /// Widths of the columns, characters. If the table is wider than `limit`, the widest columns shrink to their
    /// longest word; if that is not enough, to the longest piece of a word between two [`PARTS`].
    fn widths(&self, limit: usize) -> Vec<usize> {
        let longest = |separators: &[char]| {
            let mut widths = Vec::new();
            for row in self.rows.iter().chain([&self.header]) {
                widths.resize(widths.len().max(row.len()), 0);
                for (width, cell) in widths.iter_mut().zip(row) {
                    let parts = pieces(cell, separators).into_iter();
                    let part = parts.map(|part| part.trim_end().chars().count()).max();
                    *width = part.unwrap_or(0).max(*width);
                }
            }
            widths
        };
        let mut widths = longest(&[]);
        for least in [longest(&[' ']), longest(&PARTS)] {
            while widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1) > limit {
                let columns = (0..widths.len()).filter(|&column| widths[column] > least[column]);
                let Some(widest) = columns.max_by_key(|&column| widths[column]) else {
                    break;
                };
                widths[widest] -= 1;
            }
        }
        widths
    }
}

/// Characters after which a name may be split.
const PARTS: [char; 4] = [' ', '.', '_', '/'];

/// Splits the text after each separator, but keeps numbers such as `18.50 ± 2.10`, `68 %` or `(62 to 74)` whole.
fn pieces<'a>(text: &'a str, separators: &[char]) -> Vec<&'a str> {
    let mut pieces = Vec::new();
    let mut rest = text;
    for (place, separator) in text.match_indices(separators) {
        let end = place + separator.len();
        let after = text[end..].chars().next();
        let before = &text[..place];
        let open = before.rsplit_once('(').map(|(_, inside)| inside);
        let in_range = |inside: &str| !inside.contains(')') && inside.starts_with(char::is_numeric);
        let in_figure = match separator {
            "." => after.is_some_and(|next| next.is_ascii_digit()),
            _ => {
                matches!(after, Some('±' | '%'))
                    || before.ends_with('±')
                    || open.is_some_and(in_range)
            }
        };
        if !in_figure {
            let (piece, others) = rest.split_at(end - (text.len() - rest.len()));
            pieces.push(piece);
            rest = others;
        }
    }
    pieces.extend((!rest.is_empty()).then_some(rest));
    pieces
}

/// Lines of a cell that is `width` characters wide.
fn lines(cell: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    let fits = |word: &str| word.trim_end().chars().count() <= width;
    let words = pieces(cell, &[' ']).into_iter();
    let words = words.flat_map(|word| match fits(word) {
        true => vec![word],
        false => pieces(word, &PARTS),
    });
    for word in words {
        let line = lines.last_mut().expect("at least one line");
        if !line.is_empty() && !fits(&format!("{line}{word}")) {
            lines.push(word.to_owned());
        } else {
            *line += word;
        }
    }
    lines
        .iter()
        .map(|line| line.trim_end().to_owned())
        .collect()
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widths = self.widths(terminal::width());
        let total = widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1);
        let rule = "─".repeat(total);
        let line = |f: &mut fmt::Formatter<'_>, row: &[String]| {
            let cells = row.iter().zip(&widths);
            let cells: Vec<_> = cells.map(|(cell, &width)| lines(cell, width)).collect();
            for n in 0..cells.iter().map(Vec::len).max().unwrap_or(0) {
                let mut text = String::new();
                for (column, (cell, &width)) in cells.iter().zip(&widths).enumerate() {
                    let cell = cell.get(n).map_or("", String::as_str);
                    let gap = if column == 0 { "" } else { "  " };
                    text += &if column == 0 || self.left {
                        format!("{gap}{cell:<width$}")
                    } else {
                        format!("{gap}{cell:>width$}")
                    };
                }
                writeln!(f, "{}", text.trim_end())?;
            }
            Ok(())
        };
        line(f, &self.header)?;
        writeln!(f, "{rule}")?;
        for row in &self.rows {
            if row.is_empty() {
                writeln!(f, "{rule}")?;
            } else {
                line(f, row)?;
            }
        }
        Ok(())
    }
}

/// `mean ± spread` with `digits` decimals each; the mean alone if `spread` is NaN.
pub fn plus_minus(mean: f64, spread: f64, digits: usize) -> String {
    if spread.is_nan() {
        return format!("{mean:.digits$}");
    }
    format!("{mean:.digits$} ± {spread:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_wider_than_its_limit_wraps_between_words() {
        let mut table = Table::new(["name", "text"]).left_aligned();
        table.row(["a", &"word ".repeat(40)]);
        let widths = table.widths(80);
        assert_eq!(widths.iter().sum::<usize>() + 2, 80);
        let longest = table
            .to_string()
            .lines()
            .map(|line| line.chars().count())
            .max();
        assert_eq!(longest, Some(80));
        assert_eq!(table.to_string().matches("word").count(), 40);
        assert_eq!(table.widths(5), [4, 4], "no narrower than a word");
        assert_eq!(
            lines("robot.limits.max_speed_m_s", 12),
            ["robot.", "limits.max_", "speed_m_s"]
        );
    }

    #[test]
    fn table_wider_than_its_limit_keeps_figures_whole() {
        assert_eq!(lines("18.50 ± 2.10 cm", 4), ["18.50 ± 2.10", "cm"]);
        assert_eq!(lines("68 % (62 to 74)", 3), ["68 %", "(62 to 74)"]);
        assert_eq!(
            lines("95 % interval (of runs)", 3),
            ["95 %", "interval", "(of", "runs)"]
        );
        assert_eq!(lines("v.1.25", 2), ["v.1.25"]);
        let mut table = Table::new(["plant.tyre.brush.slip_stiffness", "e (cm)"]);
        table.row(["8.0", "18.50 ± 2.10"]);
        assert_eq!(table.widths(10), [9, 12]);
    }

    #[test]
    fn columns_align_by_characters_not_bytes() {
        let mut table = Table::new(["", "e (cm)", "θ (°)"]);
        table.row([
            "with RPS".to_string(),
            plus_minus(9.5, 2.1, 1),
            plus_minus(-13.3, 14.2, 1),
        ]);
        table.rule();
        table.row(["without", "1", "−2"]);
        let text = table.to_string();
        let ends: Vec<usize> = text.lines().map(|line| line.chars().count()).collect();
        assert_eq!(ends, [33; 5], "{text}");
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[2].starts_with("with RPS  9.5 ± 2.1  "));
        assert!(lines[4].ends_with("  −2"));
        let text = table.left_aligned().to_string();
        assert!(text.lines().nth(4).unwrap().ends_with("  1          −2"));
    }
}
