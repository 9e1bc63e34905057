//! Results of a campaign, as numbers and as a table.

use super::columns::Columns;
use super::study::{Study, Vary};
use crate::base::statistics::{Summary, percentile};
use crate::base::table::{Table, plus_minus};
use serde::Serialize;

/// Results of one combination.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// The listed quantities and their values.
    pub values: Vec<(String, String)>,
    /// Trials.
    pub trials: usize,
    /// Distance of O from the goal, m.
    pub e_m: Summary,
    /// Median of it, m.
    pub e_median_m: f64,
    /// 95th percentile of it, m.
    pub e_p95_m: f64,
    /// Heading error of O, rad.
    pub heading_rad: Summary,
    /// Share within 3 cm and 3°.
    pub within_3cm_3deg: f64,
    /// Wilson's interval of that share at 95 %.
    pub within_interval: [f64; 2],
    /// Trials that the robot reported as done.
    pub done: usize,
    /// Trials that ended with a fault.
    pub faults: usize,
    /// Root mean square of the frame's force, N.
    pub force_rms_n: Summary,
    /// Time of a trial, s.
    pub duration_s: Summary,
}

/// Correlation of a drawn quantity with the results.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Influence {
    /// The quantity.
    pub key: String,
    /// Spearman's rank correlation with the distance from the goal.
    pub rank_correlation_e: f64,
    /// The same with the magnitude of the heading error.
    pub rank_correlation_heading: f64,
    /// Magnitude that chance alone exceeds in one of twenty studies.
    pub significance: f64,
}

/// All that came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Name of the study.
    pub name: String,
    /// World of its first run.
    pub world: String,
    /// Seed.
    pub seed: u64,
    /// Runs.
    pub runs: usize,
    /// The combinations, in the order of the file.
    pub cells: Vec<Cell>,
    /// The drawn quantities.
    pub influences: Vec<Influence>,
}

/// Values of a column at some rows.
pub(super) fn pick<T: Copy>(values: &[T], rows: &[usize]) -> Vec<T> {
    rows.iter()
        .filter_map(|&row| values.get(row).copied())
        .collect()
}

/// Wilson's interval of a share at 95 %.
pub fn wilson(successes: usize, trials: usize) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let (n, z) = (trials as f64, 1.959_963_984_540_054);
    let p = successes as f64 / n;
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

/// Ranks from 1; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let same = |&&place: &&usize| values[place].total_cmp(&values[order[first]]).is_eq();
        let count = order[first..].iter().take_while(same).count();
        for &place in &order[first..first + count] {
            ranks[place] = first as f64 + 0.5 * (count as f64 + 1.0);
        }
        first += count;
    }
    ranks
}

/// Spearman's rank correlation; NaN where one of the two does not vary.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let middle = 0.5 * (a.len() as f64 + 1.0);
    let product = |x: &[f64], y: &[f64]| -> f64 {
        x.iter()
            .zip(y)
            .map(|(x, y)| (x - middle) * (y - middle))
            .sum()
    };
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt()
}

pub(super) fn listed(study: &Study) -> Vec<&Vary> {
    study
        .vary
        .iter()
        .filter(|vary| vary.values.is_some())
        .collect()
}

/// The last part of an entry's name, with what it is a part of.
pub(super) fn short(key: &str) -> &str {
    let cut = key
        .rmatch_indices('.')
        .nth(1)
        .map_or(0, |(place, _)| place + 1);
    &key[cut..]
}

impl Report {
    /// Of all runs of a study, in their order.
    pub fn of(study: &Study, runs: &Columns) -> Self {
        let trials = study.trials as usize;
        let rows: Vec<usize> = (0..runs.rows()).collect();
        let cells = rows
            .chunks(trials)
            .map(|rows| cell(study, runs, rows))
            .collect();
        let drawn = study.vary.iter().filter(|vary| vary.values.is_none());
        let heading: Vec<f64> = runs
            .doubles("heading_rad")
            .iter()
            .map(|v| v.abs())
            .collect();
        let influences = drawn
            .map(|vary| Influence {
                key: vary.key.clone(),
                rank_correlation_e: rank_correlation(runs.doubles(&vary.key), runs.doubles("e_m")),
                rank_correlation_heading: rank_correlation(runs.doubles(&vary.key), &heading),
                significance: 1.96 / (runs.rows() as f64 - 1.0).max(1.0).sqrt(),
            })
            .collect();
        Self {
            name: study.name.clone(),
            world: study
                .run(0)
                .map_or_else(|_| String::new(), |run| run.scenario.world.label()),
            seed: study.seed,
            runs: runs.rows(),
            cells,
            influences,
        }
    }

    /// The table.
    pub fn text(&self) -> String {
        let keys: Vec<&str> = match self.cells.first() {
            Some(cell) => cell.values.iter().map(|(key, _)| short(key)).collect(),
            None => Vec::new(),
        };
        let mut header = keys;
        if header.is_empty() {
            header.push("");
        }
        header.extend([
            "e (cm)",
            "median",
            "95 %",
            "|heading| (°)",
            "3 cm, 3°",
            "(95 % interval)",
            "done",
            "faults",
            "force (N)",
            "time (s)",
        ]);
        let mut table = Table::new(header);
        for cell in &self.cells {
            let mut row: Vec<String> = cell.values.iter().map(|(_, v)| v.clone()).collect();
            if row.is_empty() {
                row.push("all".to_owned());
            }
            let percent = |share: f64| format!("{:.0}", 100.0 * share);
            row.extend([
                plus_minus(100.0 * cell.e_m.mean, 100.0 * cell.e_m.sd, 2),
                format!("{:.2}", 100.0 * cell.e_median_m),
                format!("{:.2}", 100.0 * cell.e_p95_m),
                format!("{:.2}", cell.heading_rad.mean_abs.to_degrees()),
                format!("{} %", percent(cell.within_3cm_3deg)),
                format!(
                    "{} to {} %",
                    percent(cell.within_interval[0]),
                    percent(cell.within_interval[1])
                ),
                format!("{} of {}", cell.done, cell.trials),
                cell.faults.to_string(),
                plus_minus(cell.force_rms_n.mean, cell.force_rms_n.sd, 2),
                plus_minus(cell.duration_s.mean, cell.duration_s.sd, 1),
            ]);
            table.row(row);
        }
        let mut text = format!(
            "{}: {} runs, seed {}, world {}; true final posture errors\n\n{table}",
            self.name, self.runs, self.seed, self.world
        );
        if !self.influences.is_empty() {
            let mut table = Table::new([
                "drawn",
                "rank correlation with e",
                "with |heading|",
                "by chance",
            ]);
            for influence in &self.influences {
                table.row([
                    influence.key.clone(),
                    format!("{:+.2}", influence.rank_correlation_e),
                    format!("{:+.2}", influence.rank_correlation_heading),
                    format!("within ±{:.2}", influence.significance),
                ]);
            }
            text += &format!("\n{table}");
        }
        text
    }
}

fn cell(study: &Study, runs: &Columns, rows: &[usize]) -> Cell {
    let number = |name: &str| pick(runs.doubles(name), rows);
    let count = |name: &str| {
        pick(runs.flags(name), rows)
            .into_iter()
            .filter(|&v| v)
            .count()
    };
    let e_m = number("e_m");
    let within = count("within_3cm_3deg");
    let first = rows.first().copied().unwrap_or(0);
    let value = |key: &str| runs.words(key).into_iter().nth(first).unwrap_or_default();
    Cell {
        values: listed(study)
            .iter()
            .map(|vary| (vary.key.clone(), value(&vary.key)))
            .collect(),
        trials: rows.len(),
        e_median_m: percentile(&e_m, 0.5),
        e_p95_m: percentile(&e_m, 0.95),
        e_m: Summary::of(&e_m),
        heading_rad: Summary::of(&number("heading_rad")),
        within_3cm_3deg: within as f64 / rows.len().max(1) as f64,
        within_interval: wilson(within, rows.len()),
        done: count("done"),
        faults: pick(runs.integers("fault_code"), rows)
            .into_iter()
            .filter(|&code| code != 0)
            .count(),
        force_rms_n: Summary::of(&number("force_rms_n")),
        duration_s: Summary::of(&number("duration_s")),
    }
}
