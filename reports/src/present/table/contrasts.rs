//! The pairs of the declared family with the window as the unit: the test of the windows' levels, the adjusted p-values,
//! and how large the differences are.

use std::collections::BTreeSet;

use statistics::{block_permutation::DRAWS, effect::Estimate, relabelling::Coverage, shape::DISTANCES};

use super::{Table, no_data_note, texts};
use crate::{
    analysis::{
        contrast::{Contrast, Contrasts},
        report::Report,
    },
    present::forest::{percent, simultaneous_confidence},
};

/// The tables.
pub(super) fn of(report: &Report) -> Vec<Table> {
    let mut tables = vec![windows(report), family(report), effects(report)];
    tables.extend(blocks(report));
    tables
}

/// The paper's counts beside those with blocks permuted.
fn blocks(report: &Report) -> Option<Table> {
    let row = |pair: &Contrast| {
        let tally = report.tally(&pair.a, &pair.b)?;
        let blocks = pair.blocks?;
        Some(vec![
            pair.a.clone(),
            pair.b.clone(),
            tally.pairs.to_string(),
            tally.rejected.to_string(),
            match blocks.possible {
                0 => "cannot".to_owned(),
                possible => format!("{} of {possible}", blocks.rejected),
            },
            blocks.block.to_string(),
        ])
    };
    let rows: Vec<Vec<String>> = report.contrasts.pairs.iter().filter_map(row).collect();
    (!rows.is_empty()).then(|| Table {
        id: "counts-by-blocks".to_owned(),
        title: "The counts with blocks in place of values".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("N", true),
            ("rejected", true),
            ("by blocks", true),
            ("block", true),
        ]),
        rows,
        notes: vec![format!(
            "Rejected: window pairs as in Tables IV and V. By blocks: the same distance, its p by permuting blocks of so \
             many neighbouring periods (twice the autocorrelation time), {DRAWS} draws; of the pairs with blocks enough for \
             a p below {}, and \"cannot\" where none has. What shifts a window as a whole is still taken for a difference.",
            report.settings.alpha
        )],
    })
}

fn windows(report: &Report) -> Table {
    let contrasts = &report.contrasts;
    let row = |pair: &Contrast| {
        let mut cells = vec![format!("{} : {}", pair.n, pair.m), p(pair.level.p)];
        cells.extend(pair.shape.each().map(|(_, test)| p(test.p)));
        cells.push(p(pair.level.smallest_p));
        cells
    };
    let distances: Vec<String> = DISTANCES
        .iter()
        .map(|distance| format!("{} ({})", distance.name, distance.heading))
        .collect();
    let mut notes = vec![format!(
        "p-values: the windows are permuted between the two scenarios, and p is the share of the labellings that are at \
         least as far apart as the measured one: in the mean of the window means (level), and in the distributions of all \
         values by measures that see spread and tails too: {}. Windows are taken for independent, values within them are \
         not. Smallest: the level's p of the most extreme labelling; no smaller p can be found, however large the \
         difference.",
        distances.join(", ")
    )];
    if contrasts
        .pairs
        .iter()
        .any(|pair| pair.shape.coverage() == Coverage::MonteCarlo)
    {
        notes.push(format!(
            "Where there are too many labellings, some were drawn (monte-carlo, seed {}), and p is (b + 1) / (B + 1); \
             `contrasts.csv` says how many.",
            report.settings.seed
        ));
    }
    let mut columns = vec![("", false), ("", false), ("windows", true), ("level", true)];
    columns.extend(DISTANCES.iter().map(|distance| (distance.heading, true)));
    columns.push(("smallest", true));
    Table {
        id: "the-window-as-the-unit".to_owned(),
        title: "The window as the unit".to_owned(),
        columns: texts(&columns),
        rows: rows(contrasts, row),
        notes,
    }
}

fn family(report: &Report) -> Table {
    let contrasts = &report.contrasts;
    let row = |pair: &Contrast| {
        vec![
            p(pair.level.p),
            p(pair.p_holm),
            p(pair.p_benjamini_yekutieli),
            p(pair.p_max_t),
            pair.p_shift_holm.map_or_else(|| "–".to_owned(), p),
            pair.verdict.name().to_owned(),
        ]
    };
    let count = contrasts.pairs.len();
    let mut notes = vec![format!(
        "Family: {} (`report.family`), {count} {} with data. p is that of the level in the table before; Holm's bounds the chance of \
         any false rejection, Benjamini and Yekutieli's (B-Y) the share of false ones.",
        contrasts.family.description(),
        if count == 1 { "pair" } else { "pairs" }
    )];
    if let Some(max_t) = &contrasts.max_t {
        notes.push(format!(
            "max-T deals the windows, each around the mean of its scenario, anew over the family ({} dealings, monte-carlo with seed \
             {}; smallest {}), step by step from the pair that is furthest apart. It holds where the scenarios' windows spread \
             alike, and is near exact with twenty windows or so in all.",
            max_t.labellings,
            report.settings.seed,
            p(max_t.smallest_p)
        ));
    }
    notes.push(
        "Shift: Holm's p of equal mean levels, whatever the numbers and spreads of windows: the larger one of the studentised \
         permutation test's and Welch's."
            .to_owned(),
    );
    let setting = report.quantity.margin_setting;
    let margin = report.quantity.margin().map_or_else(
        || format!("No equivalence margin is declared ({setting})."),
        |margin| {
            format!(
                "The equivalence margin is {margin}: a shift matters if its whole interval for all pairs at once lies beyond, and is \
                 immaterial if it lies within."
            )
        },
    );
    notes.extend(without_data(report));
    if report.replicates.is_some() {
        notes.push(
            "These p-values take windows for the units, which windows of one environment are not. The verdict is that of the table \
             with the environment as the unit."
                .to_owned(),
        );
    }
    notes.push(format!(
        "Verdict: by Holm's p at {}. \"Cannot tell\": no windows of these numbers could reach it in this family; \"not told apart\": \
         they could have, and did not, which is not the same as no difference; \"level open\": they differ, and p of the shift \
         leaves open whether in the mean or in the spread of their windows alone. {margin}",
        report.settings.alpha
    ));
    Table {
        id: "the-family-of-comparisons".to_owned(),
        title: "The family of comparisons".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("p", true),
            ("Holm", true),
            ("B-Y", true),
            ("max-T", true),
            ("shift", true),
            ("verdict", false),
        ]),
        rows: rows(contrasts, row),
        notes,
    }
}

fn effects(report: &Report) -> Table {
    let row = |pair: &Contrast| {
        let effect = &pair.effect;
        vec![
            estimate(&effect.shift, |shift| report.quantity.signed(shift)),
            estimate(&effect.wasserstein, |distance| report.quantity.digits(distance)),
            estimate(&effect.superiority, |share| format!("{share:.2}")),
        ]
    };
    let mut confidences: Vec<f64> = report
        .contrasts
        .pairs
        .iter()
        .filter_map(|pair| pair.effect.shift.interval)
        .map(|interval| interval.confidence)
        .collect();
    confidences.sort_by(f64::total_cmp);
    let confidence = match (confidences.first(), confidences.last()) {
        (Some(low), Some(high)) if high - low > 5e-4 => {
            format!(
                "{:.1} % to {:.1} %, by the windows there are",
                low * 100.0,
                high * 100.0
            )
        }
        (Some(low), _) => format!("{:.1} %", low * 100.0),
        _ => "–".to_owned(),
    };
    Table {
        id: "effects".to_owned(),
        title: "How large the differences are".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            (&report.quantity.heading("shift"), true),
            (&report.quantity.heading("W1"), true),
            ("P(larger)", true),
        ]),
        rows: rows(&report.contrasts, row),
        notes: vec![
            format!(
                "Of the second scenario against the first. Shift: the difference of the means over windows, with the interval of the shifts \
                 that are not rejected (confidence {confidence}). W1: Wasserstein distance of the values; never negative. \
                 P(larger): that a value of the second is the larger one. Their intervals are of 95 % or more, from how the windows \
                 of a side differ."
            ),
            match report.replicates {
                None => "None of these intervals is adjusted for the number of pairs; those of the first table are.",
                Some(_) => {
                    "These intervals take windows for independent, which windows of one environment are not, and are too short \
                     for that; those of the first table have the environment as the unit."
                }
            }
            .to_owned(),
        ],
    }
}

/// What holds for all pairs of the family at once.
pub(super) fn simultaneous(report: &Report) -> String {
    let setting = report.quantity.margin_setting;
    let margin = report.quantity.margin().map_or_else(String::new, |margin| {
        format!(" The band of ±{margin} does not matter ({setting}).")
    });
    format!(
        "All at once: intervals of {} each, so that all hold together with {} (Bonferroni).{margin}",
        percent(simultaneous_confidence(report)),
        percent(1.0 - report.settings.alpha)
    )
}

/// A row for each pair of the family that has data.
pub(super) fn rows(contrasts: &Contrasts, row: impl Fn(&Contrast) -> Vec<String>) -> Vec<Vec<String>> {
    let rows = contrasts.pairs.iter().map(|pair| {
        let mut cells = vec![pair.a.clone(), pair.b.clone()];
        cells.extend(row(pair));
        cells
    });
    rows.collect()
}

/// A note that counts the pairs without data and names the scenarios that have none.
fn without_data(report: &Report) -> Option<String> {
    let missing = &report.contrasts.without_data;
    let named: BTreeSet<&str> = missing.iter().flat_map(|(a, b)| [a.as_str(), b]).collect();
    let scenarios = report.scenarios.iter();
    let why = no_data_note(scenarios.filter(|scenario| named.contains(scenario.id.as_str())))?;
    let pairs = match missing.len() {
        1 => "1 pair of the family is".to_owned(),
        many => format!("{many} pairs of the family are"),
    };
    Some(format!("{pairs} not compared. {why}"))
}

/// A p-value in a cell.
pub(super) fn p(p: f64) -> String {
    if p < 0.001 {
        format!("{p:.1e}")
    } else {
        format!("{p:.4}")
    }
}

/// A p-value in a sentence.
pub(crate) fn p_in_words(value: f64) -> String {
    match value {
        smallest if smallest < 1e-12 => "p < 1e-12".to_owned(),
        _ => format!("p = {}", p(value)),
    }
}

pub(super) fn estimate(estimate: &Estimate, digits: impl Fn(f64) -> String) -> String {
    let value = digits(estimate.value);
    match estimate.interval {
        Some(interval) => format!("{value} [{}, {}]", digits(interval.low), digits(interval.high)),
        None => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(0.5, "0.5000")]
    #[case(2.0 / 70.0, "0.0286")]
    #[case(0.0001, "1.0e-4")]
    fn a_p_is_never_shown_as_zero(#[case] value: f64, #[case] cell: &str) {
        assert_eq!(p(value), cell);
    }
}
