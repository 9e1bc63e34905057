//! Layout of a figure: `kuva`'s axes and the items in them.

use super::thin::{dashes, thinned};
use super::{Figure, Height, Item, Panel, Shown, WIDTH, is_finite};
use crate::style::{Dash, INK, Mark, Rgb, Shape, Stroke, color_scale};
use kuva::render::axis::{add_axes_and_grid, add_labels_and_title, add_y2_axis};
use kuva::render::color::Color;
use kuva::render::layout::{AxisLabelOverlap, ComputedLayout, Layout, TickFormat};
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor, TextSpan};
use kuva::render::render_utils::compute_tick_step;
use std::sync::Arc;

const EDGE: f64 = 10.0;
const TITLE_SIZE: u32 = 17;
const TEXT_SIZE: u32 = 14;
const SMALL_SIZE: u32 = 13;
/// Length of a line in the legend that shows a stroke.
const SAMPLE: f64 = 32.0;
/// Gap after a label of the legend.
const LEGEND_GAP: f64 = 18.0;
/// Height of a row of the legend.
const LEGEND_ROW: f64 = 18.0;
/// Gap before a colour bar, and its width.
const BAR: [f64; 2] = [12.0, 14.0];
/// Lower limit of the room for the numbers of a vertical axis.
const LEAST_NUMBER: f64 = 44.0;
/// Room at the right for half of the last number of a horizontal axis.
const RIGHT: f64 = 22.0;
/// Room below a panel without axis numbers.
const SLIM: f64 = 8.0;

impl From<Rgb> for Color {
    fn from(Rgb(r, g, b): Rgb) -> Self {
        Self::Rgb(r, g, b)
    }
}

/// Drawing primitives of a figure.
pub(super) fn scene(figure: &Figure) -> Scene {
    let mut page = Page::default();
    let mut top = EDGE;
    if !figure.title.is_empty() {
        top += f64::from(TITLE_SIZE);
        page.title([WIDTH / 2.0, top], &figure.title);
    }
    top = page.legend(&figure.legend(), top + 6.0);
    // All rows have the same left margin, so that stacked axes are aligned.
    let margins = figure
        .panels()
        .map(|panel| Axes::new(panel, [WIDTH; 2]).computed);
    let left = margins.fold(0.0f64, |left, axes| left.max(axes.margin_left));
    for (row, (height, panels)) in figure.rows.iter().enumerate() {
        let count = panels.len().max(1) as f64;
        let even = (WIDTH - 2.0 * EDGE) / count;
        let margins: Vec<ComputedLayout> = panels
            .iter()
            .map(|panel| Axes::new(panel, [even, WIDTH]).computed)
            .collect();
        // Panels with a colour bar are wider, so that all plot areas have the same width.
        let right: f64 = margins.iter().map(|axes| axes.margin_right).sum();
        let plot = (even - left - right / count).max(1.0);
        let height = match *height {
            Height::Fixed(height) => height,
            Height::Data { least, greatest } => {
                let [x, y] = panels.first().map_or([[0.0, 1.0]; 2], Panel::limits);
                (plot * (y[1] - y[0]) / (x[1] - x[0])).clamp(least, greatest)
            }
        };
        let most = |pick: fn(&ComputedLayout) -> f64| margins.iter().map(pick).fold(0.0, f64::max);
        let [head, foot] = [
            most(|axes| axes.margin_top),
            most(|axes| axes.margin_bottom),
        ];
        let (total, mut x) = (head + height + foot, EDGE);
        for (column, (panel, margin)) in panels.iter().zip(&margins).enumerate() {
            let width = left + plot + margin.margin_right;
            let mut axes = Axes::new(panel, [width, total]);
            axes.place([left, margin.margin_right, head, foot]);
            page.panel(&axes, [x, top], &format!("clip-{row}-{column}"));
            x += width;
        }
        top += total;
    }
    let mut scene = Scene::new(WIDTH, (top + EDGE).ceil());
    scene.elements = page.elements;
    scene
}

struct Axes<'a> {
    panel: &'a Panel,
    layout: Layout,
    computed: ComputedLayout,
}

impl<'a> Axes<'a> {
    /// Axes in a rectangle, with the margins that their labels need.
    fn new(panel: &'a Panel, [width, height]: [f64; 2]) -> Self {
        let number = |value: f64| TickFormat::Fixed(9).format(value);
        let trim = move |value: f64| {
            let text = number(value);
            let text = text.trim_end_matches('0').trim_end_matches('.');
            text.replace('-', "−")
        };
        let format = TickFormat::Custom(Arc::new(trim));
        let [x, y] = panel.limits();
        let mut layout = Layout::new((x[0], x[1]), (y[0], y[1]))
            .with_x_axis_min(x[0])
            .with_x_axis_max(x[1])
            .with_y_axis_min(y[0])
            .with_y_axis_max(y[1])
            .with_width(width)
            .with_height(height)
            .with_y_label(panel.labels[1].as_str())
            .with_tick_format(format)
            .with_box_axes()
            .with_title_size(TEXT_SIZE)
            .with_subtitle_size(SMALL_SIZE)
            .with_label_size(TEXT_SIZE)
            .with_tick_size(SMALL_SIZE)
            // Number of letters of about half an em that fit above the panel.
            .with_title_wrap((width / 8.0) as usize)
            .with_subtitle_wrap((width / 7.0) as usize)
            .with_x_label_overlap(AxisLabelOverlap::Thin);
        layout.theme.grid_color = "#e2e2e2".to_owned();
        [layout.log_x, layout.log_y] = panel.logarithmic;
        layout.equal_aspect = panel.equal;
        layout.suppress_x_ticks = panel.hide_x;
        let words = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        layout.title = words(&panel.title);
        layout.subtitle = words(&panel.caption);
        layout.x_label = words(&panel.labels[0]).filter(|_| !panel.hide_x);
        if let Some(bar) = &panel.bar {
            layout = layout
                .with_y2_range(bar.limits[0], bar.limits[1])
                .with_y2_label(bar.label.as_str());
            layout.y2_tick_format = layout.y_tick_format.clone();
        }
        let mut computed = ComputedLayout::from_layout(&layout);
        // The tick steps of `place` may have more digits than the steps that the library measured.
        let wider = (LEAST_NUMBER - computed.y_tick_label_px).max(0.0);
        computed.y_tick_label_px += wider;
        computed.margin_left += wider;
        // All panels have the same right margin, so that stacked axes are aligned.
        computed.margin_right = RIGHT;
        if panel.hide_x {
            computed.margin_bottom = SLIM;
        }
        if panel.bar.is_some() {
            computed.margin_right += BAR[0] + BAR[1] + computed.y2_axis_width;
            // The colour bar is drawn as another axis; the panel keeps its own right edge.
            layout.y2_range = None;
        }
        Self {
            panel,
            layout,
            computed,
        }
    }

    /// Sets the margins of the axes (left, right, top, bottom) and the tick steps.
    fn place(&mut self, [left, right, top, bottom]: [f64; 4]) {
        let axes = &mut self.computed;
        // The title keeps its distance from the axes.
        axes.title_y += top - axes.margin_top;
        (axes.margin_left, axes.margin_right) = (left, right);
        (axes.margin_top, axes.margin_bottom) = (top, bottom);
        axes.recompute_transforms();
        let step = |(low, high): (f64, f64), length: f64| {
            compute_tick_step(low, high, (length as usize).max(2))
        };
        let x = step(axes.x_range, axes.plot_width() / 65.0);
        let y = step(axes.y_range, axes.plot_height() / 40.0);
        // Equal axes get a square grid.
        let [x, y] = if self.panel.equal {
            [x.max(y); 2]
        } else {
            [x, y]
        };
        (axes.x_tick_step, axes.y_tick_step) =
            ((!axes.log_x).then_some(x), (!axes.log_y).then_some(y));
    }

    fn point(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        (self.computed.map_x(x), self.computed.map_y(y))
    }
}

/// Width of a text in the bundled font, accurate to a few per cent.
pub(super) fn text_width(text: &str, size: u32) -> f64 {
    let ems: f64 = text
        .chars()
        .map(|c| match c {
            '.' | ',' | ' ' | ':' | 'i' | 'j' | 'l' | '\'' => 0.32,
            'f' | 'r' | 't' | '(' | ')' | '-' | 'I' => 0.40,
            'm' | 'w' | 'M' | 'W' | '−' | '±' | '%' => 0.90,
            'A'..='Z' => 0.70,
            _ => 0.62,
        })
        .sum();
    ems * f64::from(size)
}

/// Primitives in the order in which they are drawn.
#[derive(Default)]
struct Page {
    elements: Vec<Primitive>,
}

impl Page {
    fn title(&mut self, [x, y]: [f64; 2], text: &str) {
        let mut span = TextSpan::plain(text);
        span.bold = true;
        self.elements.push(Primitive::RichText {
            x,
            y,
            spans: vec![span],
            size: TITLE_SIZE,
            anchor: TextAnchor::Middle,
            color: Some(INK.into()),
        });
    }

    /// Draws a line through points on the page, cut into its dashes.
    fn line(&mut self, points: &[(f64, f64)], stroke: Stroke) {
        for points in dashes(points, stroke.dash.pattern()) {
            self.elements.push(Primitive::PolyLine {
                points,
                stroke: stroke.color.into(),
                stroke_width: stroke.width,
                stroke_dasharray: None,
            });
        }
    }

    fn mark(&mut self, (x, y): (f64, f64), mark: Mark) {
        let Mark {
            shape,
            radius: r,
            color,
            heading,
        } = mark;
        let width = (0.45 * r).clamp(0.4, 1.6);
        let stroke = Stroke {
            color,
            width,
            dash: Dash::Solid,
        };
        if let Some(heading) = heading {
            let (sin, cos) = libm::sincos(heading);
            let length = 3.3 * r;
            self.line(&[(x, y), (x + length * cos, y - length * sin)], stroke);
        }
        let (across, down) = match shape {
            Shape::Cross => ([0.8 * r, 0.8 * r], [0.8 * r, -0.8 * r]),
            _ => ([r, 0.0], [0.0, r]),
        };
        if matches!(shape, Shape::Cross | Shape::Target) {
            for [dx, dy] in [across, down] {
                self.line(&[(x - dx, y - dy), (x + dx, y + dy)], stroke);
            }
        }
        if shape != Shape::Cross {
            let disc = shape == Shape::Disc;
            self.elements.push(Primitive::Circle {
                cx: x,
                cy: y,
                r,
                fill: if disc { color.into() } else { Color::None },
                fill_opacity: None,
                stroke: (!disc).then(|| color.into()),
                stroke_width: (!disc).then_some(width),
            });
        }
    }

    /// Draws the legend in centred rows; returns its lower edge.
    fn legend(&mut self, entries: &[&Item], mut y: f64) -> f64 {
        let width = |entry: &Item| SAMPLE + 6.0 + text_width(&entry.label, SMALL_SIZE) + LEGEND_GAP;
        let mut rows: Vec<(f64, Vec<&Item>)> = Vec::new();
        for entry in entries {
            let width = width(entry);
            match rows.last_mut() {
                Some((used, row)) if *used + width <= WIDTH - 2.0 * EDGE => {
                    *used += width;
                    row.push(entry);
                }
                _ => rows.push((width, vec![entry])),
            }
        }
        for (used, row) in rows {
            y += LEGEND_ROW;
            let mut x = 0.5 * (WIDTH - used + LEGEND_GAP);
            for entry in row {
                let middle = y - 4.5;
                let ends = [(x, middle), (x + SAMPLE, middle)];
                match &entry.shown {
                    Shown::Line(_, stroke) => self.line(&ends, *stroke),
                    Shown::Area(_, fill) => {
                        let (width, dash) = (8.0, Dash::Solid);
                        self.line(
                            &ends,
                            Stroke {
                                color: *fill,
                                width,
                                dash,
                            },
                        );
                    }
                    Shown::Mark(_, mark) => {
                        let heading = mark.heading.map(|_| 0.0);
                        let radius = mark.radius.clamp(3.0, 6.0);
                        let mark = Mark {
                            heading,
                            radius,
                            ..*mark
                        };
                        self.mark((x + 0.5 * SAMPLE - 4.0, middle), mark);
                    }
                }
                self.elements.push(Primitive::Text {
                    x: x + SAMPLE + 6.0,
                    y,
                    content: entry.label.clone(),
                    size: SMALL_SIZE,
                    anchor: TextAnchor::Start,
                    rotate: None,
                    bold: false,
                    color: Some(INK.into()),
                });
                x += width(entry);
            }
        }
        y + 6.0
    }

    /// Draws a panel with its upper left corner at this point of the page.
    fn panel(&mut self, axes: &Axes, [x, y]: [f64; 2], clip: &str) {
        let computed = &axes.computed;
        self.elements.push(Primitive::GroupStart {
            transform: Some(format!("translate({x},{y})")),
            title: None,
            extra_attrs: None,
        });
        let mut scene = Scene::new(computed.width, computed.height);
        add_axes_and_grid(&mut scene, computed, &axes.layout);
        add_labels_and_title(&mut scene, computed, &axes.layout);
        if let Some(bar) = &axes.panel.bar {
            self.color_bar(computed);
            let mut edge = computed.clone();
            edge.margin_right -= BAR[0] + BAR[1];
            edge.y2_range = Some((bar.limits[0], bar.limits[1]));
            add_y2_axis(&mut scene, &edge, &axes.layout);
        }
        self.elements.append(&mut scene.elements);
        self.elements.push(Primitive::ClipStart {
            x: computed.margin_left,
            y: computed.margin_top,
            width: computed.plot_width(),
            height: computed.plot_height(),
            id: clip.into(),
        });
        for item in &axes.panel.items {
            self.item(item, axes);
        }
        self.elements
            .extend([Primitive::ClipEnd, Primitive::GroupEnd]);
    }

    fn color_bar(&mut self, axes: &ComputedLayout) {
        const STEPS: usize = 100;
        let step = axes.plot_height() / STEPS as f64;
        for k in 0..STEPS {
            self.elements.push(Primitive::Rect {
                x: axes.width - axes.margin_right + BAR[0],
                y: axes.margin_top + (STEPS - 1 - k) as f64 * step,
                width: BAR[1],
                // Each piece of the bar overlaps the next piece, so that no gap is visible.
                height: if k == 0 { step } else { step + 0.6 },
                fill: color_scale((k as f64 + 0.5) / STEPS as f64).into(),
                stroke: None,
                stroke_width: None,
                opacity: None,
            });
        }
    }

    fn item(&mut self, item: &Item, axes: &Axes) {
        match &item.shown {
            Shown::Line(points, stroke) => {
                for piece in points.split(|p| !is_finite(p)) {
                    let placed: Vec<_> = piece.iter().map(|&p| axes.point(p)).collect();
                    self.line(&thinned(&placed), *stroke);
                }
            }
            Shown::Area(points, fill) => {
                let mut d = String::new();
                for (index, point) in points.iter().filter(|p| is_finite(p)).enumerate() {
                    let (x, y) = axes.point(*point);
                    d += &format!("{} {x:.2} {y:.2} ", if index == 0 { 'M' } else { 'L' });
                }
                d.push('Z');
                self.elements.push(Primitive::Path(Box::new(PathData {
                    d,
                    fill: Some((*fill).into()),
                    stroke: Color::None,
                    stroke_width: 0.0,
                    opacity: None,
                    stroke_dasharray: None,
                })));
            }
            Shown::Mark(at, mark) => {
                if is_finite(at) {
                    self.mark(axes.point(*at), *mark);
                }
            }
        }
    }
}
