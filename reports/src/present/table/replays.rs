//! Each window checked against itself: the times that it recorded, put through the loop, give its errors again.

use super::{Table, texts};
use crate::{
    analysis::report::Report,
    replay::{ScenarioReplay, WindowReplay},
};

/// The table; none where nothing was replayed.
pub(super) fn of(report: &Report) -> Option<Table> {
    let um = |m: f64| format!("{:.4}", m * 1e6);
    let row = |scenario: &ScenarioReplay, window: &WindowReplay| {
        vec![
            scenario.id.clone(),
            window.window.to_string(),
            window.periods.to_string(),
            um(window.largest_difference_m),
            um(window.mean_difference_m),
            if window.is_the_same() { "" } else { "SUSPECT" }.to_owned(),
        ]
    };
    let windows = report
        .replays
        .iter()
        .flat_map(|scenario| scenario.windows.iter().map(move |window| (scenario, window)));
    let rows: Vec<Vec<String>> = windows.map(|(scenario, window)| row(scenario, window)).collect();
    let doubts = report.replays.iter().flat_map(|scenario| {
        let windows = scenario.windows.iter();
        windows.filter_map(|it| Some(format!("{} window {}: {}.", scenario.id, it.window, it.doubt()?)))
    });
    (!rows.is_empty()).then(|| Table {
        id: "replays".to_owned(),
        title: "Each window, replayed".to_owned(),
        columns: texts(&[
            ("", false),
            ("window", true),
            ("periods", true),
            ("largest (µm)", true),
            ("mean (µm)", true),
            ("", false),
        ]),
        rows,
        notes: [
            "By how much the error of a period differs from what the window's own recorded times give, put through the loop. A window \
             that does not give its errors again is suspect."
                .to_owned(),
        ]
        .into_iter()
        .chain(doubts)
        .collect(),
    })
}
