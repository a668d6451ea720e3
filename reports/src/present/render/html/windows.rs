//! Each value over time, a drawing for each scenario with all its windows on one axis, so that drift within
//! and between windows is seen.

use maud::{Markup, html};

use super::{
    plot::{Axis, Plot},
    swatch,
};
use crate::{
    analysis::{report::Report, sample::Sample, scenario::ScenarioReport},
    present::colours,
};

pub(super) fn draw(report: &Report) -> Markup {
    let all = report
        .samples
        .iter()
        .flat_map(|sample| sample.values.iter().copied());
    let quantity = &report.quantity;
    let Some(errors) = Axis::around(&quantity.with_file_unit(&quantity.name), all) else {
        return html! { p { "No window counts." } };
    };
    let drawings: Vec<Markup> = report
        .scenarios
        .iter()
        .filter_map(|scenario| one(report, scenario, &errors))
        .collect();
    html! {
        p { "The " (quantity.values_name()) " in the order of time; a line a window. All drawings have the same scale." }
        div .pairs { @for drawing in &drawings { (drawing) } }
    }
}

fn one(report: &Report, scenario: &ScenarioReport, errors: &Axis) -> Option<Markup> {
    let samples: Vec<&Sample> = report
        .samples
        .iter()
        .filter(|it| it.scenario == scenario.id)
        .collect();
    let periods: usize = samples.iter().map(|sample| sample.values.len()).sum();
    if periods == 0 {
        return None;
    }
    let plot = Plot {
        x: Axis::from(
            &format!("{} that counts", report.quantity.value_nouns()[0]),
            0.0..periods as f64 + 1.0,
        ),
        y: errors.clone(),
    };
    let mut before = 0;
    let mut lines = Vec::new();
    for (index, sample) in samples.iter().enumerate() {
        let points = sample.values.iter().enumerate();
        let points = points.map(|(period, error)| ((before + period + 1) as f64, *error));
        lines.push((index % 2 == 0, plot.line(points)));
        before += sample.values.len();
    }
    let name = format!("{} {}", scenario.id, scenario.slug);
    let curve = format!("curve s{}", colours::of(report, &scenario.id));
    Some(html! {
        figure {
            figcaption { (swatch(report, &scenario.id)) (name) ", windows " (numbers(&samples)) }
            (plot.draw(&format!("{} over time of {name}", report.quantity.name), &html! {
                @for (is_odd, points) in &lines {
                    @if *is_odd { polyline class=(curve) points=(points) {} }
                    @else { polyline class=(format!("{curve} even")) points=(points) {} }
                }
            }))
        }
    })
}

fn numbers(samples: &[&Sample]) -> String {
    let numbers: Vec<String> = samples.iter().map(|sample| sample.window.to_string()).collect();
    numbers.join(", ")
}
