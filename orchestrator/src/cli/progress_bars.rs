//! On a terminal: a bar for each scenario with its window, the time left and the loop's health, and one for all of them. The main
//! type is [`ProgressBars`].

use std::{
    collections::{BTreeSet, HashMap},
    time::Duration,
};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use record::{
    progress::Progress,
    run_directory::{Event, PlanRecord, RunState},
};

use super::plain_log;
use crate::{escaping, observer::Observer};

/// One bar a scenario, in the order they run.
pub struct ProgressBars {
    bars: MultiProgress,
    scenarios: HashMap<String, Scenario>,
    whole: ProgressBar,
    /// Of all windows, in seconds, on the host that has most of them.
    measuring_s: f64,
}

struct Scenario {
    bar: ProgressBar,
    windows: u32,
    environments: u32,
    steps_per_window: u64,
    rate_hz: f64,
    /// The windows that are done, by number: of one that was measured again there is one.
    done: BTreeSet<u32>,
}

impl ProgressBars {
    /// For the scenarios that `plan` runs, with what is done of them in `state`, drawn on the terminal behind standard error.
    #[must_use]
    pub fn new(plan: &PlanRecord, state: &RunState) -> Self {
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
                let done = state.scenario(&planned.slug).complete();
                bar.set_message(match done.len() {
                    0 => "waiting".to_owned(),
                    done => format!("{done} of {} windows done", settings.all_windows()),
                });
                let scenario = Scenario {
                    bar,
                    windows: settings.all_windows(),
                    environments: settings.environments,
                    steps_per_window: settings.steps_per_window(),
                    rate_hz: settings.rate.hz(),
                    done,
                };
                scenario.bar.set_position(scenario.steps_done());
                (planned.slug.clone(), scenario)
            })
            .collect();
        let whole = bars.add(ProgressBar::new(0).with_style(style()));
        whole.set_prefix("all");
        let bars = Self {
            bars,
            scenarios,
            whole,
            measuring_s: plan.measuring_s,
        };
        bars.show_whole();
        bars
    }

    /// A window that has been under way for so long, where nobody says how many of its steps are done.
    pub fn estimate(&mut self, slug: &str, window: u32, elapsed: Duration) {
        if let Some(scenario) = self.scenarios.get_mut(slug) {
            let steps = (elapsed.as_secs_f64() * scenario.rate_hz) as u64;
            let steps = steps.min(scenario.steps_per_window);
            scenario
                .bar
                .set_position(scenario.steps_done().saturating_add(steps));
            let message = format!("window {window}/{}", scenario.windows);
            scenario.bar.set_message(message);
            self.show_whole();
        }
    }

    /// The bar of all scenarios together.
    fn show_whole(&self) {
        let all = || self.scenarios.values();
        let length: u64 = all()
            .filter_map(|it| it.bar.length())
            .fold(0, u64::saturating_add);
        let position: u64 = all().map(|it| it.bar.position()).fold(0, u64::saturating_add);
        let (windows, done) = all().fold((0_u64, 0), |(windows, done), it| {
            (windows + u64::from(it.windows), done + it.done.len())
        });
        let left = 1.0 - position as f64 / length.max(1) as f64;
        let left = Duration::try_from_secs_f64((self.measuring_s * left).round()).unwrap_or_default();
        self.whole.set_length(length);
        self.whole.set_position(position);
        self.whole.set_message(format!(
            "{done} of {windows} windows, about {} of measuring left",
            humantime::format_duration(left)
        ));
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
                    if let Progress::WindowComplete { window, .. } = progress {
                        scenario.done.insert(*window);
                        scenario.bar.set_position(scenario.steps_done());
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
            Event::JobChanged {
                scenario, standing, ..
            } => {
                if let Some(scenario) = self.scenarios.get(scenario) {
                    let line = plain_log::job(standing);
                    scenario.bar.set_message(escaping::harmless_line(&line));
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
            Event::RunFinished | Event::RunLeft | Event::RunInterrupted => {
                self.show_whole();
                self.whole.abandon();
                return;
            }
            _ => {}
        }
        self.show_whole();
    }
}

impl Scenario {
    /// Steps of the windows that are done.
    fn steps_done(&self) -> u64 {
        (self.done.len() as u64).saturating_mul(self.steps_per_window)
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
        let done = self.steps_done().saturating_add(*steps_done);
        self.bar.set_position(done);
        let total = self.bar.length().unwrap_or(done);
        let left_s = (total.saturating_sub(done) as f64 / self.rate_hz).round();
        let left = Duration::try_from_secs_f64(left_s).unwrap_or(Duration::MAX);
        self.bar.set_message(format!(
            "window {window}/{}, {} of the scenario left, latest start {:.2} ms, {missed_deadlines} missed",
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
