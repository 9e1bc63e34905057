//! What came out of a campaign: a table, and pictures of distributions, end postures and influences.

use super::columns::Columns;
use super::study::{Starts, Study, Vary};
use crate::figures::{self, SweepStart};
use crate::plot::palette::{BLACK, BLUE, GREY, SERIES, VERMILION};
use crate::plot::{Figure, Height, Legend, Mark, Panel, Rgb, Shape, Stroke};
use crate::statistics::{Summary, percentile};
use crate::table::{Table, plus_minus};
use serde::Serialize;

/// Least error that has a place on a logarithmic axis, cm and degrees.
const LEAST: f64 = 0.01;
/// Maps beside each other.
const MAPS: usize = 2;

/// What came out of one combination.
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

/// How strongly a drawn quantity and a result go together.
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
fn pick<T: Copy>(values: &[T], rows: &[usize]) -> Vec<T> {
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

fn listed(study: &Study) -> Vec<&Vary> {
    study
        .vary
        .iter()
        .filter(|vary| vary.values.is_some())
        .collect()
}

/// The last part of an entry's name, with what it is a part of.
fn short(key: &str) -> &str {
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

/// An error on a logarithmic axis; not a number stays one, and is not drawn.
fn decade(error: f64) -> f64 {
    if error < LEAST {
        LEAST.log10()
    } else {
        error.log10()
    }
}

/// A listed quantity with its values, in the order of the file.
struct Listed<'a> {
    key: &'a str,
    /// Place of each run's value among them.
    place: Vec<usize>,
    values: Vec<String>,
}

impl<'a> Listed<'a> {
    fn of(vary: &'a Vary, runs: &Columns) -> Self {
        let mut values: Vec<String> = Vec::new();
        let place = runs.words(&vary.key).into_iter().map(|word| {
            let known = values.iter().position(|value| *value == word);
            known.unwrap_or_else(|| {
                values.push(word);
                values.len() - 1
            })
        });
        Self {
            key: &vary.key,
            place: place.collect(),
            values,
        }
    }

    fn label(&self, value: usize) -> String {
        format!("{} = {}", short(self.key), self.values[value])
    }

    fn rows(&self, value: usize) -> Vec<usize> {
        let rows = self.place.iter().enumerate();
        rows.filter_map(|(row, &place)| (place == value).then_some(row))
            .collect()
    }
}

/// Colour of the n-th value.
fn color(n: usize) -> Rgb {
    SERIES[n % SERIES.len()]
}

/// Pattern of the n-th value; the third and those behind it look alike.
fn dashed(color: Rgb, n: usize) -> Stroke {
    match n {
        0 => Stroke::solid(color, 1.8),
        1 => Stroke::dashed(color, 1.8),
        _ => Stroke::dotted(color, 1.8),
    }
}

/// Share of the trials below an error, one line for each combination: the last list by colour, the
/// one before by pattern; combinations of more lists look like those of the last two.
pub fn distributions(study: &Study, report: &Report, runs: &Columns) -> Figure {
    let panels = [
        ("e (cm)", "e_m", 100.0),
        (
            "|heading error| (°)",
            "heading_rad",
            180.0 / std::f64::consts::PI,
        ),
    ];
    let lists: Vec<Listed> = listed(study)
        .into_iter()
        .map(|vary| Listed::of(vary, runs))
        .collect();
    let (by_color, by_dash) = (lists.last(), lists.iter().rev().nth(1));
    let mut figure = Figure::new(format!(
        "{}: share of runs with at most this error",
        study.name
    ));
    for (list, stroke) in [
        (
            by_color,
            (|n| Stroke::solid(color(n), 1.8)) as fn(usize) -> Stroke,
        ),
        (by_dash, |n| dashed(BLACK, n)),
    ] {
        for value in 0..list.map_or(0, |list| list.values.len()) {
            let label = list.map_or(String::new(), |list| list.label(value));
            figure = figure.legend(Legend::line(label, stroke(value)));
        }
    }
    let trials = study.trials as usize;
    let place = |list: Option<&Listed>, row: usize| list.map_or(0, |list| list.place[row]);
    let panels = panels.map(|(label, name, factor)| {
        let mut panel = Panel::new(label, "share of runs")
            .y_limits([0.0, 1.0])
            .x_decades();
        for cell in 0..report.cells.len() {
            let values = runs.doubles(name).chunks(trials).nth(cell).unwrap_or(&[]);
            let mut sorted: Vec<f64> = values.iter().map(|v| decade(factor * v.abs())).collect();
            sorted.sort_by(f64::total_cmp);
            let count = sorted.len() as f64;
            let steps = sorted.iter().enumerate().flat_map(|(k, &value)| {
                [[value, k as f64 / count], [value, (k + 1) as f64 / count]]
            });
            let row = cell * trials;
            let stroke = dashed(color(place(by_color, row)), place(by_dash, row));
            panel.line(std::iter::once([LEAST.log10(), 0.0]).chain(steps), stroke);
        }
        panel
    });
    figure.row(Height::Fixed(300.0), panels)
}

/// Where the runs started and how they ended, or where they ended if they started in one place; a map
/// for each value of the first list, if it has few.
pub fn map(study: &Study, runs: &Columns) -> Figure {
    let first = listed(study).first().map(|vary| Listed::of(vary, runs));
    let maps: Vec<(String, Vec<usize>)> = match first {
        Some(list) if (2..=2 * MAPS).contains(&list.values.len()) => (0..list.values.len())
            .map(|value| (list.label(value), list.rows(value)))
            .collect(),
        _ => vec![(String::new(), (0..runs.rows()).collect())],
    };
    let goal = study
        .run(0)
        .map_or([0.0; 3], |run| run.scenario.mission.goal);
    if study.starts == Starts::Random {
        return map_of_starts(study, runs, &maps, goal);
    }
    map_of_ends(study, runs, &maps, goal)
}

/// Each start with the largest error that any combination of the rest ends with.
fn map_of_starts(
    study: &Study,
    runs: &Columns,
    maps: &[(String, Vec<usize>)],
    goal: [f64; 3],
) -> Figure {
    let (trials, e_m) = (study.trials as usize, runs.doubles("e_m"));
    let within = runs.flags("within_3cm_3deg");
    let start = ["start_x_m", "start_y_m", "start_phi_rad"].map(|name| runs.doubles(name));
    let starts = maps.iter().map(|(label, rows)| {
        let mut starts: Vec<Option<SweepStart>> = vec![None; trials];
        for &row in rows {
            let (success, value) = (within[row], 100.0 * e_m[row]);
            match &mut starts[row % trials] {
                Some(known) => {
                    known.success &= success;
                    // Not a number is the worst.
                    if !(value <= known.value) {
                        known.value = value;
                    }
                }
                none => {
                    *none = Some(SweepStart {
                        posture: start.map(|column| column[row]),
                        success,
                        value,
                        path: Vec::new(),
                    });
                }
            }
        }
        let starts: Vec<SweepStart> = starts.into_iter().flatten().collect();
        (label.clone(), starts)
    });
    let title = format!(
        "{}: starts, and the largest error they end with",
        study.name
    );
    figures::maps(&title, "e (cm)", &starts.collect::<Vec<_>>(), goal)
}

fn map_of_ends(
    study: &Study,
    runs: &Columns,
    maps: &[(String, Vec<usize>)],
    goal: [f64; 3],
) -> Figure {
    let within = runs.flags("within_3cm_3deg");
    let panels = maps.iter().map(|(label, rows)| {
        let mut panel = Panel::new("x from the goal (cm)", "y from the goal (cm)")
            .title(label.clone())
            .equal_axes();
        for &row in rows {
            let [x, y] = ["x_m", "y_m"].map(|name| runs.doubles(name)[row]);
            let mark = Mark {
                shape: Shape::Disc,
                radius: 1.6,
                color: if within[row] { BLUE } else { VERMILION },
            };
            panel.mark([100.0 * (x - goal[0]), 100.0 * (y - goal[1])], mark);
        }
        let circle = (0..=90).map(|k| {
            let (s, c) = (f64::from(k) * 4f64.to_radians()).sin_cos();
            [3.0 * c, 3.0 * s]
        });
        panel.line(circle, Stroke::dashed(GREY, 1.2));
        panel
    });
    let mark = |color| Mark {
        shape: Shape::Disc,
        radius: 3.0,
        color,
    };
    let figure = Figure::new(format!("{}: where the runs ended", study.name))
        .legend(Legend::mark("within 3 cm and 3°", mark(BLUE)))
        .legend(Legend::mark("not", mark(VERMILION)))
        .legend(Legend::line("3 cm", Stroke::dashed(GREY, 1.2)));
    let height = if maps.len() > 1 { 300.0 } else { 420.0 };
    figures::in_rows(figure, Height::Fixed(height), panels, MAPS)
}

/// How the error depends on each quantity: its median and 5th to 95th percentile at each listed
/// number, or every run over a drawn one; by colour for each value of the first list. `None` if no
/// quantity is a number.
pub fn sensitivity(study: &Study, runs: &Columns) -> Option<Figure> {
    let e_cm: Vec<f64> = runs.doubles("e_m").iter().map(|v| 100.0 * v).collect();
    let first = listed(study).first().map(|vary| Listed::of(vary, runs));
    // Whole decades, so that the axis has numbers.
    let decades = e_cm.iter().map(|&e| decade(e)).filter(|e| e.is_finite());
    let [low, high] = decades.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], e| {
        [low.min(e.floor()), high.max(e.ceil())]
    });
    let e_limits = [low, high.max(low + 1.0)];
    let (mut panels, mut colored) = (Vec::new(), false);
    for vary in study.vary.iter().filter(|vary| vary.is_numeric()) {
        let at = runs.doubles(&vary.key);
        let Some(&any) = at.first() else { continue };
        let [low, high] = [f64::min, f64::max].map(|pick| at.iter().copied().fold(any, pick));
        let even = vary.uniform.is_some() || vary.normal.is_some();
        let logarithmic = !even && low > 0.0 && high >= 10.0 * low;
        let along = |x: f64| if logarithmic { x.log10() } else { x };
        let mut panel = Panel::new(short(&vary.key), "e (cm)")
            .decades()
            .y_limits(e_limits);
        if logarithmic {
            panel = panel.x_decades();
        }
        let groups = match first.as_ref().filter(|list| list.key != vary.key) {
            Some(list) => (0..list.values.len())
                .map(|value| list.rows(value))
                .collect(),
            None => vec![(0..runs.rows()).collect::<Vec<usize>>()],
        };
        let several = groups.len() > 1;
        colored |= several;
        let mut ends = [f64::INFINITY, f64::NEG_INFINITY];
        for (n, rows) in groups.iter().enumerate() {
            let color = if several { color(n) } else { BLACK };
            let (at, e_cm) = (pick(at, rows), pick(&e_cm, rows));
            if vary.values.is_none() {
                for (&x, &e) in at.iter().zip(&e_cm) {
                    let mark = Mark {
                        shape: Shape::Disc,
                        radius: 1.4,
                        color,
                    };
                    panel.mark([along(x), decade(e)], mark);
                }
            } else {
                let mut values = at.clone();
                values.sort_by(f64::total_cmp);
                values.dedup();
                let of = |value: f64, share: f64| {
                    let rows = at.iter().zip(&e_cm).filter(|(x, _)| **x == value);
                    decade(percentile(
                        &rows.map(|(_, &e)| e).collect::<Vec<_>>(),
                        share,
                    ))
                };
                for &value in &values {
                    let x = along(value);
                    let [low, high] = [0.05, 0.95].map(|share| [x, of(value, share)]);
                    panel.line([low, high], Stroke::solid(color.lighter(0.5), 2.4));
                    let mark = Mark {
                        shape: Shape::Disc,
                        radius: 3.0,
                        color,
                    };
                    panel.mark([x, of(value, 0.5)], mark);
                }
                let medians = values.iter().map(|&value| [along(value), of(value, 0.5)]);
                panel.line(medians, Stroke::solid(color, 1.4));
            }
            ends = [ends[0].min(along(low)), ends[1].max(along(high))];
        }
        // What lies at the ends is not cut by the axes.
        let room = 0.04 * (ends[1] - ends[0]);
        panels.push(panel.x_limits([ends[0] - room, ends[1] + room]));
    }
    if panels.is_empty() {
        return None;
    }
    let disc = |color| Mark {
        shape: Shape::Disc,
        radius: 3.0,
        color,
    };
    let mut figure = Figure::new(format!("{}: error against what was varied", study.name));
    if let Some(list) = first.as_ref().filter(|_| colored) {
        for value in 0..list.values.len() {
            figure = figure.legend(Legend::mark(list.label(value), disc(color(value))));
        }
    }
    figure = figure
        .legend(Legend::line(
            "through the medians of listed values",
            Stroke::solid(BLACK, 1.4),
        ))
        .legend(Legend::line(
            "5 to 95 % of their runs",
            Stroke::solid(BLACK.lighter(0.5), 2.4),
        ));
    Some(figures::in_rows(figure, Height::Fixed(260.0), panels, 3))
}
