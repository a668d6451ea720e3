//! The shifts of all pairs of the family with their intervals, and the band that does not matter; and of each pair that was explained
//! the parts of its difference.

use plotters::{
    element::{Circle, PathElement, Rectangle, Text},
    style::{
        BLACK, Color, RGBColor,
        text_anchor::{HPos, VPos},
    },
};

use super::{
    Figure, FigureError, Kind, Layout,
    canvas::{
        About, Area, Axes, DrawingError, LEGEND_PT, LETTERS_PT, Sample, anchored, drawn, fitted, legend,
        line, pt,
    },
};
use crate::{
    analysis::report::Report,
    explain::{ExplainedPair, Found},
    present::forest::Forest,
};

/// Of a pair.
const ROW_PT: f64 = 10.5;
/// For the letters of a pair.
const LETTERS_OF_A_PAIR_PT: f64 = 34.0;
/// For what a difference may come from.
const FACTOR_PT: f64 = 86.0;
/// A shift is of two scenarios, and has the colour of neither.
const SHIFT: RGBColor = RGBColor(64, 64, 64);
/// The band that does not matter.
const BAND: RGBColor = RGBColor(232, 236, 240);

/// Draws the shifts; none where no pair has data.
pub(super) fn draw(report: &Report, layout: Layout) -> Result<Option<Figure>, FigureError> {
    let Some(forest) = Forest::of(report) else {
        return Ok(None);
    };
    let about = about(Kind::Forest, String::new(), &forest, report);
    drawn(about, layout, |area| on(area, &forest, LETTERS_OF_A_PAIR_PT)).map(Some)
}

/// Draws the parts of a pair's difference; none where it was not explained.
pub(super) fn parts(
    report: &Report,
    pair: &ExplainedPair,
    layout: Layout,
) -> Result<Option<Figure>, FigureError> {
    let Found::Explanation(explained) = &pair.found else {
        return Ok(None);
    };
    let forest = Forest::of_explanation(explained, &report.quantity);
    let about = about(Kind::Causes, format!("{}-{}", pair.a, pair.b), &forest, report);
    drawn(about, layout, |area| on(area, &forest, FACTOR_PT)).map(Some)
}

fn about(kind: Kind, of: String, forest: &Forest, report: &Report) -> About {
    About {
        kind,
        of,
        caption: forest.caption.clone(),
        is_simulated: report.is_simulated(),
        height_pt: 40.0 + 2.0 * LEGEND_PT + ROW_PT * (forest.rows.len() + 1) as f64,
    }
}

fn on(area: &Area<'_>, forest: &Forest, names_pt: f64) -> Result<(), DrawingError> {
    let [each, all, zero] = [line(SHIFT, 2.2), line(SHIFT, 0.7), line(BLACK, 0.5)];
    let mut samples = vec![(Sample::Line(each), forest.each)];
    samples.extend(forest.all.map(|name| (Sample::Line(all), name)));
    let below = legend(area, &samples)?;
    let (low, high) = forest.range();
    let rows = forest.rows.len() as f64;
    let axes = Axes {
        x: low..high,
        y: -0.5..rows + 0.5,
        names: [&forest.heading, ""],
        ticks: [5, 0],
        sides_pt: [names_pt, 12.0],
    };
    let mut chart = axes.draw(&below)?;
    let (bottom, top) = (-0.5, rows + 0.5);
    if let Some(margin) = forest.margin {
        chart.draw_series([Rectangle::new([(-margin, bottom), (margin, top)], BAND.filled())])?;
    }
    chart.draw_series([PathElement::new([(0.0, bottom), (0.0, top)], zero)])?;
    let style = anchored(LETTERS_PT, HPos::Right, VPos::Center);
    // The first stands at the top.
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
        chart.draw_series([Circle::new((row.value, y), pt(2.2), BLACK.filled())])?;
        let (_, middle) = chart.backend_coord(&(low, y));
        let (_, offset) = below.get_base_pixel();
        let name = fitted(&row.name, names_pt - 4.0, LETTERS_PT);
        below.draw(&Text::new(
            name,
            (pt(names_pt - 2.0), middle - offset),
            style.clone(),
        ))?;
    }
    Ok(())
}
