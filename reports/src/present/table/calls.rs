//! What the calls of a user's command took.

use super::{NO_DATA, Table, texts};
use crate::{
    analysis::{calls::Calls, report::Report},
    present::axes::Axes,
};

/// The table; none of the ball on the plate.
pub(super) fn of(report: &Report) -> Option<Table> {
    let axes = Axes::of(&report.scenarios);
    let rows: Vec<Vec<String>> = report
        .scenarios
        .iter()
        .filter(|scenario| !scenario.experiment.is_ball())
        .map(|scenario| {
            let mut row = vec![scenario.id.clone(), axes.label(scenario)];
            row.extend(scenario.calls.as_ref().map_or_else(without_data, cells));
            row
        })
        .collect();
    (!rows.is_empty()).then(|| Table {
        id: "calls".to_owned(),
        title: "What the calls of the command took".to_owned(),
        columns: texts(&[
            ("", false),
            ("scenario", false),
            ("mean", true),
            ("longest", true),
            ("CPU", true),
            ("memory", true),
            ("left", true),
        ]),
        rows,
        notes: vec![
            "Mean and longest: how long a call took, with the start of the program. CPU: its use of one core, with all processes that \
             it waited for. Memory: the most that one of them had. Left: processes that were there when the command had ended, and \
             were ended then. Over the windows that count."
                .to_owned(),
        ],
    })
}

fn cells(calls: &Calls) -> [String; 5] {
    [
        seconds(calls.mean_s),
        seconds(calls.longest_s),
        format!("{:.1} %", calls.cpu_share * 100.0),
        format!("{:.1} MiB", calls.peak_memory_bytes as f64 / f64::from(1 << 20)),
        calls.left_behind.to_string(),
    ]
}

fn without_data() -> [String; 5] {
    let none = || "–".to_owned();
    [NO_DATA.to_owned(), none(), none(), none(), none()]
}

fn seconds(seconds: f64) -> String {
    match seconds {
        short if short < 1.0 => format!("{:.1} ms", short * 1e3),
        long => format!("{long:.2} s"),
    }
}
