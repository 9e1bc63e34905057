//! Checks of figures, for tests.

use super::*;
use kuva::render::render::{Primitive, TextAnchor};

/// Values of the attribute `attribute` in all elements named `element`.
pub(crate) fn attributes(svg: &str, element: &str, attribute: &str) -> Vec<String> {
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

pub(super) fn numbers(values: Vec<String>) -> Vec<f64> {
    values.iter().map(|value| value.parse().unwrap()).collect()
}

/// Checks that tags are balanced, attributes are quoted, and all numbers are finite.
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
    let widths = ["800", "500"].map(|width| format!("viewBox=\"0 0 {width} "));
    assert!(svg.starts_with("<svg ") && widths.iter().any(|width| svg.contains(width)));
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

/// Rectangle on the page: left, top, right, bottom.
type Rectangle = [f64; 4];

fn overlap(a: &Rectangle, b: &Rectangle) -> bool {
    a[0] < b[2] - 1.0 && b[0] < a[2] - 1.0 && a[1] < b[3] - 1.0 && b[1] < a[3] - 1.0
}

/// Texts with their rectangles, and the rectangles of the plot areas.
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

/// Checks that a figure is well-formed, and that all texts are on the page, do not overlap, and are outside the plot
/// areas.
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
