//! Results of runs and their file formats. Equal results give equal bytes.

use super::study::{Study, StudyRun, Vary, number};
use core_algos::link::framing::crc32c;
use core_algos::safety::Condition;
use host_sim::base::error::Error;
use host_sim::run::end::EndKind;
use host_sim::run::final_error::FinalError;
use host_sim::run::regulate::Outcome;
use output::files::{Cell, Csv};
use recording::csv;
use serde::{Deserialize, Serialize};

/// Varied values and final errors of one run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CampaignRow {
    /// Number of the run in the study.
    pub run: u64,
    /// Index of the combination of listed values. Not stored in the file, like `trial` and `values`, because the study
    /// and `run` determine all three.
    #[serde(skip)]
    pub cell: u64,
    /// Index of the trial within the combination.
    #[serde(skip)]
    pub trial: u32,
    /// Value of each varied quantity, in the order of the study.
    #[serde(skip)]
    pub values: Vec<toml::Value>,
    /// Posture at the start: m, m, rad.
    pub start: [f64; 3],
    /// Distance of O from the goal, m.
    pub e_m: f64,
    /// Heading of O less that of the goal, rad.
    pub heading_rad: f64,
    /// True if the run ends within 3 cm and 3° of the goal.
    pub within: bool,
    /// End of the run.
    pub end: EndKind,
    /// Kind of the end, with the cause of a stop and the sensors at fault.
    pub label: String,
    /// Notices of the run, separated by semicolons.
    pub notices: String,
    /// Code of the condition that ended the run, or that qualifies a reached goal; 0 without a condition.
    pub code: u8,
    /// True posture at the end: m, m, rad.
    pub at: [f64; 3],
    /// 95 % error of the estimated position at the end, m; `None` if the robot has no estimate.
    pub error_95_m: Option<f64>,
    /// Distance of the estimate from the true position at the end, m; `None` if the robot has no estimate.
    pub estimate_error_m: Option<f64>,
    /// Error of the estimated relative position of the axles at the end, m.
    pub drift_m: f64,
    /// Root mean square of the frame's force, N.
    pub force_rms_n: f64,
    /// Largest true curvature of the frame, 1/m.
    pub max_curvature: f64,
    /// Time of the run, s.
    pub duration_s: f64,
    /// Length of the midpoint's path, m.
    pub path_m: f64,
}

impl CampaignRow {
    /// Row for run number `run`, which ended with `outcome`.
    pub fn of(run: u64, of: StudyRun, outcome: &Outcome) -> Self {
        let error = FinalError::of(outcome.midpoint, of.scenario.mission.goal);
        let end = &outcome.end;
        let [x, y, _] = outcome.midpoint;
        let [x_m, y_m, _] = outcome.relative_error;
        Self {
            run,
            cell: of.cell,
            trial: of.trial,
            values: of.values,
            start: of.scenario.mission.start,
            e_m: error.e_m,
            heading_rad: error.heading_rad,
            within: error.is_near(),
            end: end.kind,
            label: end.label(),
            notices: end.notice_names().join("; "),
            code: end.condition.map_or(0, Condition::code),
            at: outcome.midpoint,
            error_95_m: end.error_95.map(|[position, _]| position),
            estimate_error_m: end.estimate.map(|[u, v, _]| libm::hypot(u - x, v - y)),
            drift_m: libm::hypot(x_m, y_m),
            force_rms_n: outcome.force_rms_n,
            max_curvature: outcome.max_curvature,
            duration_s: outcome.end.duration_s,
            path_m: outcome.path_m,
        }
    }

    /// Row of the CSV file; `vary` are the varied quantities.
    fn cells<'a>(&self, vary: &'a [Vary]) -> csv::CsvRow<'a> {
        let mut row = csv::CsvRow::default();
        row.put("run cell", &[self.run as usize, self.cell as usize]);
        row.put("trial", &[self.trial]);
        for (vary, value) in vary.iter().zip(&self.values) {
            row.cell(&vary.key, vary.cell(value));
        }
        row.put("start_x_m start_y_m start_phi_rad", &self.start);
        row.put("e_m heading_rad", &[self.e_m, self.heading_rad]);
        row.put("within_3cm_3deg", &[self.within]);
        let code = match self.code {
            0 => String::new(),
            code => format!("{code:#04x}"),
        };
        row.put(
            "end code notices",
            &[self.end.name(), code.as_str(), self.notices.as_str()],
        );
        row.put("x_m y_m phi_rad", &self.at);
        row.put("error_95_m", &[self.error_95_m.unwrap_or(f64::NAN)]);
        let drift = [self.estimate_error_m.unwrap_or(f64::NAN), self.drift_m];
        row.put("estimate_error_m drift_m", &drift);
        let frame = [self.force_rms_n, self.max_curvature];
        row.put("force_rms_n max_curvature_1_m", &frame);
        row.put("duration_s path_m", &[self.duration_s, self.path_m]);
        row
    }
}

impl Vary {
    /// CSV cell of a value: a number if every value of the quantity is a number, else text.
    pub fn cell(&self, value: &toml::Value) -> Cell {
        match number(value) {
            Some(number) if self.is_numeric() => number.into(),
            _ => Cell::Text(value.to_string()),
        }
    }
}

/// Runs of a study as CSV.
pub fn csv(study: &Study, rows: &[CampaignRow]) -> Csv {
    csv::CsvRow::table(rows.iter().map(|row| row.cells(&study.vary)))
}

/// Content of a block's file. The file has two lines of JSON: this content, and its checksum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredBlock {
    /// Build that wrote the file.
    pub made_by: String,
    /// Canonical text of the study.
    pub study: String,
    /// Results of the block's runs.
    pub rows: Vec<CampaignRow>,
}

impl StoredBlock {
    /// Lines of the block's file: content and checksum.
    pub fn to_lines(&self) -> Result<String, Error> {
        let line = serde_json::to_string(self);
        let line =
            line.map_err(|error| Error::Failure(format!("cannot write a block: {error}")))?;
        let sum = crc32c(line.as_bytes());
        Ok(format!("{line}\n{{\"crc32c\":\"{sum:08x}\"}}\n"))
    }

    /// Parses a file that [`Self::to_lines`] wrote; an error is the reason for a rejection.
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
    use super::super::tests::{finished, study};
    use super::*;
    use proptest::prelude::*;

    /// Block of runs with the given e (m), condition code and index of the end.
    fn stored(results: &[(f64, u8, usize)]) -> StoredBlock {
        let row = finished(&study(), 0).remove(0);
        let rows = results.iter().map(|&(e_m, code, end)| CampaignRow {
            e_m,
            code,
            end: EndKind::ALL[end],
            values: Vec::new(),
            ..row.clone()
        });
        StoredBlock {
            made_by: "build".to_owned(),
            study: "a = 1\n".to_owned(),
            rows: rows.collect(),
        }
    }

    properties! { cases 1024;
        #[test]
        fn rows_are_read_as_written(
            results in prop::collection::vec((prop::num::f64::NORMAL, any::<u8>(), 0..EndKind::ALL.len()), 0..60),
        ) {
            let block = stored(&results);
            let text = block.to_lines().unwrap();
            prop_assert_eq!(StoredBlock::from_lines(text.as_bytes()).unwrap(), block.clone());
        }

        #[test]
        fn damaged_file_is_refused(index in 0usize..2000, to: u8, cut in 0usize..2000) {
            let results = [1.5, 2.5].map(|e_m| (e_m, 0, 0));
            let mut file = stored(&results).to_lines().unwrap().into_bytes();
            let n = file.len();
            prop_assume!(file[index % n] != to);
            file[index % n] = to;
            prop_assert!(StoredBlock::from_lines(&file).is_err());
            file.truncate(cut % n);
            prop_assert!(StoredBlock::from_lines(&file).is_err());
        }
    }
}
