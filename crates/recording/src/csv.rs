//! Log of one trial as a table, one row an epoch.

use core_algos::math::Posture;
use host_sim::run::end::RunEnd;
use host_sim::run::robot::Record;
use output::files::{Cell, Csv};

/// A row of a table, each value beside the name of its column.
#[derive(Debug, Default)]
pub struct Row<'a>(Vec<(&'a str, Cell)>);

impl<'a> Row<'a> {
    /// Appends values with the names of their columns, separated by spaces; what is no number is an empty cell.
    pub fn put<C: Copy + Into<Cell>>(&mut self, names: &'a str, values: &[C]) {
        let names = names.split(' ');
        debug_assert_eq!(names.clone().count(), values.len());
        let cells = values.iter().map(|&value| match value.into() {
            Cell::Double(value) if value.is_nan() => Cell::Empty,
            cell => cell,
        });
        self.0.extend(names.zip(cells));
    }

    /// Appends a cell.
    pub fn cell(&mut self, name: &'a str, cell: Cell) {
        self.0.push((name, cell));
    }

    /// Appends the end of a run: kind, code, notices, truth, estimate, 95 % error, time.
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

    /// The table of these rows.
    pub fn table(rows: impl IntoIterator<Item = Self>) -> Csv {
        let mut rows = rows.into_iter().peekable();
        let names = rows.peek().into_iter().flat_map(|Self(row)| row);
        let mut csv = Csv::new(names.map(|(name, _)| name));
        rows.for_each(|Self(row)| csv.row(row.into_iter().map(|(_, cell)| cell)));
        csv
    }
}

/// Ends of runs, one a row.
pub fn of_ends<'a>(ends: impl IntoIterator<Item = &'a RunEnd>) -> Csv {
    Row::table(ends.into_iter().map(|end| {
        let mut row = Row::default();
        row.end(end);
        row
    }))
}

fn row(record: &Record) -> Row<'static> {
    let fused = &record.lead.fused;
    let motion = &record.lead.motion;
    let sigma = [0, 1, 2].map(|i| f64::from(fused.robot.covariance[i][i]).sqrt());
    let estimate = |p: Posture| [p.x, p.y, p.phi].map(f64::from);
    let words = [
        format!("{:?}", record.lead.phase).to_lowercase(),
        format!("{:?}", record.lead.mode).to_lowercase(),
    ];
    let mut row = Row::default();
    row.put("time_s", &[record.time_s]);
    row.put("x_m y_m phi_rad", &record.midpoint);
    let robot = estimate(fused.robot.posture);
    row.put("x_est_m y_est_m phi_est_rad", &robot);
    row.put("sigma_x_m sigma_y_m sigma_phi_rad", &sigma);
    row.put("front_x_m front_y_m front_phi_rad", &record.axles[0]);
    row.put("rear_x_m rear_y_m rear_phi_rad", &record.axles[1]);
    let front = estimate(fused.front.posture);
    row.put("front_x_est_m front_y_est_m front_phi_est_rad", &front);
    let rear = estimate(fused.rear.posture);
    row.put("rear_x_est_m rear_y_est_m rear_phi_est_rad", &rear);
    let names = "relative_x_m relative_y_m relative_phi_rad";
    row.put(names, &record.relative);
    row.put("phase mode", &[words[0].as_str(), words[1].as_str()]);
    let motion = [motion.v, motion.v_rate, motion.psi.0, motion.psi_rate];
    let names = "v_m_s v_rate_m_s2 psi_rad psi_rate_rad_s";
    row.put(names, &motion.map(f64::from));
    let names =
        "torque_front_left_nm torque_front_right_nm torque_rear_left_nm torque_rear_right_nm";
    row.put(names, record.torque.as_flattened());
    let names = "force_x_n force_y_n moment_root_nm moment_end_nm";
    row.put(names, &record.wrench);
    row.put("beam_nis", &[f64::from(fused.beam.nis)]);
    let names = "beam_innovation_x_m beam_innovation_y_m beam_innovation_phi_rad";
    row.put(names, &fused.beam.innovation.map(f64::from));
    let names = "wheel_speed_front_left_rad_s wheel_speed_front_right_rad_s \
                 wheel_speed_rear_left_rad_s wheel_speed_rear_right_rad_s";
    row.put(names, record.wheel_speed.as_flattened());
    let names = "strain_1 strain_2 strain_3 strain_4 strain_5 strain_6 strain_7 strain_8";
    row.put(names, &record.strain.map(f64::from));
    row
}

/// The records as CSV with a header; names carry the unit, `_est` marks the robot's own estimate.
pub fn of_records(records: &[Record]) -> Csv {
    let Row(header) = row(&Record::default());
    let mut csv = Csv::new(header.iter().map(|(name, _)| name));
    for record in records {
        csv.row(row(record).0.into_iter().map(|(_, cell)| cell));
    }
    csv
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_every_column() {
        let text = of_records(&[Record::default(), Record::default()]).into_bytes();
        let mut reader = ::csv::Reader::from_reader(text.as_slice());
        assert_eq!(reader.headers().unwrap().len(), 55);
        // The reader itself refuses rows of another length.
        assert_eq!(reader.records().filter(|row| row.is_ok()).count(), 2);
    }
}
