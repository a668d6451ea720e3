//! The shifts of all pairs of the family with their intervals, and the band that does not matter.

use plotters::{
    element::{Circle, PathElement, Rectangle, Text},
    style::{
        BLACK, Color, RGBColor,
        text_anchor::{HPos, VPos},
    },
};

use super::{
    Figure, FigureError, Kind,
    canvas::{
        About, Area, Axes, DrawingError, FIRST, LEGEND_PT, LETTERS_PT, Sample, anchored, drawn, fitted,
        legend, line, pt,
    },
};
use crate::{analysis::report::Report, present::forest::Forest};

/// Of a pair.
const ROW_PT: f64 = 10.5;
/// For the letters of a pair.
const NAMES_PT: f64 = 34.0;
/// The band that does not matter.
const BAND: RGBColor = RGBColor(232, 236, 240);

/// Draws them; none where no pair has data.
pub(super) fn draw(report: &Report) -> Result<Option<Figure>, FigureError> {
    let Some(forest) = Forest::of(report) else {
        return Ok(None);
    };
    let about = About {
        kind: Kind::Forest,
        of: String::new(),
        caption: forest.caption(),
        is_simulated: report.is_simulated(),
        height_pt: 40.0 + 2.0 * LEGEND_PT + ROW_PT * (forest.rows.len() + 1) as f64,
    };
    drawn(about, |area| on(area, &forest)).map(Some)
}

fn on(area: &Area<'_>, forest: &Forest) -> Result<(), DrawingError> {
    let [each, all, zero] = [line(FIRST, 2.2), line(FIRST, 0.7), line(BLACK, 0.5)];
    let below = legend(
        area,
        &[
            (Sample::Line(each), "each pair by itself"),
            (Sample::Line(all), "all pairs at once"),
        ],
    )?;
    let (low, high) = forest.range();
    let rows = forest.rows.len() as f64;
    let axes = Axes {
        x: low..high,
        y: -0.5..rows + 0.5,
        names: [&forest.heading, ""],
        ticks: [5, 0],
        sides_pt: [NAMES_PT, 12.0],
    };
    let mut chart = axes.draw(&below)?;
    let (bottom, top) = (-0.5, rows + 0.5);
    if let Some(margin) = forest.margin {
        chart.draw_series([Rectangle::new([(-margin, bottom), (margin, top)], BAND.filled())])?;
    }
    chart.draw_series([PathElement::new([(0.0, bottom), (0.0, top)], zero)])?;
    let style = anchored(LETTERS_PT, HPos::Right, VPos::Center);
    // The first pair stands at the top.
    for (y, row) in (1..)
        .zip(&forest.rows)
        .map(|(nth, row)| (rows - f64::from(nth) + 0.5, row))
    {
        for (interval, style) in [(row.all, all), (row.each, each)] {
            let ends = interval.map(|(from, to)| PathElement::new([(from, y), (to, y)], style));
            chart.draw_series(ends)?;
        }
        for end in row.all.into_iter().flat_map(|(from, to)| [from, to]) {
            chart.draw_series([PathElement::new([(end, y - 0.2), (end, y + 0.2)], all)])?;
        }
        chart.draw_series([Circle::new((row.shift, y), pt(2.2), BLACK.filled())])?;
        let (_, middle) = chart.backend_coord(&(low, y));
        let (_, offset) = below.get_base_pixel();
        let name = fitted(&row.name, NAMES_PT - 4.0, LETTERS_PT);
        below.draw(&Text::new(
            name,
            (pt(NAMES_PT - 2.0), middle - offset),
            style.clone(),
        ))?;
    }
    Ok(())
}
