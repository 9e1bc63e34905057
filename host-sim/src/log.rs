//! Log of one trial as a table, one row an epoch.

use crate::output::{Cell, Csv};
use crate::simulation::Record;

const COLUMNS: [&str; 55] = [
    "time_s",
    "x_m",
    "y_m",
    "phi_rad",
    "x_est_m",
    "y_est_m",
    "phi_est_rad",
    "sigma_x_m",
    "sigma_y_m",
    "sigma_phi_rad",
    "front_x_m",
    "front_y_m",
    "front_phi_rad",
    "rear_x_m",
    "rear_y_m",
    "rear_phi_rad",
    "front_x_est_m",
    "front_y_est_m",
    "front_phi_est_rad",
    "rear_x_est_m",
    "rear_y_est_m",
    "rear_phi_est_rad",
    "relative_x_m",
    "relative_y_m",
    "relative_phi_rad",
    "phase",
    "mode",
    "v_m_s",
    "v_rate_m_s2",
    "psi_rad",
    "psi_rate_rad_s",
    "torque_front_left_nm",
    "torque_front_right_nm",
    "torque_rear_left_nm",
    "torque_rear_right_nm",
    "force_x_n",
    "force_y_n",
    "moment_root_nm",
    "moment_end_nm",
    "beam_nis",
    "beam_innovation_x_m",
    "beam_innovation_y_m",
    "beam_innovation_phi_rad",
    "wheel_speed_front_left_rad_s",
    "wheel_speed_front_right_rad_s",
    "wheel_speed_rear_left_rad_s",
    "wheel_speed_rear_right_rad_s",
    "strain_1",
    "strain_2",
    "strain_3",
    "strain_4",
    "strain_5",
    "strain_6",
    "strain_7",
    "strain_8",
];

/// The records as CSV with a header; names carry the unit, `_est` marks the robot's own estimate.
pub fn csv(records: &[Record]) -> Csv {
    let mut csv = Csv::new(COLUMNS);
    for record in records {
        let fused = &record.lead.fused;
        let motion = &record.lead.motion;
        let sigma = |i: usize| f64::from(fused.robot.covariance[i][i]).sqrt();
        let estimate = |p: core_algos::math::Posture| [p.x, p.y, p.phi].map(f64::from);
        let mut row: Vec<Cell> = vec![record.time_s.into()];
        let mut put = |values: &[f64]| row.extend(values.iter().map(|&value| Cell::from(value)));
        put(&record.midpoint);
        put(&estimate(fused.robot.posture));
        put(&[sigma(0), sigma(1), sigma(2)]);
        put(&record.axles[0]);
        put(&record.axles[1]);
        put(&estimate(fused.front.posture));
        put(&estimate(fused.rear.posture));
        put(&record.relative);
        row.push(
            format!("{:?}", record.lead.phase)
                .to_lowercase()
                .as_str()
                .into(),
        );
        row.push(
            format!("{:?}", record.lead.mode)
                .to_lowercase()
                .as_str()
                .into(),
        );
        let mut put = |values: &[f64]| row.extend(values.iter().map(|&value| Cell::from(value)));
        put(&[motion.v, motion.v_rate, motion.psi, motion.psi_rate].map(f64::from));
        put(&record.torque[0]);
        put(&record.torque[1]);
        put(&record.wrench);
        put(&[f64::from(fused.beam.nis)]);
        put(&fused.beam.innovation.map(f64::from));
        put(&record.wheel_speed[0]);
        put(&record.wheel_speed[1]);
        put(&record.strain.map(f64::from));
        csv.row(row);
    }
    csv
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_every_column() {
        let text = csv(&[Record::default(), Record::default()]).into_bytes();
        let mut reader = csv::Reader::from_reader(text.as_slice());
        assert_eq!(reader.headers().unwrap().len(), COLUMNS.len());
        // The reader itself refuses rows of another length.
        assert_eq!(reader.records().filter(|row| row.is_ok()).count(), 2);
    }
}
