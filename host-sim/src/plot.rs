//! Pictures as SVG and PNG: panels with axes, lines, marks and legends.
//!
//! Labels of vertical axes stand upright above them, where they are read without turning the head.
//! A [`Figure`] is rows of [`Panel`]s; a panel holds data in the units of its axes. Everything is
//! laid out here and handed to `kuva`, which writes the SVG text and, with its bundled font, the
//! pixels: the same figure gives the same bytes on any machine. Lines are thinned to what can be
//! seen, dashes are cut here so that both formats show the same ones, and points that are not
//! finite interrupt a line.

use kuva::backend::raster::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::render::color::Color;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor, TextSpan};

/// Width of every picture, in units of the SVG.
const WIDTH: f64 = 800.0;
/// Pixels of the PNG for one unit of the SVG.
const PNG_SCALE: f32 = 2.0;
const EDGE: f64 = 14.0;
const TITLE_SIZE: u32 = 17;
const TEXT_SIZE: u32 = 14;
const TICK_SIZE: u32 = 13;
const TICK_LENGTH: f64 = 4.0;
const BAR_GAP: f64 = 12.0;
const BAR_WIDTH: f64 = 14.0;
const GRID: Rgb = Rgb(226, 226, 226);
const AXIS: Rgb = Rgb(70, 70, 70);
const TEXT: Rgb = Rgb(30, 30, 30);
const FONTS: &str = "DejaVu Sans, Verdana, Arial, sans-serif";

/// A colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rgb(pub u8, pub u8, pub u8);

impl Rgb {
    /// Mixed with white: 0 stays, 1 is white.
    pub fn lighter(self, by: f64) -> Self {
        let mix = |part: u8| (f64::from(part) + (255.0 - f64::from(part)) * by).round() as u8;
        Self(mix(self.0), mix(self.1), mix(self.2))
    }
}

impl From<Rgb> for Color {
    fn from(Rgb(r, g, b): Rgb) -> Self {
        Self::Rgb(r, g, b)
    }
}

/// Colours that differ for colour-blind readers too (Okabe and Ito).
pub mod palette {
    use super::Rgb;
    /// Black.
    pub const BLACK: Rgb = Rgb(0, 0, 0);
    /// Grey.
    pub const GREY: Rgb = Rgb(128, 128, 128);
    /// Blue.
    pub const BLUE: Rgb = Rgb(0, 114, 178);
    /// Vermilion.
    pub const VERMILION: Rgb = Rgb(213, 94, 0);
    /// Bluish green.
    pub const GREEN: Rgb = Rgb(0, 158, 115);
    /// Reddish purple.
    pub const PURPLE: Rgb = Rgb(204, 121, 167);
    /// Orange.
    pub const ORANGE: Rgb = Rgb(230, 159, 0);
    /// Sky blue.
    pub const SKY: Rgb = Rgb(86, 180, 233);
    /// Colours for a list of series, most distinct first.
    pub const SERIES: [Rgb; 7] = [BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK];
}

/// Colour of a value from 0 to 1 on a scale of even lightness (viridis without its palest end).
pub fn color_scale(value: f64) -> Rgb {
    const ANCHORS: [Rgb; 8] = [
        Rgb(68, 1, 84),
        Rgb(71, 44, 122),
        Rgb(59, 81, 139),
        Rgb(44, 113, 142),
        Rgb(33, 144, 141),
        Rgb(39, 173, 129),
        Rgb(92, 200, 99),
        Rgb(170, 220, 50),
    ];
    let place = value.clamp(0.0, 1.0) * (ANCHORS.len() - 1) as f64;
    let index = (place as usize).min(ANCHORS.len() - 2);
    let part = place - index as f64;
    let (low, high) = (ANCHORS[index], ANCHORS[index + 1]);
    let mix = |a: u8, b: u8| (f64::from(a) * (1.0 - part) + f64::from(b) * part).round() as u8;
    Rgb(mix(low.0, high.0), mix(low.1, high.1), mix(low.2, high.2))
}

/// Pattern of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dash {
    /// Unbroken.
    Solid,
    /// Long dashes.
    Dashed,
    /// Short dashes.
    Dotted,
}

impl Dash {
    /// Lengths drawn and left out, in units of the SVG.
    fn pattern(self) -> Option<[f64; 2]> {
        match self {
            Self::Solid => None,
            Self::Dashed => Some([7.0, 4.5]),
            Self::Dotted => Some([2.0, 3.5]),
        }
    }
}

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Colour.
    pub color: Rgb,
    /// Width in units of the SVG.
    pub width: f64,
    /// Pattern.
    pub dash: Dash,
}

impl Stroke {
    /// An unbroken line.
    pub const fn solid(color: Rgb, width: f64) -> Self {
        Self {
            color,
            width,
            dash: Dash::Solid,
        }
    }

    /// A dashed line.
    pub const fn dashed(color: Rgb, width: f64) -> Self {
        Self {
            color,
            width,
            dash: Dash::Dashed,
        }
    }

    /// A dotted line.
    pub const fn dotted(color: Rgb, width: f64) -> Self {
        Self {
            color,
            width,
            dash: Dash::Dotted,
        }
    }
}

/// Shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A filled circle.
    Disc,
    /// A circle's outline.
    Ring,
    /// An upright cross.
    Plus,
    /// A diagonal cross.
    Cross,
}

/// A mark of constant size on the page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Shape.
    pub shape: Shape,
    /// Half its size in units of the SVG.
    pub radius: f64,
    /// Colour.
    pub color: Rgb,
}

/// Something in a panel, in the units of its axes.
#[derive(Clone, Debug, PartialEq)]
enum Item {
    Line(Vec<[f64; 2]>, Stroke),
    Area(Vec<[f64; 2]>, Rgb),
    Mark([f64; 2], Mark),
    /// A stroke of constant length on the page, from a point into a direction.
    Needle([f64; 2], f64, f64, Stroke),
    /// Text at an offset on the page from a point.
    Note([f64; 2], [f64; 2], String, Rgb),
}

/// One entry of a legend.
#[derive(Clone, Debug, PartialEq)]
pub struct Legend {
    label: String,
    sample: Sample,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Sample {
    Line(Stroke),
    Mark(Mark),
}

impl Legend {
    /// A line and its meaning.
    pub fn line(label: impl Into<String>, stroke: Stroke) -> Self {
        Self {
            label: label.into(),
            sample: Sample::Line(stroke),
        }
    }

    /// A mark and its meaning.
    pub fn mark(label: impl Into<String>, mark: Mark) -> Self {
        Self {
            label: label.into(),
            sample: Sample::Mark(mark),
        }
    }

    fn width(&self) -> f64 {
        let sample = match self.sample {
            Sample::Line(_) => 30.0,
            Sample::Mark(_) => 12.0,
        };
        sample + 7.0 + text_width(&self.label, TICK_SIZE) + 18.0
    }
}

/// A second scale at the right edge: label, and its value for one unit of the left axis.
#[derive(Clone, Debug, PartialEq)]
struct RightAxis {
    label: String,
    factor: f64,
}

/// The scale of [`color_scale`] at the right edge.
#[derive(Clone, Debug, PartialEq)]
struct ColorBar {
    label: String,
    limits: [f64; 2],
}

/// A diagram with its axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    title: String,
    x_label: String,
    y_label: String,
    caption: String,
    x_limits: Option<[f64; 2]>,
    y_limits: Option<[f64; 2]>,
    equal: bool,
    hide_x: bool,
    decades: bool,
    x_decades: bool,
    right: Option<RightAxis>,
    bar: Option<ColorBar>,
    legend: Vec<Legend>,
    items: Vec<Item>,
}

impl Panel {
    /// A panel with the labels of its axes, units included. Its limits follow the data.
    pub fn new(x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self {
            x_label: x_label.into(),
            y_label: y_label.into(),
            ..Self::default()
        }
    }

    /// Sets the line above the panel.
    pub fn title(mut self, title: impl Into<String>) -> Self {
        self.title = title.into();
        self
    }

    /// Sets a few words at the right, above the panel.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }

    /// One unit is as long on both axes; the limits widen as needed.
    pub fn equal_axes(mut self) -> Self {
        self.equal = true;
        self
    }

    /// Leaves the numbers of the horizontal axis to the panel below.
    pub fn hide_x(mut self) -> Self {
        self.hide_x = true;
        self
    }

    /// The vertical axis holds decimal logarithms; its numbers are those they are of.
    pub fn decades(mut self) -> Self {
        self.decades = true;
        self
    }

    /// The horizontal axis holds decimal logarithms; its numbers are those they are of.
    pub fn x_decades(mut self) -> Self {
        self.x_decades = true;
        self
    }

    /// Fixes the limits of the horizontal axis.
    pub fn x_limits(mut self, limits: [f64; 2]) -> Self {
        self.x_limits = Some(limits);
        self
    }

    /// Fixes the limits of the vertical axis.
    pub fn y_limits(mut self, limits: [f64; 2]) -> Self {
        self.y_limits = Some(limits);
        self
    }

    /// Adds a scale at the right edge: `factor` is its value for one unit of the left axis.
    pub fn right_axis(mut self, label: impl Into<String>, factor: f64) -> Self {
        self.right = Some(RightAxis {
            label: label.into(),
            factor,
        });
        self
    }

    /// Adds the scale of [`color_scale`] at the right edge.
    pub fn color_bar(mut self, label: impl Into<String>, limits: [f64; 2]) -> Self {
        self.bar = Some(ColorBar {
            label: label.into(),
            limits,
        });
        self
    }

    /// Adds an entry to the panel's legend, above it.
    pub fn legend(mut self, entry: Legend) -> Self {
        self.legend.push(entry);
        self
    }

    /// Draws a line.
    pub fn line(&mut self, points: impl IntoIterator<Item = [f64; 2]>, stroke: Stroke) {
        self.items
            .push(Item::Line(points.into_iter().collect(), stroke));
    }

    /// Fills a polygon.
    pub fn area(&mut self, points: impl IntoIterator<Item = [f64; 2]>, fill: Rgb) {
        self.items
            .push(Item::Area(points.into_iter().collect(), fill));
    }

    /// Draws a mark.
    pub fn mark(&mut self, at: [f64; 2], mark: Mark) {
        self.items.push(Item::Mark(at, mark));
    }

    /// Draws a stroke of `length` units of the SVG from a point into `direction` (rad).
    pub fn needle(&mut self, at: [f64; 2], direction: f64, length: f64, stroke: Stroke) {
        self.items.push(Item::Needle(at, direction, length, stroke));
    }

    /// Writes a few words beside a point; `offset` in units of the SVG, y up.
    pub fn note(&mut self, at: [f64; 2], offset: [f64; 2], text: impl Into<String>, color: Rgb) {
        self.items.push(Item::Note(at, offset, text.into(), color));
    }

    /// Distance of the numbers of the vertical axis; whole powers of ten on a logarithmic one.
    fn y_step(&self, limits: [f64; 2], count: usize) -> (f64, f64) {
        axis_step(limits, count, self.decades)
    }

    fn y_ticks(&self, limits: [f64; 2], count: usize) -> Ticks {
        Ticks {
            decades: self.decades,
            ..Ticks::with_step(limits, self.y_step(limits, count))
        }
    }

    /// Limits of the data: [[least, greatest] of x, of y]; none where there is no finite point.
    pub fn extent(&self) -> Option<[[f64; 2]; 2]> {
        extent(self.items.iter().flat_map(|item| match item {
            Item::Line(points, _) | Item::Area(points, _) => points.as_slice(),
            Item::Mark(at, _) | Item::Needle(at, ..) | Item::Note(at, ..) => {
                std::slice::from_ref(at)
            }
        }))
    }

    fn limits(&self) -> [[f64; 2]; 2] {
        let data = self.extent().unwrap_or([[0.0, 1.0]; 2]);
        let padded = |[low, high]: [f64; 2], share: f64| {
            let width = high - low;
            // A constant signal still gets an axis.
            let pad = if width > 1e-12 * high.abs().max(low.abs()) {
                share * width
            } else {
                (0.1 * high.abs()).max(1e-6)
            };
            [low - pad, high + pad]
        };
        let x_pad = if self.equal { 0.05 } else { 0.0 };
        let valid = |limits: &[f64; 2]| limits[1] > limits[0];
        [
            self.x_limits
                .filter(valid)
                .unwrap_or_else(|| padded(data[0], x_pad)),
            self.y_limits
                .filter(valid)
                .unwrap_or_else(|| padded(data[1], 0.06)),
        ]
    }
}

/// Limits of points: [[least, greatest] of x, of y]; none where no point is finite.
pub fn extent<'a>(points: impl IntoIterator<Item = &'a [f64; 2]>) -> Option<[[f64; 2]; 2]> {
    points
        .into_iter()
        .filter(|p| p[0].is_finite() && p[1].is_finite())
        .fold(None, |limits, p| {
            let [x, y] = limits.unwrap_or([[p[0]; 2], [p[1]; 2]]);
            Some([
                [x[0].min(p[0]), x[1].max(p[0])],
                [y[0].min(p[1]), y[1].max(p[1])],
            ])
        })
}

/// Height of a row of panels without its labels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Height {
    /// In units of the SVG; the picture is 800 wide.
    Fixed(f64),
    /// As the data of the first panel's equal axes need, within these bounds.
    Data {
        /// Least height.
        least: f64,
        /// Greatest height.
        greatest: f64,
    },
}

/// Rows of panels under a title and a legend.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    title: String,
    legend: Vec<Legend>,
    rows: Vec<(Height, Vec<Panel>)>,
}

impl Default for Height {
    fn default() -> Self {
        Self::Fixed(300.0)
    }
}

impl Figure {
    /// A figure without panels.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            ..Self::default()
        }
    }

    /// Adds an entry to the legend that holds for all panels.
    pub fn legend(mut self, entry: Legend) -> Self {
        self.legend.push(entry);
        self
    }

    /// Adds a row of panels of equal width.
    pub fn row(mut self, height: Height, panels: impl IntoIterator<Item = Panel>) -> Self {
        self.rows.push((height, panels.into_iter().collect()));
        self
    }

    /// The picture as text of an SVG file.
    pub fn svg(&self) -> String {
        let scene = self.scene();
        let size = format!("width=\"{}\" height=\"{}\"", scene.width, scene.height);
        // Scales with its page, and has the round ends and joins that the pixels have.
        let view = format!(
            "{size} viewBox=\"0 0 {} {}\" stroke-linecap=\"round\" stroke-linejoin=\"round\"",
            scene.width, scene.height
        );
        let mut text = SvgBackend::new()
            .with_pretty(true)
            .render_scene(&scene)
            .replacen(&size, &view, 1);
        text.push('\n');
        text
    }

    /// The picture as bytes of a PNG file, 1600 pixels wide.
    ///
    /// # Panics
    ///
    /// Never: the size of a picture is greater than zero.
    pub fn png(&self) -> Vec<u8> {
        RasterBackend::new()
            .with_scale(PNG_SCALE)
            .render_scene(&self.scene())
            .expect("a picture of more than zero pixels")
    }

    fn scene(&self) -> Scene {
        let mut page = Page::default();
        let mut top = EDGE;
        if !self.title.is_empty() {
            top += f64::from(TITLE_SIZE);
            page.bold(
                [WIDTH / 2.0, top],
                &self.title,
                TITLE_SIZE,
                TextAnchor::Middle,
            );
            top += 10.0;
        }
        if !self.legend.is_empty() {
            top = page.legend(&self.legend, [EDGE, WIDTH - EDGE], top, true) + 4.0;
        }
        // The same margins for all rows, so that stacked axes stand in line.
        let left = self.panels().map(left_margin).fold(0.0, f64::max);
        let right = self.panels().map(right_margin).fold(0.0, f64::max);
        for (row, (height, panels)) in self.rows.iter().enumerate() {
            let column = (WIDTH - 2.0 * EDGE) / panels.len().max(1) as f64;
            let width = (column - left - right).max(1.0);
            let height = match *height {
                Height::Fixed(height) => height,
                Height::Data { least, greatest } => {
                    let [x, y] = panels.first().map_or([[0.0, 1.0]; 2], Panel::limits);
                    (width * (y[1] - y[0]) / (x[1] - x[0])).clamp(least, greatest)
                }
            };
            let mut head = 0.0f64;
            for (index, panel) in panels.iter().enumerate() {
                let edge = EDGE + index as f64 * column;
                head = head.max(page.head(panel, [edge + left, edge + column - right], top));
            }
            top += head + 9.0;
            for (index, panel) in panels.iter().enumerate() {
                let area = Area {
                    left: EDGE + index as f64 * column + left,
                    top,
                    width,
                    height,
                };
                page.panel(panel, area, &format!("clip-{row}-{index}"));
            }
            let hidden = panels.iter().all(|panel| panel.hide_x);
            top += height + if hidden { 8.0 } else { 50.0 };
        }
        page.into_scene(top + EDGE - 8.0)
    }

    fn panels(&self) -> impl Iterator<Item = &Panel> {
        self.rows.iter().flat_map(|(_, panels)| panels)
    }
}

/// Room for the numbers left of a panel. The final limits may be wider than the data's, so there is
/// some to spare.
fn left_margin(panel: &Panel) -> f64 {
    let [_, y] = panel.limits();
    (panel.y_ticks(y, 6).widest() + TICK_LENGTH + 8.0).max(36.0)
}

fn right_margin(panel: &Panel) -> f64 {
    if let Some(bar) = &panel.bar {
        BAR_GAP + BAR_WIDTH + Ticks::new(bar.limits, 8).widest() + 8.0
    } else if let Some(axis) = &panel.right {
        let [_, y] = panel.limits();
        10.0 + Ticks::new(y.map(|value| value * axis.factor), 6).widest()
    } else {
        // Half of the last number of the horizontal axis.
        18.0
    }
}

/// Where the axes of a panel stand on the page.
#[derive(Clone, Copy, Debug)]
struct Area {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
}

/// From the units of the axes to the page.
#[derive(Clone, Copy, Debug)]
struct Frame {
    area: Area,
    x: [f64; 2],
    y: [f64; 2],
}

impl Frame {
    fn new(panel: &Panel, area: Area) -> Self {
        let [mut x, mut y] = panel.limits();
        if panel.equal {
            let scale = (area.width / (x[1] - x[0])).min(area.height / (y[1] - y[0]));
            let widen = |limits: [f64; 2], length: f64| {
                let (middle, half) = (0.5 * (limits[0] + limits[1]), 0.5 * length / scale);
                [middle - half, middle + half]
            };
            x = widen(x, area.width);
            y = widen(y, area.height);
        }
        Self { area, x, y }
    }

    fn place(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        let across = (x - self.x[0]) / (self.x[1] - self.x[0]);
        let up = (y - self.y[0]) / (self.y[1] - self.y[0]);
        (
            self.area.left + across * self.area.width,
            self.area.top + (1.0 - up) * self.area.height,
        )
    }
}

/// Round numbers for an axis.
struct Ticks {
    values: Vec<f64>,
    decimals: usize,
    /// The values are decimal logarithms of what is written.
    decades: bool,
}

/// Distance of about `count` round numbers within the limits: 1, 2 or 5 times a power of ten, as
/// (factor, power).
fn tick_step([low, high]: [f64; 2], count: usize) -> (f64, f64) {
    let rough = ((high - low) / count.max(1) as f64).max(1e-300);
    let power = rough.log10().floor();
    [1.0, 2.0, 5.0]
        .into_iter()
        .find(|factor| factor * 10f64.powf(power) >= 0.7 * rough)
        .map_or((1.0, power + 1.0), |factor| (factor, power))
}

/// The same for an axis that may be logarithmic: whole powers of ten then.
fn axis_step(limits: [f64; 2], count: usize, decades: bool) -> (f64, f64) {
    let (factor, power) = tick_step(limits, count);
    if decades && power < 0.0 {
        (1.0, 0.0)
    } else {
        (factor, power)
    }
}

impl Ticks {
    /// About `count` round numbers within the limits.
    fn new(limits: [f64; 2], count: usize) -> Self {
        Self::with_step(limits, tick_step(limits, count))
    }

    fn with_step([low, high]: [f64; 2], (factor, power): (f64, f64)) -> Self {
        let step = factor * 10f64.powf(power);
        // A signal that ends a sample before a round number has that number on its axis.
        let slack = 1e-3 * (high - low);
        let (first, last) = (
            ((low - slack) / step).ceil() as i64,
            ((high + slack) / step).floor() as i64,
        );
        Self {
            values: (first..=last).map(|k| k as f64 * step).collect(),
            decimals: (-power).clamp(0.0, 12.0) as usize,
            decades: false,
        }
    }

    fn text(&self, value: f64) -> String {
        if self.decades {
            return format!("{}", 10f64.powi(value.round() as i32));
        }
        let text = format!("{value:.*}", self.decimals);
        match text.strip_prefix('-') {
            Some(digits) if digits.bytes().any(|b| (b'1'..=b'9').contains(&b)) => {
                format!("−{digits}")
            }
            Some(digits) => digits.to_string(),
            None => text,
        }
    }

    fn widest(&self) -> f64 {
        let widths = self
            .values
            .iter()
            .map(|&value| text_width(&self.text(value), TICK_SIZE));
        widths.fold(0.0, f64::max)
    }
}

/// Width of a text in the bundled font, to a few per cent.
fn text_width(text: &str, size: u32) -> f64 {
    let ems: f64 = text
        .chars()
        .map(|c| match c {
            '0'..='9' => 0.636,
            '.' | ',' | ' ' | ':' | 'i' | 'j' | 'l' | '\'' => 0.32,
            'f' | 'r' | 't' | '(' | ')' | '-' | 'I' => 0.40,
            'm' | 'w' | 'M' | 'W' | '−' | '±' | '%' => 0.90,
            'A'..='Z' => 0.70,
            _ => 0.61,
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
    fn into_scene(self, height: f64) -> Scene {
        let mut scene = Scene::new(WIDTH, height.max(1.0).ceil());
        scene.font_family = Some(FONTS.into());
        scene.elements = self.elements;
        scene
    }

    fn text(&mut self, at: [f64; 2], text: &str, size: u32, anchor: TextAnchor) {
        self.colored_text(at, text, size, anchor, TEXT);
    }

    fn colored_text(
        &mut self,
        [x, y]: [f64; 2],
        text: &str,
        size: u32,
        anchor: TextAnchor,
        color: Rgb,
    ) {
        self.elements.push(Primitive::Text {
            x,
            y,
            content: text.into(),
            size,
            anchor,
            rotate: None,
            bold: false,
            color: Some(color.into()),
        });
    }

    fn bold(&mut self, [x, y]: [f64; 2], text: &str, size: u32, anchor: TextAnchor) {
        let mut span = TextSpan::plain(text);
        span.bold = true;
        self.elements.push(Primitive::RichText {
            x,
            y,
            spans: vec![span],
            size,
            anchor,
            color: Some(TEXT.into()),
        });
    }

    /// A line between points on the page: thinned, and cut into its dashes.
    fn line(&mut self, points: &[(f64, f64)], stroke: Stroke) {
        let pieces = match stroke.dash.pattern() {
            None => vec![points.to_vec()],
            Some(pattern) => dashes(points, pattern),
        };
        for points in pieces {
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
        } = mark;
        let mut stroke = |dx: f64, dy: f64| {
            self.line(
                &[(x - dx, y - dy), (x + dx, y + dy)],
                Stroke::solid(color, 1.5),
            );
        };
        match shape {
            Shape::Plus => {
                stroke(r, 0.0);
                stroke(0.0, r);
            }
            Shape::Cross => {
                stroke(0.8 * r, 0.8 * r);
                stroke(0.8 * r, -0.8 * r);
            }
            Shape::Disc | Shape::Ring => {
                let ring = shape == Shape::Ring;
                self.elements.push(Primitive::Circle {
                    cx: x,
                    cy: y,
                    r,
                    fill: if ring { Color::None } else { color.into() },
                    fill_opacity: None,
                    stroke: ring.then(|| color.into()),
                    stroke_width: ring.then_some(1.5),
                });
            }
        }
    }

    /// Entries in rows between two edges; gives the lower edge.
    fn legend(&mut self, entries: &[Legend], edges: [f64; 2], top: f64, center: bool) -> f64 {
        let room = edges[1] - edges[0];
        let mut rows: Vec<(f64, Vec<&Legend>)> = Vec::new();
        for entry in entries {
            let width = entry.width();
            match rows.last_mut() {
                Some((used, row)) if *used + width <= room => {
                    *used += width;
                    row.push(entry);
                }
                _ => rows.push((width, vec![entry])),
            }
        }
        let mut y = top;
        for (used, row) in rows {
            y += 18.0;
            let mut x = if center {
                edges[0] + 0.5 * (room - used).max(0.0) + 9.0
            } else {
                edges[0]
            };
            for entry in row {
                let middle = y - 4.5;
                let text = match entry.sample {
                    Sample::Line(stroke) => {
                        self.line(&[(x, middle), (x + 30.0, middle)], stroke);
                        x + 37.0
                    }
                    Sample::Mark(mark) => {
                        self.mark((x + 6.0, middle), mark);
                        x + 19.0
                    }
                };
                self.text([text, y], &entry.label, TICK_SIZE, TextAnchor::Start);
                x += entry.width();
            }
        }
        y + 6.0
    }

    /// Title, legend and the labels of the vertical axes above a panel; gives the height.
    fn head(&mut self, panel: &Panel, [left, right]: [f64; 2], top: f64) -> f64 {
        let mut y = top;
        if !panel.title.is_empty() {
            y += 17.0;
            self.bold([left, y], &panel.title, TEXT_SIZE, TextAnchor::Start);
            y += 6.0;
        }
        let beside = left + text_width(&panel.y_label, TEXT_SIZE) + 24.0;
        y = match panel.legend.as_slice() {
            [] => y + 17.0,
            entries => self.legend(entries, [beside, right], y - 1.0, false) - 6.0,
        };
        self.text([left, y], &panel.y_label, TEXT_SIZE, TextAnchor::Start);
        // The label of a scale at the right edge ends above the scale; the caption gives way.
        let scale = match (&panel.right, &panel.bar) {
            (Some(axis), _) => Some((&axis.label, right + 18.0)),
            (None, Some(bar)) => Some((&bar.label, right + BAR_GAP + BAR_WIDTH + 8.0)),
            (None, None) => None,
        };
        let mut end = right;
        if let Some((label, at)) = scale {
            self.text([at, y], label, TEXT_SIZE, TextAnchor::End);
            end = at - text_width(label, TEXT_SIZE) - 24.0;
        }
        self.text(
            [end.min(right), y],
            &panel.caption,
            TICK_SIZE,
            TextAnchor::End,
        );
        y - top
    }

    fn panel(&mut self, panel: &Panel, area: Area, clip: &str) {
        let frame = Frame::new(panel, area);
        let Area {
            left,
            top,
            width,
            height,
        } = area;
        let (right, bottom) = (left + width, top + height);
        let middle = left + 0.5 * width;
        let y_count = (height / 40.0).max(2.0) as usize;
        let x_step = axis_step(frame.x, (width / 65.0) as usize, panel.x_decades);
        let y_step = panel.y_step(frame.y, y_count);
        let larger = if x_step.1 > y_step.1 || (x_step.1 == y_step.1 && x_step.0 > y_step.0) {
            x_step
        } else {
            y_step
        };
        // Equal axes get a square grid.
        let [mut x_ticks, mut y_ticks] =
            [(frame.x, x_step), (frame.y, y_step)].map(|(limits, step)| {
                Ticks::with_step(limits, if panel.equal { larger } else { step })
            });
        (x_ticks.decades, y_ticks.decades) = (panel.x_decades, panel.decades);

        let grid = Stroke::solid(GRID, 1.0);
        for &value in &x_ticks.values {
            let (x, _) = frame.place([value, frame.y[0]]);
            self.line(&[(x, top), (x, bottom)], grid);
        }
        for &value in &y_ticks.values {
            let (_, y) = frame.place([frame.x[0], value]);
            self.line(&[(left, y), (right, y)], grid);
        }

        self.elements.push(Primitive::ClipStart {
            x: left,
            y: top,
            width,
            height,
            id: clip.into(),
        });
        for item in &panel.items {
            self.item(item, &frame);
        }
        self.elements.push(Primitive::ClipEnd);

        let axis = Stroke::solid(AXIS, 1.2);
        let corners = [
            (left, top),
            (right, top),
            (right, bottom),
            (left, bottom),
            (left, top),
        ];
        self.line(&corners, axis);
        for &value in &x_ticks.values {
            let (x, _) = frame.place([value, frame.y[0]]);
            self.line(&[(x, bottom), (x, bottom + TICK_LENGTH)], axis);
            if !panel.hide_x {
                let text = x_ticks.text(value);
                self.text([x, bottom + 18.0], &text, TICK_SIZE, TextAnchor::Middle);
            }
        }
        if !panel.hide_x {
            self.text(
                [middle, bottom + 37.0],
                &panel.x_label,
                TEXT_SIZE,
                TextAnchor::Middle,
            );
        }
        for &value in &y_ticks.values {
            let (_, y) = frame.place([frame.x[0], value]);
            self.line(&[(left - TICK_LENGTH, y), (left, y)], axis);
            let place = [left - TICK_LENGTH - 4.0, y + 4.5];
            self.text(place, &y_ticks.text(value), TICK_SIZE, TextAnchor::End);
        }
        if let Some(axis) = &panel.right {
            let ticks = Ticks::new(frame.y.map(|value| value * axis.factor), y_count);
            self.right_ticks(&ticks, right, |value| {
                frame.place([0.0, value / axis.factor]).1
            });
        }
        if let Some(bar) = &panel.bar {
            self.color_bar(bar, area);
        }
    }

    fn right_ticks(&mut self, ticks: &Ticks, right: f64, place: impl Fn(f64) -> f64) {
        for &value in &ticks.values {
            let y = place(value);
            let axis = Stroke::solid(AXIS, 1.2);
            self.line(&[(right, y), (right + TICK_LENGTH, y)], axis);
            let at = [right + TICK_LENGTH + 4.0, y + 4.5];
            self.text(at, &ticks.text(value), TICK_SIZE, TextAnchor::Start);
        }
    }

    fn color_bar(&mut self, bar: &ColorBar, area: Area) {
        const STEPS: usize = 100;
        let (left, width) = (area.left + area.width + BAR_GAP, BAR_WIDTH);
        let step = area.height / STEPS as f64;
        for k in 0..STEPS {
            let value = (k as f64 + 0.5) / STEPS as f64;
            self.elements.push(Primitive::Rect {
                x: left,
                // A little taller than its share, so that no seam shows.
                y: area.top + (STEPS - 1 - k) as f64 * step,
                width,
                height: if k == 0 { step } else { step + 0.6 },
                fill: color_scale(value).into(),
                stroke: None,
                stroke_width: None,
                opacity: None,
            });
        }
        let [low, high] = bar.limits;
        let ticks = Ticks::new(bar.limits, 8);
        self.right_ticks(&ticks, left + width, |value| {
            area.top + (1.0 - (value - low) / (high - low)) * area.height
        });
    }

    fn item(&mut self, item: &Item, frame: &Frame) {
        let finite = |p: &[f64; 2]| p[0].is_finite() && p[1].is_finite();
        match item {
            Item::Line(points, stroke) => {
                for piece in points.split(|p| !finite(p)) {
                    let placed: Vec<_> = piece.iter().map(|&p| frame.place(p)).collect();
                    self.line(&thinned(&placed), *stroke);
                }
            }
            Item::Area(points, fill) => {
                let mut d = String::new();
                for (index, point) in points.iter().filter(|p| finite(p)).enumerate() {
                    let (x, y) = frame.place(*point);
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
            Item::Mark(at, mark) if finite(at) => self.mark(frame.place(*at), *mark),
            Item::Needle(at, direction, length, stroke) if finite(at) => {
                let (x, y) = frame.place(*at);
                let (sin, cos) = direction.sin_cos();
                self.line(&[(x, y), (x + length * cos, y - length * sin)], *stroke);
            }
            Item::Note(at, offset, text, color) if finite(at) => {
                let (x, y) = frame.place(*at);
                let Area {
                    left,
                    top,
                    width,
                    height,
                } = frame.area;
                let right = left + width - text_width(text, TICK_SIZE) - 3.0;
                let at = [
                    (x + offset[0]).min(right).max(left + 3.0),
                    (y - offset[1]).min(top + height - 5.0).max(top + 13.0),
                ];
                self.colored_text(at, text, TICK_SIZE, TextAnchor::Start, *color);
            }
            Item::Mark(..) | Item::Needle(..) | Item::Note(..) => {}
        }
    }
}

/// The points of a line that can be told apart on the page.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    straightened(&columns(points))
}

/// Of the points that fall into one half unit of a signal over time: first, least, greatest, last.
fn columns(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let over_time = points.windows(2).all(|pair| pair[0].0 <= pair[1].0);
    if !over_time {
        return points.to_vec();
    }
    let column = |point: &(f64, f64)| (point.0 * 2.0).floor();
    let mut kept = Vec::new();
    for group in points.chunk_by(|a, b| column(a) == column(b)) {
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let pick = |point: Option<&(f64, f64)>| {
            point.and_then(|point| group.iter().position(|other| other == point))
        };
        let mut indices: Vec<usize> = [
            Some(0),
            pick(group.iter().min_by(by_height)),
            pick(group.iter().max_by(by_height)),
            Some(group.len() - 1),
        ]
        .into_iter()
        .flatten()
        .collect();
        indices.sort_unstable();
        indices.dedup();
        kept.extend(indices.into_iter().map(|index| group[index]));
    }
    kept
}

/// Drops points closer than a tenth of a unit to the line without them (Douglas and Peucker).
fn straightened(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    const TOLERANCE: f64 = 0.1;
    if points.len() < 3 {
        return points.to_vec();
    }
    let mut keep = vec![false; points.len()];
    keep[0] = true;
    keep[points.len() - 1] = true;
    let mut open = vec![(0, points.len() - 1)];
    while let Some((first, last)) = open.pop() {
        let (a, b) = (points[first], points[last]);
        let farthest = (first + 1..last)
            .map(|k| (k, distance_to_segment(points[k], a, b)))
            .max_by(|one, two| one.1.total_cmp(&two.1));
        if let Some((k, distance)) = farthest
            && distance > TOLERANCE
        {
            keep[k] = true;
            open.push((first, k));
            open.push((k, last));
        }
    }
    let kept = points.iter().zip(keep).filter(|(_, keep)| *keep);
    kept.map(|(point, _)| *point).collect()
}

fn distance_to_segment(p: (f64, f64), a: (f64, f64), b: (f64, f64)) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let square = dx * dx + dy * dy;
    let along = if square > 0.0 {
        (((p.0 - a.0) * dx + (p.1 - a.1) * dy) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (p.0 - a.0 - along * dx).hypot(p.1 - a.1 - along * dy)
}

/// Cuts a line into the pieces that a pattern of drawn and omitted lengths leaves.
fn dashes(points: &[(f64, f64)], [drawn, omitted]: [f64; 2]) -> Vec<Vec<(f64, f64)>> {
    let mut pieces = Vec::new();
    let mut piece: Vec<(f64, f64)> = points.first().copied().into_iter().collect();
    let (mut draws, mut left) = (true, drawn);
    for pair in points.windows(2) {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        let length = (x1 - x0).hypot(y1 - y0);
        let mut done = 0.0;
        while length - done > left {
            done += left;
            let at = (
                x0 + (x1 - x0) * done / length,
                y0 + (y1 - y0) * done / length,
            );
            if draws {
                piece.push(at);
                pieces.push(std::mem::take(&mut piece));
            } else {
                piece = vec![at];
            }
            draws = !draws;
            left = if draws { drawn } else { omitted };
        }
        left -= length - done;
        if draws {
            piece.push((x1, y1));
        }
    }
    if piece.len() > 1 {
        pieces.push(piece);
    }
    pieces
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
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

    /// Checks that every text stands on the page as a whole.
    pub fn check_texts(svg: &str) {
        let x = numbers(attributes(svg, "text", "x"));
        let y = numbers(attributes(svg, "text", "y"));
        let size = numbers(attributes(svg, "text", "font-size"));
        let anchors = attributes(svg, "text", "text-anchor");
        let height = numbers(attributes(svg, "svg", "height"))[0];
        let contents = svg.split("<text ").skip(1).map(|element| {
            let content = &element[element.find('>').unwrap() + 1..element.find("</text").unwrap()];
            content
                .replace("<tspan font-weight=\"bold\">", "")
                .replace("</tspan>", "")
        });
        for (index, content) in contents.enumerate() {
            let width = text_width(&content, size[index] as u32);
            let left = match anchors[index].as_str() {
                "start" => x[index],
                "middle" => x[index] - width / 2.0,
                _ => x[index] - width,
            };
            assert!(
                left >= 0.0 && left + width <= WIDTH,
                "{content:?} at {left}, {width} wide"
            );
            assert!(
                y[index] >= size[index] && y[index] <= height - 4.0,
                "{content:?}"
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

    const DOT: Mark = Mark {
        shape: Shape::Disc,
        radius: 2.0,
        color: palette::BLUE,
    };

    fn dots(panel: Panel, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut panel = panel;
        for &point in points {
            panel.mark(point, DOT);
        }
        let svg = Figure::new("t").row(Height::Fixed(200.0), [panel]).svg();
        check_svg(&svg);
        let x = numbers(attributes(&svg, "circle", "cx"));
        let y = numbers(attributes(&svg, "circle", "cy"));
        x.into_iter().zip(y).map(|(x, y)| [x, y]).collect()
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
                (0..100).map(|k| [f64::from(k), f64::from(k * k)]),
                Stroke::dashed(palette::GREEN, 1.0),
            );
            Figure::new("a < b")
                .legend(Legend::line("v", Stroke::solid(palette::BLUE, 1.0)))
                .row(Height::Fixed(100.0), [panel.clone(), panel])
        };
        let (svg, png) = (draw().svg(), draw().png());
        check_svg(&svg);
        check_texts(&svg);
        let height: f64 = numbers(attributes(&svg, "svg", "height"))[0];
        assert_eq!(png_size(&png), [1600, (2.0 * height) as u32]);
        assert_eq!(svg, draw().svg());
        assert_eq!(png, draw().png());
    }

    #[test]
    fn nothing_to_draw_and_no_finite_number_still_give_a_picture() {
        let mut broken = Panel::new("x", "y").x_limits([f64::NAN, 1.0]).equal_axes();
        broken.line(
            [[0.0, f64::NAN], [f64::INFINITY, 1.0]],
            Stroke::solid(palette::BLUE, 1.0),
        );
        broken.mark([f64::NAN; 2], DOT);
        let mut constant = Panel::new("x", "y");
        constant.line([[0.0, 5.0], [1.0, 5.0]], Stroke::solid(palette::BLUE, 1.0));
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
        panel.line(points, Stroke::solid(Rgb(1, 2, 3), 1.0));
        let svg = Figure::new("").row(Height::Fixed(100.0), [panel]).svg();
        assert_eq!(svg.matches("stroke=\"#010203\"").count(), 2);
    }

    #[test]
    fn a_logarithmic_axis_is_labelled_with_powers_of_ten() {
        let mut panel = Panel::new("t (s)", "ratio").decades().x_decades();
        panel.line([[3.9, -2.2], [5.1, 3.1]], Stroke::solid(palette::BLUE, 1.0));
        let svg = Figure::new("").row(Height::Fixed(200.0), [panel]).svg();
        for text in ["0.01", "1", "100", "10000", "100000"] {
            assert!(svg.contains(&format!(">{text}<")), "{text}");
        }
        assert!(!svg.contains(">−2<"));
    }

    #[test]
    fn ticks_are_round_and_read_as_they_are_placed() {
        let ticks = Ticks::new([-1.3, 0.4], 6);
        let texts: Vec<String> = ticks.values.iter().map(|&v| ticks.text(v)).collect();
        assert_eq!(
            texts,
            [
                "−1.2", "−1.0", "−0.8", "−0.6", "−0.4", "−0.2", "0.0", "0.2", "0.4"
            ]
        );
        let ticks = Ticks::new([0.0, 19.999], 4);
        assert_eq!(ticks.values, [0.0, 5.0, 10.0, 15.0, 20.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_axis_has_a_few_ticks(low in -1e4f64..1e4, width in 1e-3f64..1e5, count in 2usize..12) {
            let ticks = Ticks::new([low, low + width], count);
            prop_assert!(ticks.values.len() <= 2 * count + 2);
            prop_assert!(ticks.values.len() + 1 >= count / 2);
            for &value in &ticks.values {
                prop_assert!(value > low - 0.01 * width && value < low + 1.01 * width);
                let read: f64 = ticks.text(value).replace('−', "-").parse().unwrap();
                prop_assert!((read - value).abs() <= 1e-9 * value.abs().max(width));
            }
        }

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
            let pieces = dashes(&points, [7.0, 4.0]);
            let total = length(&points);
            let periods = (total / 11.0).floor();
            let expected = periods * 7.0 + (total - periods * 11.0).min(7.0);
            let drawn: f64 = pieces.iter().map(|piece| length(piece)).sum();
            prop_assert!((drawn - expected).abs() < 1e-9 * (1.0 + total));
        }
    }
}
