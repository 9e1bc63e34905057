//! CSV tables of runs: one row per epoch, or one row per run.

use crate::entry::{AxleTruth, FrameTruth, LeadEntry, TruthEntry, inner_names};
use crate::schema::Schema;
use core_algos::topology::{Role, Topology};
use host_sim::run::end::RunEnd;
use host_sim::run::final_error::FinalError;
use host_sim::run::path_run;
use host_sim::run::regulate::Outcome;
use host_sim::run::robot::Record;
use host_sim::scenario::variant::Variant;
use output::files::{Cell, Csv};

/// Row of a CSV table: cells with the names of their columns.
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

    /// Cells of the row with the names of their columns.
    pub fn into_cells(self) -> Vec<(&'a str, Cell)> {
        self.0
    }

    /// CSV table of these rows; the header is from the first row.
    pub fn table(rows: impl IntoIterator<Item = Self>) -> Csv {
        let mut rows = rows.into_iter().peekable();
        let names = rows.peek().into_iter().flat_map(|Self(row)| row);
        let mut csv = Csv::new(names.map(|(name, _)| name));
        rows.for_each(|Self(row)| csv.row(row.into_iter().map(|(_, cell)| cell)));
        csv
    }
}

/// Row of a trial of posture regulation to `goal` (m, m, rad): sensors and fusion, end, final errors.
pub fn of_trial(
    variant: &Variant,
    trial: usize,
    outcome: &Outcome,
    goal: [f64; 3],
) -> CsvRow<'static> {
    let error = FinalError::of(outcome.midpoint, goal);
    let [dx, dy, _] = outcome.relative_error;
    let mut row = CsvRow::default();
    row.put("rps imu", &[variant.rps, variant.imu]);
    row.put("fusion", &[variant.fusion()]);
    row.put("trial", &[trial]);
    row.end(&outcome.end);
    row.put("e_m heading_rad", &[error.e_m, error.heading_rad]);
    row.put("theta_rad alpha_rad", &[error.theta_rad, error.alpha_rad]);
    row.put("within_tolerance", &[outcome.within]);
    row.put("force_rms_n", &[outcome.force_rms_n]);
    row.put("beam_share", &[outcome.beam_share]);
    row.put("nees drift_m", &[outcome.nees, libm::hypot(dx, dy)]);
    row
}

/// Row of a run along a path: end, and path errors of the true and of the estimated midpoint.
pub fn of_path(outcome: &path_run::Outcome) -> CsvRow<'static> {
    let mut row = CsvRow::default();
    row.end(&outcome.end);
    let names = [
        "rms_m max_m max_cross_track_m rms_heading_rad final_m final_heading_rad",
        "rms_est_m max_est_m max_cross_track_est_m rms_heading_est_rad final_est_m \
         final_heading_est_rad",
    ];
    for (names, it) in names.into_iter().zip([&outcome.truth, &outcome.estimate]) {
        let errors = [
            it.rms_m,
            it.max_m,
            it.max_cross_track_m,
            it.rms_heading_rad,
            it.final_m,
            it.final_heading_rad,
        ];
        row.put(names, &errors);
    }
    row
}

/// CSV table of runs' ends, one row per run.
pub fn of_ends<'a>(ends: impl IntoIterator<Item = &'a RunEnd>) -> Csv {
    CsvRow::table(ends.into_iter().map(|end| {
        let mut row = CsvRow::default();
        row.end(end);
        row
    }))
}

/// Columns of [`RecordRows::cells`]: time, then the fields of the topics `/truth` and `/lead` under their paths in a log.
/// Ticks and times of the topics are left out, because each row has one time. With more than two axles follow the true
/// state of each axle and frame, and the estimates of the axles between the first and the last.
pub fn record_columns(robot: Topology) -> Vec<String> {
    let time = std::iter::once("time_s".to_owned());
    time.chain(record_names(robot).into_iter().flatten())
        .collect()
}

/// Names of the fields of `/truth`, `/lead` and the topics of axles and frames; `None` for ticks and times.
fn record_names(robot: Topology) -> Vec<Option<String>> {
    const TIMES: [&str; 3] = ["time_s", "tick", "epoch_s"];
    let names = |topic: &str, schema: &Schema| -> Vec<Option<String>> {
        let columns = schema.columns().into_iter();
        columns
            .map(|name| (!TIMES.contains(&name.as_str())).then(|| format!("{topic}.{name}")))
            .collect()
    };
    let mut all = names("truth", &TruthEntry::SCHEMA);
    all.extend(names("lead", &LeadEntry::SCHEMA));
    if robot.axle_count() == 2 {
        return all;
    }
    for board in robot.boards() {
        let schema = match board {
            Role::Axle(_) => &AxleTruth::SCHEMA,
            Role::Beam(_) => &FrameTruth::SCHEMA,
        };
        all.extend(names(&format!("truth.{}", robot.name(board)), schema));
    }
    for inner in inner_names(robot) {
        all.extend(["x_m", "y_m", "phi_rad"].map(|field| Some(format!("lead.{inner}.{field}"))));
    }
    all
}

/// Converts records of a robot to rows of [`record_columns`].
pub struct RecordRows {
    robot: Topology,
    /// True for a cell with a column.
    own: Vec<bool>,
}

impl RecordRows {
    /// Rows of this robot.
    pub fn new(robot: Topology) -> Self {
        Self {
            robot,
            own: record_names(robot).iter().map(Option::is_some).collect(),
        }
    }

    /// Cells of the record's row.
    pub fn cells(&self, record: &Record) -> impl Iterator<Item = Cell> {
        let mut all = TruthEntry::from(record).cells();
        all.extend(LeadEntry::new(0, record.time_s, &record.lead).cells());
        if self.robot.axle_count() > 2 {
            let time = record.time_s;
            all.extend(
                record
                    .axles
                    .iter()
                    .flat_map(|axle| AxleTruth::new(time, axle).cells()),
            );
            all.extend(
                record
                    .frames
                    .iter()
                    .flat_map(|frame| FrameTruth::new(time, frame).cells()),
            );
            for at in record.lead.inner.iter().take(self.robot.axle_count() - 2) {
                let at = at.map(|at| [at.x, at.y, at.phi].map(|value| Cell::Double(value.into())));
                all.extend(at.unwrap_or([const { Cell::Empty }; 3]));
            }
        }
        let cells = all.into_iter().zip(&self.own);
        let own = cells.filter_map(|(cell, own)| own.then_some(cell));
        std::iter::once(Cell::from(record.time_s)).chain(own)
    }
}

/// CSV table of records, one row per record.
pub fn of_records(records: &[Record]) -> Csv {
    let axles = records.first().map(|record| record.axles.len());
    let robot = axles.and_then(Topology::new).unwrap_or_default();
    let mut csv = Csv::new(record_columns(robot));
    let rows = RecordRows::new(robot);
    for record in records {
        csv.row(rows.cells(record));
    }
    csv
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::node::lead;

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

    #[test]
    fn three_axles_have_columns_of_each_axle_and_frame() {
        let robot = Topology::new(3).unwrap();
        let record = Record::without_truth(0, robot, lead::Output::default());
        let text = of_records(&[record.clone(), record]).into_bytes();
        let mut reader = ::csv::Reader::from_reader(text.as_slice());
        let columns = reader.headers().unwrap().clone();
        // In addition: 7 of each axle, 7 and the strains of each frame, 3 of the inner axle's estimate.
        let expected = 85 + 3 * 7 + 2 * (7 + core_algos::beam::MAX_GAUGES) + 3;
        assert_eq!(columns.len(), expected);
        for name in [
            "truth.axle-2.axle.x_m",
            "truth.beam-2.force_n[0]",
            "lead.axle-2.phi_rad",
        ] {
            assert!(
                columns.iter().any(|column| column == name),
                "{name}: {columns:?}"
            );
        }
        assert_eq!(reader.records().filter(|row| row.is_ok()).count(), 2);
    }
}
