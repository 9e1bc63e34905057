//! A table of named columns, and its form as a Parquet file.
//!
//! The same table gives the same bytes: no dictionary, no compression, one row group, no time.

use crate::base::error::Error;
use bytes::Bytes;
use core_algos::link::framing::crc32c;
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use std::fmt::Debug;
use std::sync::Arc;

/// Values of one column.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Numbers.
    Double(Vec<f64>),
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

    /// True if two rows have the same value to the bit.
    pub fn same(&self, row: usize, other: usize) -> bool {
        match self {
            Self::Double(values) => values[row].to_bits() == values[other].to_bits(),
            Self::Integer(values) => values[row] == values[other],
            Self::Flag(values) => values[row] == values[other],
            Self::Text(values) => values[row] == values[other],
        }
    }

    const fn physical(&self) -> Physical {
        match self {
            Self::Double(_) => Physical::DOUBLE,
            Self::Integer(_) => Physical::INT64,
            Self::Flag(_) => Physical::BOOLEAN,
            Self::Text(_) => Physical::BYTE_ARRAY,
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

/// Key of the checksum of a file's columns and notes.
const CHECKSUM: &str = "cfmmr.crc32c";

/// Metadata of a file: keys and texts.
pub type Notes = Vec<(String, String)>;

/// A table of columns of the same length.
#[derive(Clone, Debug, Default, PartialEq)]
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
        match self.get(name) {
            Some(Values::Double(values)) => values.iter().map(|v| format!("{v:?}")).collect(),
            Some(Values::Integer(values)) => values.iter().map(i64::to_string).collect(),
            Some(Values::Flag(values)) => values.iter().map(bool::to_string).collect(),
            Some(Values::Text(values)) => values.clone(),
            None => Vec::new(),
        }
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

    fn checksum(&self, notes: &impl Debug) -> String {
        let text = format!("{:?} {notes:?}", self.0);
        format!("{:08x}", crc32c(text.as_bytes()))
    }

    /// The file, with `notes` beside the columns and a checksum of both.
    pub fn to_parquet(&self, notes: &[(&str, &str)]) -> Result<Vec<u8>, Error> {
        let checksum = self.checksum(&notes);
        self.write(&[notes, &[(CHECKSUM, &checksum)]].concat())
            .map_err(|error| Error::Failure(format!("cannot write a Parquet file: {error}")))
    }

    fn write(&self, notes: &[(&str, &str)]) -> Result<Vec<u8>, ParquetError> {
        let fields = self.0.iter().map(|(name, values)| {
            let field = Type::primitive_type_builder(name, values.physical())
                .with_repetition(Repetition::REQUIRED);
            let text = matches!(values, Values::Text(_)).then_some(LogicalType::String);
            field.with_logical_type(text).build().map(Arc::new)
        });
        let schema = Type::group_type_builder("runs")
            .with_fields(fields.collect::<Result<_, _>>()?)
            .build()?;
        let notes = notes
            .iter()
            .map(|(key, value)| KeyValue::new((*key).to_owned(), (*value).to_owned()))
            .collect();
        let properties = WriterProperties::builder()
            .set_created_by(concat!("cfmmr ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_dictionary_enabled(false)
            .set_key_value_metadata(Some(notes))
            .build();
        let mut writer =
            SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties))?;
        let mut group = writer.next_row_group()?;
        for (_, values) in &self.0 {
            let Some(mut column) = group.next_column()? else {
                break;
            };
            match values {
                Values::Double(v) => column.typed::<DoubleType>().write_batch(v, None, None)?,
                Values::Integer(v) => column.typed::<Int64Type>().write_batch(v, None, None)?,
                Values::Flag(v) => column.typed::<BoolType>().write_batch(v, None, None)?,
                Values::Text(v) => {
                    let v: Vec<ByteArray> = v.iter().map(|s| s.as_str().into()).collect();
                    column
                        .typed::<ByteArrayType>()
                        .write_batch(&v, None, None)?
                }
            };
            column.close()?;
        }
        group.close()?;
        writer.into_inner()
    }

    /// Reads a file that [`Self::to_parquet`] made: columns and notes, or why it is none.
    pub fn from_parquet(content: Vec<u8>) -> Result<(Self, Notes), String> {
        // The library panics on some damaged files.
        match std::panic::catch_unwind(|| Self::read(content)) {
            Ok(result) => result.map_err(|error| error.to_string()),
            Err(_) => Err("the file is damaged".to_owned()),
        }
    }

    fn read(content: Vec<u8>) -> Result<(Self, Notes), ParquetError> {
        let reader = SerializedFileReader::new(Bytes::from(content))?;
        let metadata = reader.metadata().file_metadata();
        let notes = metadata.key_value_metadata().into_iter().flatten();
        let mut notes: Notes = notes
            .map(|note| (note.key.clone(), note.value.clone().unwrap_or_default()))
            .collect();
        let mut columns = Self::default();
        for g in 0..reader.num_row_groups() {
            let group = reader.get_row_group(g)?;
            let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
            let mut part = Self::default();
            for c in 0..group.num_columns() {
                let name = group.metadata().column(c).column_descr().name().to_owned();
                part.0
                    .push((name, read_column(group.get_column_reader(c)?, rows)?));
            }
            if !columns.append(&part) {
                return Err(ParquetError::General("row groups differ".to_owned()));
            }
        }
        let given = notes.pop_if(|(key, _)| key == CHECKSUM);
        match given.is_some_and(|(_, sum)| sum == columns.checksum(&notes)) {
            true => Ok((columns, notes)),
            false => Err(ParquetError::General("checksum does not match".to_owned())),
        }
    }
}

/// All records of a column.
fn records<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    rows: usize,
) -> Result<Vec<T::T>, ParquetError> {
    let mut values = Vec::new();
    reader.read_records(rows, None, None, &mut values)?;
    Ok(values)
}

fn read_column(reader: ColumnReader, rows: usize) -> Result<Values, ParquetError> {
    let error = |text: &str| Err(ParquetError::General(text.to_owned()));
    let values = match reader {
        ColumnReader::DoubleColumnReader(reader) => Values::Double(records(reader, rows)?),
        ColumnReader::Int64ColumnReader(reader) => Values::Integer(records(reader, rows)?),
        ColumnReader::BoolColumnReader(reader) => Values::Flag(records(reader, rows)?),
        ColumnReader::ByteArrayColumnReader(reader) => {
            let values = records(reader, rows)?;
            let words = values.iter().map(|v| v.as_utf8().map(str::to_owned));
            Values::Text(words.collect::<Result<_, _>>()?)
        }
        _ => return error("a column of an unknown type"),
    };
    match values.len() == rows {
        true => Ok(values),
        false => error("a column is truncated"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    properties! { cases 1024;
        #[test]
        fn a_table_comes_back_with_its_bits(
            rows in prop::collection::vec((any::<u64>(), any::<i64>(), any::<bool>(), "\\PC{0,8}"), 0..60),
        ) {
            let columns = Columns(vec![
                ("number".into(), Values::Double(rows.iter().map(|r| f64::from_bits(r.0)).collect())),
                ("count".into(), Values::Integer(rows.iter().map(|r| r.1).collect())),
                ("flag".into(), Values::Flag(rows.iter().map(|r| r.2).collect())),
                ("word".into(), Values::Text(rows.iter().map(|r| r.3.clone()).collect())),
            ]);
            let file = columns.to_parquet(&[("study", "a = 1\n"), ("empty", "")]).unwrap();
            prop_assert_eq!(&file, &columns.to_parquet(&[("study", "a = 1\n"), ("empty", "")]).unwrap());
            let (back, notes) = Columns::from_parquet(file).unwrap();
            prop_assert_eq!(back.words("word"), columns.words("word"));
            prop_assert_eq!(back.integers("count"), columns.integers("count"));
            prop_assert_eq!(back.flags("flag"), columns.flags("flag"));
            let bits = |c: &Columns| c.doubles("number").iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(&back), bits(&columns));
            prop_assert!(notes.contains(&("study".into(), "a = 1\n".into())));
        }

        #[test]
        fn a_damaged_file_is_refused_or_read_as_it_was(place in 0usize..2000, to: u8, cut in 0usize..2000) {
            let columns = Columns(vec![
                ("a".into(), Values::Double((0..50).map(f64::from).collect())),
                ("b".into(), Values::Text((0..50).map(|i: i32| i.to_string()).collect())),
            ]);
            let mut file = columns.to_parquet(&[]).unwrap();
            let n = file.len();
            file[place % n] = to;
            if let Ok((read, _)) = Columns::from_parquet(file.clone()) {
                prop_assert_eq!(&read, &columns);
            }
            file.truncate(cut % n);
            prop_assert!(Columns::from_parquet(file).is_err());
        }
    }
}
