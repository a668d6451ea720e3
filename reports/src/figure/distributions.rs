//! The empirical distribution functions of two windows, with the Kolmogorov-Smirnov distance where it is attained.
//!
//! Two scenarios have many pairs of windows. The pair shown is the one whose distance is the median of all, so that the
//! figure is neither the best case nor the worst.

use plotters::{
    chart::ChartBuilder,
    prelude::{BLACK, Circle, Color, LineSeries, PathElement, Text},
    style::{IntoFont, ShapeStyle},
};

use super::{Area, DrawingError, FIRST, FRAME, Figure, FigureError, GRID, SECOND, drawn, label};
use crate::{
    comparison::Comparison,
    report::{Report, ScenarioReport},
};

pub(super) fn draw(
    report: &Report,
    a: &ScenarioReport,
    b: &ScenarioReport,
) -> Result<Option<Figure>, FigureError> {
    let Some((comparison, tally)) = median_comparison(report, a, b).zip(report.tally(&a.id, &b.id)) else {
        return Ok(None);
    };
    // As the comparison has them, which may be the other way round.
    let (a, b) = if *comparison.a == *a.id { (a, b) } else { (b, a) };
    let sorted = |scenario: &str, window| {
        let sample = report
            .samples
            .iter()
            .find(|s| s.scenario == scenario && s.window == window);
        let mut errors_m = sample.map(|sample| sample.errors_m.clone()).unwrap_or_default();
        errors_m.sort_by(f64::total_cmp);
        errors_m
    };
    let pair = Pair {
        x: sorted(&comparison.a, comparison.a_window),
        y: sorted(&comparison.b, comparison.b_window),
        names: [
            format!("{} {}, window {}", a.id, a.slug, comparison.a_window),
            format!("{} {}, window {}", b.id, b.slug, comparison.b_window),
        ],
        axis: format!("error of a period, {} (m)", report.settings.metric.formula()),
        distance: format!(
            "D = {}/{} = {:.3}",
            comparison.test.h, comparison.test.lcm, comparison.test.d
        ),
    };
    let verdict = if comparison.rejected {
        "rejected"
    } else {
        "not rejected"
    };
    let caption = [
        format!("{} {} against {} {}", a.id, a.slug, b.id, b.slug),
        format!(
            "n = {}, m = {}, p = {} ({}), {verdict} at p < {}",
            comparison.test.n,
            comparison.test.m,
            p_value(comparison),
            comparison.test.method.name(),
            report.settings.alpha
        ),
        format!(
            "The pair of the median D; {} of {} window pairs rejected",
            tally.rejected, tally.pairs
        ),
    ];
    let name = format!("cdf-{}-{}.svg", a.id, b.id);
    let is_simulated = a.is_simulated || b.is_simulated;
    drawn(name, (820, 560), &caption, is_simulated, |area| pair.draw(area)).map(Some)
}

fn median_comparison<'a>(
    report: &'a Report,
    a: &ScenarioReport,
    b: &ScenarioReport,
) -> Option<&'a Comparison> {
    let is_of_both = |c: &&Comparison| (*c.a == *a.id && *c.b == *b.id) || (*c.a == *b.id && *c.b == *a.id);
    let mut comparisons: Vec<&Comparison> = report.comparisons.iter().filter(is_of_both).collect();
    comparisons.sort_by(|first, second| first.test.d.total_cmp(&second.test.d));
    comparisons.get(comparisons.len() / 2).copied()
}

/// A p-value in three digits, also where a double cannot hold it.
fn p_value(comparison: &Comparison) -> String {
    let test = &comparison.test;
    if test.p >= 0.001 {
        return format!("{:.3}", test.p);
    }
    let exponent = test.log10_p.floor();
    format!("{:.2}e{exponent}", 10_f64.powf(test.log10_p - exponent))
}

/// What is drawn: the samples in ascending order, and words.
struct Pair {
    x: Vec<f64>,
    y: Vec<f64>,
    names: [String; 2],
    axis: String,
    distance: String,
}

impl Pair {
    fn draw(&self, area: &Area<'_>) -> Result<(), DrawingError> {
        let (low, high) = self.range();
        let mut chart = ChartBuilder::on(area)
            .margin(14)
            .x_label_area_size(44)
            .y_label_area_size(56)
            .build_cartesian_2d(low..high, 0.0..1.0)?;
        chart
            .configure_mesh()
            .light_line_style(BLACK.mix(0.0))
            .bold_line_style(GRID)
            .x_desc(self.axis.as_str())
            .y_desc("share of periods with at most this error")
            .label_style(label())
            .axis_desc_style(label())
            .draw()?;
        for ((sample, name), colour) in [&self.x, &self.y]
            .into_iter()
            .zip(&self.names)
            .zip([FIRST, SECOND])
        {
            let style = ShapeStyle::from(colour).stroke_width(2);
            chart
                .draw_series(LineSeries::new(steps(sample, low, high), style))?
                .label(name.as_str())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
        }
        let (at, lower, upper) = self.widest();
        let mark = ShapeStyle::from(BLACK).stroke_width(3);
        chart.draw_series([PathElement::new([(at, lower), (at, upper)], mark)])?;
        chart.draw_series([lower, upper].map(|share| Circle::new((at, share), 4, mark.filled())))?;
        // The words stand on the side that has more room.
        let words_at = if at < (low + high) / 2.0 {
            at + (high - low) * 0.015
        } else {
            at - (high - low) * 0.23
        };
        let words = Text::new(
            self.distance.clone(),
            (words_at, (lower + upper) / 2.0),
            ("sans-serif", 15).into_font().color(&BLACK),
        );
        chart.draw_series([words])?;
        chart
            .configure_series_labels()
            .position(plotters::chart::SeriesLabelPosition::LowerRight)
            .background_style(plotters::prelude::WHITE)
            .border_style(FRAME)
            .label_font(label())
            .draw()
    }

    /// The values with some room on both sides.
    fn range(&self) -> (f64, f64) {
        let values = || self.x.iter().chain(&self.y).copied();
        let low = values().fold(f64::INFINITY, f64::min);
        let high = values().fold(f64::NEG_INFINITY, f64::max);
        let room = if high > low {
            0.05 * (high - low)
        } else {
            0.05 * high.abs().max(1.0)
        };
        (low - room, high + room)
    }

    /// Where the distance is attained first, and the two functions there, the lower one first.
    fn widest(&self) -> (f64, f64, f64) {
        let at_most = |sample: &[f64], value: f64| {
            sample.partition_point(|other| *other <= value) as f64 / sample.len().max(1) as f64
        };
        let heights = |value: f64| (at_most(&self.x, value), at_most(&self.y, value));
        let mut values: Vec<f64> = self.x.iter().chain(&self.y).copied().collect();
        values.sort_by(f64::total_cmp);
        let mut widest = (0.0, 0.0, 0.0);
        for value in values {
            let (of_x, of_y) = heights(value);
            if (of_x - of_y).abs() > widest.2 - widest.1 {
                widest = (value, of_x.min(of_y), of_x.max(of_y));
            }
        }
        widest
    }
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
