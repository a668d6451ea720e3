//! What is expected of scenarios, beside what they are.

use super::{Table, contrasts::estimate, texts};
use crate::{
    analysis::{expectation::ExpectedMean, report::Report},
    present::axes::Axes,
};

/// The table; none where nothing is expected.
pub(super) fn of(report: &Report) -> Option<Table> {
    let axes = Axes::of(&report.scenarios);
    let row = |it: &ExpectedMean| {
        let scenario = report
            .scenarios
            .iter()
            .find(|scenario| scenario.id == it.scenario);
        let limit =
            |limit: Option<f64>| limit.map_or_else(|| "–".to_owned(), |limit| report.quantity.digits(limit));
        let verdict = match it.miss() {
            None => "as expected",
            Some(miss) if miss.is_sure => "not as expected",
            Some(_) => "not as expected, within the spread of windows",
        };
        vec![
            it.scenario.clone(),
            scenario.map(|scenario| axes.label(scenario)).unwrap_or_default(),
            it.windows.to_string(),
            estimate(&it.mean, |value| report.quantity.digits(value)),
            limit(it.low),
            limit(it.high),
            verdict.to_owned(),
        ]
    };
    (!report.expected.is_empty()).then(|| Table {
        id: "expected-values".to_owned(),
        title: "What is expected of scenarios".to_owned(),
        columns: texts(&[
            ("", false),
            ("scenario", false),
            ("windows", true),
            (&report.quantity.heading("mean"), true),
            ("at least", true),
            ("at most", true),
            ("", false),
        ]),
        rows: report.expected.iter().map(row).collect(),
        notes: vec![
            "Mean: of the means of the windows that count, with an interval of 95 % over windows (Student). A mean beyond a limit of \
             `report.expect` ends `matrix run` and `matrix report` with exit code 7, also where the interval reaches over the limit: \
             more or longer windows then tell."
                .to_owned(),
        ],
    })
}
