//! How well each platform held the schedule: read it before the other tables.

use super::{NO_DATA, Table, texts};
use crate::{
    analysis::{health::Health, report::Report},
    present::axes::Axes,
};

/// The table; none of a command, which has no schedule of ours.
pub(super) fn of(report: &Report) -> Option<Table> {
    let axes = Axes::of(&report.scenarios);
    let rows: Vec<Vec<String>> = report
        .scenarios
        .iter()
        .filter(|scenario| scenario.experiment.is_ball())
        .map(|scenario| {
            let mut row = vec![scenario.id.clone(), axes.label(scenario)];
            row.extend(scenario.health.as_ref().map_or_else(without_data, cells));
            row
        })
        .collect();
    (!rows.is_empty()).then(|| Table {
        id: "schedule".to_owned(),
        title: "How well each platform held the schedule".to_owned(),
        columns: texts(&[
            ("", false),
            ("scenario", false),
            ("CPU", true),
            ("late", true),
            ("missed", true),
            ("stale", true),
            ("age", true),
        ]),
        rows,
        notes: vec![
            "CPU: the workload's own use of one core. Late: steps of both loops that began more than a tenth of a step \
             after they were due; missed: those a whole step late, and ticks that were lost. Stale: control steps without a newer state. Age: of \
             the state when it was used, mean. Over the windows that count."
                .to_owned(),
        ],
    })
}

fn cells(health: &Health) -> [String; 5] {
    [
        percent(health.cpu_share),
        percent(health.late_share),
        (health.missed_deadlines + health.lost_ticks).to_string(),
        percent(health.stale_share),
        health
            .state_age_s
            .map_or_else(|| NO_DATA.to_owned(), |age_s| format!("{:.1} ms", age_s * 1e3)),
    ]
}

fn without_data() -> [String; 5] {
    let none = || "–".to_owned();
    [none(), none(), none(), none(), NO_DATA.to_owned()]
}

fn percent(share: f64) -> String {
    let percent = share * 100.0;
    // A share that is not nothing must not look like it.
    if percent > 0.0 && percent < 0.01 {
        "<0.01 %".to_owned()
    } else {
        format!("{percent:.2} %")
    }
}
