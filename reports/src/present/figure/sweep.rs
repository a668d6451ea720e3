//! The metric against each swept setting, a line for the scenarios that are alike in all else.

use plotters::{
    element::{Circle, PathElement},
    series::LineSeries,
    style::Color,
};

use super::{
    Figure, FigureError, Kind, Layout,
    canvas::{About, Area, Axes, DrawingError, LEGEND_PT, Sample, colour, drawn, legend, line, pt},
};
use crate::{
    analysis::report::Report,
    present::sweep::{Line, Sweep},
};

/// Lines of a legend, beyond which lines have no names.
const MOST_NAMED: usize = 14;

/// Draws a figure for each swept setting.
pub(super) fn draw(report: &Report, layout: Layout) -> Result<Vec<Figure>, FigureError> {
    let sweeps = Sweep::all(report).into_iter();
    sweeps.map(|sweep| of(report, &sweep, layout)).collect()
}

fn of(report: &Report, sweep: &Sweep, layout: Layout) -> Result<Figure, FigureError> {
    let named: Vec<&Line> = sweep.lines.iter().filter(|line| !line.name.is_empty()).collect();
    let is_named = named.len() <= MOST_NAMED;
    let legend_lines = if is_named { named.len() } else { 0 };
    let unnamed = match is_named {
        true => "",
        false => " There are too many lines to name them.",
    };
    let about = About {
        kind: Kind::Sweep,
        of: of_file(&sweep.axis),
        caption: format!(
            "The mean {} of the windows against `{}`, a line for scenarios that are alike in all else. Bars: 95 % by Student's \
             distribution over windows, which takes them for independent.{unnamed}",
            report.quantity.name, sweep.axis
        ),
        is_simulated: report.is_simulated(),
        height_pt: 160.0 + LEGEND_PT * legend_lines as f64,
    };
    let name = report.quantity.heading(&report.quantity.name);
    drawn(about, layout, |area| on(area, sweep, &name, is_named))
}

/// An axis's name in a file's.
fn of_file(axis: &str) -> String {
    let plain = |letter: char| {
        if letter.is_ascii_alphanumeric() {
            letter
        } else {
            '-'
        }
    };
    axis.chars().map(plain).collect()
}

fn on(area: &Area<'_>, sweep: &Sweep, name: &str, is_named: bool) -> Result<(), DrawingError> {
    let coloured = || sweep.lines.iter().zip((0..).map(colour));
    let names: Vec<(Sample, &str)> = coloured()
        .filter(|(line, _)| is_named && !line.name.is_empty())
        .map(|(one, colour)| (Sample::Line(line(colour, 1.0)), one.name.as_str()))
        .collect();
    let below = legend(area, &names)?;
    let points = || sweep.lines.iter().flat_map(|line| &line.points);
    let ends = points().flat_map(|point| {
        let (low, high) = point.interval.unwrap_or((point.mean, point.mean));
        [low, high]
    });
    let axes = Axes {
        x: with_room(points().map(|point| point.x)),
        y: with_room(ends),
        names: [&sweep.heading, name],
        ticks: [6, 6],
        sides_pt: [38.0, 12.0],
    };
    let mut chart = axes.draw(&below)?;
    for (one, colour) in coloured() {
        let (curve, bar) = (line(colour, 1.0), line(colour, 0.6));
        let means = one.points.iter().map(|point| (point.x, point.mean));
        chart.draw_series(LineSeries::new(means, curve))?;
        for point in &one.points {
            let ends = point
                .interval
                .map(|(low, high)| [(point.x, low), (point.x, high)]);
            chart.draw_series(ends.map(|ends| PathElement::new(ends, bar)))?;
            chart.draw_series([Circle::new((point.x, point.mean), pt(1.6), colour.filled())])?;
        }
    }
    Ok(())
}

/// From the least to the largest, with some room on both sides.
fn with_room(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values {
        low = low.min(value);
        high = high.max(value);
    }
    let room = if high > low { 0.06 * (high - low) } else { 1.0 };
    low - room..high + room
}
