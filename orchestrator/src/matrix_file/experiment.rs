//! The section `experiment:`, and which settings and axes a file with one can have. The function is [`read`].

use std::sync::Arc;

use record::{experiment::CommandExperiment, report_settings::ReportSettings};

use super::{
    axes::Axes,
    diagnostic::{Code, Diagnostic, Diagnostics},
    sections::{EXPERIMENT, REPORT, WORKLOAD},
    source::{Source, Span},
    spelling::{list, propose},
    sweep::{PARAMETERS, Role},
    tree::{Content, Entry, Node},
    typing,
};

/// The settings of the workload that every experiment has.
const SHARED: [&str; 3] = ["windows", "environments", "validity"];
/// Those that one with nodes has besides.
const OF_NODES: [&str; 3] = ["network", "capture", "realtime"];

/// Finds what is wrong with the section and what it rules out.
pub fn read(source: &Arc<Source>, tree: &Node, axes: &Axes, found: &mut Diagnostics) {
    let error = |code, span: Span, message: String| Diagnostic::error(source, code, span, message);
    let workload = tree.entry(WORKLOAD).map(|entry| &entry.value);
    if let Some(entry) = workload.and_then(|workload| workload.entry(EXPERIMENT)) {
        let message = "the experiment is a section of its own".to_owned();
        found.push(
            error(Code::UnknownKey, entry.key.span, message)
                .help("write `experiment:` beside `workload:`, not below it"),
        );
    }
    let section = tree.entry(EXPERIMENT).filter(|entry| !entry.value.is_null());
    if let Some(lists) = section
        .map(|entry| lists_of_values(&entry.value))
        .filter(|lists| !lists.is_empty())
    {
        for entry in lists {
            let name = &entry.key.value;
            let message = format!("the parameter `{name}` has one value, not a list");
            let help =
                format!("write one of them here, and all as an axis: `parameters.{name}: …` under `matrix:`");
            found.push(error(Code::WrongType, entry.value.span, message).help(help));
        }
        return;
    }
    let has_nodes = section.is_some_and(|entry| entry.value.entry("nodes").is_some());
    let had: Vec<&str> = SHARED
        .into_iter()
        .chain(OF_NODES.into_iter().filter(|_| has_nodes))
        .collect();
    let experiment = section.and_then(|entry| {
        let read = typing::read::<CommandExperiment>(source, &entry.value);
        read.map_err(|wrong| found.extend(wrong)).ok()
    });
    let assigned = axes.includes.iter().flat_map(|include| &include.values);
    let names = axes.axes.iter().map(|axis| &axis.name);
    let names = names.chain(assigned.map(|assignment| &assignment.axis));
    for axis in names.filter(|name| Role::of(&name.value) == Ok(Role::Sweep)) {
        let name = axis.value.as_str();
        let wrong = match (section, name.strip_prefix(PARAMETERS)) {
            (None, Some(_)) => Some((
                "there is no experiment that has parameters".to_owned(),
                "write the command and its `parameters:` under `experiment:`".to_owned(),
            )),
            // One that cannot be read says nothing of its parameters.
            (Some(_), Some(parameter)) => experiment.as_ref().and_then(|it| no_parameter(it, parameter)),
            (Some(_), None) if !is_among(name, &had) => Some(of_the_ball(name, &had)),
            _ => None,
        };
        if let Some((message, help)) = wrong {
            found.push(error(Code::UnknownKey, axis.span, message).help(help));
        }
    }
    if section.is_none() {
        return;
    }
    let report = tree.entry(REPORT).map(|entry| entry.value.entries());
    for entry in report.unwrap_or_default() {
        let key = entry.key.value.as_str();
        if ReportSettings::OF_THE_BALL.contains(&key) || key == "matters" {
            let message =
                format!("`report.{key}` is of the ball on the plate, which this file does not measure");
            let help = match key {
                "equivalence_margin" | "matters" => {
                    "write `equivalence_margin:` with a metric under `experiment:`, as a number in its unit"
                }
                _ => "take it out: what is compared is what `metrics:` under `experiment:` names",
            };
            found.push(error(Code::UnknownKey, entry.key.span, message).help(help));
        }
    }
    let others = workload.map(Node::entries).unwrap_or_default().iter();
    for entry in others.filter(|entry| !is_among(&entry.key.value, &had) && entry.key.value != EXPERIMENT) {
        let (message, help) = of_the_ball(&entry.key.value, &had);
        found.push(error(Code::UnknownKey, entry.key.span, message).help(help));
    }
}

/// The parameters that are written as lists: axes in the wrong place.
fn lists_of_values(section: &Node) -> Vec<&Entry> {
    let parameters = section.entry("parameters").map(|entry| entry.value.entries());
    let parameters = parameters.unwrap_or_default().iter();
    parameters
        .filter(|entry| matches!(entry.value.content, Content::List(_)))
        .collect()
}

fn is_among(path: &str, had: &[&str]) -> bool {
    let first = path.split('.').next().unwrap_or(path);
    had.contains(&first)
}

fn no_parameter(experiment: &CommandExperiment, parameter: &str) -> Option<(String, String)> {
    let known = experiment.parameters.keys().map(String::as_str);
    (!experiment.parameters.contains_key(parameter)).then(|| {
        let help = match experiment.parameters.is_empty() {
            true => format!("write it under `experiment:`, as in `parameters: {{{parameter}: 1}}`"),
            false => propose(parameter, known),
        };
        (format!("the experiment has no parameter `{parameter}`"), help)
    })
}

fn of_the_ball(path: &str, had: &[&str]) -> (String, String) {
    if is_among(path, &OF_NODES) {
        return (
            format!("`{path}` is of an emulated network, on which this experiment is not"),
            "take it out, or write `nodes:` in place of `run:`, which puts programs on the network"
                .to_owned(),
        );
    }
    (
        format!("`{path}` is a setting of the ball on the plate, which this file does not measure"),
        format!(
            "take it out: with `experiment:` the workload has {}",
            list(had.iter().copied())
        ),
    )
}

#[cfg(test)]
mod tests;
