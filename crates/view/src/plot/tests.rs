//! Tests of figures.

use super::checks::{attributes, check_figure, check_svg, numbers, png_size};
use super::thin::{columns, dashes, straightened};
use super::*;
use crate::style::{Dash, INK, Shape};
use proptest::prelude::*;

const DOT: Mark = Mark::new(Shape::Disc, 2.0, INK);

const fn stroke(color: Rgb, dash: Dash) -> Stroke {
    let width = 1.0;
    Stroke { color, width, dash }
}

const SOLID: Stroke = stroke(INK, Dash::Solid);

fn dots(panel: Panel, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut panel = panel;
    for &point in points {
        panel.mark("dot", point, DOT);
    }
    let svg = Figure::new("t").row(Height::Fixed(200.0), [panel]).svg();
    check_svg(&svg);
    let x = numbers(attributes(&svg, "circle", "cx"));
    let y = numbers(attributes(&svg, "circle", "cy"));
    // The first circle belongs to the legend.
    x.into_iter().zip(y).skip(1).map(|(x, y)| [x, y]).collect()
}

#[test]
fn equal_axes_are_equal_and_y_points_up() {
    let points = [[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [-8.0, 1.0]];
    let placed = dots(Panel::new("x", "y").equal_axes(), &points);
    let right = placed[1][0] - placed[0][0];
    let up = placed[0][1] - placed[2][1];
    assert!(right > 30.0 && (right - up).abs() < 0.02, "{right} {up}");
    assert!((placed[1][1] - placed[0][1]).abs() < 0.02);
}

#[test]
fn axes_end_at_the_fixed_limits() {
    let panel = Panel::new("x", "y")
        .x_limits([0.0, 10.0])
        .y_limits([-1.0, 1.0]);
    let placed = dots(panel, &[[0.0, -1.0], [10.0, 1.0], [5.0, 0.0]]);
    assert!((placed[0][1] - placed[1][1] - 200.0).abs() < 0.02);
    for k in 0..2 {
        assert!((placed[2][k] - 0.5 * (placed[0][k] + placed[1][k])).abs() < 0.02);
    }
}

#[test]
fn figure_has_the_stated_size_and_is_reproducible() {
    let draw = || {
        let mut panel = Panel::new("t (s)", "<v> & \"w\"").caption("−1 °");
        panel.line(
            "v",
            (0..100).map(|k| [f64::from(k), f64::from(k * k)]),
            stroke(Rgb(0, 99, 0), Dash::Dashed),
        );
        Figure::new("a < b").row(Height::Fixed(100.0), [panel.clone(), panel])
    };
    let (svg, png) = (draw().svg(), draw().png());
    check_figure(&draw());
    let height: f64 = numbers(attributes(&svg, "svg", "height"))[0];
    assert_eq!(png_size(&png), [1600, (2.0 * height) as u32]);
    assert_eq!(svg, draw().svg());
    assert_eq!(png, draw().png());
}

#[test]
fn figure_without_finite_data_is_still_drawn() {
    let mut broken = Panel::new("x", "y").x_limits([f64::NAN, 1.0]).equal_axes();
    broken.line("a", [[0.0, f64::NAN], [f64::INFINITY, 1.0]], SOLID);
    broken.mark("b", [f64::NAN; 2], DOT);
    let mut constant = Panel::new("x", "y");
    constant.line("", [[0.0, 5.0], [1.0, 5.0]], SOLID);
    let figure = Figure::new("")
        .row(Height::Fixed(100.0), [broken, constant, Panel::new("", "")])
        .row(Height::Fixed(100.0), []);
    check_svg(&figure.svg());
    png_size(&figure.png());
    check_svg(&Figure::default().svg());
}

#[test]
fn line_is_interrupted_at_a_gap() {
    let mut panel = Panel::new("x", "y");
    let points = [
        [0.0, 0.0],
        [1.0, 1.0],
        [f64::NAN; 2],
        [2.0, 0.0],
        [3.0, 1.0],
    ];
    panel.line("", points, stroke(Rgb(1, 2, 3), Dash::Solid));
    let svg = Figure::new("").row(Height::Fixed(100.0), [panel]).svg();
    assert_eq!(svg.matches("stroke=\"#010203\"").count(), 2);
}

#[test]
fn logarithmic_axis_is_labelled_with_powers_of_ten() {
    let mut panel = Panel::new("t (s)", "ratio").logarithmic([true; 2]);
    panel.line("", [[8e3, 6e-3], [2e5, 1.2e3]], SOLID);
    let figure = Figure::new("").row(Height::Fixed(200.0), [panel]);
    check_figure(&figure);
    for text in ["0.01", "1", "100", "10000", "100000"] {
        assert!(figure.svg().contains(&format!(">{text}<")), "{text}");
    }
}

#[test]
fn legend_lists_each_drawn_label_once_and_no_other() {
    let mut panel = Panel::new("x", "y");
    for label in ["first", "second", "first", ""] {
        panel.line(label, [[0.0, 0.0], [1.0, 1.0]], SOLID);
    }
    panel.mark("nowhere", [f64::NAN, 1.0], DOT);
    let figure = Figure::new("").row(Height::Fixed(100.0), [panel.clone(), panel]);
    let svg = figure.svg();
    let count = |label: &str| svg.matches(&format!(">{label}<")).count();
    assert_eq!(["first", "second", "nowhere"].map(count), [1, 1, 0]);
}

properties! { cases 64;
    #[test]
    fn thinning_stays_within_its_tolerance(
        steps in prop::collection::vec((-3.0f64..3.0, -3.0f64..3.0), 3..60)
    ) {
        let mut at = (0.0, 0.0);
        let points: Vec<_> = steps.iter().map(|s| { at = (at.0 + s.0, at.1 + s.1); at }).collect();
        let kept = straightened(&points);
        prop_assert_eq!(kept.first(), points.first());
        prop_assert_eq!(kept.last(), points.last());
        for p in &points {
            // Distance to the nearest of many points on the thinned line.
            let nearest = kept.windows(2).flat_map(|w| (0..=100).map(move |k| {
                let t = f64::from(k) / 100.0;
                (w[0].0 + t * (w[1].0 - w[0].0), w[0].1 + t * (w[1].1 - w[0].1))
            })).map(|q| (q.0 - p.0).hypot(q.1 - p.1)).fold(f64::INFINITY, f64::min);
            prop_assert!(nearest < 0.2, "{}", nearest);
        }
    }

    #[test]
    fn columns_keep_the_extremes_of_a_signal(values in prop::collection::vec(-50.0f64..50.0, 2..400)) {
        let points: Vec<_> = values.iter().enumerate().map(|(k, &v)| (k as f64 * 0.03, v)).collect();
        let kept = columns(&points);
        let range = |points: &[(f64, f64)]| points.iter().fold(
            (f64::INFINITY, f64::NEG_INFINITY), |r, p| (r.0.min(p.1), r.1.max(p.1)));
        prop_assert_eq!(range(&kept), range(&points));
        prop_assert!(kept.windows(2).all(|w| w[0].0 < w[1].0));
        prop_assert!(kept.len() as f64 <= 4.0 * (values.len() as f64 * 0.06 + 1.0));
    }

    #[test]
    fn dashes_cover_their_share_of_any_line(
        steps in prop::collection::vec((0.1f64..9.0, -9.0f64..9.0), 1..60)
    ) {
        let mut at = (0.0, 0.0);
        let points: Vec<_> = std::iter::once(at)
            .chain(steps.iter().map(|s| { at = (at.0 + s.0, at.1 + s.1); at }))
            .collect();
        let length = |line: &[(f64, f64)]| -> f64 {
            line.windows(2).map(|w| (w[1].0 - w[0].0).hypot(w[1].1 - w[0].1)).sum()
        };
        let pieces = dashes(&points, &[7.0, 4.0]);
        let total = length(&points);
        let periods = (total / 11.0).floor();
        let expected = periods * 7.0 + (total - periods * 11.0).min(7.0);
        let drawn: f64 = pieces.iter().map(|piece| length(piece)).sum();
        prop_assert!((drawn - expected).abs() < 1e-9 * (1.0 + total));
    }
}
