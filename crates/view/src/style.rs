//! Colours, dashes and marks of all figures and of the report page.
//!
//! Figures take each [`Appearance`] from one table and define none of their own. The colours are those of Okabe and
//! Ito, which colour-blind readers can distinguish. Dashes and shapes distinguish the kinds in grayscale.

use host_sim::run::end::Verdict;

/// Colour: red, green, blue, 0 to 255.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rgb(pub u8, pub u8, pub u8);

impl Rgb {
    /// Mixture of the colour with white: `by` = 0 gives the colour, 1 gives white.
    pub fn lighter(self, by: f64) -> Self {
        self.mixed(Self(255, 255, 255), by)
    }

    fn mixed(self, other: Self, share: f64) -> Self {
        let mix =
            |a: u8, b: u8| (f64::from(a) * (1.0 - share) + f64::from(b) * share).round() as u8;
        Self(
            mix(self.0, other.0),
            mix(self.1, other.1),
            mix(self.2, other.2),
        )
    }

    /// The colour in CSS notation.
    pub fn css(self) -> String {
        format!("#{:02x}{:02x}{:02x}", self.0, self.1, self.2)
    }
}

/// Pattern of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dash {
    /// Unbroken line.
    Solid,
    /// Long dashes.
    Dashed,
    /// Alternating long and short dashes.
    DashDot,
    /// Short dashes.
    Dotted,
}

impl Dash {
    /// Alternating lengths of dash and gap, in units of the figure; empty for a solid line.
    pub const fn pattern(self) -> &'static [f64] {
        match self {
            Self::Solid => &[],
            Self::Dashed => &[7.0, 4.5],
            Self::DashDot => &[9.0, 3.5, 2.0, 3.5],
            Self::Dotted => &[2.0, 3.5],
        }
    }
}

/// Colour, width and pattern of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Colour of the line.
    pub color: Rgb,
    /// Width of the line in units of the figure.
    pub width: f64,
    /// Dash pattern of the line.
    pub dash: Dash,
}

/// Shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A filled circle.
    Disc,
    /// A circle.
    Ring,
    /// A circle with a cross in it.
    Target,
    /// A diagonal cross.
    Cross,
}

/// Mark of constant size on the page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Shape of the mark.
    pub shape: Shape,
    /// Half the size in units of the figure.
    pub radius: f64,
    /// Colour of the mark.
    pub color: Rgb,
    /// Direction of the stroke from the centre, rad; `None` without a stroke.
    pub heading: Option<f64>,
}

impl Mark {
    /// Mark without a heading.
    pub const fn new(shape: Shape, radius: f64, color: Rgb) -> Self {
        Self {
            shape,
            radius,
            color,
            heading: None,
        }
    }

    /// Mark with a heading, rad.
    pub fn heading(self, heading: f64) -> Self {
        Self {
            heading: Some(heading),
            ..self
        }
    }
}

/// Appearance of one kind of object in every figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance {
    /// Name of the CSS variable on the report page.
    pub name: &'static str,
    /// Width and pattern of the line, and its colour on a light page.
    pub stroke: Stroke,
    /// Colour of the line on a dark page.
    pub dark: Rgb,
}

const BLACK: Rgb = Rgb(0, 0, 0);
const GREY: Rgb = Rgb(110, 110, 110);
const BLUE: Rgb = Rgb(0, 114, 178);
const VERMILION: Rgb = Rgb(213, 94, 0);
const GREEN: Rgb = Rgb(0, 158, 115);
const PURPLE: Rgb = Rgb(204, 121, 167);
const ORANGE: Rgb = Rgb(230, 159, 0);
const SKY: Rgb = Rgb(86, 180, 233);
/// Colours of the [`series`] on a light and on a dark page, most distinct first.
const SERIES: [(Rgb, Rgb); 7] = [
    (BLUE, Rgb(108, 178, 255)),
    (VERMILION, Rgb(255, 138, 92)),
    (GREEN, Rgb(79, 214, 160)),
    (PURPLE, Rgb(244, 143, 177)),
    (ORANGE, Rgb(232, 189, 79)),
    (SKY, Rgb(77, 208, 225)),
    (BLACK, Rgb(231, 234, 238)),
];
const DASHES: [Dash; 4] = [Dash::Solid, Dash::Dashed, Dash::DashDot, Dash::Dotted];

const fn appearance(
    name: &'static str,
    (color, dark): (Rgb, Rgb),
    width: f64,
    dash: Dash,
) -> Appearance {
    Appearance {
        name,
        stroke: Stroke { color, width, dash },
        dark,
    }
}

/// Appearance of the true motion.
pub const TRUTH: Appearance = appearance("truth", SERIES[0], 2.0, Dash::Solid);
/// Appearance of the robot's estimate.
pub const ESTIMATE: Appearance = appearance("estimate", SERIES[6], 1.6, Dash::Dashed);
/// Appearance of the reference path or reference motion.
pub const REFERENCE: Appearance = appearance("reference", SERIES[2], 2.0, Dash::DashDot);
/// Appearance of the goal posture.
pub const GOAL: Appearance = appearance("goal", SERIES[2], 2.0, Dash::Solid);
/// Appearance of a run that stopped, failed or ran out of time.
pub const FAILURE: Appearance = appearance("failure", SERIES[1], 1.8, Dash::Dotted);
/// Appearance of a run that ended outside the tolerance.
pub const OUTSIDE: Appearance = appearance("outside", SERIES[3], 1.6, Dash::Dashed);
/// Appearance of the flexible frame.
pub const FRAME: Appearance = appearance("frame", SERIES[4], 3.0, Dash::Solid);
/// Appearance of axles and wheels.
pub const BODY: Appearance = appearance("body", (GREY, Rgb(160, 169, 179)), 2.5, Dash::Solid);
/// Appearance of the tracks of the wheels.
pub const WHEELS: Appearance = appearance("wheels", (GREY, Rgb(160, 169, 179)), 1.1, Dash::Dotted);
/// Appearance of trials that are not drawn in full.
pub const OTHERS: Appearance = appearance("others", SERIES[5], 0.9, Dash::Solid);
/// Appearance of the tolerance and of 95 % bands.
pub const BAND: Appearance = appearance(
    "band",
    (Rgb(214, 214, 214), Rgb(60, 66, 74)),
    1.6,
    Dash::Solid,
);

/// Appearance of values that the paper prints.
pub const PAPER: Appearance = appearance("paper", SERIES[6], 1.8, Dash::DashDot);

/// Appearances of all kinds of objects.
pub const TABLE: [Appearance; 12] = [
    TRUTH, ESTIMATE, REFERENCE, GOAL, FAILURE, OUTSIDE, FRAME, BODY, WHEELS, OTHERS, BAND, PAPER,
];

/// Appearance with colour number `color` and dash pattern number `dash`.
pub const fn series_by(color: usize, dash: usize) -> Appearance {
    let colors = SERIES[color % SERIES.len()];
    appearance("series", colors, 1.8, DASHES[dash % DASHES.len()])
}

/// Appearance of the n-th series, for series that are not of a kind in [`TABLE`].
pub const fn series(n: usize) -> Appearance {
    series_by(n, n)
}

/// Colour of text, and of lines that belong to no single series.
pub const INK: Rgb = BLACK;
/// Mark of a value that the paper prints.
pub const PAPER_MARK: Mark = Mark::new(Shape::Ring, 5.0, PAPER.stroke.color);
/// Mark of the goal.
pub const GOAL_MARK: Mark = Mark::new(Shape::Target, 6.0, GOAL.stroke.color);

/// Style of a line for a run with this verdict.
pub const fn stroke_of(verdict: Verdict) -> Stroke {
    match verdict {
        Verdict::Within => TRUTH.stroke,
        Verdict::Outside => OUTSIDE.stroke,
        Verdict::Failed => FAILURE.stroke,
    }
}

/// Mark at the start or the end of a run with this verdict.
pub const fn mark_of(verdict: Verdict, radius: f64) -> Mark {
    let color = stroke_of(verdict).color;
    match verdict {
        Verdict::Within => Mark::new(Shape::Disc, radius, color),
        Verdict::Outside => Mark::new(Shape::Ring, radius, color),
        Verdict::Failed => Mark::new(Shape::Cross, 1.3 * radius, color),
    }
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
    ANCHORS[index].mixed(ANCHORS[index + 1], place - index as f64)
}

/// Number of series whose colours the report page defines as CSS variables: `c0`, `c1`, …
const PAGE_SERIES: usize = 8;

/// CSS variables of all appearances: colours for a light or a dark page, and dashes.
pub fn css(dark: bool) -> String {
    let series = (0..PAGE_SERIES).map(|n| (format!("c{n}"), series(n)));
    let named = TABLE.map(|appearance| (appearance.name.to_owned(), appearance));
    let all = named.into_iter().chain(series).map(|(name, appearance)| {
        let color = if dark {
            appearance.dark
        } else {
            appearance.stroke.color
        };
        let dash: Vec<String> = appearance
            .stroke
            .dash
            .pattern()
            .iter()
            .map(f64::to_string)
            .collect();
        let (color, dash) = (color.css(), dash.join(" "));
        format!("--{name}: {color}; --{name}-dash: {dash};")
    });
    all.collect::<Vec<_>>().join("\n    ")
}

const SHEET: &str = include_str!("base.css");
/// Placeholder of the colours of a light page in the style sheet.
const LIGHT: &str = "/*LIGHT*/";
/// Placeholder of the colours of a dark page in the style sheet.
const DARK: &str = "/*DARK*/";

/// Style sheet that the report page and the browser page share.
pub fn sheet() -> String {
    SHEET
        .replacen(LIGHT, &css(false), 1)
        .replacen(DARK, &css(true), 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness(Rgb(r, g, b): Rgb) -> f64 {
        0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
    }

    #[test]
    fn lines_of_one_picture_differ_in_grayscale() {
        // Each list holds kinds that appear together in one panel.
        for kinds in [
            &[TRUTH, ESTIMATE, REFERENCE][..],
            &[TRUTH, OUTSIDE, FAILURE],
            &[TRUTH, WHEELS, OTHERS, FRAME],
        ] {
            for (n, a) in kinds.iter().enumerate() {
                for b in &kinds[n + 1..] {
                    let (a_light, b_light) = (lightness(a.stroke.color), lightness(b.stroke.color));
                    let widths = [a.stroke.width, b.stroke.width];
                    let apart = (a_light - b_light).abs() > 40.0
                        || widths[0] > 2.0 * widths[1]
                        || widths[1] > 2.0 * widths[0];
                    assert!(apart || a.stroke.dash != b.stroke.dash, "{a:?} {b:?}");
                }
            }
        }
        for n in 0..4 {
            assert!((0..n).all(|m| series(m).stroke.dash != series(n).stroke.dash));
        }
    }

    #[test]
    fn style_sheet_names_every_kind_once() {
        for dark in [false, true] {
            let css = css(dark);
            for appearance in TABLE {
                assert_eq!(css.matches(&format!("--{}: #", appearance.name)).count(), 1);
            }
            assert!(css.contains("--estimate-dash: 7 4.5;") && css.contains("--truth-dash: ;"));
        }
    }
}
