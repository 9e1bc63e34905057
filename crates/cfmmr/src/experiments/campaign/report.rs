//! Results of a campaign, as numbers and as a table.

use super::rows::CampaignRow;
use super::study::{Study, Vary, number};
use host_sim::base::statistics::{Summary, percentile};
use host_sim::run::end::Ends;
use host_sim::scenario::own;
use output::table::{Table, plus_minus};
use serde::Serialize;

/// Statistics of all trials with one combination of listed values.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// The listed quantities and their values.
    pub values: Vec<(String, String)>,
    /// Number of trials.
    pub trials: usize,
    /// Distance of O from the goal, m.
    pub e_m: Summary,
    /// Median distance of O from the goal, m.
    pub e_median_m: f64,
    /// 95th percentile of the distance of O from the goal, m.
    pub e_p95_m: f64,
    /// Heading error of O, rad.
    pub heading_rad: Summary,
    /// Share of the trials that end within 3 cm and 3° of the goal.
    pub within_3cm_3deg: f64,
    /// Wilson's 95 % interval of the share within 3 cm and 3°.
    pub within_interval: [f64; 2],
    /// Numbers of trials by end.
    pub ends: Ends,
    /// Root mean square of the frame's force, N.
    pub force_rms_n: Summary,
    /// Time of a trial, s.
    pub duration_s: Summary,
}

/// Rank correlation of a drawn quantity with the final errors, in one combination of listed values.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Influence {
    /// Scenario key of the drawn quantity.
    pub key: String,
    /// Index of the combination of listed values, as in `runs.csv`.
    pub cell: u64,
    /// The listed quantities and their values.
    pub values: Vec<(String, String)>,
    /// Number of trials.
    pub trials: usize,
    /// Spearman's rank correlation with the distance from the goal.
    pub rank_correlation_e: Option<f64>,
    /// Spearman's rank correlation with the magnitude of the heading error.
    pub rank_correlation_heading: Option<f64>,
    /// 5 % significance bound of the correlations' magnitudes; `None` without a correlation.
    pub significance: Option<f64>,
    /// Reason for a missing correlation.
    pub note: Option<String>,
}

/// Statistics and correlations of a campaign.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CampaignReport {
    /// Name of the study.
    pub name: String,
    /// World of the first run.
    pub world: String,
    /// Seed of all draws.
    pub seed: u64,
    /// Names of the user's parts.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub own: Vec<String>,
    /// Number of runs.
    pub runs: usize,
    /// Results of each combination of listed values, in the order of the study.
    pub cells: Vec<Cell>,
    /// Rank correlations of each drawn quantity, one for each combination.
    pub influences: Vec<Influence>,
}

/// Wilson's 95 % interval of a share.
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

/// Rank of each value, from 1; equal values share the mean of their ranks.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let same = |&&index: &&usize| values[index].total_cmp(&values[order[first]]).is_eq();
        let count = order[first..].iter().take_while(same).count();
        for &index in &order[first..first + count] {
            ranks[index] = first as f64 + 0.5 * (count as f64 + 1.0);
        }
        first += count;
    }
    ranks
}

/// Spearman's rank correlation; `None` if `a` or `b` is constant.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let (a, b) = (ranks(a), ranks(b));
    let middle = 0.5 * (a.len() as f64 + 1.0);
    let product = |x: &[f64], y: &[f64]| -> f64 {
        x.iter()
            .zip(y)
            .map(|(x, y)| (x - middle) * (y - middle))
            .sum()
    };
    let scale = (product(&a, &a) * product(&b, &b)).sqrt();
    (scale > 0.0).then(|| product(&a, &b) / scale)
}

/// Listed quantities, each with its index among all varied quantities.
pub(super) fn listed(study: &Study) -> impl Iterator<Item = (usize, &Vary)> {
    let vary = study.vary.iter().enumerate();
    vary.filter(|(_, vary)| vary.values.is_some())
}

/// Value of the quantity at `index` in each run; NaN for a value that is no number.
pub(super) fn numbers(index: usize, rows: &[CampaignRow]) -> Vec<f64> {
    let values = rows.iter().map(|row| number(&row.values[index]));
    values.map(|value| value.unwrap_or(f64::NAN)).collect()
}

/// Last two names of a key: `robot.lead.limits.bend_rad` gives `limits.bend_rad`.
pub(super) fn short(key: &str) -> &str {
    let cut = key
        .rmatch_indices('.')
        .nth(1)
        .map_or(0, |(index, _)| index + 1);
    &key[cut..]
}

impl CampaignReport {
    /// Report on the runs of a study, in the order of their numbers.
    pub fn of(study: &Study, rows: &[CampaignRow]) -> Self {
        let cells = rows.chunk_by(|a, b| a.cell == b.cell);
        let idle = |rows: &[CampaignRow]| study.idle(rows[0].cell).unwrap_or_default();
        let cells: Vec<_> = cells.map(|rows| (rows, idle(rows))).collect();
        let indices = 0..study.vary.len();
        let drawn = indices.filter(|&index| study.vary[index].values.is_none());
        let influences = drawn.flat_map(|index| {
            let of = move |(rows, idle): &(&[CampaignRow], Vec<Option<String>>)| {
                influence(study, index, rows, idle.get(index).cloned().flatten())
            };
            cells.iter().map(of)
        });
        let first = study.run(0);
        Self {
            name: study.name.clone(),
            world: first.map_or_else(|_| String::new(), |run| run.scenario.world.label()),
            seed: study.seed,
            own: study.own.clone(),
            runs: rows.len(),
            influences: influences.collect(),
            cells: cells.iter().map(|(rows, _)| cell(study, rows)).collect(),
        }
    }

    /// Report as tables.
    pub fn text(&self) -> String {
        let names = self.cells.iter().take(1).flat_map(|cell| &cell.values);
        let names = names.map(|(key, _)| short(key)).collect::<Vec<_>>();
        let names = names.join(", ");
        let errors = [&names, "e (cm)", "median", "95 %", "within 3 cm, 3°"];
        let mut errors = Table::new(errors);
        let more = [&names, "|heading| (°)", "force (N)", "time (s)"];
        let mut more = Table::new(more);
        let mut ends = Table::new([&names, "ends"]).left_aligned();
        for cell in &self.cells {
            let share = 100.0 * cell.within_3cm_3deg;
            let [low, high] = cell.within_interval.map(|share| 100.0 * share);
            errors.row([
                label(&cell.values),
                plus_minus(100.0 * cell.e_m.mean, 100.0 * cell.e_m.sd, 2),
                format!("{:.2}", 100.0 * cell.e_median_m),
                format!("{:.2}", 100.0 * cell.e_p95_m),
                format!("{share:.0} % ({low:.0} to {high:.0})"),
            ]);
            more.row([
                label(&cell.values),
                format!("{:.2}", cell.heading_rad.mean_abs.to_degrees()),
                plus_minus(cell.force_rms_n.mean, cell.force_rms_n.sd, 2),
                plus_minus(cell.duration_s.mean, cell.duration_s.sd, 1),
            ]);
            let mut label = label(&cell.values);
            for line in cell.ends.lines() {
                ends.row([std::mem::take(&mut label), line]);
            }
        }
        format!(
            "{}: {} runs, seed {}, world {}{}; true final posture errors\n\n\
             {errors}In parentheses: 95 % interval of the share.\n\n{more}\n{ends}{}",
            self.name,
            self.runs,
            self.seed,
            self.world,
            own::title(&self.own),
            self.correlations()
        )
    }

    /// Text table of the rank correlations.
    fn correlations(&self) -> String {
        if self.influences.is_empty() {
            return String::new();
        }
        let header = "drawn, in combination;runs;with e;with |heading|;by chance";
        let mut table = Table::new(header.split(';'));
        let mut notes: Vec<String> = Vec::new();
        let mut last = "";
        for influence in &self.influences {
            let key = influence.key.as_str();
            if last != key {
                table.row([short(key)]);
            }
            let signed =
                |value: Option<f64>| value.map_or_else(String::new, |r| format!("{r:+.2}"));
            let bound = influence.significance.map(|bound| format!("±{bound:.2}"));
            table.row([
                format!("  {}", label(&influence.values)),
                influence.trials.to_string(),
                signed(influence.rank_correlation_e),
                signed(influence.rank_correlation_heading),
                bound.unwrap_or_default(),
            ]);
            let note = influence.note.as_ref();
            notes.extend(note.map(|note| format!("Empty: {note}.\n")));
            last = key;
        }
        notes.sort();
        notes.dedup();
        format!(
            "\nRank correlation of the drawn quantities with the final errors, by combination\n\n\
             {table}By chance: exceeded in 1 of 20 studies if the quantity has no effect.\n{}",
            notes.concat()
        )
    }
}

/// Listed values of a combination as text, for a table cell.
fn label(values: &[(String, String)]) -> String {
    let values: Vec<&str> = values.iter().map(|(_, value)| value.as_str()).collect();
    match values.is_empty() {
        true => "all".to_owned(),
        false => values.join(", "),
    }
}

/// Correlations of the drawn quantity at `index` in the runs of one combination. `idle` is the reason if the quantity
/// has no effect in this combination.
fn influence(study: &Study, index: usize, rows: &[CampaignRow], idle: Option<String>) -> Influence {
    let drawn = numbers(index, rows);
    let with = |error: fn(&CampaignRow) -> f64| match idle {
        None => rank_correlation(&drawn, &rows.iter().map(error).collect::<Vec<_>>()),
        Some(_) => None,
    };
    let (e, heading) = (with(|row| row.e_m), with(|row| row.heading_rad.abs()));
    let constant = e.is_none() || heading.is_none();
    let constant = constant.then(|| "the error is the same in all runs".to_owned());
    // With few runs the normal approximation exceeds 1.
    let bound = (1.96 / (rows.len() as f64 - 1.0).sqrt()).min(1.0);
    Influence {
        key: study.vary[index].key.clone(),
        cell: rows[0].cell,
        values: values(study, &rows[0]),
        trials: rows.len(),
        rank_correlation_e: e,
        rank_correlation_heading: heading,
        significance: e.or(heading).map(|_| bound),
        note: idle.clone().or(constant),
    }
}

/// Listed quantities with their values in a run.
fn values(study: &Study, row: &CampaignRow) -> Vec<(String, String)> {
    let value = |(index, vary): (usize, &Vary)| {
        let value = vary.cell(&row.values[index]);
        (vary.key.clone(), value.to_string())
    };
    listed(study).map(value).collect()
}

fn cell(study: &Study, rows: &[CampaignRow]) -> Cell {
    let numbers = |pick: fn(&CampaignRow) -> f64| rows.iter().map(pick).collect::<Vec<_>>();
    let count = |is: fn(&&CampaignRow) -> bool| rows.iter().filter(is).count();
    let e_m = numbers(|row| row.e_m);
    let within = count(|row| row.within);
    Cell {
        values: values(study, &rows[0]),
        trials: rows.len(),
        e_median_m: percentile(&e_m, 0.5),
        e_p95_m: percentile(&e_m, 0.95),
        e_m: Summary::of(&e_m),
        heading_rad: Summary::of(&numbers(|row| row.heading_rad)),
        within_3cm_3deg: within as f64 / rows.len() as f64,
        within_interval: wilson(within, rows.len()),
        ends: Ends::of_labels(rows.iter().map(|row| row.label.clone())),
        force_rms_n: Summary::of(&numbers(|row| row.force_rms_n)),
        duration_s: Summary::of(&numbers(|row| row.duration_s)),
    }
}
