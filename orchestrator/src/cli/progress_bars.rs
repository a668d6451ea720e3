//! On a terminal: a bar for each scenario with its window, the time left and the loop's health. The main type is
//! [`ProgressBars`].

use std::{collections::HashMap, time::Duration};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use record::{
    progress::Progress,
    run_directory::{Event, PlanRecord},
};

use super::plain_log;
use crate::observer::Observer;

/// One bar a scenario, in the order they run.
pub struct ProgressBars {
    bars: MultiProgress,
    scenarios: HashMap<String, Scenario>,
}

struct Scenario {
    bar: ProgressBar,
    windows: u32,
    environments: u32,
    steps_per_window: u64,
    rate_hz: f64,
    /// Windows that were done before the one under way.
    windows_done: u64,
}

impl ProgressBars {
    /// For the scenarios that `plan` runs, drawn on the terminal behind standard error.
    #[must_use]
    pub fn new(plan: &PlanRecord) -> Self {
        let bars = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(4));
        let planned = plan
            .order
            .iter()
            .filter_map(|id| plan.scenarios.iter().find(|s| s.id == *id));
        let scenarios = planned
            .map(|planned| {
                let settings = &planned.settings;
                let steps = settings
                    .steps_per_window()
                    .saturating_mul(u64::from(settings.all_windows()));
                let bar = bars.add(ProgressBar::new(steps).with_style(style()));
                bar.set_prefix(format!("{} {}", planned.id, planned.slug));
                bar.set_message("waiting");
                let scenario = Scenario {
                    bar,
                    windows: settings.all_windows(),
                    environments: settings.environments,
                    steps_per_window: settings.steps_per_window(),
                    rate_hz: settings.rate.hz(),
                    windows_done: 0,
                };
                (planned.slug.clone(), scenario)
            })
            .collect();
        Self { bars, scenarios }
    }
}

fn style() -> ProgressStyle {
    // The template is ours and fixed; should it ever be wrong, a plain bar is what a user gets.
    ProgressStyle::with_template("{prefix:32!} {bar:20} {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

impl Observer for ProgressBars {
    fn observe(&mut self, event: &Event) {
        match event {
            Event::Workload {
                scenario,
                progress: Progress::Health { .. },
            } => {
                if let (Some(scenario), Event::Workload { progress, .. }) =
                    (self.scenarios.get_mut(scenario), event)
                {
                    scenario.health(progress);
                }
            }
            Event::Workload { scenario, progress } => {
                if let (Some(scenario), Some(line)) =
                    (self.scenarios.get_mut(scenario), plain_log::line(event))
                {
                    if let Progress::WindowComplete { .. } = progress {
                        scenario.windows_done += 1;
                        scenario.bar.set_position(scenario.steps_before());
                    }
                    scenario.bar.set_message(after_colon(&line));
                }
            }
            Event::ScenarioFinished { scenario, round, .. } => {
                if let (Some(scenario), Some(line)) = (self.scenarios.get(scenario), plain_log::line(event)) {
                    // Its next environment goes on with the bar.
                    match round.is_some_and(|round| round < scenario.environments) {
                        true => scenario.bar.set_message(after_colon(&line)),
                        false => scenario.bar.abandon_with_message(after_colon(&line)),
                    }
                }
            }
            Event::WindowBroken { .. }
            | Event::HostBusy { .. }
            | Event::EnvironmentFound { .. }
            | Event::WorkloadSilent { .. }
            | Event::WorkloadHeard { .. } => {
                if let Some(line) = plain_log::line(event) {
                    // As with the plain log: a terminal that went away does not stop a run.
                    let _ = self.bars.println(line);
                }
            }
            _ => {}
        }
    }
}

impl Scenario {
    /// Steps of the windows that were done before the one under way.
    fn steps_before(&self) -> u64 {
        self.windows_done.saturating_mul(self.steps_per_window)
    }

    fn health(&mut self, progress: &Progress) {
        let Progress::Health {
            window,
            steps_done,
            missed_deadlines,
            worst_lateness_ns,
            ..
        } = progress
        else {
            return;
        };
        // The number is another machine's.
        let done = self.steps_before().saturating_add(*steps_done);
        self.bar.set_position(done);
        let total = self.bar.length().unwrap_or(done);
        let left_s = (total.saturating_sub(done) as f64 / self.rate_hz).round();
        let left = Duration::try_from_secs_f64(left_s).unwrap_or(Duration::MAX);
        self.bar.set_message(format!(
            "window {window}/{}, {} left, latest start {:.2} ms, {missed_deadlines} missed",
            self.windows,
            humantime::format_duration(left),
            *worst_lateness_ns as f64 / 1e6,
        ));
    }
}

fn after_colon(line: &str) -> String {
    line.split_once(": ")
        .map_or_else(|| line.to_owned(), |(_, rest)| rest.to_owned())
}
