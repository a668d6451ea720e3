//! What a reader must know before believing the tables, a sentence or two each. The function is [`remarks`].

use std::collections::BTreeSet;

use record::family::Family;

use crate::{
    analysis::{
        comparison::{LISTED, pairs_of},
        declaration,
        report::Report,
    },
    present::figure,
    statistics::ks::Procedure,
};

/// What a reader must know before believing the tables.
pub(super) fn remarks(report: &Report) -> Vec<String> {
    let mut remarks = report.reading.clone();
    let simulated: Vec<&str> = report
        .scenarios
        .iter()
        .filter(|s| s.is_simulated)
        .map(|s| s.id.as_str())
        .collect();
    if !simulated.is_empty() {
        remarks.push(format!(
            "SIMULATED, NOT MEASURED: {} made up by the provider `fake`. These numbers say nothing about any platform.",
            match simulated.as_slice() {
                [one] => format!("scenario {one} was"),
                many => format!("scenarios {} were", many.join(", ")),
            }
        ));
    }
    remarks.extend(declaration::remark(&report.declared, &report.settings));
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
    remarks
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
        _ => format!("The run directory of {}", unchecked.join(", ")),
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
    const MOST: usize = 6;
    let fields: BTreeSet<&str> = report
        .unlike
        .iter()
        .flat_map(|unlike| unlike.fields.iter().map(String::as_str))
        .collect();
    let fields = Vec::from_iter(fields).join(", ");
    let mut pairs: Vec<String> = report
        .unlike
        .iter()
        .take(MOST)
        .map(|unlike| format!("{} / {}", unlike.a, unlike.b))
        .collect();
    if let Some(more @ 1..) = report.unlike.len().checked_sub(MOST) {
        pairs.push(format!("{more} more"));
    }
    let family = match report.settings.family {
        Family::Pairs(_) => "`report.family` names some of them, so they are in it all the same",
        _ => "they are left out of the family; to have them in it, name them in `report.family`",
    };
    (!report.unlike.is_empty()).then(|| {
        format!(
            "NOT THE SAME EXPERIMENT: {} differ in {fields}. What is different of them is not the platform's alone. Their \
             counts are marked with *, and {family}.",
            pairs.join(", ")
        )
    })
}

/// Sizes at which no pair of windows can be rejected, if there are any among the comparisons.
fn hopeless(report: &Report) -> Option<(usize, usize, f64)> {
    let procedure = Procedure {
        method: report.settings.method,
        ..Procedure::default()
    };
    let mut sizes: Vec<usize> = report
        .samples
        .iter()
        .map(|sample| sample.errors_m.len())
        .collect();
    // The fewer values, the larger the smallest p-value: the two smallest samples have the largest.
    sizes.sort_unstable();
    let &[n, m] = sizes.first_chunk()?;
    let p = procedure.smallest_p(n, m);
    (p >= report.settings.alpha).then_some((n, m, p))
}
