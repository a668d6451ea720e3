//! What a reader must know before believing the tables, a sentence or two each. The function is [`remarks`].

use std::collections::{BTreeMap, BTreeSet};

use record::family::Family;
use statistics::ks::Procedure;

use crate::{
    analysis::{
        comparison::{LISTED, pairs_of},
        declaration,
        report::Report,
    },
    present::{figure, forest::unit, listing::listed},
    replay::{ScenarioReplay, WindowReplay},
};

/// What a reader must know before believing the tables.
pub(super) fn remarks(report: &Report) -> Vec<String> {
    // What was chosen when the data was known is said before anything else.
    let mut remarks = Vec::from_iter(declaration::remark(&report.declared, &report.settings));
    remarks.extend(report.reading.iter().cloned());
    let simulated: Vec<&str> = report
        .scenarios
        .iter()
        .filter(|s| s.is_simulated)
        .map(|s| s.id.as_str())
        .collect();
    if !simulated.is_empty() {
        remarks.push(format!(
            "SIMULATED, NOT MEASURED: {} computed. These numbers say nothing about any platform, but about a model of one.{}",
            match simulated.as_slice() {
                [one] => format!("scenario {one} was"),
                many => format!("scenarios {} were", listed(many)),
            },
            match report.scenarios.iter().any(|s| !s.is_simulated && s.within.is_some()) {
                false => "",
                true => " A pair of a measured and a simulated scenario compares a platform with a model.",
            }
        ));
    }
    let is_suspect = |scenario: &ScenarioReplay| !scenario.windows.iter().all(WindowReplay::is_the_same);
    for scenario in report.replays.iter().filter(|scenario| is_suspect(scenario)) {
        remarks.push(format!(
            "Windows of {} do not give their errors again from their own recorded times: see the table of replays.",
            scenario.id
        ));
    }
    remarks.extend(dependent_values(report));
    remarks.extend(dependent_windows(report));
    if let Some((n, m, p)) = hopeless(report) {
        remarks.push(format!(
            "With {n} and {m} values the smallest p-value is {p:.2e}, and α is {}: such windows are never told apart, \
             and a count of 0 says nothing. Measure more periods in a window.",
            report.settings.alpha
        ));
    }
    let pairs = pairs_of(report.samples.len());
    if pairs > LISTED {
        remarks.push(format!(
            "{pairs} comparisons were made and counted. They are not listed one by one, since they are more than \
             {LISTED}: `comparisons.csv` and `report.json` have none of them."
        ));
    }
    remarks.extend(figure::chosen(report).remarks);
    let names = report.settings.family.names();
    for name in names.filter(|name| !report.scenarios.iter().any(|s| s.id == *name || s.slug == *name)) {
        remarks.push(format!(
            "`report.family` names `{name}`, which is no scenario's letter or slug."
        ));
    }
    for (id, found) in &report.traffic.scenarios {
        for (window, reason) in &found.unreadable {
            remarks.push(format!(
                "The captures of {id}, window {window}, are left out of the tables of packets: {reason}."
            ));
        }
        for window in found.windows.iter().filter(|window| window.dropped > 0) {
            remarks.push(format!(
                "{} packets of {id}, window {}, were dropped before they were captured: as many may be taken for lost.",
                window.dropped, window.window
            ));
        }
    }
    remarks.extend(unlike_remark(report));
    remarks.extend(nodes_remarks(report));
    for (part, line) in report
        .parts
        .iter()
        .flat_map(|part| part.cut_lines.iter().map(move |line| (part, line)))
    {
        let journal = match report.parts.len() {
            1 => "events.jsonl".to_owned(),
            _ => format!("events.jsonl of {}", part.run),
        };
        remarks.push(format!(
            "Line {line} of {journal} is cut, as a crash leaves it; what it was to announce had not been done."
        ));
    }
    remarks.extend(unchecked_remark(report));
    remarks.extend(one_environment_remark(report));
    remarks.extend(too_few_draws(report));
    remarks
}

/// That a family is so large that the draws which a report has time for decide, and not the windows.
fn too_few_draws(report: &Report) -> Option<String> {
    let draws = report
        .contrasts
        .too_few_draws
        .filter(|_| report.replicates.is_none())?;
    Some(format!(
        "TOO LARGE A FAMILY: of {} pairs, each has {draws} permutations, and so few cannot reach α = {} after Holm's adjustment, whatever \
         the windows are. Declare fewer pairs with `report.family`.",
        report.contrasts.pairs.len(),
        report.settings.alpha
    ))
}

/// That what an environment has of its own cannot be told from what its platform has.
fn one_environment_remark(report: &Report) -> Option<String> {
    (!report.contrasts.pairs.is_empty() && report.replicates.is_none()).then(|| {
        "ONE ENVIRONMENT EACH: the windows of a scenario are contiguous and share its environment. A verdict holds for these \
         environments, as they were at that time: what one boot, container or hour has of its own counts as its platform's. To test \
         platforms, write `environments: N` below `workload:` in the matrix file, which measures each scenario in N environments made anew."
            .to_owned()
    })
}

/// Values within windows that are worth less than this share of so many independent ones are remarked on.
const WORTH: f64 = 0.5;

/// That values depend so much on their neighbours that the counts say little.
fn dependent_values(report: &Report) -> Option<String> {
    let found = report.scenarios.iter().filter_map(|scenario| {
        let dependence = scenario.within.as_ref()?.dependence.as_ref()?;
        Some((scenario, dependence))
    });
    let strong: Vec<_> = found
        .filter(|(_, dependence)| {
            // Of independent values the correlation is seldom further from 0 than 2.6 / √n.
            let is_seen = dependence.lag_one() > 2.6 / (dependence.n as f64).sqrt();
            is_seen && dependence.effective < WORTH * dependence.n as f64
        })
        .collect();
    let (worst, least) = strong
        .iter()
        .min_by(|(_, a), (_, b)| (a.effective / a.n as f64).total_cmp(&(b.effective / b.n as f64)))?;
    let letters: Vec<&str> = strong.iter().map(|(scenario, _)| scenario.id.as_str()).collect();
    Some(format!(
        "VALUES WITHIN WINDOWS DEPEND ON EACH OTHER in {}: of {} the {} values are worth {:.0} (lag 1 {:+.2}). The tests of two windows \
         take values for independent, and so reject windows that are alike far more often than α: the counts of Tables III to V are \
         too high. Read the verdicts, which have the {} as the unit.",
        listed(&letters),
        worst.id,
        least.n,
        least.effective,
        least.lag_one(),
        unit(report)
    ))
}

/// The level of the test of windows in a row: one report in a hundred without dependence has the remark.
const SERIAL_LEVEL: f64 = 0.01;

/// That successive windows resemble each other, so that windows are no independent measurements either.
fn dependent_windows(report: &Report) -> Option<String> {
    let serial = report.contrasts.serial.filter(|serial| serial.p < SERIAL_LEVEL)?;
    let consequence = match report.replicates {
        None => {
            "as where a machine drifts or remembers. Every p-value and interval here takes windows for independent, and is then too \
             small or too short. Measure each scenario in several environments, spread over time."
        }
        Some(_) => {
            "as where environments differ, or a machine drifts or remembers. The verdicts and the first table have environments as the \
             units, and allow for that; the tables that have windows as the units do not."
        }
    };
    Some(format!(
        "SUCCESSIVE WINDOWS RESEMBLE EACH OTHER: over all scenarios, {} windows correlate with the next one by {:+.2} (p = {:.4}), \
         {consequence}",
        serial.windows, serial.lag_one, serial.p
    ))
}

/// That nobody can say whether the run's files are as they were written.
fn unchecked_remark(report: &Report) -> Option<String> {
    let unchecked: Vec<&str> = report
        .parts
        .iter()
        .filter(|part| !part.is_checked)
        .map(|part| part.run.as_str())
        .collect();
    let whose = match report.parts.len() {
        1 => "The run directory".to_owned(),
        _ => format!("The run directory of {}", listed(&unchecked)),
    };
    (!unchecked.is_empty()).then(|| {
        format!(
            "{whose} is of an earlier version of matrix and has no checksums of its manifest, plan, journal, environments and \
             window records: whether they are as they were written is not known."
        )
    })
}

/// That not all scenarios ran the same experiment, and what the report makes of it.
fn unlike_remark(report: &Report) -> Option<String> {
    let fields: BTreeSet<&str> = report
        .setup_differences
        .iter()
        .flat_map(|unlike| unlike.fields.iter().map(String::as_str))
        .collect();
    let fields = Vec::from_iter(fields).join(", ");
    let pairs = report.setup_differences.iter();
    let pairs = listed(pairs.map(|unlike| format!("{} / {}", unlike.a, unlike.b)));
    let family = match report.settings.family {
        Family::Pairs(_) => "`report.family` names some of them, so they are in it all the same",
        _ => "they are left out of the family; to have them in it, name them in `report.family`",
    };
    (!report.setup_differences.is_empty()).then(|| {
        format!(
            "NOT THE SAME EXPERIMENT: {pairs} differ in {fields}. What is different of them is not the platform's alone. Their \
             counts are marked with *, and {family}."
        )
    })
}

/// Of each host that is a cluster, that its scenarios were measured on different nodes.
fn nodes_remarks(report: &Report) -> Vec<String> {
    let mut by_host: BTreeMap<&str, BTreeMap<&str, Vec<&str>>> = BTreeMap::new();
    for scenario in &report.scenarios {
        let Some(environment) = &scenario.environment else {
            continue;
        };
        if let Some(node) = environment.node() {
            let nodes = by_host.entry(&environment.host).or_default();
            nodes.entry(node).or_default().push(&scenario.id);
        }
    }
    let several = by_host.into_iter().filter(|(_, nodes)| nodes.len() > 1);
    several
        .map(|(host, nodes)| {
            let nodes: Vec<String> = nodes
                .into_iter()
                .map(|(node, ids)| format!("{node} ({})", listed(&ids)))
                .collect();
            format!(
                "DIFFERENT NODES: the scenarios of host {host} ended on {}. A difference between two of different nodes may be one \
                 between the nodes.",
                nodes.join(" and ")
            )
        })
        .collect()
}

/// Sizes at which no pair of windows can be rejected, if there are any among the comparisons.
fn hopeless(report: &Report) -> Option<(usize, usize, f64)> {
    let procedure = Procedure {
        method: report.settings.method,
        ..Procedure::default()
    };
    let mut sizes: Vec<usize> = report.samples.iter().map(|sample| sample.values.len()).collect();
    // The fewer values, the larger the smallest p-value: the two smallest samples have the largest.
    sizes.sort_unstable();
    let &[n, m] = sizes.first_chunk()?;
    let p = procedure.smallest_p(n, m);
    (p >= report.settings.alpha).then_some((n, m, p))
}
