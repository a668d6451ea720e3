//! The figures, as SVG: the two distribution functions of a pair of scenarios with the distance marked, and one period of
//! target and actual position; and the same as PDF. Text of the SVG is left to whoever shows it. The main type is
//! [`Figure`]; [`draw`] makes all of a report's.

mod distributions;
mod pdf;
mod trajectory;

use std::io;

use plotters::{
    coord::Shift,
    drawing::DrawingAreaErrorKind,
    prelude::{DrawingArea, IntoDrawingArea, RED, RGBColor, SVGBackend, Text, WHITE},
    style::{IntoFont, TextStyle},
};

pub use pdf::{PdfError, of as pdf};

use crate::{
    report::{Report, ScenarioReport},
    run::Run,
};

/// One drawn figure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Its file's name, such as `cdf-b-d.svg`.
    pub name: String,
    /// The drawing.
    pub svg: String,
}

/// A figure could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("the figure {name} cannot be drawn")]
pub struct FigureError {
    /// The figure.
    pub name: String,
    /// Why.
    source: DrawingError,
}

type DrawingError = DrawingAreaErrorKind<io::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Blue and vermilion that are told apart without colour vision too (Okabe and Ito).
const FIRST: RGBColor = RGBColor(0, 114, 178);
const SECOND: RGBColor = RGBColor(213, 94, 0);

/// Greys in place of black that lets the paper through: that would be set apart in PDF, and in no fixed order.
const LABEL: RGBColor = RGBColor(38, 38, 38);
const FRAME: RGBColor = RGBColor(178, 178, 178);
const GRID: RGBColor = RGBColor(224, 224, 224);

/// Draws the figures of a report.
///
/// # Errors
/// When the drawing library fails.
pub fn draw(run: &Run, report: &Report) -> Result<Vec<Figure>, FigureError> {
    let mut figures = Vec::new();
    for (a, b) in chosen_pairs(report).pairs {
        figures.extend(distributions::draw(report, a, b)?);
    }
    for scenario in &run.scenarios {
        figures.extend(trajectory::draw(scenario)?);
    }
    Ok(figures)
}

/// The pairs of scenarios to draw.
pub(crate) struct ChosenPairs<'a> {
    pub(crate) pairs: Vec<(&'a ScenarioReport, &'a ScenarioReport)>,
    /// Names in `report.figures` that no scenario has.
    pub(crate) unknown: Vec<&'a str>,
}

/// Those that the settings name, or else the controls against all others.
pub(crate) fn chosen_pairs(report: &Report) -> ChosenPairs<'_> {
    let find = |name: &str| {
        report
            .scenarios
            .iter()
            .find(|scenario| scenario.id == name || scenario.slug == name)
    };
    let named = &report.settings.figures;
    let pairs = if named.is_empty() {
        let controls = report.scenarios.iter().filter(|scenario| scenario.is_control);
        let others = || report.scenarios.iter().filter(|scenario| !scenario.is_control);
        controls
            .flat_map(|control| others().map(move |other| (control, other)))
            .collect()
    } else {
        named.iter().filter_map(|(a, b)| find(a).zip(find(b))).collect()
    };
    let names = named.iter().flat_map(|(a, b)| [a.as_str(), b.as_str()]);
    ChosenPairs {
        pairs,
        unknown: names.filter(|name| find(name).is_none()).collect(),
    }
}

/// Draws one figure of the given size with its caption lines, the first one larger.
fn drawn(
    name: String,
    size: (u32, u32),
    caption: &[String],
    is_simulated: bool,
    draw: impl Fn(&Area<'_>) -> Result<(), DrawingError>,
) -> Result<Figure, FigureError> {
    let mut svg = String::new();
    let result = (|| {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE)?;
        let mut top = 10;
        for (index, line) in caption.iter().enumerate() {
            let height = if index == 0 { 18 } else { 14 };
            area.draw(&Text::new(
                line.clone(),
                (16, top),
                ("sans-serif", height).into_font(),
            ))?;
            top += height + 6;
        }
        if is_simulated {
            let loud = TextStyle::from(("sans-serif", 16).into_font()).color(&RED);
            area.draw(&Text::new("SIMULATED, NOT MEASURED", (16, top), loud))?;
            top += 22;
        }
        let (_, below) = area.split_vertically(top);
        draw(&below)?;
        area.present()
    })();
    match result {
        Ok(()) => Ok(Figure { name, svg }),
        Err(source) => Err(FigureError { name, source }),
    }
}

/// The style of axis labels.
fn label() -> TextStyle<'static> {
    ("sans-serif", 13).into_font().color(&LABEL)
}
