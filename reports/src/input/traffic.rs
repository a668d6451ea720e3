//! What became of a run's packets, from its captures. The function is [`read`].

use captures::{
    packets::CapturedWindow,
    traffic::{self, ScenarioTraffic, Traffic},
};
use rayon::prelude::*;

use super::run::{Run, ScenarioRun, WindowState};

/// Reads the captures of all windows that count, scenarios side by side. A capture that cannot be used takes its window out
/// and no other.
#[must_use]
pub fn read(run: &Run) -> Traffic {
    let scenarios = run.scenarios.par_iter().filter_map(|scenario| {
        let traffic = of_scenario(scenario);
        let is_empty = traffic.windows.is_empty() && traffic.unreadable.is_empty();
        (!is_empty).then(|| (scenario.planned.id.clone(), traffic))
    });
    Traffic {
        scenarios: scenarios.collect(),
    }
}

fn of_scenario(scenario: &ScenarioRun) -> ScenarioTraffic {
    // What nodes of the user's say to each other, only they know.
    if scenario.planned.settings.experiment.is_some() {
        return ScenarioTraffic::default();
    }
    let mut traffic = traffic::read(captured(scenario), scenario.planned.settings.period);
    let counted: Vec<u32> = scenario.counted().map(|(number, ..)| number).collect();
    traffic.windows.retain(|window| counted.contains(&window.window));
    traffic.unreadable.retain(|(window, _)| counted.contains(window));
    traffic
}

/// The windows that are whole and have captures, those too that do not count: what is under way when a window begins was
/// sent in the one before.
fn captured(scenario: &ScenarioRun) -> Vec<CapturedWindow> {
    let windows = scenario.windows.iter().filter_map(|window| match &window.state {
        WindowState::Counted { record, .. } | WindowState::Invalid { record } => Some(CapturedWindow {
            folder: window.folder.clone(),
            record: (**record).clone(),
        }),
        WindowState::Broken { .. } | WindowState::Missing { .. } => None,
    });
    windows.filter(CapturedWindow::is_captured).collect()
}
