//! The empirical distribution functions of two windows, with the Kolmogorov-Smirnov distance where it is attained; and the
//! same as an example of the test.

use plotters::{
    element::{Circle, PathElement, Text},
    series::{DashedLineSeries, LineSeries},
    style::{
        BLACK, RGBColor,
        text_anchor::{HPos, VPos},
    },
};

use super::{
    Figure, FigureError, Kind, Layout,
    canvas::{
        About, Area, Axes, DASH_PT, DrawingError, LETTERS_PT, Sample, anchored, drawn, legend, line, pt,
    },
    pairs::{self, WindowPair},
};
use crate::analysis::{comparison::Comparison, report::Report};

/// Draws the distribution functions of two windows.
pub(super) fn draw(report: &Report, pair: &WindowPair<'_>, layout: Layout) -> Result<Figure, FigureError> {
    let comparison = &pair.comparison;
    let [first, second] = pair.names();
    let [a, b] = pair.scenarios;
    let counts = report.tally(&a.id, &b.id).map_or_else(String::new, |tally| {
        format!(
            "; {} of {} window pairs are rejected",
            tally.rejected, tally.pairs
        )
    });
    let about = About {
        kind: Kind::Distributions,
        of: pair.name.clone(),
        caption: format!(
            "Distribution functions of the {} of {first}, and {second}: {}, n = {}, m = {}, p = {} ({}), {} at p < {}. {}{counts}.",
            report.quantity.values_name(),
            distance(comparison),
            comparison.test.n,
            comparison.test.m,
            p_value(comparison),
            comparison.test.method.name(),
            if comparison.rejected {
                "rejected"
            } else {
                "not rejected"
            },
            report.settings.alpha,
            pair.choice,
        ),
        is_simulated: pair.is_simulated(),
        height_pt: 180.0,
    };
    let curves = Curves {
        colours: pair.colours(report),
        samples: pair.samples(report),
        names: pair.names(),
        x: report.quantity.axis(),
        y: format!("share of {}", report.quantity.value_nouns()[1]),
        distance: distance(comparison),
    };
    drawn(about, layout, |area| curves.draw(area))
}

/// Draws an example of the test: of all pairs of windows of two scenarios the one of the median D. None if no two are compared.
pub(super) fn example(report: &Report, layout: Layout) -> Result<Option<Figure>, FigureError> {
    let Some(pair) = pairs::of_median_d(report) else {
        return Ok(None);
    };
    let [first, second] = pair.names();
    let about = About {
        kind: Kind::KsTest,
        of: String::new(),
        caption: format!(
            "The two-sample Kolmogorov-Smirnov test: D is the largest distance between the distribution functions \
             of two samples, here of {first}, and {second}, {} and {} {}. {}.",
            pair.comparison.test.n,
            pair.comparison.test.m,
            report.quantity.value_nouns()[1],
            pair.choice
        ),
        is_simulated: pair.is_simulated(),
        height_pt: 150.0,
    };
    let curves = Curves {
        colours: pair.colours(report),
        samples: pair.samples(report),
        names: [format!("F(x) of {first}"), format!("G(x) of {second}")],
        x: report
            .quantity
            .with_file_unit(match report.quantity.is_tracking_error {
                true => "x, the error of a period",
                false => &report.quantity.name,
            }),
        y: "F(x), G(x)".to_owned(),
        distance: "D".to_owned(),
    };
    drawn(about, layout, |area| curves.draw(area)).map(Some)
}

fn distance(comparison: &Comparison<'_>) -> String {
    let test = &comparison.test;
    format!("D = {}/{} = {:.3}", test.h, test.lcm, test.d)
}

/// A p-value in three digits, also where a double cannot hold it.
fn p_value(comparison: &Comparison<'_>) -> String {
    let test = &comparison.test;
    if test.p >= 0.001 {
        return format!("{:.3}", test.p);
    }
    let exponent = test.log10_p.floor();
    format!("{:.2}e{exponent}", 10_f64.powf(test.log10_p - exponent))
}

/// What is drawn: the samples in ascending order, and words.
struct Curves {
    colours: [RGBColor; 2],
    samples: [Vec<f64>; 2],
    names: [String; 2],
    x: String,
    y: String,
    distance: String,
}

impl Curves {
    fn draw(&self, area: &Area<'_>) -> Result<(), DrawingError> {
        let [x, y] = &self.samples;
        let [first, second] = self.colours.map(|colour| line(colour, 1.0));
        let [of_x, of_y] = self.names.each_ref().map(String::as_str);
        let below = legend(
            area,
            &[(Sample::Line(first), of_x), (Sample::Dashed(second), of_y)],
        )?;
        let (low, high) = range(&self.samples);
        let axes = Axes {
            x: low..high,
            y: 0.0..1.0,
            names: [&self.x, &self.y],
            ticks: [5, 5],
            sides_pt: [30.0, 12.0],
        };
        let mut chart = axes.draw(&below)?;
        chart.draw_series(LineSeries::new(steps(x, low, high), first))?;
        let (dash, gap) = (pt(DASH_PT.0), pt(DASH_PT.1));
        chart.draw_series(DashedLineSeries::new(steps(y, low, high), dash, gap, second))?;
        let (at, lower, upper) = self.widest();
        let mark = line(BLACK, 1.5);
        chart.draw_series([PathElement::new([(at, lower), (at, upper)], mark)])?;
        chart.draw_series([lower, upper].map(|share| Circle::new((at, share), pt(2.0), mark.filled())))?;
        // To the right both functions are above the lower end of the mark, to the left below the upper one: no curve is there.
        let (room, height) = ((high - low) * 0.02, 0.07);
        let (place, side) = match at < (low + high) / 2.0 {
            true => ((at + room, (lower - height).max(height)), HPos::Left),
            false => ((at - room, (upper + height).min(1.0 - height)), HPos::Right),
        };
        let style = anchored(LETTERS_PT, side, VPos::Center).color(&BLACK);
        let words = Text::new(self.distance.clone(), place, style);
        chart.draw_series([words])?;
        Ok(())
    }

    /// Where the distance is attained first, and the two functions there, the lower one first.
    fn widest(&self) -> (f64, f64, f64) {
        let at_most = |sample: &[f64], value: f64| {
            sample.partition_point(|other| *other <= value) as f64 / sample.len().max(1) as f64
        };
        let mut values = self.samples.concat();
        values.sort_by(f64::total_cmp);
        let mut widest = (0.0, 0.0, 0.0);
        for value in values {
            let [of_x, of_y] = self.samples.each_ref().map(|sample| at_most(sample, value));
            if (of_x - of_y).abs() > widest.2 - widest.1 {
                widest = (value, of_x.min(of_y), of_x.max(of_y));
            }
        }
        widest
    }
}

/// The values of both samples with some room on both sides.
pub(super) fn range(samples: &[Vec<f64>; 2]) -> (f64, f64) {
    let values = || samples.iter().flatten().copied();
    let low = values().fold(f64::INFINITY, f64::min);
    let high = values().fold(f64::NEG_INFINITY, f64::max);
    let room = if high > low {
        0.05 * (high - low)
    } else {
        0.05 * high.abs().max(1.0)
    };
    (low - room, high + room)
}

/// The corners of a sample's distribution function from `low` to `high`.
fn steps(sorted: &[f64], low: f64, high: f64) -> Vec<(f64, f64)> {
    let height = |count: usize| count as f64 / sorted.len().max(1) as f64;
    let mut corners = vec![(low, 0.0)];
    for (index, value) in sorted.iter().enumerate() {
        corners.extend([(*value, height(index)), (*value, height(index + 1))]);
    }
    corners.push((high, 1.0));
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distribution_function_rises_from_nothing_to_all() {
        let corners = [
            (0.0, 0.0),
            (1.0, 0.0),
            (1.0, 0.5),
            (2.0, 0.5),
            (2.0, 1.0),
            (3.0, 1.0),
        ];
        assert_eq!(steps(&[1.0, 2.0], 0.0, 3.0), corners);
    }
}
