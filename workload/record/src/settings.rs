//! The settings of the experiment: the `workload:` section of a matrix file. docs/paper.md says where each default comes
//! from.
//!
//! The same types are read from the matrix file, kept in the manifest and handed to the workload, so that one spelling
//! serves all three. The main type is [`Settings`]; [`Settings::problems`] says what does not fit together.

mod backend;
mod ball;
mod dynamics;
mod need;
mod network;
mod problems;
mod simulation;
pub mod validity;

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

pub use self::{
    backend::{BackendFacts, NetworkBackend, Refusal},
    ball::{ControlSettings, PdGains, PlantSettings, ReferenceSettings},
    dynamics::{
        Discretization, Dynamics, Feedback, LateTicks, Messages, PlantSends, Processes, Rates, ReferenceBy,
        StepOrder, Waiting, asked_for, recorded,
    },
    need::Need,
    network::{ImpairedFrom, NetworkSettings, Offloads},
    problems::SettingsProblem,
    simulation::SimulationSettings,
    validity::{Limit, Limits, ValiditySettings},
};
use crate::{
    experiment::CommandExperiment,
    quantity::{Bytes, Frequency, TimeSpan},
};

/// Everything that the experiment inside one environment depends on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Which rules plant, controller and their messages follow. It decides what the other settings are when they are
    /// left out.
    pub dynamics: Dynamics,
    /// How many contiguous windows are measured in each environment.
    pub windows: u32,
    /// In how many environments, each made anew, the windows are measured. A run has as many rounds, and each round makes one
    /// environment of every scenario, in an order of its own. From two on, environments are what contrasts compare.
    #[serde(skip_serializing_if = "is_one")]
    pub environments: u32,
    /// The length of a window: a whole number of periods.
    pub window: TimeSpan,
    /// The period T of the reference: a whole number of control steps, and what one error value is averaged over.
    pub period: TimeSpan,
    /// How often plant and controller are updated.
    pub rate: Frequency,
    /// The path that the ball is to follow.
    pub reference: ReferenceSettings,
    /// The ball on the plate.
    pub plant: PlantSettings,
    /// The four PD controllers.
    pub control: ControlSettings,
    /// The links between the three virtual hosts.
    pub network: NetworkSettings,
    /// How the nodes talk to each other.
    pub ros: RosSettings,
    /// What is captured on each virtual host.
    pub capture: CaptureSettings,
    /// What the control loops ask of the operating system.
    pub realtime: RealtimeSettings,
    /// How the programs of plant and controller run.
    pub loops: LoopSettings,
    /// From where on a window is suspect or invalid.
    pub validity: ValiditySettings,
    /// How scenarios of `virtualization: simulated` are computed; others do not have it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulation: Option<SimulationSettings>,
    /// An experiment of the user's own in place of the ball on the plate. In a matrix file it is a section of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(skip))]
    pub experiment: Option<CommandExperiment>,
}

impl Default for Settings {
    fn default() -> Self {
        Self::of(Dynamics::default())
    }
}

impl Settings {
    /// The settings of [`Dynamics::Robust`], of which the others are told by their differences.
    fn of_robust() -> Self {
        Self {
            dynamics: Dynamics::Robust,
            windows: 4,
            environments: 1,
            window: TimeSpan::from_secs(6000),
            period: TimeSpan::from_secs(100),
            rate: Frequency::from_hz(50.0),
            reference: ReferenceSettings::default(),
            plant: PlantSettings::default(),
            control: ControlSettings::default(),
            network: NetworkSettings::default(),
            ros: RosSettings::default(),
            capture: CaptureSettings::default(),
            realtime: RealtimeSettings::default(),
            loops: LoopSettings::default(),
            validity: ValiditySettings::default(),
            simulation: None,
            experiment: None,
        }
    }
}

/// How the nodes talk to each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct RosSettings {
    /// Which program is the ROS master on `h1`.
    pub master: RosMaster,
    /// Whether our subscribers ask for TCP_NODELAY. ROS 1 does not unless told to; at 40 ms round trip Nagle and
    /// delayed acknowledgements are first-order effects.
    pub tcp_nodelay: bool,
    /// What the two topics carry.
    pub messages: Messages,
}

impl Default for RosSettings {
    fn default() -> Self {
        Self {
            master: RosMaster::Embedded,
            tcp_nodelay: true,
            messages: Messages::Rates,
        }
    }
}

/// Which program is the ROS master.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum RosMaster {
    /// The workload's own: nothing has to be installed.
    #[default]
    Embedded,
    /// ROS's, as Debian packages it (`python3-rosmaster`), started and ended with the run.
    Rosmaster,
}

/// What is captured on each virtual host.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CaptureSettings {
    /// Whether there is a capture at all.
    pub enabled: bool,
    /// What captures.
    pub tool: CaptureTool,
    /// Bytes kept of each packet.
    pub snaplen: Bytes,
    /// Which packets are captured, an expression of pcap-filter(7) such as `tcp`; all when it is left out. tcpdump
    /// must be installed where the workload runs, since it makes the kernel's program of the expression.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
}

/// What captures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum CaptureTool {
    /// A packet socket of the workload's own.
    Builtin,
    /// tcpdump, as in the paper; it must be installed where the workload runs.
    Tcpdump,
}

impl Default for CaptureSettings {
    fn default() -> Self {
        Self {
            enabled: true,
            tool: CaptureTool::Builtin,
            snaplen: Bytes::new(65_535),
            filter: None,
        }
    }
}

/// What the control loops ask of the operating system. What was granted is in `environment.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeSettings {
    /// SCHED_FIFO priority of the control loops, 1 to 99, or 0 for the ordinary scheduler.
    pub priority: u8,
    /// Whether memory is locked.
    pub lock_memory: bool,
}

impl Default for RealtimeSettings {
    fn default() -> Self {
        Self {
            priority: 80,
            lock_memory: true,
        }
    }
}

/// How the programs of plant and controller run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct LoopSettings {
    /// What becomes of ticks that fall due while an earlier one has not ended.
    pub late_ticks: LateTicks,
    /// How the controller's thread waits for its next tick. The plant's always sleeps.
    pub controller_waits: Waiting,
    /// Where ROS master, controller and plant run.
    pub processes: Processes,
}

impl Default for LoopSettings {
    fn default() -> Self {
        Self {
            late_ticks: LateTicks::CaughtUp,
            controller_waits: Waiting::Sleep,
            processes: Processes::Threads,
        }
    }
}

/// One environment is what earlier versions had, whose records do not say so.
#[allow(clippy::trivially_copy_pass_by_ref)] // As serde calls it.
fn is_one(environments: &u32) -> bool {
    *environments == 1
}

/// Replicates. Windows are numbered through a scenario: with four windows, those of its second environment are 5 to 8.
impl Settings {
    /// Environments of a scenario: the smallest p of ten rounds is below 0.002, and more cost time only.
    pub const MOST_ENVIRONMENTS: u32 = 1000;

    /// How many windows are measured in all environments.
    #[must_use]
    pub const fn all_windows(&self) -> u32 {
        self.windows.saturating_mul(self.environments)
    }

    /// The numbers of the windows of the environment of a round, from 1.
    #[must_use]
    pub const fn windows_of_round(&self, round: u32) -> RangeInclusive<u32> {
        let before = self.windows.saturating_mul(round.saturating_sub(1));
        before.saturating_add(1)..=before.saturating_add(self.windows)
    }

    /// The round, from 1, whose environment measures a window.
    #[must_use]
    pub fn round_of(&self, window: u32) -> u32 {
        let before = window.saturating_sub(1).checked_div(self.windows);
        before.unwrap_or(0).saturating_add(1)
    }
}

impl Settings {
    /// How long a window takes: exactly, or at most where a command decides it.
    #[must_use]
    pub fn longest_window(&self) -> TimeSpan {
        self.experiment
            .as_ref()
            .map_or(self.window, |experiment| experiment.window.longest())
    }

    /// The network that the experiment emulates; none of a command that is on none.
    #[must_use]
    pub fn network_in_use(&self) -> Option<&NetworkSettings> {
        let is_in_use = self.experiment.as_ref().is_none_or(|it| !it.nodes.is_empty());
        is_in_use.then_some(&self.network)
    }

    /// The ROS master that the experiment has, if it has one.
    #[must_use]
    pub fn master_in_use(&self) -> Option<RosMaster> {
        match &self.experiment {
            None => Some(self.ros.master),
            Some(experiment) => experiment.ros_master.map(|master| master.program),
        }
    }

    /// Control steps in one period.
    #[must_use]
    pub fn steps_per_period(&self) -> u64 {
        (self.period.as_secs_f64() * self.rate.hz()).round() as u64
    }

    /// Periods in one window, which is the size of the sample it gives.
    #[must_use]
    pub fn periods_per_window(&self) -> u64 {
        if self.period.as_nanos() == 0 {
            0
        } else {
            self.window.as_nanos() / self.period.as_nanos()
        }
    }

    /// Control steps in one window.
    #[must_use]
    pub fn steps_per_window(&self) -> u64 {
        self.periods_per_window() * self.steps_per_period()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_have_the_papers_windows_and_fit_together() {
        let settings = Settings::default();
        assert_eq!(settings.problems(), Vec::new());
        assert_eq!(settings.periods_per_window(), 60);
        assert_eq!(settings.steps_per_window(), 300_000);
    }

    #[rstest::rstest]
    #[case("50Hz", 300_000, 0)]
    #[case("30Hz", 180_000, 60_000)]
    #[case("70Hz", 420_000, 120_000)]
    #[case("333Hz", 1_998_000, 6_000)]
    #[case("999Hz", 5_994_000, 6_000)]
    fn a_long_window_has_all_its_steps_though_a_step_is_whole_nanoseconds(
        #[case] rate: &str,
        #[case] steps: u64,
        #[case] short_by_ns: u64,
    ) {
        let settings = Settings {
            rate: rate.parse().unwrap(),
            ..Settings::default()
        };
        assert_eq!(settings.steps_per_window(), steps);
        let lasts_ns = steps * settings.rate.step().as_nanos() as u64;
        assert_eq!(lasts_ns.abs_diff(6_000_000_000_000), short_by_ns);
    }

    #[test]
    fn settings_read_back_as_they_were_written() {
        let settings = Settings::default();
        let text = serde_json::to_string(&settings).unwrap();
        assert!(text.contains(r#""delay":"10ms""#), "{text}");
        assert_eq!(serde_json::from_str::<Settings>(&text).unwrap(), settings);
    }
}
