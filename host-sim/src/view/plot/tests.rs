//! Tests of the pictures.

use super::thin::{columns, dashes, straightened};
use super::*;
use crate::view::style::{Dash, INK, Shape};
use kuva::render::render::{Primitive, TextAnchor};
use proptest::prelude::*;

/// Values of an attribute in all elements of a kind.
fn attributes(svg: &str, element: &str, attribute: &str) -> Vec<String> {
    let (open, key) = (format!("<{element} "), format!(" {attribute}=\""));
    let starts = svg.match_indices(&open).map(|(start, _)| start);
    starts
        .filter_map(|start| {
            let tag = &svg[start..start + svg[start..].find('>')?];
            let value = &tag[tag.find(&key)? + key.len()..];
            Some(value[..value.find('"')?].to_string())
        })
        .collect()
}

fn numbers(values: Vec<String>) -> Vec<f64> {
    values.iter().map(|value| value.parse().unwrap()).collect()
}

/// Checks that tags are balanced, attributes quoted, and that no number is missing.
pub fn check_svg(svg: &str) {
    let mut open = Vec::new();
    let mut rest = svg;
    while let Some(start) = rest.find('<') {
        assert!(!rest[..start].contains('>'), "stray >: {}", &rest[..start]);
        rest = &rest[start..];
        let end = rest.find('>').expect("a closed tag");
        let tag = &rest[1..end];
        rest = &rest[end + 1..];
        if tag.starts_with("!--") {
            continue;
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
        } else if !tag.ends_with('/') {
            open.push(tag.split_whitespace().next().unwrap());
        }
    }
    assert!(open.is_empty(), "{open:?} never closed");
    assert!(svg.starts_with("<svg ") && svg.contains("viewBox=\"0 0 800 "));
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

/// A rectangle on the page: left, top, right, bottom.
type Rectangle = [f64; 4];

fn overlap(a: &Rectangle, b: &Rectangle) -> bool {
    a[0] < b[2] - 1.0 && b[0] < a[2] - 1.0 && a[1] < b[3] - 1.0 && b[1] < a[3] - 1.0
}

/// Words with the rectangles that they fill, and the rectangles of the plots.
fn layout(figure: &Figure) -> (Vec<(String, Rectangle)>, Vec<Rectangle>) {
    let (mut texts, mut plots, mut at) = (Vec::new(), Vec::new(), [0.0; 2]);
    let mut text = |at: [f64; 2], content: String, size: u32, anchor: &TextAnchor, turned: bool| {
        let (width, size) = (page::text_width(&content, size), f64::from(size));
        let from = match anchor {
            TextAnchor::Start => 0.0,
            TextAnchor::Middle => -0.5 * width,
            TextAnchor::End => -width,
        };
        let [x, y] = at;
        let rectangle = match turned {
            false => [x + from, y - 0.75 * size, x + from + width, y + 0.2 * size],
            true => [x - 0.75 * size, y + from, x + 0.75 * size, y + from + width],
        };
        texts.push((content, rectangle));
    };
    for element in page::scene(figure).elements {
        match element {
            Primitive::GroupStart { transform, .. } => {
                let transform = transform.unwrap();
                let numbers = transform
                    .trim_start_matches("translate(")
                    .trim_end_matches(')');
                let (x, y) = numbers.split_once(',').unwrap();
                at = [x.parse().unwrap(), y.parse().unwrap()];
            }
            Primitive::GroupEnd => at = [0.0; 2],
            Primitive::ClipStart {
                x,
                y,
                width,
                height,
                ..
            } => {
                let (x, y) = (x + at[0], y + at[1]);
                plots.push([x, y, x + width, y + height]);
            }
            Primitive::Text {
                x,
                y,
                content,
                size,
                anchor,
                rotate,
                ..
            } => {
                text(
                    [x + at[0], y + at[1]],
                    content,
                    size,
                    &anchor,
                    rotate.is_some(),
                );
            }
            Primitive::RichText {
                x,
                y,
                spans,
                size,
                anchor,
                ..
            } => {
                let content = spans.iter().map(|span| span.text.as_str()).collect();
                text([x, y], content, size, &anchor, false);
            }
            _ => {}
        }
    }
    (texts, plots)
}

/// Checks that a figure is well-formed, and that all its words stand on the page, apart from each other
/// and outside the plots, where no track is.
pub fn check_figure(figure: &Figure) {
    let svg = figure.svg();
    check_svg(&svg);
    let height = numbers(attributes(&svg, "svg", "height"))[0];
    let (texts, plots) = layout(figure);
    for (n, (text, place)) in texts.iter().enumerate() {
        let inside = place[0] >= 0.0 && place[2] <= WIDTH && place[1] >= 0.0;
        assert!(inside && place[3] <= height, "{text:?} at {place:?}");
        for (other, by) in &texts[..n] {
            assert!(!overlap(place, by), "{text:?} over {other:?}");
        }
        assert!(
            !plots.iter().any(|plot| overlap(place, plot)),
            "{text:?} in a plot"
        );
    }
}

/// Width and height in the header of a PNG file.
pub fn png_size(png: &[u8]) -> [u32; 2] {
    assert_eq!(png[..8], *b"\x89PNG\r\n\x1a\n");
    assert_eq!(png[12..16], *b"IHDR");
    assert_eq!(png[png.len() - 8..png.len() - 4], *b"IEND");
    [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().unwrap()))
}

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
    // The first one is the legend's.
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
fn fixed_limits_are_where_the_axes_end() {
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
fn a_picture_has_the_stated_size_and_is_the_same_twice() {
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
fn nothing_to_draw_and_no_finite_number_still_give_a_picture() {
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
fn a_gap_interrupts_a_line() {
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
fn a_logarithmic_axis_is_labelled_with_powers_of_ten() {
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
            // Nearest of many points on the thinned line.
            let nearest = kept.windows(2).flat_map(|w| (0..=100).map(move |k| {
                let t = f64::from(k) / 100.0;
                (w[0].0 + t * (w[1].0 - w[0].0), w[0].1 + t * (w[1].1 - w[0].1))
            })).map(|q| (q.0 - p.0).hypot(q.1 - p.1)).fold(f64::INFINITY, f64::min);
            prop_assert!(nearest < 0.2, "{}", nearest);
        }
    }

    #[test]
    fn columns_keep_what_a_signal_reaches(values in prop::collection::vec(-50.0f64..50.0, 2..400)) {
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
