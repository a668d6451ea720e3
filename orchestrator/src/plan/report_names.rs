//! Whether the scenarios, windows and axes are there that the report's settings name. The main function is [`check`].

use std::collections::{BTreeMap, BTreeSet};

use record::{
    experiment::Compare,
    report_settings::{Amount, HOST, ReportSettings, TRACKING_ERROR, Tolerance},
    run_directory::PlannedScenario,
};

use crate::matrix_file::{Code, Diagnostic, Diagnostics, Places, list, propose};

/// Checks all of them.
pub(super) fn check(
    places: &Places<'_>,
    report: &ReportSettings,
    scenarios: &[PlannedScenario],
    found: &mut Diagnostics,
) {
    check_figures(places, report, scenarios, found);
    check_family(places, report, scenarios, found);
    check_baseline(places, report, scenarios, found);
    check_expectations(places, report, scenarios, found);
}

/// The metrics of which something is expected, in which scenarios.
fn check_expectations(
    places: &Places<'_>,
    report: &ReportSettings,
    scenarios: &[PlannedScenario],
    found: &mut Diagnostics,
) {
    let metrics: BTreeMap<&str, Option<Compare>> = scenarios
        .iter()
        .flat_map(|scenario| match &scenario.settings.experiment {
            None => vec![(TRACKING_ERROR, None)],
            Some(experiment) => {
                let metrics = experiment.metrics.iter();
                metrics
                    .map(|metric| (metric.name.as_str(), Some(metric.compare)))
                    .collect()
            }
        })
        .collect();
    for (metric, expected) in &report.expect {
        let path = format!("report.expect.{metric}");
        let mut wrong = |span, message: String, help: String| {
            found.push(Diagnostic::error(places.source, Code::InvalidValue, span, message).help(help));
        };
        match metrics.get(metric.as_str()) {
            None => {
                let message = format!("there is no metric `{metric}` to expect something of");
                wrong(
                    places.of_key(&path),
                    message,
                    propose(metric, metrics.keys().copied()),
                );
                continue;
            }
            Some(Some(Compare::Identical)) => {
                let message = format!("`{metric}` is compared byte for byte, and has no mean");
                wrong(
                    places.of_key(&path),
                    message,
                    "leave it out, or write `compare: ks` with the metric".to_owned(),
                );
                continue;
            }
            Some(_) => {}
        }
        let is_ball = metric == TRACKING_ERROR && metrics[TRACKING_ERROR].is_none();
        for expectation in &expected.0 {
            let span = places.of(&path);
            let is_length = |amount: Amount| matches!(amount, Amount::Length(_));
            let tolerances = [expectation.below, expectation.above].into_iter().flatten();
            let amounts = tolerances.filter_map(|tolerance| match tolerance {
                Tolerance::Share(_) => None,
                Tolerance::Amount(amount) => Some(amount),
            });
            let other = std::iter::once(expectation.value)
                .chain(amounts)
                .find(|amount| is_length(*amount) != is_ball);
            match other {
                Some(amount) if is_ball => wrong(
                    span,
                    format!("`{amount}` has no unit, and `error` is a length"),
                    format!("write `{amount}mm` or whatever it is"),
                ),
                Some(amount) => wrong(
                    span,
                    format!("`{amount}` is a length, and `{metric}` has a unit of its own"),
                    "write the number alone, in the metric's unit".to_owned(),
                ),
                None => {}
            }
            if expectation.below.is_none() && expectation.above.is_none() {
                let message = format!("`{metric}` may be anything: this bounds nothing");
                wrong(span, message, "add `above: 5%`, `below: 5%` or both".to_owned());
            }
            if !scenarios.iter().any(|scenario| expectation.is_of(scenario)) {
                let wanted = expectation.scenarios.iter();
                let wanted: Vec<_> = wanted.map(|(key, value)| format!("{key}: {value}")).collect();
                let message = format!("no scenario has `{}`", wanted.join(", "));
                let axes = scenarios.iter().flat_map(|it| it.axes.keys().map(String::as_str));
                let keys: BTreeSet<&str> = axes.chain([HOST]).collect();
                wrong(
                    span,
                    message,
                    format!("write values of {}, as the plan prints them", list(keys)),
                );
            }
        }
    }
}

/// The scenarios and windows that are to be drawn.
pub(crate) fn check_figures(
    places: &Places<'_>,
    report: &ReportSettings,
    scenarios: &[PlannedScenario],
    found: &mut Diagnostics,
) {
    const PATH: &str = "report.figures";
    for side in report.figures.iter().flat_map(|pair| pair.sides()) {
        let text = side.to_string();
        let Some(scenario) = named(scenarios, &side.name) else {
            found.push(no_scenario(places, PATH, &text, &side.name, "draw", scenarios));
            continue;
        };
        let windows = scenario.settings.all_windows();
        if side.window.is_some_and(|window| window > windows) {
            let message = format!("`{text}` is none of the {windows} windows of `{}`", side.name);
            let span = places.of_item(PATH, &text);
            found.push(
                Diagnostic::error(places.source, Code::UnknownValue, span, message).help(format!(
                    "write a window from 1 to {windows}, such as `{}/{windows}`",
                    side.name
                )),
            );
        }
    }
}

/// The scenarios that are asked about.
pub(crate) fn check_family(
    places: &Places<'_>,
    report: &ReportSettings,
    scenarios: &[PlannedScenario],
    found: &mut Diagnostics,
) {
    for name in report
        .family
        .names()
        .filter(|name| named(scenarios, name).is_none())
    {
        found.push(no_scenario(
            places,
            "report.family",
            name,
            name,
            "compare",
            scenarios,
        ));
    }
}

fn named<'a>(scenarios: &'a [PlannedScenario], name: &str) -> Option<&'a PlannedScenario> {
    scenarios
        .iter()
        .find(|scenario| scenario.id == name || scenario.slug == name)
}

fn no_scenario(
    places: &Places<'_>,
    path: &str,
    text: &str,
    name: &str,
    to: &str,
    scenarios: &[PlannedScenario],
) -> Diagnostic {
    let slugs = scenarios.iter().map(|scenario| scenario.slug.as_str());
    let message = format!("there is no scenario `{name}` to {to}");
    Diagnostic::error(
        places.source,
        Code::UnknownValue,
        places.of_item(path, text),
        message,
    )
    .help(propose(name, slugs))
}

/// The axes and values of the baseline scenarios.
pub(crate) fn check_baseline(
    places: &Places<'_>,
    report: &ReportSettings,
    scenarios: &[PlannedScenario],
    found: &mut Diagnostics,
) {
    for (axis, value) in &report.baseline {
        let path = format!("report.baseline.{axis}");
        let with_axis: Vec<_> = scenarios
            .iter()
            .filter_map(|scenario| scenario.axis(axis))
            .collect();
        if with_axis.is_empty() {
            let axes = scenarios
                .iter()
                .flat_map(|scenario| scenario.axes.keys().map(String::as_str));
            let message = format!("no scenario has an axis `{axis}`");
            found.push(
                Diagnostic::error(places.source, Code::UnknownKey, places.of_key(&path), message)
                    .help(propose(axis, axes.collect::<BTreeSet<_>>())),
            );
        } else if !with_axis.contains(value) {
            let values: BTreeSet<_> = with_axis.iter().map(String::as_str).collect();
            let message = format!("no scenario has `{axis}: {value}`: the baseline is empty");
            found.push(
                Diagnostic::warning(places.source, Code::UnknownValue, places.of(&path), message).help(
                    format!(
                        "Tables IV and V need a baseline scenario; there are {}",
                        list(values)
                    ),
                ),
            );
        }
    }
}
