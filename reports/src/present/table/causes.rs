//! Why the errors of pairs differ: the parts of late ticks, stalls, delays and losses, by simulation on mixtures of both platforms.

use super::{Table, texts};
use crate::{
    analysis::report::Report,
    explain::{ExplainedPair, Found, Line},
};

/// The table; none where nothing was explained.
pub(super) fn of(report: &Report) -> Option<Table> {
    (!report.causes.is_empty()).then(|| Table {
        id: "causes".to_owned(),
        title: "Why they differ".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("", false),
            (&report.quantity.heading("of the means"), true),
            ("of the distributions", true),
        ]),
        rows: report.causes.iter().flat_map(|pair| rows(report, pair)).collect(),
        notes: notes(report),
    })
}

fn rows(report: &Report, pair: &ExplainedPair) -> Vec<Vec<String>> {
    let signed = |value: f64| report.quantity.signed(value);
    let named = |cells: [String; 3]| {
        let letters = [pair.a.clone(), pair.b.clone()];
        Vec::from_iter(letters.into_iter().chain(cells))
    };
    let of_line = |line: Line<'_>| {
        let interval = line.interval_m.map_or_else(String::new, |[low, high]| {
            format!(" [{}, {}]", signed(low), signed(high))
        });
        named([
            line.words.to_owned(),
            format!("{}{interval}", signed(line.m)),
            line.d.map_or_else(|| "–".to_owned(), |d| format!("{d:+.3}")),
        ])
    };
    match &pair.found {
        Found::Explanation(explained) => explained.lines().into_iter().map(of_line).collect(),
        Found::Reason(_) => vec![named(["cannot be said", "–", "–"].map(str::to_owned))],
    }
}

fn notes(report: &Report) -> Vec<String> {
    let mut notes = Vec::new();
    for ExplainedPair { a, b, found } in &report.causes {
        match found {
            Found::Explanation(explained) => {
                notes.push(format!("{} {}", explained.sentence(), explained.method()));
                notes.extend(explained.remarks.iter().cloned());
            }
            Found::Reason(reason) => notes.push(format!("{a} and {b}: {reason}.")),
        }
    }
    notes.dedup();
    notes.push(
        "A part is by how much the simulated error changes if that factor alone is exchanged between the two platforms, as the mean over \
         all orders of exchanging them (Shapley's value). Unexplained: what is left of the measured difference. Of the distributions: \
         the same of the Kolmogorov-Smirnov distance of a period's errors from those of the first."
            .to_owned(),
    );
    notes
}
