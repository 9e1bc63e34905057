//! CSV tables of runs: one row per epoch, or one row per run.

use crate::entry::{LeadEntry, TruthEntry};
use crate::schema::Schema;
use host_sim::run::end::RunEnd;
use host_sim::run::robot::Record;
use output::files::{Cell, Csv};

/// Row of a table: values with the names of their columns.
#[derive(Debug, Default)]
pub struct CsvRow<'a>(Vec<(&'a str, Cell)>);

impl<'a> CsvRow<'a> {
    /// Appends values with the names of their columns, separated by spaces; NaN gives an empty cell.
    pub fn put<C: Copy + Into<Cell>>(&mut self, names: &'a str, values: &[C]) {
        let names = names.split(' ');
        debug_assert_eq!(names.clone().count(), values.len());
        let cells = values.iter().map(|&value| match value.into() {
            Cell::Double(value) if value.is_nan() => Cell::Empty,
            cell => cell,
        });
        self.0.extend(names.zip(cells));
    }

    /// Appends one cell to the row.
    pub fn cell(&mut self, name: &'a str, cell: Cell) {
        self.0.push((name, cell));
    }

    /// Appends the end of a run: kind, condition code, notices, reason, true posture, estimate, 95 % error, duration.
    pub fn end(&mut self, end: &RunEnd) {
        const UNKNOWN: f64 = f64::NAN;
        let code = end.code().unwrap_or_default();
        let notices = end.notice_names().join("; ");
        self.put(
            "end code notices",
            &[end.kind.name(), code.as_str(), notices.as_str()],
        );
        self.put("reason", &[end.reason.as_deref().unwrap_or_default()]);
        self.put("x_m y_m phi_rad", &end.truth.unwrap_or([UNKNOWN; 3]));
        let estimate = end.estimate.unwrap_or([UNKNOWN; 3]);
        self.put("x_est_m y_est_m phi_est_rad", &estimate);
        let error = end.error_95.unwrap_or([UNKNOWN; 2]);
        self.put("error_95_m error_95_rad", &error);
        self.put("duration_s", &[end.duration_s]);
    }

    /// Makes a table of these rows.
    pub fn table(rows: impl IntoIterator<Item = Self>) -> Csv {
        let mut rows = rows.into_iter().peekable();
        let names = rows.peek().into_iter().flat_map(|Self(row)| row);
        let mut csv = Csv::new(names.map(|(name, _)| name));
        rows.for_each(|Self(row)| csv.row(row.into_iter().map(|(_, cell)| cell)));
        csv
    }
}

/// Table of ends of runs, one per row.
pub fn of_ends<'a>(ends: impl IntoIterator<Item = &'a RunEnd>) -> Csv {
    CsvRow::table(ends.into_iter().map(|end| {
        let mut row = CsvRow::default();
        row.end(end);
        row
    }))
}

/// Table of records: time, then the fields of the topics `/truth` and `/lead` under their paths in a log. Ticks and
/// times of the topics are left out, because each row has one time.
pub fn of_records(records: &[Record]) -> Csv {
    const TIMES: [&str; 3] = ["time_s", "tick", "epoch_s"];
    let names = |topic: &str, schema: &Schema| -> Vec<Option<String>> {
        let columns = schema.columns().into_iter();
        let own = columns.map(|name| (!TIMES.contains(&name.as_str())).then_some(name));
        own.map(|name| Some(format!("{topic}.{}", name?))).collect()
    };
    let names = [
        names("truth", &TruthEntry::SCHEMA),
        names("lead", &LeadEntry::SCHEMA),
    ]
    .concat();
    let own = names.iter().flatten().map(String::as_str);
    let mut csv = Csv::new(std::iter::once("time_s").chain(own));
    for record in records {
        let truth = TruthEntry::from(record).cells();
        let lead = LeadEntry::new(0, record.time_s, &record.lead).cells();
        let cells = truth.into_iter().chain(lead).zip(&names);
        let own = cells.filter_map(|(cell, name)| name.as_ref().map(|_| cell));
        csv.row(std::iter::once(Cell::from(record.time_s)).chain(own));
    }
    csv
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::node::lead;
    use core_algos::topology::Topology;

    #[test]
    fn every_row_has_every_column() {
        let record = Record::without_truth(0, Topology::PAIR, lead::Output::default());
        let text = of_records(&[record.clone(), record]).into_bytes();
        let mut reader = ::csv::Reader::from_reader(text.as_slice());
        // 85 columns: the time; 12 of postures and 20 of lists from `/truth`; 5 of words, 36 of estimates and 11 of
        // other values from `/lead`.
        assert_eq!(reader.headers().unwrap().len(), 85);
        // The reader rejects a row whose length differs from that of the header.
        assert_eq!(reader.records().filter(|row| row.is_ok()).count(), 2);
    }
}
