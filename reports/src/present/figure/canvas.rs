//! What a figure is drawn on: a page as wide as the place where it is to stand, so that its letters have their size there. All lengths here
//! and in the drawings are points on a column of a paper; where letters are larger, all is. The main function is [`drawn`].

use std::{io, ops::Range};

use plotters::{
    chart::{ChartBuilder, ChartContext},
    coord::{Shift, types::RangedCoordf64},
    data::float::FloatPrettyPrinter,
    drawing::DrawingAreaErrorKind,
    prelude::{
        BLACK, Cartesian2d, Color, DrawingArea, IntoDrawingArea, PathElement, RED, RGBColor, SVGBackend,
        Text, WHITE,
    },
    style::{
        IntoFont, ShapeStyle, TextStyle,
        text_anchor::{HPos, Pos, VPos},
    },
};

use super::{Figure, Kind, Layout};
use crate::present::colours::COLOURS;

/// A figure could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("the figure {name} cannot be drawn")]
pub struct FigureError {
    /// The figure.
    pub name: String,
    source: DrawingError,
}

pub(super) type DrawingError = DrawingAreaErrorKind<io::Error>;
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A column of the IEEE's two-column papers is 3.5 inches wide.
pub(super) const COLUMN_PT: f64 = 252.0;
/// Of the figures. Papers ask for 7 pt at least.
pub(super) const LETTERS_PT: f64 = 7.5;
/// Of what stands raised.
pub(super) const SMALL_PT: f64 = 7.0;
/// The drawing library has whole coordinates only.
const UNITS_PER_PT: f64 = 10.0;
/// The library writes fonts smaller by this.
const FONT_SCALE: f64 = 1.24;

/// The colour of that number.
pub(super) fn colour(number: usize) -> RGBColor {
    let (red, green, blue) = COLOURS.get(number % COLOURS.len()).copied().unwrap_or_default();
    RGBColor(red, green, blue)
}

/// The same with much white, so that another's outline is seen on it.
pub(super) fn pale(RGBColor(red, green, blue): RGBColor) -> RGBColor {
    let mixed = |part: u8| (f64::from(part) * 0.35 + 255.0 * 0.65).round() as u8;
    RGBColor(mixed(red), mixed(green), mixed(blue))
}

/// Opaque, since what lets the paper through would be set apart in PDF, and in no fixed order.
const LABEL: RGBColor = RGBColor(38, 38, 38);
const GRID: RGBColor = RGBColor(224, 224, 224);

/// Points in the units of a drawing.
pub(super) fn pt(points: f64) -> i32 {
    (points * UNITS_PER_PT).round() as i32
}

/// Letters of that size, in points.
pub(super) fn letters(size_pt: f64) -> TextStyle<'static> {
    ("sans-serif", size_pt * UNITS_PER_PT * FONT_SCALE)
        .into_font()
        .color(&LABEL)
}

/// Letters whose given point is not the upper left corner.
pub(super) fn anchored(size_pt: f64, horizontal: HPos, vertical: VPos) -> TextStyle<'static> {
    letters(size_pt).pos(Pos::new(horizontal, vertical))
}

/// A line of that width, in points.
pub(super) fn line(colour: RGBColor, width_pt: f64) -> ShapeStyle {
    ShapeStyle::from(colour).stroke_width(pt(width_pt).unsigned_abs())
}

/// The page's parts of a figure: what it is, beside the drawing.
pub(super) struct About {
    pub(super) kind: Kind,
    /// What comes after the kind in the file's name: `b-d`; empty if there is only one.
    pub(super) of: String,
    pub(super) caption: String,
    pub(super) is_simulated: bool,
    pub(super) height_pt: f64,
}

/// Draws one figure.
pub(super) fn drawn(
    about: About,
    layout: Layout,
    draw: impl Fn(&Area<'_>) -> Result<(), DrawingError>,
) -> Result<Figure, FigureError> {
    let warning_pt = if about.is_simulated { 12.0 } else { 0.0 };
    let height_pt = about.height_pt + warning_pt;
    let width_pt = layout.width_pt() / layout.scale();
    let size = (pt(width_pt).unsigned_abs(), pt(height_pt).unsigned_abs());
    let mut svg = String::new();
    let result = (|| {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE)?;
        let (warning, below) = area.split_vertically(pt(warning_pt));
        if about.is_simulated {
            let loud = letters(LETTERS_PT).color(&RED);
            warning.draw(&Text::new("SIMULATED, NOT MEASURED", (pt(2.0), pt(3.0)), loud))?;
        }
        draw(&below)?;
        area.present()
    })();
    let mut words = vec![about.kind.prefix()];
    words.extend(Some(about.of.as_str()).filter(|of| !of.is_empty()));
    let name = words.join("-") + ".svg";
    match result {
        Ok(()) => Ok(Figure {
            kind: about.kind,
            name,
            caption: match about.is_simulated {
                true => format!("Simulated, not measured. {}", about.caption),
                false => about.caption,
            },
            layout,
            svg: in_points(&svg, size, layout.scale()),
        }),
        Err(source) => Err(FigureError { name, source }),
    }
}

/// The drawing at the size that it has on paper.
fn in_points(svg: &str, (width, height): (u32, u32), scale: f64) -> String {
    let units = format!("width=\"{width}\" height=\"{height}\"");
    // Of a tenth of a point no one sees a part.
    let points = |units: u32| (f64::from(units) / UNITS_PER_PT * scale * 10.0).round() / 10.0;
    svg.replacen(
        &units,
        &format!("width=\"{}pt\" height=\"{}pt\"", points(width), points(height)),
        1,
    )
}

/// How wide an area is, in points.
pub(super) fn width_pt(area: &Area<'_>) -> f64 {
    f64::from(area.dim_in_pixel().0) / UNITS_PER_PT
}

/// The middle of an area, as wide as a column.
pub(super) fn column_of<'a>(area: &Area<'a>) -> Area<'a> {
    let aside = pt((width_pt(area) - COLUMN_PT).max(0.0) / 2.0);
    area.margin(0, 0, aside, aside)
}

/// Two axes to be drawn.
pub(super) struct Axes<'a> {
    pub(super) x: Range<f64>,
    pub(super) y: Range<f64>,
    pub(super) names: [&'a str; 2],
    /// About so many numbers on each.
    pub(super) ticks: [usize; 2],
    /// For the numbers and the name on the left, and for the half of the last number on the right.
    pub(super) sides_pt: [f64; 2],
}

impl Axes<'_> {
    pub(super) fn draw<'a>(self, area: &Area<'a>) -> Result<Chart<'a>, DrawingError> {
        // The drawing library would look for numbers at an axis without ends for ever.
        if [&self.x, &self.y]
            .iter()
            .any(|axis| !(axis.end - axis.start).is_finite())
        {
            return Err(DrawingError::LayoutError);
        }
        let mut chart = ChartBuilder::on(area)
            .margin_top(pt(4.0))
            .margin_right(pt(self.sides_pt[1]))
            .margin_left(pt(2.0))
            .margin_bottom(pt(1.0))
            .x_label_area_size(pt(24.0))
            .y_label_area_size(pt(self.sides_pt[0]))
            .build_cartesian_2d(self.x, self.y)?;
        let [x, y] = self.names;
        chart
            .configure_mesh()
            .light_line_style(BLACK.mix(0.0))
            .bold_line_style(line(GRID, 0.5))
            .axis_style(line(LABEL, 0.5))
            .set_all_tick_mark_size(pt(1.5))
            .x_label_formatter(&number)
            .y_label_formatter(&number)
            .x_desc(x)
            .y_desc(y)
            .x_labels(self.ticks[0])
            .y_labels(self.ticks[1])
            .label_style(letters(LETTERS_PT))
            .axis_desc_style(letters(LETTERS_PT))
            .draw()?;
        Ok(chart)
    }
}

/// A number at an axis, with as many places as it needs.
fn number(value: &f64) -> String {
    let printer = FloatPrettyPrinter {
        allow_scientific: false,
        min_decimal: 0,
        max_decimal: 5,
    };
    printer.print(*value)
}

/// How one line of a legend shows what it is about.
#[derive(Clone, Copy)]
pub(super) enum Sample {
    /// A line.
    Line(ShapeStyle),
    /// A dashed line.
    Dashed(ShapeStyle),
    /// A filled bar with its edge.
    Filled(RGBColor, ShapeStyle),
}

/// Height of a line of a legend.
pub(super) const LEGEND_PT: f64 = 10.0;

/// Draws a legend above the rest, a line for each name; the rest.
pub(super) fn legend<'a>(area: &Area<'a>, lines: &[(Sample, &str)]) -> Result<Area<'a>, DrawingError> {
    const SAMPLE_PT: f64 = 20.0;
    let style = anchored(LETTERS_PT, HPos::Left, VPos::Center);
    for (index, (sample, name)) in lines.iter().enumerate() {
        let middle = pt(3.0 + LEGEND_PT * (index as f64 + 0.5));
        let (from, to) = (pt(2.0), pt(2.0 + SAMPLE_PT));
        match *sample {
            Sample::Line(style) => area.draw(&PathElement::new([(from, middle), (to, middle)], style))?,
            Sample::Dashed(style) => {
                for dash in dashes(from, to) {
                    area.draw(&PathElement::new(dash.map(|x| (x, middle)), style))?;
                }
            }
            Sample::Filled(fill, edge) => {
                let corners = [(from, middle - pt(2.5)), (to, middle + pt(2.5))];
                area.draw(&plotters::prelude::Rectangle::new(corners, fill.filled()))?;
                area.draw(&plotters::prelude::Rectangle::new(corners, edge))?;
            }
        }
        let room_pt = width_pt(area) - SAMPLE_PT - 8.0;
        area.draw(&Text::new(
            fitted(name, room_pt, LETTERS_PT),
            (pt(6.0 + SAMPLE_PT), middle),
            style.clone(),
        ))?;
    }
    let (_, below) = area.split_vertically(pt(4.0 + LEGEND_PT * lines.len() as f64));
    Ok(below)
}

/// Length of a dash and of the gap behind it.
pub(super) const DASH_PT: (f64, f64) = (4.0, 2.0);

fn dashes(from: i32, to: i32) -> impl Iterator<Item = [i32; 2]> {
    let (dash, gap) = (pt(DASH_PT.0), pt(DASH_PT.1));
    (from..to)
        .step_by((dash + gap).unsigned_abs() as usize)
        .map(move |start| [start, (start + dash).min(to)])
}

/// A name that fits: of one that is too long, the middle is left out, since scenarios differ at their ends.
pub(super) fn fitted(name: &str, room_pt: f64, size_pt: f64) -> String {
    let width = |letters: &[char]| letters.iter().copied().map(advance).sum::<f64>() * size_pt;
    let letters: Vec<char> = name.chars().collect();
    if width(&letters) <= room_pt {
        return name.to_owned();
    }
    let shortened = |kept: usize| -> Vec<char> {
        let head = letters.iter().take(kept / 3);
        let tail = letters.iter().skip(letters.len() - (kept - kept / 3));
        head.chain(&['…']).chain(tail).copied().collect()
    };
    let fitting = (0..letters.len())
        .rev()
        .map(shortened)
        .find(|it| width(it) <= room_pt);
    fitting.unwrap_or_default().into_iter().collect()
}

/// What a letter takes at most in the fonts that come into question, of the letters' size.
const fn advance(letter: char) -> f64 {
    match letter {
        'f' | 'i' | 'j' | 'l' | 'r' | 't' | ' ' | '-' | ',' | '.' | '/' | '(' | ')' | '|' => 0.42,
        'm' | 'w' | '…' => 1.0,
        'a'..='z' | '0'..='9' => 0.65,
        _ => 0.9,
    }
}
