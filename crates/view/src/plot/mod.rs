//! Figures as SVG and PNG: panels with axes, lines, marks and one legend.
//!
//! A [`Figure`] consists of rows of [`Panel`]s; a panel holds data in the units of its axes. `kuva` lays out the axes
//! and writes the SVG text and, with its bundled font, the pixels: equal figures give equal bytes on any machine.
//!
//! Every item has a label, and the legend lists exactly the labels of the drawn items. The legend is above the
//! panels, and all texts are outside the plot areas. Points that are not finite interrupt a line.

mod page;
mod thin;

use crate::style::{Mark, Rgb, Stroke};
use kuva::backend::raster::RasterBackend;
use kuva::backend::svg::SvgBackend;
use output::files::OutputDir;

/// Width of every figure, in units of the SVG.
const WIDTH: f64 = 800.0;
/// Pixels of the PNG per unit of the SVG.
const PNG_SCALE: f32 = 2.0;

/// Line, area or mark in a panel, in the units of its axes.
#[derive(Clone, Debug, PartialEq)]
enum Shown {
    Line(Vec<[f64; 2]>, Stroke),
    Area(Vec<[f64; 2]>, Rgb),
    Mark([f64; 2], Mark),
}

/// Line, area or mark with its label in the legend; the label is empty for a part of a labelled object.
#[derive(Clone, Debug, PartialEq)]
struct Item {
    label: String,
    shown: Shown,
}

impl Item {
    fn points(&self) -> &[[f64; 2]] {
        match &self.shown {
            Shown::Line(points, _) | Shown::Area(points, _) => points,
            Shown::Mark(at, _) => std::slice::from_ref(at),
        }
    }
}

/// Colour bar of a panel: [`color_scale`](crate::style::color_scale) at the right edge.
#[derive(Clone, Debug, PartialEq)]
struct ColorBar {
    label: String,
    limits: [f64; 2],
}

/// Diagram with axes and the items drawn in it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    title: String,
    caption: String,
    labels: [String; 2],
    limits: [Option<[f64; 2]>; 2],
    logarithmic: [bool; 2],
    equal: bool,
    hide_x: bool,
    bar: Option<ColorBar>,
    items: Vec<Item>,
}

impl Panel {
    /// Panel with these axis labels, units included. The limits follow the data.
    pub fn new(x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self {
            labels: [x_label.into(), y_label.into()],
            ..Self::default()
        }
    }

    /// Sets the title above the panel.
    pub fn title(mut self, title: impl Into<String>) -> Self {
        self.title = title.into();
        self
    }

    /// Sets a smaller text between title and panel.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }

    /// Gives both axes the same scale; the limits widen as needed.
    pub fn equal_axes(mut self) -> Self {
        self.equal = true;
        self
    }

    /// Omits the numbers of the horizontal axis, which the panel below shows.
    pub fn hide_x(mut self) -> Self {
        self.hide_x = true;
        self
    }

    /// Makes the horizontal or the vertical axis logarithmic. Values that are not positive are not drawn.
    pub fn logarithmic(mut self, axes: [bool; 2]) -> Self {
        self.logarithmic = axes;
        self
    }

    /// Fixes the limits of the horizontal axis.
    pub fn x_limits(mut self, limits: [f64; 2]) -> Self {
        self.limits[0] = Some(limits);
        self
    }

    /// Fixes the limits of the vertical axis.
    pub fn y_limits(mut self, limits: [f64; 2]) -> Self {
        self.limits[1] = Some(limits);
        self
    }

    /// Adds a scale of [`color_scale`](crate::style::color_scale) at the right edge.
    pub fn color_bar(mut self, label: impl Into<String>, limits: [f64; 2]) -> Self {
        self.bar = Some(ColorBar {
            label: label.into(),
            limits,
        });
        self
    }

    fn add(&mut self, label: impl Into<String>, shown: Shown) {
        let label = label.into();
        self.items.push(Item { label, shown });
    }

    /// Draws a line.
    pub fn line(
        &mut self,
        label: impl Into<String>,
        points: impl IntoIterator<Item = [f64; 2]>,
        stroke: Stroke,
    ) {
        self.add(label, Shown::Line(points.into_iter().collect(), stroke));
    }

    /// Fills a polygon.
    pub fn area(
        &mut self,
        label: impl Into<String>,
        points: impl IntoIterator<Item = [f64; 2]>,
        fill: Rgb,
    ) {
        self.add(label, Shown::Area(points.into_iter().collect(), fill));
    }

    /// Draws a mark.
    pub fn mark(&mut self, label: impl Into<String>, at: [f64; 2], mark: Mark) {
        self.add(label, Shown::Mark(at, mark));
    }

    /// Limits of the data: [[least, greatest] of x, of y]; `None` without a finite point.
    pub fn extent(&self) -> Option<[[f64; 2]; 2]> {
        extent(self.items.iter().flat_map(Item::points))
    }

    fn limits(&self) -> [[f64; 2]; 2] {
        let data = self.extent().unwrap_or([[0.0, 1.0]; 2]);
        let shares = [if self.equal { 0.05 } else { 0.0 }, 0.06];
        std::array::from_fn(|axis| {
            let fixed = self.limits[axis].filter(|limits| limits[1] > limits[0]);
            fixed.unwrap_or_else(|| padded(data[axis], shares[axis], self.logarithmic[axis]))
        })
    }
}

/// Limits widened by a fraction of their width at each end; a constant signal still gets an axis.
fn padded([low, high]: [f64; 2], share: f64, logarithmic: bool) -> [f64; 2] {
    let width = high - low;
    let pad = if width <= 1e-12 * high.abs().max(low.abs()) {
        (0.1 * high.abs()).max(1e-6)
    } else if logarithmic {
        0.0
    } else {
        share * width
    };
    [low - pad, high + pad]
}

fn is_finite(point: &[f64; 2]) -> bool {
    point[0].is_finite() && point[1].is_finite()
}

/// Limits of points: [[least, greatest] of x, of y]; `None` without a finite point.
pub fn extent<'a>(points: impl IntoIterator<Item = &'a [f64; 2]>) -> Option<[[f64; 2]; 2]> {
    points
        .into_iter()
        .filter(|p| is_finite(p))
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
    /// In units of the SVG; the figure is 800 units wide.
    Fixed(f64),
    /// As needed by the data of the first panel, which has equal axes, within these limits.
    Data {
        /// Least height, units of the SVG.
        least: f64,
        /// Greatest height, units of the SVG.
        greatest: f64,
    },
}

/// Rows of panels under a title and a legend.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    title: String,
    rows: Vec<(Height, Vec<Panel>)>,
}

impl Figure {
    /// A figure without panels.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            ..Self::default()
        }
    }

    /// Adds a row of panels of equal width.
    pub fn row(mut self, height: Height, panels: impl IntoIterator<Item = Panel>) -> Self {
        self.rows.push((height, panels.into_iter().collect()));
        self
    }

    /// Adds panels in rows of `columns`.
    pub fn rows_of(mut self, columns: usize, height: Height, panels: &[Panel]) -> Self {
        for row in panels.chunks(columns.max(1)) {
            self = self.row(height, row.to_vec());
        }
        self
    }

    fn panels(&self) -> impl Iterator<Item = &Panel> {
        self.rows.iter().flat_map(|(_, panels)| panels)
    }

    /// First item of each label that has a finite point.
    fn legend(&self) -> Vec<&Item> {
        let mut entries: Vec<&Item> = Vec::new();
        for item in self.panels().flat_map(|panel| &panel.items) {
            let known = entries.iter().any(|entry| entry.label == item.label);
            if !item.label.is_empty() && !known && item.points().iter().any(is_finite) {
                entries.push(item);
            }
        }
        entries
    }

    /// Adds the figure to the files, as NAME.svg and NAME.png.
    pub fn add(&self, files: &mut OutputDir, name: &str) {
        files.text(&format!("{name}.svg"), self.svg());
        files.bytes(&format!("{name}.png"), self.png());
    }

    /// The figure as text of an SVG file.
    pub fn svg(&self) -> String {
        let scene = page::scene(self);
        let size = format!("width=\"{}\" height=\"{}\"", scene.width, scene.height);
        // The view box lets the figure scale with its page; round ends and joins match the PNG.
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

    /// The figure as bytes of a PNG file, 1600 pixels wide.
    ///
    /// # Panics
    ///
    /// Never: the size of a figure is greater than zero.
    pub fn png(&self) -> Vec<u8> {
        RasterBackend::new()
            .with_scale(PNG_SCALE)
            .render_scene(&page::scene(self))
            .expect("a picture of more than zero pixels")
    }
}

#[cfg(any(test, feature = "checks"))]
pub mod checks;
#[cfg(test)]
mod tests;
