//! Pictures of a campaign: distributions, end postures and influences.
//!
//! A study varies quantities: a listed quantity takes given values, a drawn quantity is random. Each picture is split
//! by every listed quantity that is not a number: into panels, or into coloured series if no listed number uses the
//! colours.

use super::report::{Influence, listed, numbers, short};
use super::rows::CampaignRow;
use super::study::{Starts, Study, Vary, number};
use host_sim::base::statistics::percentile;
use host_sim::run::end::Verdict;
use host_sim::run::final_error::NEAR;
use view::figures;
use view::figures::StartMark;
use view::plot::{Figure, Height, Panel};
use view::style::{BAND, INK, Mark, Shape, Stroke, mark_of, series, series_by};

/// Smallest error on a logarithmic axis, cm and degrees.
const MIN_ERROR: f64 = 0.01;
/// Symbols of the series, distinct in grayscale.
const SHAPES: [Shape; 4] = [Shape::Disc, Shape::Ring, Shape::Cross, Shape::Target];
/// Largest number of maps in a row.
const MAPS: usize = 2;

/// Limits an error to at least [`MIN_ERROR`], for a logarithmic axis.
fn on_decades(error: f64) -> f64 {
    error.max(MIN_ERROR)
}

/// Listed quantity with the values that occur in the runs, in the order of the study's file.
struct Listed<'a> {
    vary: &'a Vary,
    /// Index of the quantity among all varied quantities of the study.
    index: usize,
    values: Vec<&'a toml::Value>,
}

impl<'a> Listed<'a> {
    fn all(study: &'a Study, rows: &[CampaignRow]) -> Vec<Self> {
        let of = |(index, vary): (usize, &'a Vary)| {
            let has = |value: &&toml::Value| rows.iter().any(|row| row.values[index] == **value);
            let values = vary.values.iter().flatten().filter(has).collect();
            Self {
                vary,
                index,
                values,
            }
        };
        listed(study).map(of).collect()
    }

    fn label(&self, value: usize) -> String {
        let value = self.vary.cell(self.values[value]);
        format!("{} = {value}", short(&self.vary.key))
    }
}

/// Runs with equal values of the quantities in the label.
struct Group<'a> {
    label: String,
    rows: Vec<&'a CampaignRow>,
}

/// Group of all runs, without label.
fn all(rows: &[CampaignRow]) -> Group<'_> {
    Group {
        label: String::new(),
        rows: rows.iter().collect(),
    }
}

/// Splits a group by every combination of values of the given lists.
fn split<'a>(group: Group<'a>, lists: &[&Listed]) -> Vec<Group<'a>> {
    lists.iter().fold(vec![group], |groups, list| {
        let part = |group: &Group<'a>, value: usize| {
            let labels = [group.label.clone(), list.label(value)];
            let labels = labels.into_iter().filter(|label| !label.is_empty());
            let rows = group.rows.iter().copied();
            let has = |row: &&CampaignRow| row.values[list.index] == *list.values[value];
            Group {
                label: labels.collect::<Vec<_>>().join(", "),
                rows: rows.filter(has).collect(),
            }
        };
        let parts = |group: &Group<'a>| -> Vec<Group<'a>> {
            let values = 0..list.values.len();
            values.map(|value| part(group, value)).collect()
        };
        groups.iter().flat_map(parts).collect()
    })
}

/// Listed quantities by which maps are split: those that are not numbers. If all are numbers, the first, provided that
/// it has at most four values.
fn splitting<'a>(lists: &'a [Listed<'a>]) -> Vec<&'a Listed<'a>> {
    let words = lists.iter().filter(|list| !list.vary.is_numeric());
    let words: Vec<&Listed> = words.collect();
    let first = lists.iter().take(1);
    match words.is_empty() {
        true => first.filter(|list| list.values.len() <= 2 * MAPS).collect(),
        false => words,
    }
}

/// Distribution functions of the final errors. Listed numbers select the line: the last number its colour, the others
/// its pattern. Each combination of listed words has a row of panels; without listed numbers, the last listed quantity
/// selects the colour.
pub fn distributions(study: &Study, rows: &[CampaignRow]) -> Figure {
    let lists = Listed::all(study, rows);
    let (numbers, mut words): (Vec<&Listed>, Vec<&Listed>) =
        lists.iter().partition(|list| list.vary.is_numeric());
    let by_color = numbers.last().copied().or_else(|| words.pop());
    let by_dash = &numbers[..numbers.len().saturating_sub(1)];
    type OfRow = fn(&CampaignRow) -> f64;
    let errors: [(&str, OfRow); 2] = [
        ("e (cm)", |row| on_decades(100.0 * row.e_m)),
        ("|heading error| (°)", |row| {
            on_decades(row.heading_rad.abs().to_degrees())
        }),
    ];
    let title = format!("{}: share of runs with at most this error", study.name);
    let groups = split(all(rows), &words).into_iter();
    groups.fold(Figure::new(title), |figure, group| {
        let mut panels = errors.map(|(label, error)| {
            Panel::new(label, "share of runs")
                .title(group.label.clone())
                .x_limits(decades(rows.iter().map(error)))
                .y_limits([0.0, 1.0])
                .logarithmic([true, false])
        });
        let label = String::new();
        let colors = split(Group { label, ..group }, by_color.as_slice());
        for (c, color) in colors.into_iter().enumerate() {
            for (d, line) in split(color, by_dash).into_iter().enumerate() {
                // Without a second number, the pattern changes with the colour, so that lines differ in grayscale.
                let stroke = series_by(c, if by_dash.is_empty() { c } else { d }).stroke;
                for (panel, (_, error)) in panels.iter_mut().zip(errors) {
                    let errors = line.rows.iter().map(|row| error(row));
                    panel.line(line.label.clone(), shares(errors.collect()), stroke);
                }
            }
        }
        figure.row(Height::Fixed(300.0), panels)
    })
}

/// Limits of a logarithmic axis: the powers of ten that enclose the errors, because only powers of ten have labels.
fn decades(errors: impl Iterator<Item = f64>) -> [f64; 2] {
    let finite = errors.filter(|e| e.is_finite()).map(libm::log10);
    let [low, high] = finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], e| {
        [low.min(e.floor()), high.max(e.ceil())]
    });
    [low, high.max(low + 1.0)].map(|decade| libm::pow(10f64, decade))
}

/// Empirical distribution function as steps.
fn shares(mut values: Vec<f64>) -> Vec<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let count = values.len() as f64;
    let steps = values.iter().enumerate();
    let steps = steps.flat_map(|(k, &v)| [[v, k as f64 / count], [v, (k + 1) as f64 / count]]);
    std::iter::once([MIN_ERROR, 0.0]).chain(steps).collect()
}

/// Maps of the random starts, or of the final positions if all runs have one start. Marks show the end of the run.
/// There is one map for each combination of the quantities that `splitting` selects.
pub fn map(study: &Study, rows: &[CampaignRow]) -> Figure {
    let lists = Listed::all(study, rows);
    let maps = split(all(rows), &splitting(&lists));
    let goal = study
        .run(0)
        .map_or([0.0; 3], |run| run.scenario.mission.goal);
    match study.starts {
        Starts::Random => map_of_starts(study, &maps, goal),
        Starts::Scenario => map_of_ends(study, &maps, goal),
    }
}

/// End of a run, and whether its error is within 3 cm and 3°.
fn end(row: &CampaignRow) -> Verdict {
    Verdict::of(row.end, row.within)
}

/// Map of each group: every start with the largest error and the worst end of its runs in the group.
fn map_of_starts(study: &Study, maps: &[Group], goal: [f64; 3]) -> Figure {
    let starts = maps.iter().map(|group| {
        let mut starts: Vec<Option<StartMark>> = vec![None; study.trials as usize];
        for row in &group.rows {
            let (end, value) = (end(row), 100.0 * row.e_m);
            let known = starts[row.trial as usize].get_or_insert(StartMark {
                posture: row.start,
                end,
                value,
            });
            known.end = known.end.max(end);
            known.value = known.value.max(value);
        }
        (group.label.clone(), starts.into_iter().flatten().collect())
    });
    let title = format!("{}: starts, with the largest final error", study.name);
    figures::maps(&title, "e (cm)", &starts.collect::<Vec<_>>(), (goal, NEAR))
}

fn map_of_ends(study: &Study, maps: &[Group], goal: [f64; 3]) -> Figure {
    let panels = maps.iter().map(|group| {
        let mut panel = Panel::new("x from the goal (cm)", "y from the goal (cm)")
            .title(group.label.clone())
            .equal_axes();
        for row in &group.rows {
            let ([x, y, _], end) = (row.at, end(row));
            let at = [100.0 * (x - goal[0]), 100.0 * (y - goal[1])];
            panel.mark(end.label(NEAR), at, mark_of(end, 1.8));
        }
        let circle = (0..=90).map(|k| {
            let (s, c) = libm::sincos(f64::from(k) * 4f64.to_radians());
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

/// Position error over each numeric quantity: median and 5th to 95th percentile at each listed number, or every run
/// over a drawn number. There is one series for each combination of the quantities that `splitting` selects. `None`
/// if no quantity is a number.
pub fn sensitivity(study: &Study, rows: &[CampaignRow]) -> Option<Figure> {
    let limits = decades(rows.iter().map(e_cm));
    let lists = Listed::all(study, rows);
    let splitting = splitting(&lists);
    let varied = study.vary.iter().enumerate();
    let numeric = varied.filter(|(_, vary)| vary.is_numeric() && !rows.is_empty());
    let panels = numeric.map(|(index, vary)| {
        let others = splitting.iter().copied();
        let others = others.filter(|list| list.vary.key != vary.key);
        let groups = split(all(rows), &others.collect::<Vec<_>>());
        influence(vary, index, &numbers(index, rows), &groups).y_limits(limits)
    });
    let panels: Vec<Panel> = panels.collect();
    let title = format!("{}: error against the varied quantities", study.name);
    let figure = Figure::new(title);
    (!panels.is_empty()).then(|| figure.rows_of(3, Height::Fixed(260.0), &panels))
}

/// Error of a run on a logarithmic axis, cm.
fn e_cm(row: &CampaignRow) -> f64 {
    on_decades(100.0 * row.e_m)
}

/// Rank correlation of each drawn quantity with the final errors. The horizontal axis is the last listed number, or
/// the index of the combination if no number is listed. Each combination of the other listed quantities has a series.
/// `None` without a correlation.
pub fn correlations(
    study: &Study,
    rows: &[CampaignRow],
    influences: &[Influence],
) -> Option<Figure> {
    let of_keys = influences.chunk_by(|a, b| a.key == b.key);
    let values = |of: &Influence| [of.rank_correlation_e, of.rank_correlation_heading];
    let most = influences
        .iter()
        .flat_map(|of| [values(of), [of.significance; 2]]);
    let most = most.flatten().flatten().map(f64::abs).reduce(f64::max)?;
    let lists = Listed::all(study, rows);
    let across = lists.iter().rposition(|list| list.vary.is_numeric());
    let others = lists.iter().enumerate().filter(|(n, _)| Some(*n) != across);
    let groups = split(all(rows), &others.map(|(_, list)| list).collect::<Vec<_>>());
    let x = |row: &CampaignRow| match across {
        Some(n) => number(&row.values[lists[n].index]).unwrap_or(f64::NAN),
        None => row.cell as f64,
    };
    let x_label = across.map_or("cell of runs.csv", |n| short(&lists[n].vary.key));
    let (x_limits, logarithmic) = axis(&rows.iter().map(x).collect::<Vec<_>>(), false);
    let panel = |of_key: &[Influence], error: usize| {
        let runs = of_key.iter().map(|of| of.trials);
        let runs = [runs.clone().min(), runs.max()].map(Option::unwrap_or_default);
        let mut panel = Panel::new(x_label, ["with e", "with |heading error|"][error])
            .title(short(&of_key[0].key))
            .caption(match runs {
                [least, most] if least < most => format!("{least} to {most} runs each"),
                [runs, _] => format!("{runs} runs each"),
            })
            .logarithmic([logarithmic, false])
            .x_limits(x_limits)
            .y_limits([-1.1 * most, 1.1 * most]);
        let mut marks = Vec::new();
        for (n, group) in groups.iter().enumerate() {
            for rows in group.rows.chunk_by(|a, b| a.cell == b.cell) {
                let mut of_cell = of_key.iter().filter(|of| of.cell == rows[0].cell);
                let found = of_cell.find_map(|of| Some((values(of)[error]?, of.significance?)));
                let Some((value, bound)) = found else {
                    continue;
                };
                let (x, (color, width)) = (x(rows[0]), (BAND.stroke.color, 8.0));
                let dash = BAND.stroke.dash;
                let stroke = Stroke { color, width, dash };
                panel.line("19 of 20 by chance", [[x, -bound], [x, bound]], stroke);
                let mark = Mark::new(SHAPES[n % 4], 3.0, series(n).stroke.color);
                marks.push((group.label.clone(), [x, value], mark));
            }
        }
        for (label, at, mark) in marks {
            panel.mark(label, at, mark);
        }
        panel
    };
    let panels = of_keys.flat_map(|of_key| [panel(of_key, 0), panel(of_key, 1)]);
    let title = format!("{}: rank correlation of drawn quantities", study.name);
    let figure = Figure::new(title);
    Some(figure.rows_of(2, Height::Fixed(220.0), &panels.collect::<Vec<_>>()))
}

/// Limits of an axis for the values `all`. True for a logarithmic axis; false if `even`, that is, for a linear axis.
fn axis(all: &[f64], even: bool) -> ([f64; 2], bool) {
    let [low, high] = [f64::min, f64::max].map(|pick| all.iter().copied().fold(all[0], pick));
    // Margin, so that marks at the ends are not cut.
    if !even && low > 0.0 && high >= 10.0 * low {
        let room = libm::pow(high / low, 0.04);
        return ([low / room, high * room], true);
    }
    let room = if high > low { 0.04 * (high - low) } else { 0.5 };
    ([low - room, high + room], false)
}

/// Position error over one quantity; `all` holds the values of the quantity in all runs.
fn influence(vary: &Vary, index: usize, all: &[f64], groups: &[Group]) -> Panel {
    let even = vary.uniform.is_some() || vary.normal.is_some();
    let (limits, logarithmic) = axis(all, even);
    let mut panel = Panel::new(short(&vary.key), "e (cm)")
        .logarithmic([logarithmic, true])
        .x_limits(limits);
    for (n, group) in groups.iter().enumerate() {
        let mut stroke = series(n).stroke;
        if groups.len() == 1 {
            stroke.color = INK;
        }
        let points = group.rows.iter();
        let points = points.filter_map(|row| Some([number(&row.values[index])?, e_cm(row)]));
        let points: Vec<[f64; 2]> = points.collect();
        let mark = |radius| Mark::new(SHAPES[n % 4], radius, stroke.color);
        if vary.values.is_none() {
            let name = match group.label.as_str() {
                "" => "one run".to_owned(),
                label => format!("one run, {label}"),
            };
            for point in points {
                panel.mark(name.clone(), point, mark(1.6));
            }
        } else {
            medians(&mut panel, &group.label, &points, stroke, mark(3.0));
        }
    }
    panel
}

/// Median and 5th to 95th percentile of the errors at each value of a listed number.
fn medians(panel: &mut Panel, label: &str, points: &[[f64; 2]], stroke: Stroke, mark: Mark) {
    let name = |what: &str| match label {
        "" => what.to_owned(),
        label => format!("{what}, {label}"),
    };
    let mut values: Vec<f64> = points.iter().map(|[x, _]| *x).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let of = |value: f64, share: f64| {
        let there = points.iter().filter(|[x, _]| *x == value);
        percentile(&there.map(|[_, e]| *e).collect::<Vec<_>>(), share)
    };
    let mut medians = Vec::new();
    for &x in &values {
        let range = [0.05, 0.95].map(|share| [x, of(x, share)]);
        let (color, width, dash) = (stroke.color.lighter(0.5), 2.4, stroke.dash);
        let bar = Stroke { color, width, dash };
        panel.line(name("5 to 95 %"), range, bar);
        medians.push([x, of(x, 0.5)]);
        panel.mark("", [x, of(x, 0.5)], mark);
    }
    panel.line(name("median"), medians, stroke);
}
