//! What the scenarios ran on: what differs between them side by side, and what all have in common once. With many scenarios, each by
//! itself.

use maud::{Markup, html};
use record::{
    field,
    run_directory::{EnvironmentRecord, RecordedPlatform},
};

use super::{MOST_SHOWN, left_out, prose};
use crate::analysis::{report::Report, scenario::ScenarioReport};

/// Scenarios that stand side by side.
const MOST_COLUMNS: usize = 8;

pub(super) fn draw(report: &Report) -> Markup {
    let scenarios = report.scenarios.iter();
    let described: Vec<_> = scenarios
        .filter_map(|scenario| Some((scenario, scenario.environment.as_ref()?)))
        .collect();
    html! {
        p { "What was different between the environments of a rejected pair stands among the tables." }
        @if described.is_empty() { p { "No scenario came so far as to have an environment." } }
        @for (scenario, environment) in &described {
            @for remark in environment.remarks() {
                p { strong { (scenario.id) } " " (scenario.slug) ": " (prose(&remark)) }
            }
        }
        @if (2..=MOST_COLUMNS).contains(&described.len()) {
            (side_by_side(&described))
        } @else {
            (left_out(described.len(), "report.json"))
            @for (scenario, environment) in described.iter().take(MOST_SHOWN) {
                details {
                    summary { (scenario.id) " " (scenario.slug) }
                    (list(&facts(environment)))
                }
            }
        }
    }
}

fn list(facts: &[(String, String)]) -> Markup {
    html! { dl { @for (name, value) in facts { dt { (name) } dd { (value) } } } }
}

/// A field that is not the same in all scenarios, with what each has.
type Differing = (String, Vec<Option<String>>);

fn side_by_side(described: &[(&ScenarioReport, &EnvironmentRecord)]) -> Markup {
    let all: Vec<Vec<(String, String)>> = described
        .iter()
        .map(|(_, environment)| facts(environment))
        .collect();
    let (common, differing) = compared(&all);
    html! {
        @if !differing.is_empty() {
            details open {
                summary { (differing.len()) " fields differ between scenarios" }
                div .wide tabindex="0" role="region" aria-label="Fields that differ between scenarios" {
                    table .environments {
                        thead { tr {
                            th scope="col" { "field" }
                            @for (scenario, _) in described { th scope="col" { (scenario.id) } }
                        } }
                        tbody { @for (name, values) in &differing { tr {
                            th scope="row" { (name) }
                            @for value in values { td { (value.as_deref().unwrap_or("–")) } }
                        } } }
                    }
                }
            }
        }
        details {
            summary { (common.len()) " fields are the same in all scenarios" }
            (list(&common))
        }
    }
}

/// The fields that all have with the same value, and the others.
fn compared(all: &[Vec<(String, String)>]) -> (Vec<(String, String)>, Vec<Differing>) {
    let mut names: Vec<&String> = all.iter().flatten().map(|(name, _)| name).collect();
    names.sort();
    names.dedup();
    let (mut common, mut differing) = (Vec::new(), Vec::new());
    for name in names {
        let of = |facts: &Vec<(String, String)>| {
            let fact = facts.iter().find(|(known, _)| known == name);
            fact.map(|(_, value)| value.clone())
        };
        let values: Vec<Option<String>> = all.iter().map(of).collect();
        match values.split_first() {
            Some((Some(first), rest)) if rest.iter().all(|value| value.as_ref() == Some(first)) => {
                common.push((name.clone(), first.clone()));
            }
            _ => differing.push((name.clone(), values)),
        }
    }
    (common, differing)
}

/// What an environment was, field by field, by its dotted path.
fn facts(environment: &EnvironmentRecord) -> Vec<(String, String)> {
    const PLATFORM: &str = field!(EnvironmentRecord, platform);
    let mut facts = vec![
        (
            field!(EnvironmentRecord, provider).to_owned(),
            environment.provider.clone(),
        ),
        (
            field!(EnvironmentRecord, host).to_owned(),
            environment.host.clone(),
        ),
    ];
    for (name, value) in &environment.facts {
        flatten(name, value, &mut facts);
    }
    for (name, value) in environment.platform.iter().flat_map(RecordedPlatform::fields) {
        flatten(&format!("{PLATFORM}.{name}"), value, &mut facts);
    }
    facts
}

fn flatten(path: &str, value: &serde_json::Value, facts: &mut Vec<(String, String)>) {
    match value {
        serde_json::Value::Null => {}
        serde_json::Value::Object(fields) => {
            for (name, field) in fields {
                flatten(&format!("{path}.{name}"), field, facts);
            }
        }
        other => facts.push((path.to_owned(), record::axis::axis_text(other))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_scenario_lacks_differs_and_what_all_have_stands_once() {
        let facts = |facts: &[(&str, &str)]| {
            let own = |(name, value): &(&str, &str)| ((*name).to_owned(), (*value).to_owned());
            facts.iter().map(own).collect::<Vec<_>>()
        };
        let (common, differing) = compared(&[
            facts(&[("host", "x"), ("load", "1"), ("image", "i")]),
            facts(&[("host", "x"), ("load", "2")]),
        ]);
        assert_eq!(common, facts(&[("host", "x")]));
        let names: Vec<&str> = differing.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["image", "load"]);
        assert_eq!(differing[0].1, [Some("i".to_owned()), None]);
    }

    #[test]
    fn facts_are_named_by_their_paths_and_nothing_stands_for_what_is_not_known() {
        let mut facts = Vec::new();
        let platform =
            serde_json::json!({"cpu": {"model": "x", "governor": null}, "load": 0.5, "list": [1, 2]});
        flatten("platform", &platform, &mut facts);
        let facts: Vec<_> = facts
            .iter()
            .map(|(name, value)| format!("{name}={value}"))
            .collect();
        assert_eq!(
            facts,
            ["platform.cpu.model=x", "platform.load=0.5", "platform.list=[1,2]"]
        );
    }
}
