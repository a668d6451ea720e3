//! The pairs of the declared family with the window as the unit: the test of the windows' levels, the adjusted p-values,
//! and how large the differences are.

use super::{Table, no_data_note, texts};
use crate::{
    analysis::{
        contrast::{Contrast, Contrasts},
        report::Report,
    },
    statistics::{block_permutation::DRAWS, effect::Estimate, relabelling::Coverage},
};

/// The tables.
pub(super) fn of(report: &Report) -> Vec<Table> {
    let mut tables = vec![windows(report), family(report), effects(report)];
    tables.extend(blocks(report));
    tables
}

/// The paper's counts beside those with blocks dealt anew.
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
            "Rejected: window pairs as in Tables IV and V. By blocks: the same distance, its p by dealing blocks of so many \
             neighbouring periods anew (twice the autocorrelation time), {DRAWS} draws; of the pairs with blocks enough for \
             a p below {}, and \"cannot\" where none has. What shifts a window as a whole is still taken for a difference.",
            report.settings.alpha
        )],
    })
}

fn windows(report: &Report) -> Table {
    let contrasts = &report.contrasts;
    let row = |pair: &Contrast| {
        vec![
            format!("{} : {}", pair.n, pair.m),
            p(pair.level.p),
            p(pair.shape.kolmogorov_smirnov.p),
            p(pair.shape.anderson_darling.p),
            p(pair.shape.energy.p),
            p(pair.level.smallest_p),
        ]
    };
    let mut notes = vec![
        "p-values: the windows are dealt anew to the two scenarios, and p is the share of the labellings that are at least \
         as far apart as the measured one: in the mean of the window means (level), and in the distributions of all values \
         by the distances of Kolmogorov and Smirnov (KS), Anderson and Darling (A-D) and the energy distance, which see \
         spread and tails too. Windows are taken for independent, values within them are not. Smallest: the level's p of \
         the most extreme labelling; none below it can be found, however large the difference."
            .to_owned(),
    ];
    if contrasts
        .pairs
        .iter()
        .any(|pair| pair.shape.energy.coverage == Coverage::MonteCarlo)
    {
        notes.push(format!(
            "Where there are too many labellings, some were drawn (monte-carlo, seed {}), and p is (b + 1) / (B + 1); \
             `contrasts.csv` says how many.",
            report.settings.seed
        ));
    }
    Table {
        title: "The window as the unit".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("windows", true),
            ("level", true),
            ("KS", true),
            ("A-D", true),
            ("energy", true),
            ("smallest", true),
        ]),
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
        let how = match max_t.coverage {
            Coverage::Exact => format!("all {} labellings", max_t.labellings),
            Coverage::MonteCarlo => format!(
                "{} labellings, monte-carlo with seed {}",
                max_t.labellings, report.settings.seed
            ),
        };
        notes.push(format!(
            "max-T deals all windows of the family anew at once ({how}; smallest {}). It is exact for the hypothesis that \
             no scenario differs; for a single pair it holds where the scenarios' windows spread alike.",
            p(max_t.smallest_p)
        ));
    }
    let matters = report.settings.matters.map_or_else(
        || "What shift matters is not declared (`report.matters`).".to_owned(),
        |matters| {
            format!("A shift matters above {matters}: the verdict asks that its whole interval lies beyond.")
        },
    );
    notes.extend(without_data(report));
    notes.push(format!(
        "Verdict: by Holm's p at {}. \"Cannot tell\": no windows of this number could reach it; \"not told apart\": they could \
         have, and did not, which is not the same as no difference. {matters}",
        report.settings.alpha
    ));
    Table {
        title: "The family of comparisons".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("p", true),
            ("Holm", true),
            ("B-Y", true),
            ("max-T", true),
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
            estimate(&effect.shift_m, |shift_m| signed(shift_m * 1e3)),
            estimate(&effect.wasserstein_m, |distance_m| digits(distance_m * 1e3)),
            estimate(&effect.superiority, |share| format!("{share:.2}")),
        ]
    };
    let mut confidences: Vec<f64> = report
        .contrasts
        .pairs
        .iter()
        .filter_map(|pair| pair.effect.shift_m.interval)
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
        title: "How large the differences are".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("shift (mm)", true),
            ("W1 (mm)", true),
            ("P(larger)", true),
        ]),
        rows: rows(&report.contrasts, row),
        notes: vec![
            format!(
                "Of the second scenario against the first. Shift: Hodges-Lehmann, of window means, its interval exact for \
                 a shift (confidence {confidence}). W1: Wasserstein distance of the values; never negative, so not 0 for \
                 scenarios alike. P(larger): that a value of the second is the larger one. Their intervals are 95 % \
                 bootstraps over windows, and rough with few."
            ),
            "None of the intervals is adjusted for the number of pairs.".to_owned(),
        ],
    }
}

/// A row for each pair of the family that has data.
fn rows(contrasts: &Contrasts, row: impl Fn(&Contrast) -> Vec<String>) -> Vec<Vec<String>> {
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
    let scenarios = report.scenarios.iter().filter(|scenario| {
        missing
            .iter()
            .any(|(a, b)| *a == scenario.id || *b == scenario.id)
    });
    let why = no_data_note(scenarios)?;
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

pub(super) fn estimate(estimate: &Estimate, digits: impl Fn(f64) -> String) -> String {
    let value = digits(estimate.value);
    match estimate.interval {
        Some(interval) => format!("{value} [{}, {}]", digits(interval.low), digits(interval.high)),
        None => value,
    }
}

/// Three digits or so, and no more than a cell takes.
fn digits(value: f64) -> String {
    match value.abs() {
        large if large >= 99.95 => format!("{value:.0}"),
        middle if middle >= 9.995 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

pub(super) fn signed(value: f64) -> String {
    let digits = digits(value);
    if digits.starts_with('-') {
        digits
    } else {
        format!("+{digits}")
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

    #[rstest::rstest]
    #[case(-123.4, "-123")]
    #[case(12.34, "+12.3")]
    #[case(-0.004, "-0.00")]
    #[case(9.999, "+10.0")]
    fn a_shift_has_a_sign_and_about_three_digits(#[case] value: f64, #[case] cell: &str) {
        assert_eq!(signed(value), cell);
    }
}
