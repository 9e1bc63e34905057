//! Pictures of a campaign: distributions, end postures and influences.
//!
//! Each is split by every listed quantity that is not a number: into panels, or into series where no
//! listed number needs their colours.

use super::columns::Columns;
use super::report::{listed, pick, short};
use super::study::{Starts, Study, Vary};
use crate::base::statistics::percentile;
use crate::view::figures::{self, StartMark};
use crate::view::plot::{Figure, Height, Panel};
use crate::view::style::{BAND, End, INK, Mark, Shape, Stroke, series, series_by};

/// Least error that has a place on a logarithmic axis, cm and degrees.
const LEAST: f64 = 0.01;
/// Maps beside each other.
const MAPS: usize = 2;

/// An error on a logarithmic axis; not a number stays one, and is not drawn.
fn on_decades(error: f64) -> f64 {
    if error < LEAST { LEAST } else { error }
}

/// A listed quantity with its values, in the order of the file.
struct Listed<'a> {
    vary: &'a Vary,
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
            place: place.collect(),
            vary,
            values,
        }
    }

    fn all(study: &'a Study, runs: &Columns) -> Vec<Self> {
        let lists = listed(study).into_iter();
        lists.map(|vary| Self::of(vary, runs)).collect()
    }

    fn label(&self, value: usize) -> String {
        format!("{} = {}", short(&self.vary.key), self.values[value])
    }
}

/// Runs that agree in some listed quantities.
struct Group {
    label: String,
    rows: Vec<usize>,
}

/// All runs.
fn all(runs: &Columns) -> Group {
    Group {
        label: String::new(),
        rows: (0..runs.rows()).collect(),
    }
}

/// The runs of a group by each combination of the values of some lists.
fn split(group: Group, lists: &[&Listed]) -> Vec<Group> {
    lists.iter().fold(vec![group], |groups, list| {
        let part = |group: &Group, value: usize| {
            let labels = [group.label.clone(), list.label(value)];
            let labels = labels.into_iter().filter(|label| !label.is_empty());
            let rows = group.rows.iter().copied();
            Group {
                label: labels.collect::<Vec<_>>().join(", "),
                rows: rows.filter(|&row| list.place[row] == value).collect(),
            }
        };
        let parts = |group: &Group| -> Vec<Group> {
            let values = 0..list.values.len();
            values.map(|value| part(group, value)).collect()
        };
        groups.iter().flat_map(parts).collect()
    })
}

/// The lists that are not numbers, or else the first list if it has few values.
fn splitting<'a>(lists: &'a [Listed<'a>]) -> Vec<&'a Listed<'a>> {
    let words: Vec<&Listed> = lists
        .iter()
        .filter(|list| !list.vary.is_numeric())
        .collect();
    match words.is_empty() {
        true => lists
            .iter()
            .take(1)
            .filter(|list| list.values.len() <= 2 * MAPS)
            .collect(),
        false => words,
    }
}

/// Share of the runs below an error, one line for each combination of listed numbers: the last by
/// colour, the others by pattern. A row of panels for each combination of the other lists, the last of
/// which takes the colours if no number is listed.
pub fn distributions(study: &Study, runs: &Columns) -> Figure {
    let lists = Listed::all(study, runs);
    let (numbers, mut words): (Vec<&Listed>, Vec<&Listed>) =
        lists.iter().partition(|list| list.vary.is_numeric());
    let by_color = numbers.last().copied().or_else(|| words.pop());
    let by_dash = &numbers[..numbers.len().saturating_sub(1)];
    let errors = [
        ("e (cm)", "e_m", 100.0),
        ("|heading error| (°)", "heading_rad", 1f64.to_degrees()),
    ];
    let title = format!("{}: share of runs with at most this error", study.name);
    let rows = split(all(runs), &words);
    rows.into_iter().fold(Figure::new(title), |figure, group| {
        let mut panels = errors.map(|(label, name, factor)| {
            let values = runs.doubles(name).iter();
            Panel::new(label, "share of runs")
                .title(group.label.clone())
                .x_limits(decades(values.map(|v| on_decades(factor * v.abs()))))
                .y_limits([0.0, 1.0])
                .logarithmic([true, false])
        });
        let label = String::new();
        let colors = split(Group { label, ..group }, by_color.as_slice());
        for (c, color) in colors.into_iter().enumerate() {
            for (d, line) in split(color, by_dash).into_iter().enumerate() {
                // Without a second number the pattern differs too, for grayscale.
                let stroke = series_by(c, if by_dash.is_empty() { c } else { d }).stroke;
                for (panel, (_, name, factor)) in panels.iter_mut().zip(errors) {
                    let values = pick(runs.doubles(name), &line.rows);
                    let values = values.iter().map(|v| on_decades(factor * v.abs()));
                    panel.line(line.label.clone(), shares(values.collect()), stroke);
                }
            }
        }
        figure.row(Height::Fixed(300.0), panels)
    })
}

/// Whole decades around errors, so that the axis has numbers.
fn decades(errors: impl Iterator<Item = f64>) -> [f64; 2] {
    let finite = errors.filter(|e| e.is_finite()).map(f64::log10);
    let [low, high] = finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], e| {
        [low.min(e.floor()), high.max(e.ceil())]
    });
    [low, high.max(low + 1.0)].map(|decade| 10f64.powf(decade))
}

/// Steps of the share of values up to each value.
fn shares(mut values: Vec<f64>) -> Vec<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let count = values.len() as f64;
    let steps = values.iter().enumerate();
    let steps = steps.flat_map(|(k, &v)| [[v, k as f64 / count], [v, (k + 1) as f64 / count]]);
    std::iter::once([LEAST, 0.0]).chain(steps).collect()
}

/// Starts of the runs by their ends, or the ends if all runs have one start; a map
/// for each combination of the lists that are not numbers.
pub fn map(study: &Study, runs: &Columns) -> Figure {
    let lists = Listed::all(study, runs);
    let maps = split(all(runs), &splitting(&lists));
    let goal = study
        .run(0)
        .map_or([0.0; 3], |run| run.scenario.mission.goal);
    match study.starts {
        Starts::Random => map_of_starts(study, runs, &maps, goal),
        Starts::Scenario => map_of_ends(study, runs, &maps, goal),
    }
}

/// End of each run.
fn ends(runs: &Columns) -> Vec<End> {
    let (done, within) = (runs.flags("done"), runs.flags("within_3cm_3deg"));
    let pairs = done.iter().zip(within.iter());
    pairs
        .map(|(&done, &within)| End::of(done, within))
        .collect()
}

/// Each start with the largest error, and the worst end, of any combination of the rest.
fn map_of_starts(study: &Study, runs: &Columns, maps: &[Group], goal: [f64; 3]) -> Figure {
    let (trials, e_m, ends) = (study.trials as usize, runs.doubles("e_m"), ends(runs));
    let start = ["start_x_m", "start_y_m", "start_phi_rad"].map(|name| runs.doubles(name));
    let starts = maps.iter().map(|group| {
        let mut starts: Vec<Option<StartMark>> = vec![None; trials];
        for &row in &group.rows {
            let (end, value) = (ends[row], 100.0 * e_m[row]);
            let known = starts[row % trials].get_or_insert_with(|| StartMark {
                posture: start.map(|column| column[row]),
                end,
                value,
            });
            known.end = known.end.max(end);
            // Not a number is the worst.
            if !(value <= known.value) {
                known.value = value;
            }
        }
        (group.label.clone(), starts.into_iter().flatten().collect())
    });
    let title = format!("{}: starts, with the largest final error", study.name);
    figures::maps(&title, "e (cm)", &starts.collect::<Vec<_>>(), goal)
}

fn map_of_ends(study: &Study, runs: &Columns, maps: &[Group], goal: [f64; 3]) -> Figure {
    let ends = ends(runs);
    let panels = maps.iter().map(|group| {
        let mut panel = Panel::new("x from the goal (cm)", "y from the goal (cm)")
            .title(group.label.clone())
            .equal_axes();
        for &row in &group.rows {
            let [x, y] = ["x_m", "y_m"].map(|name| runs.doubles(name)[row]);
            let at = [100.0 * (x - goal[0]), 100.0 * (y - goal[1])];
            panel.mark(ends[row].label(), at, ends[row].mark(1.8));
        }
        let circle = (0..=90).map(|k| {
            let (s, c) = (f64::from(k) * 4f64.to_radians()).sin_cos();
            [3.0 * c, 3.0 * s]
        });
        panel.line("3 cm", circle, BAND.stroke);
        panel
    });
    let height = if maps.len() > 1 { 300.0 } else { 420.0 };
    Figure::new(format!("{}: final positions", study.name)).rows_of(
        maps.len().clamp(1, MAPS),
        Height::Fixed(height),
        &panels.collect::<Vec<_>>(),
    )
}

/// Error over each quantity: its median and 5th to 95th percentile at each listed
/// number, or every run over a drawn one; a series for each combination of the lists that are not
/// numbers. `None` if no quantity is a number.
pub fn sensitivity(study: &Study, runs: &Columns) -> Option<Figure> {
    let e_cm = runs.doubles("e_m").iter().map(|v| on_decades(100.0 * v));
    let e_cm: Vec<f64> = e_cm.collect();
    let limits = decades(e_cm.iter().copied());
    let lists = Listed::all(study, runs);
    let splitting = splitting(&lists);
    let panels: Vec<Panel> = study
        .vary
        .iter()
        .filter(|vary| vary.is_numeric() && runs.rows() > 0)
        .map(|vary| {
            let others = splitting
                .iter()
                .copied()
                .filter(|list| list.vary.key != vary.key);
            let groups = split(all(runs), &others.collect::<Vec<_>>());
            influence(vary, runs.doubles(&vary.key), &e_cm, &groups).y_limits(limits)
        })
        .collect();
    let figure = Figure::new(format!(
        "{}: error against the varied quantities",
        study.name
    ));
    (!panels.is_empty()).then(|| figure.rows_of(3, Height::Fixed(260.0), &panels))
}

/// Error over one quantity.
fn influence(vary: &Vary, at: &[f64], e_cm: &[f64], groups: &[Group]) -> Panel {
    let [low, high] = [f64::min, f64::max].map(|pick| at.iter().copied().fold(at[0], pick));
    let even = vary.uniform.is_some() || vary.normal.is_some();
    let logarithmic = !even && low > 0.0 && high >= 10.0 * low;
    // What lies at the ends is not cut by the axes.
    let limits = if logarithmic {
        let room = (high / low).powf(0.04);
        [low / room, high * room]
    } else {
        let room = 0.04 * (high - low);
        [low - room, high + room]
    };
    let mut panel = Panel::new(short(&vary.key), "e (cm)")
        .logarithmic([logarithmic, true])
        .x_limits(limits);
    for (n, group) in groups.iter().enumerate() {
        let mut stroke = series(n).stroke;
        if groups.len() == 1 {
            stroke.color = INK;
        }
        let (at, e_cm) = (pick(at, &group.rows), pick(e_cm, &group.rows));
        // The shapes differ for grayscale.
        let shape = [Shape::Disc, Shape::Ring, Shape::Cross, Shape::Target][n % 4];
        let mark = |radius| Mark::new(shape, radius, stroke.color);
        if vary.values.is_none() {
            let name = match group.label.as_str() {
                "" => "one run".to_owned(),
                label => format!("one run, {label}"),
            };
            for (&x, &e) in at.iter().zip(&e_cm) {
                panel.mark(name.clone(), [x, e], mark(1.6));
            }
        } else {
            medians(&mut panel, &group.label, (&at, &e_cm), stroke, mark(3.0));
        }
    }
    panel
}

/// Median and 5th to 95th percentile of the errors at each value of a listed number.
fn medians(
    panel: &mut Panel,
    label: &str,
    (at, e_cm): (&[f64], &[f64]),
    stroke: Stroke,
    mark: Mark,
) {
    let name = |what: &str| match label {
        "" => what.to_owned(),
        label => format!("{what}, {label}"),
    };
    let mut values = at.to_vec();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let of = |value: f64, share: f64| {
        let rows = at.iter().zip(e_cm).filter(|(x, _)| **x == value);
        percentile(&rows.map(|(_, &e)| e).collect::<Vec<_>>(), share)
    };
    let mut medians = Vec::new();
    for &x in &values {
        let range = [0.05, 0.95].map(|share| [x, of(x, share)]);
        let (color, width) = (stroke.color.lighter(0.5), 2.4);
        panel.line(
            name("5 to 95 %"),
            range,
            Stroke {
                color,
                width,
                ..stroke
            },
        );
        medians.push([x, of(x, 0.5)]);
        panel.mark("", [x, of(x, 0.5)], mark);
    }
    panel.line(name("median"), medians, stroke);
}
