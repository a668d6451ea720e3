//! The settings of the experiment: the `workload:` section of a matrix file. docs/paper.md says where each default comes
//! from.
//!
//! The same types are read from the matrix file, kept in the manifest and handed to the workload, so that one spelling
//! serves all three. The main type is [`Settings`]; [`Settings::problems`] says what does not fit together.

mod backend;
mod dynamics;
mod need;
mod simulation;
pub mod validity;

use std::{borrow::Cow, ops::RangeInclusive};

use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

pub use self::{
    backend::{BackendFacts, NetworkBackend, Refusal},
    dynamics::{
        Discretization, Dynamics, Feedback, LateTicks, Messages, PlantSends, Processes, Rates, ReferenceBy,
        StepOrder, Waiting, asked_for, recorded,
    },
    need::Need,
    simulation::SimulationSettings,
    validity::{Limit, Limits, ValiditySettings},
};
use crate::{
    experiment::CommandExperiment,
    platform_model::PlatformModel,
    quantity::{BitRate, Bytes, Fraction, Frequency, TimeSpan},
    topology::{self, Link, LinkSettings, Topology, Wanted},
    virtual_host::VirtualHost,
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

/// The path `x = a cos(2πft) sin(4πft)`, `y = a cos(2πft) sin(2πft)` with `f = 1/period`, in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ReferenceSettings {
    /// The amplitude `a`, in metres.
    pub amplitude_m: f64,
    /// What it is evaluated at.
    pub by: ReferenceBy,
}

impl Default for ReferenceSettings {
    fn default() -> Self {
        Self {
            amplitude_m: 2.0,
            by: ReferenceBy::Step,
        }
    }
}

/// The plant, one for each axis. The paper's is `Y/U = 1 / (16 s (b1 s + b0))`, `X/Y = -7 / s²`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PlantSettings {
    /// The motor's `b1`.
    pub b1: f64,
    /// The motor's `b0`.
    pub b0: f64,
    /// The plate tilts this far each way, in degrees: a sixteenth of what the motor's shaft turns.
    pub angle_limit_deg: f64,
    /// The ball meets the rim at this distance from the centre, in metres.
    pub position_limit_m: f64,
    /// How motor and ball go from one step to the next.
    pub discretization: Discretization,
    /// When the plant publishes its state.
    pub sends: PlantSends,
}

impl Default for PlantSettings {
    fn default() -> Self {
        Self {
            b1: 0.01176,
            b0: 0.58823,
            angle_limit_deg: 32.0,
            position_limit_m: 3.1,
            discretization: Discretization::ZeroOrderHold,
            sends: PlantSends::OnTick,
        }
    }
}

/// The gains, the same for both axes, and when the controller ticks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ControlSettings {
    /// Ball position to wanted plate angle.
    pub position: PdGains,
    /// Motor shaft angle (16 × the plate's) to motor voltage.
    pub angle: PdGains,
    /// How long after the plant's tick the controller's comes. It decides how many steps old the state is that the
    /// controller sees, so it is a setting and not a matter of which process started first.
    pub phase: TimeSpan,
    /// Where the rates come from.
    pub rates: Rates,
    /// The sign with which the inner loop takes the shaft's rate.
    pub angle_rate_feedback: Feedback,
    /// The wanted plate angle, before the gear, is cut to this many degrees each way; `never` for no limit.
    pub wanted_limit_deg: Limit<f64>,
    /// What comes first in a step.
    pub order: StepOrder,
}

impl Default for ControlSettings {
    fn default() -> Self {
        Self {
            position: PdGains {
                kp: -1.312,
                kd: 1.299,
            },
            angle: PdGains { kp: 5.79, kd: 0.22 },
            phase: TimeSpan::from_millis(10),
            rates: Rates::Sent,
            angle_rate_feedback: Feedback::Negative,
            wanted_limit_deg: Limit::Never,
            order: StepOrder::TakeFirst,
        }
    }
}

/// The gains of one PD controller; `kd` acts on the measured rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PdGains {
    /// On the error.
    pub kp: f64,
    /// On the measured rate.
    pub kd: f64,
}

/// How the virtual hosts are connected. Delay, jitter, loss and rate are applied at both ends of each link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct NetworkSettings {
    /// What carries the packets.
    pub backend: NetworkBackend,
    /// Mean delay of one pass through a link's end.
    pub delay: TimeSpan,
    /// Uniform on [delay − jitter, delay + jitter).
    pub jitter: TimeSpan,
    /// Share of packets lost at one pass through a link's end, each independently.
    pub loss: Fraction,
    /// Rate of one pass through a link's end.
    pub bandwidth: BitRate,
    /// How many packets a link's end holds before it drops (netem's `limit`).
    pub limit_packets: u32,
    /// From when on the links are impaired.
    pub impaired_from: ImpairedFrom,
    /// What the hosts' interfaces do for TCP, where they are the kernel's.
    pub offloads: Offloads,
    /// Seed of the losses and the jitter, of the `userspace` network only. When it is left out, each environment draws its own and `window.json` has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The virtual hosts, each with its link to a switch. Their addresses are 10.0.0.1, 10.0.0.2 and so on in this order. Left out,
    /// they are h1, sta1 and sta2.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::collections::BTreeMap<String, LinkSettings>")
    )]
    pub hosts: IndexMap<VirtualHost, LinkSettings>,
    /// The switches, each but the first with its link to one before it. Left out, there is one.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::collections::BTreeMap<String, LinkSettings>")
    )]
    pub switches: IndexMap<VirtualHost, LinkSettings>,
}

impl NetworkSettings {
    /// Who is connected to whom.
    #[must_use]
    pub fn topology(&self) -> Topology {
        Topology::of(&self.wanted(&self.link()))
    }

    pub(crate) const fn wanted<'a>(&'a self, link: &'a Link) -> Wanted<'a> {
        Wanted {
            hosts: &self.hosts,
            switches: &self.switches,
            link,
        }
    }

    /// What each link does that says nothing of its own.
    #[must_use]
    pub const fn link(&self) -> Link {
        Link {
            delay: self.delay,
            jitter: self.jitter,
            loss: self.loss,
            bandwidth: self.bandwidth,
            limit_packets: self.limit_packets,
        }
    }
}

impl Default for NetworkSettings {
    fn default() -> Self {
        Self {
            backend: NetworkBackend::Userspace,
            delay: TimeSpan::from_millis(10),
            jitter: TimeSpan::from_millis(1),
            loss: Fraction::from_percent(1.0),
            bandwidth: BitRate::from_mbit(10),
            limit_packets: 1000,
            impaired_from: ImpairedFrom::Connection,
            offloads: Offloads::Mininet,
            seed: None,
            hosts: IndexMap::new(),
            switches: IndexMap::new(),
        }
    }
}

/// From when on the links delay, lose and limit. All control steps are after it, either way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum ImpairedFrom {
    /// Once both topics are connected. Registering and connecting take some fifteen messages in a row, 0.3 s on the
    /// paper's links and minutes or for ever on worse ones, and nothing of it is measured. TCP, though, keeps the
    /// shortest round trip that it saw on a connection for 300 s (`tcp_min_rtt_wlen`) and judges reordering by a quarter
    /// of it: it matters where segments follow each other within 10 ms, so not at 50 Hz.
    Connection,
    /// From the beginning, as with Mininet's `TCLink`: registering and connecting meet delay and loss, too.
    Start,
}

/// What an interface of the kernel does for TCP. The TAP devices of `userspace` never do any of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Offloads {
    /// As Mininet leaves veth: TCP hands over up to 64 KiB at once, which netem delays and loses as one packet, and
    /// leaves checksums out, which captures then show.
    Mininet,
    /// None (`ethtool -K … tso off gso off gro off tx off`): every packet on a link is one that Ethernet could carry.
    /// Needs `ethtool`.
    None,
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

    /// Windows of a scenario, each of which is a folder.
    pub const MOST_WINDOWS: u32 = 10_000;

    /// What is wrong with these settings; empty if the experiment can run with them.
    #[must_use]
    pub fn problems(&self) -> Vec<SettingsProblem> {
        let mut problems = Vec::new();
        let mut problem = |path, message: String, hint: String| {
            problems.push(SettingsProblem {
                path: Cow::Borrowed(path),
                message,
                hint,
            });
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
            .map(|(path, message, hint)| SettingsProblem {
                path: format!("simulation.platform.{path}").into(),
                message,
                hint: hint.to_owned(),
            })
    }

    /// What is wrong with the emulated network and its captures.
    fn problems_of_the_network(&self, problems: &mut Vec<SettingsProblem>) {
        let of_the_topology = topology::problems(&self.network.wanted(&self.network.link())).into_iter();
        problems.extend(of_the_topology.map(|(path, message, hint)| SettingsProblem {
            path: format!("network.{path}").into(),
            message,
            hint,
        }));
        let mut problem = |path, message: String, hint: String| {
            problems.push(SettingsProblem {
                path: Cow::Borrowed(path),
                message,
                hint,
            });
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
        let mut problem = |path, message: String, hint: String| {
            problems.push(SettingsProblem {
                path: Cow::Borrowed(path),
                message,
                hint,
            });
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
