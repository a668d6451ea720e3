//! Two scenarios beside each other: the distribution functions of all their values with the largest distance marked, and
//! their histograms.

use maud::{Markup, html};

use super::{
    plot::{Axis, Plot},
    prose,
};
use crate::{
    figure::chosen_pairs,
    ks::{self, KsTest},
    report::{Report, ScenarioReport},
};

/// Which pairs are drawn.
const CHOSEN: &str = "`report.figures` names the pairs; left out, each control and each other scenario.";
/// Bars of a histogram.
const BARS: usize = 24;

pub(super) fn draw(report: &Report) -> Markup {
    let pairs: Vec<Markup> = chosen_pairs(report)
        .pairs
        .into_iter()
        .filter_map(|(a, b)| one(report, a, b))
        .collect();
    html! {
        @if pairs.is_empty() {
            p { "No pair of scenarios has data. " (prose(CHOSEN)) }
        } @else {
            p { "All values of two scenarios, in metres. " (prose(CHOSEN)) }
        }
        @for pair in &pairs { (pair) }
    }
}

fn one(report: &Report, a: &ScenarioReport, b: &ScenarioReport) -> Option<Markup> {
    let (x, y) = (values(report, a), values(report, b));
    // None without a value on each side.
    let test = ks::test(&x, &y).ok()?;
    let both = || x.iter().chain(&y).copied();
    let curves = Plot {
        x: Axis::around("error of a period (m)", both())?,
        y: Axis::from("share at most so large", 0.0..1.0),
    };
    let (bars_x, bars_y) = bars(&x, &y);
    let highest = bars_x
        .iter()
        .chain(&bars_y)
        .map(|bar| bar.share)
        .fold(0.0, f64::max);
    let histogram = Plot {
        x: Axis::around("error of a period (m)", both())?,
        y: Axis::from("share of the values", 0.0..highest * 1.05),
    };
    let tally = report.tally(&a.id, &b.id);
    let name = |it: &ScenarioReport| format!("{} {}", it.id, it.slug);
    Some(html! {
        h3 { (name(a)) " and " (name(b)) }
        p {
            span .first-name { "— " (a.id) ": " (x.len()) " values" } ", "
            span .second-name { "- - " (b.id) ": " (y.len()) " values" } ". "
            "Largest distance " (test.h) "/" (test.lcm) " = " (format!("{:.3}", test.d))
            @if let Some(at) = test.signed_d().1 { " at " (format!("{at:.5}")) " m" }
            ", of all values together, which are not independent: the tests are of windows."
            @if let Some(tally) = tally { " " (tally.rejected) " of " (tally.pairs) " window pairs rejected." }
        }
        div .pairs {
            (curves.draw(
                &format!("Distribution functions of {} and {}", a.id, b.id),
                &functions(&curves, &x, &y, &test)
            ))
            (histogram.draw(
                &format!("Histograms of {} and {}", a.id, b.id),
                &html! { (columns(&histogram, &bars_x, "first")) (columns(&histogram, &bars_y, "second")) }
            ))
        }
    })
}

/// In ascending order.
fn values(report: &Report, scenario: &ScenarioReport) -> Vec<f64> {
    let of_it = report
        .samples
        .iter()
        .filter(|sample| sample.scenario == scenario.id);
    let mut values: Vec<f64> = of_it.flat_map(|sample| sample.errors_m.iter().copied()).collect();
    values.sort_by(f64::total_cmp);
    values
}

fn functions(plot: &Plot, x: &[f64], y: &[f64], test: &KsTest) -> Markup {
    let place = test.signed_d().1;
    html! {
        polyline .curve.first points=(plot.line(steps(x))) {}
        polyline .curve.second points=(plot.line(steps(y))) {}
        @if let Some(at) = place {
            line .mark x1=(format!("{:.1}", plot.left(at))) x2=(format!("{:.1}", plot.left(at)))
                y1=(format!("{:.1}", plot.top(share(x, at)))) y2=(format!("{:.1}", plot.top(share(y, at)))) {}
            text x=(format!("{:.1}", plot.left(at) + 6.0)) y=(format!("{:.1}", plot.top((share(x, at) + share(y, at)) / 2.0))) {
                "D"
            }
        }
    }
}

/// The share of the values that are at most so large.
fn share(sorted: &[f64], at: f64) -> f64 {
    sorted.partition_point(|value| *value <= at) as f64 / sorted.len().max(1) as f64
}

/// The corners of an empirical distribution function.
fn steps(sorted: &[f64]) -> impl Iterator<Item = (f64, f64)> {
    let n = sorted.len().max(1) as f64;
    sorted
        .iter()
        .enumerate()
        .flat_map(move |(index, value)| [(*value, index as f64 / n), (*value, (index + 1) as f64 / n)])
}

/// One bar of a histogram.
struct Bar {
    from: f64,
    to: f64,
    share: f64,
}

/// Both histograms, with the same bars.
fn bars(x: &[f64], y: &[f64]) -> (Vec<Bar>, Vec<Bar>) {
    let all = || x.iter().chain(y).copied();
    let (low, high) = (
        all().fold(f64::INFINITY, f64::min),
        all().fold(f64::NEG_INFINITY, f64::max),
    );
    let width = (high - low).max(f64::MIN_POSITIVE) / BARS as f64;
    let of = |values: &[f64]| {
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
    };
    (of(x), of(y))
}

fn columns(plot: &Plot, bars: &[Bar], class: &str) -> Markup {
    html! {
        @for bar in bars.iter().filter(|bar| bar.share > 0.0) {
            rect class={ "bar " (class) }
                x=(format!("{:.1}", plot.left(bar.from))) width=(format!("{:.1}", plot.left(bar.to) - plot.left(bar.from)))
                y=(format!("{:.1}", plot.top(bar.share))) height=(format!("{:.1}", plot.top(0.0) - plot.top(bar.share))) {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_one_bar() {
        let x: Vec<f64> = (0..100).map(|it| f64::from(it) / 99.0).collect();
        let (of_x, of_y) = bars(&x, &[0.5]);
        let whole = |bars: &[Bar]| bars.iter().map(|bar| bar.share).sum::<f64>();
        assert!((whole(&of_x) - 1.0).abs() < 1e-12, "{}", whole(&of_x));
        assert!((whole(&of_y) - 1.0).abs() < 1e-12);
        // All alike: one bar has them.
        assert!((whole(&bars(&[0.1; 3], &[0.1]).0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_distribution_function_rises_from_nothing_to_all() {
        let steps: Vec<_> = steps(&[1.0, 2.0]).collect();
        assert_eq!(steps, [(1.0, 0.0), (1.0, 0.5), (2.0, 0.5), (2.0, 1.0)]);
        assert_eq!((share(&[1.0, 2.0], 1.0), share(&[1.0, 2.0], 0.9)), (0.5, 0.0));
    }
}
