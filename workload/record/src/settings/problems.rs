//! What is wrong with settings that read well: those that do not fit together, and those out of their range.

use std::borrow::Cow;

use super::{Discretization, Limit, Messages, Rates, Settings, Waiting};
use crate::{platform_model::PlatformModel, quantity::TimeSpan, topology, virtual_host::VirtualHost};

/// Two settings that do not fit together, or one out of its range.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SettingsProblem {
    /// Dotted path of the setting to change, such as `window`; an item of a list is named by its place, from 0.
    pub path: Cow<'static, str>,
    /// What is wrong.
    pub message: String,
    /// What to write instead.
    pub hint: String,
}

impl SettingsProblem {
    pub(crate) fn of(
        path: impl Into<Cow<'static, str>>,
        message: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self {
            path: path.into(),
            message: message.into(),
            hint: hint.into(),
        }
    }
}

impl Settings {
    /// Windows of a scenario, each of which is a folder.
    pub const MOST_WINDOWS: u32 = 10_000;

    /// Rules that exclude each other: path, what is wrong, what to write.
    fn contradictions(&self) -> Vec<(&'static str, &'static str, &'static str)> {
        let mut found = Vec::new();
        if self.control.rates == Rates::Sent && self.ros.messages != Messages::Rates {
            found.push((
                "control.rates",
                "the messages carry no rates that the controller could use",
                "write `differenced`, or `ros.messages: rates`",
            ));
        }
        if self.ros.messages == Messages::Rates && self.plant.discretization == Discretization::Author {
            found.push((
                "ros.messages",
                "the author's difference equations have no rates to send",
                "write `text` or `positions`, or `plant.discretization: zero-order-hold`",
            ));
        }
        if self.loops.controller_waits == Waiting::Spin && self.realtime.priority > 0 {
            found.push((
                "loops.controller_waits",
                "a thread that spins at real-time priority lets nothing else run on its processor",
                "write `sleep`, or `realtime.priority: 0`",
            ));
        }
        found
    }

    /// What is wrong with these settings; empty if the experiment can run with them.
    #[must_use]
    pub fn problems(&self) -> Vec<SettingsProblem> {
        let mut problems = Vec::new();
        let mut problem = |path: &'static str, message: String, hint: String| {
            problems.push(SettingsProblem::of(path, message, hint))
        };
        if self.windows == 0 {
            problem(
                "windows",
                "there is no window to measure".into(),
                "write at least 1".into(),
            );
        }
        if self.windows > Self::MOST_WINDOWS {
            problem(
                "windows",
                format!("{} windows are more than anybody measures", self.windows),
                format!("write at most {}", Self::MOST_WINDOWS),
            );
        } else if !(1..=Self::MOST_ENVIRONMENTS).contains(&self.environments) {
            let most = Self::MOST_ENVIRONMENTS;
            problem(
                "environments",
                format!("{} environments cannot be measured in", self.environments),
                format!("write 1 to {most}"),
            );
        } else if self.all_windows() > Self::MOST_WINDOWS {
            problem(
                "environments",
                format!(
                    "{} windows in each of {} environments are more than {} windows of a scenario",
                    self.windows,
                    self.environments,
                    Self::MOST_WINDOWS
                ),
                "write fewer environments, or fewer `windows`".into(),
            );
        }
        for path in self.validity.crossed() {
            problem(
                path,
                "a window would be invalid before it is suspect".into(),
                "write at least what `suspect` is, or `never`".into(),
            );
        }
        match &self.experiment {
            Some(experiment) => {
                problems.extend(experiment.problems(&self.network.topology()));
                if self.network_in_use().is_some() {
                    self.problems_of_the_network(&mut problems);
                }
            }
            None => {
                self.problems_of_the_ball(&mut problems);
                self.problems_of_the_network(&mut problems);
                problems.extend(self.problems_of_the_simulation());
            }
        }
        problems
    }

    /// What is wrong with what is computed in place of measured.
    fn problems_of_the_simulation(&self) -> impl Iterator<Item = SettingsProblem> {
        let platform = self.simulation.iter().map(|simulation| &simulation.platform);
        platform
            .flat_map(PlatformModel::problems)
            .map(|(path, message, hint)| {
                SettingsProblem::of(format!("simulation.platform.{path}"), message, hint)
            })
    }

    /// What is wrong with the emulated network and its captures.
    fn problems_of_the_network(&self, problems: &mut Vec<SettingsProblem>) {
        let of_the_topology = topology::problems(&self.network.wanted(&self.network.link())).into_iter();
        problems.extend(
            of_the_topology
                .map(|(path, message, hint)| SettingsProblem::of(format!("network.{path}"), message, hint)),
        );
        let mut problem = |path: &'static str, message: String, hint: String| {
            problems.push(SettingsProblem::of(path, message, hint))
        };
        for refusal in self.network.backend.facts().refusals {
            if let Some(message) = (refusal.problem)(&self.network) {
                problem(refusal.path, message, refusal.hint.into());
            }
        }
        if self.capture.snaplen.get() < 96 || self.capture.snaplen.get() > 262_144 {
            problem(
                "capture.snaplen",
                format!(
                    "{} does not hold the headers, or is more than a packet has",
                    self.capture.snaplen
                ),
                "write a size from `96B` to `256KiB`".into(),
            );
        }
        if self
            .capture
            .filter
            .as_ref()
            .is_some_and(|filter| filter.trim().is_empty())
        {
            problem(
                "capture.filter",
                "an empty expression names no packets".into(),
                "leave it out to capture all packets, or write an expression such as `tcp`".into(),
            );
        }
    }

    /// What is wrong with what only the ball on the plate has.
    fn problems_of_the_ball(&self, problems: &mut Vec<SettingsProblem>) {
        let mut problem = |path: &'static str, message: String, hint: String| {
            problems.push(SettingsProblem::of(path, message, hint))
        };
        let period = self.period.as_nanos();
        if period == 0 {
            problem(
                "period",
                "the period is zero".into(),
                "write a length such as `100s`".into(),
            );
        } else if self.window.as_nanos() == 0 || self.window.as_nanos() % period != 0 {
            let periods = (self.window.as_nanos() as f64 / period as f64).round().max(1.0) as u64;
            problem(
                "window",
                format!(
                    "a window of {} is not a whole number of periods of {}",
                    self.window, self.period
                ),
                format!(
                    "write `{}`, which is {periods} periods",
                    TimeSpan::from(self.period.duration() * u32::try_from(periods).unwrap_or(u32::MAX))
                ),
            );
        }
        let steps = self.period.as_secs_f64() * self.rate.hz();
        if period != 0 && ((steps - steps.round()).abs() > 1e-9 * steps.max(1.0) || steps < 1.0) {
            problem(
                "rate",
                format!(
                    "a period of {} at {} is not a whole number of steps ({steps})",
                    self.period, self.rate
                ),
                "choose a rate that divides the period".into(),
            );
        }
        if self.control.phase.duration() >= self.rate.step() {
            problem(
                "control.phase",
                format!(
                    "{} is not within one step of {:?}",
                    self.control.phase,
                    self.rate.step()
                ),
                "write a time below one step".into(),
            );
        }
        if self.realtime.priority > 99 {
            problem(
                "realtime.priority",
                format!("{} is above the highest priority", self.realtime.priority),
                "write 1 to 99, or 0 for the ordinary scheduler".into(),
            );
        }
        for (path, message, hint) in self.contradictions() {
            problem(path, message.to_owned(), hint.to_owned());
        }
        if matches!(self.control.wanted_limit_deg, Limit::Above(limit) if !(limit.is_finite() && limit > 0.0))
        {
            problem(
                "control.wanted_limit_deg",
                "a limit that is no positive number lets no angle be wanted".into(),
                "write a positive number of degrees, or `never`".into(),
            );
        }
        if !self.network.topology().names().eq(VirtualHost::OF_THE_BALL) {
            let [h1, sta1, sta2] = VirtualHost::OF_THE_BALL;
            problem(
                "network.hosts",
                "the ball on the plate has other hosts".into(),
                format!("write `{h1}`, `{sta1}` and `{sta2}`, in this order, each with its link"),
            );
        }
        for (path, value, positive) in [
            ("reference.amplitude_m", self.reference.amplitude_m, false),
            ("plant.b1", self.plant.b1, true),
            ("plant.b0", self.plant.b0, true),
            ("plant.angle_limit_deg", self.plant.angle_limit_deg, true),
            ("plant.position_limit_m", self.plant.position_limit_m, true),
            ("control.position.kp", self.control.position.kp, false),
            ("control.position.kd", self.control.position.kd, false),
            ("control.angle.kp", self.control.angle.kp, false),
            ("control.angle.kd", self.control.angle.kd, false),
        ] {
            if !value.is_finite() || (positive && value <= 0.0) {
                let wanted = if positive {
                    "a positive number"
                } else {
                    "a finite number"
                };
                problem(path, format!("{value} does not do"), format!("write {wanted}"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{quantity::BitRate, settings::NetworkBackend};

    #[test]
    fn a_window_that_cuts_a_period_is_a_problem_with_the_nearest_whole_one() {
        let settings = Settings {
            window: TimeSpan::from_secs(250),
            ..Settings::default()
        };
        let problems = settings.problems();
        assert_eq!(problems.len(), 1);
        assert_eq!(problems[0].path, "window");
        assert_eq!(problems[0].hint, "write `300s`, which is 3 periods");
    }

    #[rstest::rstest]
    #[case(1000, None)]
    #[case(1001, Some("network.bandwidth"))]
    fn mininet_sets_no_limit_above_a_gigabit_and_that_is_a_problem(
        #[case] mbit: u32,
        #[case] problem: Option<&str>,
    ) {
        let mut settings = Settings::default();
        settings.network.backend = NetworkBackend::Mininet;
        settings.network.bandwidth = BitRate::from_mbit(mbit.into());
        assert_eq!(
            settings.problems().first().map(|problem| problem.path.as_ref()),
            problem
        );
    }
}
