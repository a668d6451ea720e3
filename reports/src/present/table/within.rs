//! What the values within the windows have to do with each other, and which windows are not steady.

use record::report_settings::WarmUp;
use statistics::stationarity::CHANGE_LEVEL;

use super::{NO_DATA, Table, texts};
use crate::{
    analysis::{
        report::Report,
        within::{Look, WithinWindows},
    },
    present::axes::Axes,
};

pub(super) fn of(report: &Report) -> Table {
    let axes = Axes::of(&report.scenarios);
    let rows = report
        .scenarios
        .iter()
        .map(|scenario| {
            let mut row = vec![scenario.id.clone(), axes.label(scenario)];
            let Some(within) = &scenario.within else {
                row.extend(["–", "–", "–", NO_DATA].map(str::to_owned));
                return row;
            };
            match &within.dependence {
                Some(found) => row.extend([
                    format!("{:+.2}", found.lag_one()),
                    format!("{:.1}", found.time),
                    format!("{:.0} of {}", found.effective, found.n),
                ]),
                None => row.extend(["–", "–", "–"].map(str::to_owned)),
            }
            row.push(match within.is_looked_at() {
                true => within.unsteady.len().to_string(),
                false => "–".to_owned(),
            });
            row
        })
        .collect();
    let [_, values] = report.quantity.value_nouns();
    let of_a_value = match report.quantity.is_tracking_error {
        true => "a period's error with the next one's",
        false => "a value with the next one",
    };
    let to_do = match (report.quantity.is_tracking_error, report.settings.warm_up) {
        (false, _) => "Nothing is cut for it.",
        (true, WarmUp::Flag) => "Nothing is cut for it: `report.warm_up: cut` does that.",
        (true, WarmUp::Cut) => "What warms up was cut (`report.warm_up`); a change of level is not.",
    };
    let mut notes = vec![format!(
        "Lag 1: correlation of {of_a_value}. Time: autocorrelation time in {values}, by Geyer's \
         initial positive sequence; so many values are worth one. Unsteady: windows that warm up beyond what is left out \
         (MSER) or whose level changes (CUSUM, p < {CHANGE_LEVEL}, so about one in a hundred steady ones too). {}",
        to_do
    )];
    for scenario in &report.scenarios {
        let unseen = scenario.within.iter().flat_map(unseen);
        notes.extend(unseen.map(|unseen| format!("{}: {unseen}", scenario.id)));
        for (window, periods) in scenario.within.iter().flat_map(|within| &within.cut) {
            let id = &scenario.id;
            let were = if *periods == 1 { "was" } else { "were" };
            let periods = report.quantity.count(periods);
            notes.push(format!(
                "{id} window {window}: warmed up, {periods} more {were} cut."
            ));
        }
        for (window, found) in scenario.within.iter().flat_map(|within| &within.unsteady) {
            let id = &scenario.id;
            notes.extend(
                found
                    .warm_up
                    .map(|periods| report.quantity.count(format!("{periods:.1}")))
                    .map(|periods| format!("{id} window {window}: warms up for {periods}.")),
            );
            notes.extend(found.change.map(|change| {
                format!(
                    "{id} window {window}: its level changes by {} after {}, p = {:.4}.",
                    report.quantity.signed_text(change.by),
                    report.quantity.count(change.after),
                    change.p
                )
            }));
        }
    }
    Table {
        id: "within-the-windows".to_owned(),
        title: "Within the windows".to_owned(),
        columns: texts(&[
            ("", false),
            ("scenario", false),
            ("lag 1", true),
            ("time", true),
            ("worth", true),
            ("unsteady", true),
        ]),
        rows,
        notes,
    }
}

/// What could not be looked for, a sentence each.
fn unseen(within: &WithinWindows) -> Vec<String> {
    let of = |look: Look| {
        let found = within.unseen.iter().filter(|(_, it, _)| *it == look);
        let found: Vec<_> = found.collect();
        let mut reasons: Vec<String> = found.iter().map(|(_, _, why)| why.to_string()).collect();
        reasons.dedup();
        let windows = match found.len() {
            all if all == within.windows => "any window".to_owned(),
            _ => {
                let numbers: Vec<String> = found.iter().map(|(window, ..)| window.to_string()).collect();
                format!("window {}", numbers.join(", "))
            }
        };
        (!found.is_empty()).then(|| {
            format!(
                "no {} could be looked for in {windows} ({}).",
                look.name(),
                reasons.join("; ")
            )
        })
    };
    Look::ALL.into_iter().filter_map(of).collect()
}
