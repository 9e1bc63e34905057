//! A table of named columns, and its forms as a file. The same table gives the same bytes.

use crate::base::error::Error;
use crate::base::output::{Cell, Csv};
use core_algos::link::framing::crc32c;
use serde::{Deserialize, Deserializer, Serialize};

/// Values of one column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Values {
    /// Numbers.
    Double(#[serde(deserialize_with = "numbers")] Vec<f64>),
    /// Whole numbers.
    Integer(Vec<i64>),
    /// Yes or no.
    Flag(Vec<bool>),
    /// Words.
    Text(Vec<String>),
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Self::Double(values) => values.len(),
            Self::Integer(values) => values.len(),
            Self::Flag(values) => values.len(),
            Self::Text(values) => values.len(),
        }
    }

    fn cell(&self, row: usize) -> Cell {
        match self {
            Self::Double(values) if values[row].is_nan() => Cell::Empty,
            Self::Double(values) => values[row].into(),
            Self::Integer(values) => Cell::Integer(values[row]),
            Self::Flag(values) => Cell::Text(values[row].to_string()),
            Self::Text(values) => Cell::Text(values[row].clone()),
        }
    }

    /// True if two rows have the same value to the bit.
    pub fn same(&self, row: usize, other: usize) -> bool {
        match self {
            Self::Double(values) => values[row].to_bits() == values[other].to_bits(),
            Self::Integer(values) => values[row] == values[other],
            Self::Flag(values) => values[row] == values[other],
            Self::Text(values) => values[row] == values[other],
        }
    }

    /// Appends those of another column of the same kind; `false` if it is of another.
    #[must_use]
    pub fn append(&mut self, other: &Self) -> bool {
        match (self, other) {
            (Self::Double(to), Self::Double(from)) => to.extend_from_slice(from),
            (Self::Integer(to), Self::Integer(from)) => to.extend_from_slice(from),
            (Self::Flag(to), Self::Flag(from)) => to.extend_from_slice(from),
            (Self::Text(to), Self::Text(from)) => to.extend_from_slice(from),
            _ => return false,
        }
        true
    }
}

/// Numbers of a JSON file, where null is none.
fn numbers<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    let values = Vec::<Option<f64>>::deserialize(from)?;
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    Ok(values.into_iter().map(number).collect())
}

/// A table of columns of the same length.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Columns(pub Vec<(String, Values)>);

impl Columns {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.0.first().map_or(0, |(_, values)| values.len())
    }

    fn get(&self, name: &str) -> Option<&Values> {
        let found = self.0.iter().find(|(other, _)| other == name);
        found.map(|(_, values)| values)
    }

    /// The numbers of a column; none if there is no such column of numbers.
    pub fn doubles(&self, name: &str) -> &[f64] {
        match self.get(name) {
            Some(Values::Double(values)) => values,
            _ => &[],
        }
    }

    /// The whole numbers of a column; none if there is no such column of them.
    pub fn integers(&self, name: &str) -> &[i64] {
        match self.get(name) {
            Some(Values::Integer(values)) => values,
            _ => &[],
        }
    }

    /// The flags of a column; none if there is no such column of them.
    pub fn flags(&self, name: &str) -> &[bool] {
        match self.get(name) {
            Some(Values::Flag(values)) => values,
            _ => &[],
        }
    }

    /// Each value of a column as a word.
    pub fn words(&self, name: &str) -> Vec<String> {
        let values = self.get(name);
        let word = |row| {
            values
                .map_or(Cell::Empty, |values| values.cell(row))
                .to_string()
        };
        (0..values.map_or(0, Values::len)).map(word).collect()
    }

    /// Appends the rows of another table; `false`, with nothing kept whole, if its columns differ.
    #[must_use]
    pub fn append(&mut self, other: &Self) -> bool {
        if self.0.is_empty() {
            self.0.clone_from(&other.0);
            return true;
        }
        self.0.len() == other.0.len()
            && (self.0.iter_mut().zip(&other.0))
                .all(|((name, to), (other, from))| name == other && to.append(from))
    }

    /// The table as CSV; what is no number is empty.
    pub fn to_csv(&self) -> Csv {
        let mut csv = Csv::new(self.0.iter().map(|(name, _)| name));
        for row in 0..self.rows() {
            csv.row(self.0.iter().map(|(_, values)| values.cell(row)));
        }
        csv
    }
}

/// A table with what it is of: a file of two lines of JSON, of which the second has the checksum of the first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noted {
    /// Build that made it.
    pub made_by: String,
    /// Canonical text of the study.
    pub study: String,
    /// The table.
    pub columns: Columns,
}

impl Noted {
    /// The file.
    pub fn to_lines(&self) -> Result<String, Error> {
        let line = serde_json::to_string(self);
        let line =
            line.map_err(|error| Error::Failure(format!("cannot write a block: {error}")))?;
        let sum = crc32c(line.as_bytes());
        Ok(format!("{line}\n{{\"crc32c\":\"{sum:08x}\"}}\n"))
    }

    /// Reads a file that [`Self::to_lines`] made, or says why it is none.
    pub fn from_lines(content: &[u8]) -> Result<Self, String> {
        let first = content
            .split(|&byte| byte == b'\n')
            .next()
            .unwrap_or(content);
        let read: Self = serde_json::from_slice(first).map_err(|error| error.to_string())?;
        match read.to_lines() {
            Ok(text) if text.as_bytes() == content => Ok(read),
            _ => Err("the file is damaged".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn noted(columns: Vec<(String, Values)>) -> Noted {
        Noted {
            made_by: "build".to_owned(),
            study: "a = 1\n".to_owned(),
            columns: Columns(columns),
        }
    }

    properties! { cases 1024;
        #[test]
        fn a_table_comes_back_with_its_bits(
            rows in prop::collection::vec((any::<f64>(), any::<i64>(), any::<bool>(), "\\PC{0,8}"), 0..60),
        ) {
            let block = noted(vec![
                ("number".into(), Values::Double(rows.iter().map(|r| r.0).collect())),
                ("count".into(), Values::Integer(rows.iter().map(|r| r.1).collect())),
                ("flag".into(), Values::Flag(rows.iter().map(|r| r.2).collect())),
                ("word".into(), Values::Text(rows.iter().map(|r| r.3.clone()).collect())),
            ]);
            let text = block.to_lines().unwrap();
            prop_assert_eq!(Noted::from_lines(text.as_bytes()).unwrap(), block.clone());
            let csv = block.columns.to_csv().into_bytes();
            let mut csv = csv::Reader::from_reader(&*csv);
            for (record, row) in csv.records().map(Result::unwrap).zip(&rows) {
                prop_assert_eq!(record[0].parse::<f64>().unwrap().to_bits(), row.0.to_bits());
                prop_assert_eq!(&record[3], &row.3);
            }
        }

        #[test]
        fn a_damaged_file_is_refused(place in 0usize..2000, to: u8, cut in 0usize..2000) {
            let block = noted(vec![
                ("a".into(), Values::Double((0..50).map(f64::from).collect())),
                ("b".into(), Values::Text((0..50).map(|i: i32| i.to_string()).collect())),
            ]);
            let mut file = block.to_lines().unwrap().into_bytes();
            let n = file.len();
            prop_assume!(file[place % n] != to);
            file[place % n] = to;
            prop_assert!(Noted::from_lines(&file).is_err());
            file.truncate(cut % n);
            prop_assert!(Noted::from_lines(&file).is_err());
        }
    }

    #[test]
    fn what_is_no_number_is_empty() {
        let block = noted(vec![("a".into(), Values::Double(vec![1.5, f64::NAN]))]);
        assert_eq!(block.columns.to_csv().into_bytes(), b"a\n1.5\n\"\"\n");
        let back = Noted::from_lines(block.to_lines().unwrap().as_bytes()).unwrap();
        assert!(back.columns.doubles("a")[1].is_nan());
    }
}
