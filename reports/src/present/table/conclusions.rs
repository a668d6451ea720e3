//! The paper's two conclusions: virtualizations over all platforms, and operating systems over all virtualizations; and each node of
//! a cluster with the others.

use record::axis::{NODE, VIRTUALIZATION};
use statistics::relabelling::Coverage;

use super::{
    Table,
    contrasts::{estimate, p},
    texts,
};
use crate::analysis::{
    conclusion::{Conclusion, Stratum},
    report::Report,
};

/// The tables; none where no two values have windows in a stratum in common.
pub(super) fn of(report: &Report) -> Vec<Table> {
    let (mut nodes, others): (Vec<_>, Vec<_>) = report.conclusions.iter().partition(|it| it.axis == NODE);
    // The oddest first: nobody looks for it among a hundred.
    nodes.sort_by(|a, b| b.shift.value.abs().total_cmp(&a.shift.value.abs()));
    let by_value = table(
        report,
        "conclusions",
        "By virtualization, and by operating system",
        &others,
    );
    let by_node = table(report, "nodes", "Each node against the others", &nodes);
    by_value.into_iter().chain(by_node).collect()
}

fn table(report: &Report, id: &str, title: &str, conclusions: &[&Conclusion]) -> Option<Table> {
    let row = |one: &&Conclusion| {
        let windows = |of: fn(&Stratum) -> usize| one.strata.iter().map(of).sum::<usize>();
        vec![
            one.first.clone(),
            one.second.clone(),
            format!("{} : {}", windows(|it| it.n), windows(|it| it.m)),
            p(one.test.p),
            p(one.p_holm),
            estimate(&one.shift, |shift| report.quantity.signed(shift)),
        ]
    };
    (!conclusions.is_empty()).then(|| Table {
        id: id.to_owned(),
        title: title.to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("windows", true),
            ("p", true),
            ("Holm", true),
            (&report.quantity.heading("shift"), true),
        ]),
        rows: conclusions.iter().map(row).collect(),
        notes: notes(report, conclusions),
    })
}

fn notes(report: &Report, conclusions: &[&Conclusion]) -> Vec<String> {
    let mut notes = vec![
        "Hypothesis: within a stratum it makes no difference which of the two a window was measured under. The windows of each \
         stratum are permuted between the two, and p is the share of the labellings whose weighted mean shift is at least as large, \
         up or down. Shift: of the second against the first, mean over the strata of the differences of their window means, \
         with all shifts that the test does not reject at 0.05; no interval where so few windows reject none. Holm: for the \
         rows of this table."
            .to_owned(),
        "It assumes that windows of a stratum are exchangeable but for the two values. Each scenario is one environment on one \
         machine: a difference between two environments that has nothing to do with their platforms cannot be told from one of \
         the platforms. To tell them apart, run each platform on several machines, or the run several times."
            .to_owned(),
    ];
    let drawn = |one: &&&Conclusion| one.test.coverage == Coverage::MonteCarlo;
    if let Some(one) = conclusions.iter().find(drawn) {
        notes.push(format!(
            "Where there are too many labellings, {} were looked at (monte-carlo, seed {}), and p is (b + 1) / (B + 1).",
            one.test.labellings, report.settings.seed
        ));
    }
    notes.extend(conclusions.iter().map(|one| strata(one)));
    notes
}

/// Of which scenarios it is.
fn strata(one: &Conclusion) -> String {
    let side = |letters: &[String], windows: usize| format!("{} ({windows})", letters.join("+"));
    let strata: Vec<String> = one
        .strata
        .iter()
        .map(|it| format!("{}, {} against {}", it.name, side(&it.a, it.n), side(&it.b, it.m)))
        .collect();
    let fixed = match (one.axis, one.hardware_differs) {
        (VIRTUALIZATION, _) => "on each platform",
        (_, false) => "with all else alike",
        (_, true) => {
            "with all else alike but the hardware, which no two operating systems have in common, so that it may be the \
             hardware that differs"
        }
    };
    format!(
        "{} and {}, {fixed}: {}. The smallest p that so many windows can reach is {}.",
        one.first,
        one.second,
        strata.join("; "),
        p(one.smallest_p)
    )
}
