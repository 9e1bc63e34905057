//! Plain text tables with aligned columns.

use std::fmt;

/// A table: the first column stands left, all others right unless all stand left.
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

    /// The same with all columns to the left, for words.
    #[must_use]
    pub fn left_aligned(self) -> Self {
        Self { left: true, ..self }
    }

    /// Adds a row: cells beyond the header get a column without a name, missing ones stay empty.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> &mut Self {
        self.rows.push(cells.into_iter().map(Into::into).collect());
        self
    }

    /// Adds a line across the table.
    pub fn rule(&mut self) -> &mut Self {
        self.rows.push(Vec::new());
        self
    }

    fn widths(&self) -> Vec<usize> {
        let mut widths = Vec::new();
        for row in self.rows.iter().chain([&self.header]) {
            widths.resize(widths.len().max(row.len()), 0);
            for (width, cell) in widths.iter_mut().zip(row) {
                *width = (*width).max(cell.chars().count());
            }
        }
        widths
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widths = self.widths();
        let total = widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1);
        let rule = "─".repeat(total);
        let line = |f: &mut fmt::Formatter<'_>, row: &[String]| {
            let mut text = String::new();
            for (column, (cell, &width)) in row.iter().zip(&widths).enumerate() {
                let gap = if column == 0 { "" } else { "  " };
                text += &if column == 0 || self.left {
                    format!("{gap}{cell:<width$}")
                } else {
                    format!("{gap}{cell:>width$}")
                };
            }
            writeln!(f, "{}", text.trim_end())
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

/// `mean ± spread` with `digits` decimals each; the mean alone where one value has no spread.
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
