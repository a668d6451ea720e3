//! The histograms of two windows, with the same bars.

use plotters::{
    element::{PathElement, Rectangle},
    prelude::{Color, RGBColor},
};

use super::{
    Figure, FigureError, Kind, Layout,
    canvas::{About, Area, Axes, DrawingError, Sample, drawn, legend, line, pale},
    distributions::range,
    pairs::WindowPair,
};
use crate::analysis::report::Report;

/// Bars of a histogram.
const BARS: usize = 24;

/// Draws the histograms of two windows.
pub(super) fn draw(report: &Report, pair: &WindowPair<'_>, layout: Layout) -> Result<Figure, FigureError> {
    let quantity = &report.quantity;
    let samples = pair.samples(report);
    let [first, second] = pair.names();
    let means = samples
        .each_ref()
        .map(|sample| sample.iter().sum::<f64>() / sample.len().max(1) as f64);
    let about = About {
        kind: Kind::Histogram,
        of: pair.name.clone(),
        caption: format!(
            "Histograms of the {} of {first} ({}, mean {}), and {second} ({}, mean {}), with the same bars. {}.",
            quantity.values_name(),
            quantity.count(samples[0].len()),
            quantity.text(means[0]),
            quantity.count(samples[1].len()),
            quantity.text(means[1]),
            pair.choice
        ),
        is_simulated: pair.is_simulated(),
        height_pt: 165.0,
    };
    let (axis, share) = (quantity.axis(), format!("share of {}", quantity.value_nouns()[1]));
    drawn(about, layout, |area| {
        draw_bars(
            area,
            &samples,
            &[&first, &second],
            [&axis, &share],
            pair.colours(report),
        )
    })
}

fn draw_bars(
    area: &Area<'_>,
    samples: &[Vec<f64>; 2],
    names: &[&str; 2],
    axes: [&str; 2],
    [first, second]: [RGBColor; 2],
) -> Result<(), DrawingError> {
    let fill = pale(first);
    let (edge, outline) = (line(first, 0.5), line(second, 1.25));
    let below = legend(
        area,
        &[
            (Sample::Filled(fill, edge), names[0]),
            (Sample::Line(outline), names[1]),
        ],
    )?;
    let histograms = bars(samples);
    let highest = histograms
        .iter()
        .flatten()
        .map(|bar| bar.share)
        .fold(0.0, f64::max);
    let (low, high) = range(samples);
    let drawn = Axes {
        x: low..high,
        y: 0.0..highest * 1.05,
        names: axes,
        ticks: [5, 5],
        sides_pt: [34.0, 12.0],
    };
    let mut chart = drawn.draw(&below)?;
    let [first, second] = &histograms;
    for bar in first.iter().filter(|bar| bar.share > 0.0) {
        let corners = [(bar.from, 0.0), (bar.to, bar.share)];
        chart.draw_series([
            Rectangle::new(corners, fill.filled()),
            Rectangle::new(corners, edge),
        ])?;
    }
    let ends = second.first().zip(second.last());
    let start = ends.map(|(first, _)| (first.from, 0.0));
    let tops = second
        .iter()
        .flat_map(|bar| [(bar.from, bar.share), (bar.to, bar.share)]);
    let end = ends.map(|(_, last)| (last.to, 0.0));
    let corners: Vec<(f64, f64)> = start.into_iter().chain(tops).chain(end).collect();
    chart.draw_series([PathElement::new(corners, outline)])?;
    Ok(())
}

/// One bar of a histogram.
struct Bar {
    from: f64,
    to: f64,
    share: f64,
}

/// Both histograms.
fn bars(samples: &[Vec<f64>; 2]) -> [Vec<Bar>; 2] {
    let all = || samples.iter().flatten().copied();
    let (low, high) = (
        all().fold(f64::INFINITY, f64::min),
        all().fold(f64::NEG_INFINITY, f64::max),
    );
    // Values that are all alike have one bar about them, which is to be seen.
    let width = match high > low {
        true => (high - low) / BARS as f64,
        false => high.abs().max(1.0) / 1000.0,
    };
    samples.each_ref().map(|values| {
        (0..BARS)
            .map(|bar| {
                let (from, to) = (low + bar as f64 * width, low + (bar + 1) as f64 * width);
                // The largest value belongs to the last bar.
                let is_within = |value: &&f64| **value >= from && (**value < to || bar + 1 == BARS);
                Bar {
                    from,
                    to,
                    share: values.iter().filter(is_within).count() as f64 / values.len().max(1) as f64,
                }
            })
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_one_bar() {
        let x: Vec<f64> = (0..100).map(|it| f64::from(it) / 99.0).collect();
        let whole = |bars: &[Bar]| bars.iter().map(|bar| bar.share).sum::<f64>();
        for samples in [
            [x, vec![0.5]],
            [vec![0.1; 3], vec![0.1]],
            [vec![0.0; 3], vec![0.0]],
        ] {
            for histogram in bars(&samples) {
                assert!((whole(&histogram) - 1.0).abs() < 1e-12, "{}", whole(&histogram));
            }
        }
    }
}
