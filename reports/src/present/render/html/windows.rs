//! The error of each period over time, a drawing for each scenario with all its windows on one axis, so that drift within
//! and between windows is seen.

use maud::{Markup, html};

use super::plot::{Axis, Plot};
use crate::analysis::{report::Report, sample::Sample, scenario::ScenarioReport};

pub(super) fn draw(report: &Report) -> Markup {
    let all = report
        .samples
        .iter()
        .flat_map(|sample| sample.errors_m.iter().copied());
    let Some(errors) = Axis::around("error (m)", all) else {
        return html! { p { "No window counts." } };
    };
    let drawings: Vec<Markup> = report
        .scenarios
        .iter()
        .filter_map(|scenario| one(report, scenario, &errors))
        .collect();
    html! {
        p { "The error of each period, in the order of time; a line a window. All drawings have the same scale." }
        div .pairs { @for drawing in &drawings { (drawing) } }
    }
}

fn one(report: &Report, scenario: &ScenarioReport, errors: &Axis) -> Option<Markup> {
    let samples: Vec<&Sample> = report
        .samples
        .iter()
        .filter(|it| it.scenario == scenario.id)
        .collect();
    let periods: usize = samples.iter().map(|sample| sample.errors_m.len()).sum();
    if periods == 0 {
        return None;
    }
    let plot = Plot {
        x: Axis::from("period that counts", 0.0..periods as f64 + 1.0),
        y: errors.clone(),
    };
    let mut before = 0;
    let mut lines = Vec::new();
    for (index, sample) in samples.iter().enumerate() {
        let points = sample.errors_m.iter().enumerate();
        let points = points.map(|(period, error)| ((before + period + 1) as f64, *error));
        lines.push((index % 2 == 0, plot.line(points)));
        before += sample.errors_m.len();
    }
    let name = format!("{} {}", scenario.id, scenario.slug);
    Some(html! {
        figure {
            figcaption { (name) ", windows " (numbers(&samples)) }
            (plot.draw(&format!("Error over time of {name}"), &html! {
                @for (is_odd, points) in &lines {
                    @if *is_odd { polyline .curve.first points=(points) {} }
                    @else { polyline .curve.second points=(points) {} }
                }
            }))
        }
    })
}

fn numbers(samples: &[&Sample]) -> String {
    let numbers: Vec<String> = samples.iter().map(|sample| sample.window.to_string()).collect();
    numbers.join(", ")
}
