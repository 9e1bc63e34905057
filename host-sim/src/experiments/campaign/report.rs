//! Results of a campaign, as numbers and as a table.

use super::rows::Row;
use super::study::{Study, Vary, number};
use crate::base::statistics::{Summary, percentile};
use crate::base::table::{Table, plus_minus};
use crate::run::end::Ends;
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
    /// Numbers of trials by end.
    pub ends: Ends,
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

/// The listed quantities and their places among the varied ones.
pub(super) fn listed(study: &Study) -> impl Iterator<Item = (usize, &Vary)> {
    let vary = study.vary.iter().enumerate();
    vary.filter(|(_, vary)| vary.values.is_some())
}

/// Values of a varied quantity of numbers.
pub(super) fn numbers(place: usize, rows: &[Row]) -> Vec<f64> {
    let values = rows.iter().map(|row| number(&row.values[place]));
    values.map(|value| value.unwrap_or(f64::NAN)).collect()
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
    pub fn of(study: &Study, rows: &[Row]) -> Self {
        let cells = rows.chunk_by(|a, b| a.cell == b.cell);
        let e_m: Vec<f64> = rows.iter().map(|row| row.e_m).collect();
        let heading: Vec<f64> = rows.iter().map(|row| row.heading_rad.abs()).collect();
        let drawn = study.vary.iter().enumerate();
        let drawn = drawn.filter(|(_, vary)| vary.values.is_none());
        let influences = drawn.map(|(place, vary)| {
            let values = numbers(place, rows);
            Influence {
                key: vary.key.clone(),
                rank_correlation_e: rank_correlation(&values, &e_m),
                rank_correlation_heading: rank_correlation(&values, &heading),
                significance: 1.96 / (rows.len() as f64 - 1.0).max(1.0).sqrt(),
            }
        });
        Self {
            name: study.name.clone(),
            world: study
                .run(0)
                .map_or_else(|_| String::new(), |run| run.scenario.world.label()),
            seed: study.seed,
            runs: rows.len(),
            cells: cells.map(|rows| cell(study, rows)).collect(),
            influences: influences.collect(),
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
            "ends",
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
                cell.ends.text(),
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

fn cell(study: &Study, rows: &[Row]) -> Cell {
    let numbers = |pick: fn(&Row) -> f64| rows.iter().map(pick).collect::<Vec<_>>();
    let count = |is: fn(&&Row) -> bool| rows.iter().filter(is).count();
    let e_m = numbers(|row| row.e_m);
    let within = count(|row| row.within);
    let value = |(place, vary): (usize, &Vary)| {
        let value = vary.cell(&rows[0].values[place]);
        (vary.key.clone(), value.to_string())
    };
    Cell {
        values: listed(study).map(value).collect(),
        trials: rows.len(),
        e_median_m: percentile(&e_m, 0.5),
        e_p95_m: percentile(&e_m, 0.95),
        e_m: Summary::of(&e_m),
        heading_rad: Summary::of(&numbers(|row| row.heading_rad)),
        within_3cm_3deg: within as f64 / rows.len() as f64,
        within_interval: wilson(within, rows.len()),
        ends: Ends::of_labels(rows.iter().map(Row::end_label)),
        force_rms_n: Summary::of(&numbers(|row| row.force_rms_n)),
        duration_s: Summary::of(&numbers(|row| row.duration_s)),
    }
}
