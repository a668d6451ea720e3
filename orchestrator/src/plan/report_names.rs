//! Whether the scenarios, windows and axes are there that the report's settings name. The main function is [`check`].

use std::collections::BTreeSet;

use record::{report_settings::ReportSettings, run_directory::PlannedScenario};

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
