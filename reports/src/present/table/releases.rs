//! How late the network emulator let packets go: what it adds to the delays that were asked for.

use record::window::ReleaseRecord;

use super::{NO_DATA, Table, texts};
use crate::{analysis::report::Report, present::axes::Axes};

/// None if no window had an emulator.
pub(super) fn of(report: &Report) -> Option<Table> {
    let releases = |scenario: &crate::analysis::scenario::ScenarioReport| scenario.health.as_ref()?.releases;
    report.scenarios.iter().find_map(releases)?;
    let axes = Axes::of(&report.scenarios);
    let rows = report
        .scenarios
        .iter()
        .map(|scenario| {
            let mut row = vec![scenario.id.clone(), axes.label(scenario)];
            row.extend(releases(scenario).as_ref().map_or_else(without_data, cells));
            row
        })
        .collect();
    Some(Table {
        id: "release-lateness".to_owned(),
        title: "How late the network emulator let packets go".to_owned(),
        columns: texts(&[
            ("", false),
            ("scenario", false),
            ("mean", true),
            ("p99", true),
            ("p99.9", true),
            ("max", true),
        ]),
        rows,
        notes: vec![
            "In milliseconds after each pass through a link was due to end; a packet between two hosts makes two. The mean \
             over the windows that count, the rest of the worst of them."
                .to_owned(),
        ],
    })
}

fn cells(releases: &ReleaseRecord) -> [String; 4] {
    [
        milliseconds(releases.lateness_mean_ns),
        milliseconds(releases.lateness_p99_ns as f64),
        milliseconds(releases.lateness_p999_ns as f64),
        milliseconds(releases.lateness_max_ns as f64),
    ]
}

fn without_data() -> [String; 4] {
    let none = || "–".to_owned();
    [none(), none(), none(), NO_DATA.to_owned()]
}

fn milliseconds(ns: f64) -> String {
    format!("{:.3}", ns / 1e6)
}
