//! What the platform was, as seen from inside the environment: the `platform` part of `environment.json`.
//! The main type is [`PlatformRecord`].

use serde::{Deserialize, Serialize};

use crate::settings::RosMaster;

/// The platform as the workload sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlatformRecord {
    /// [`super::FORMAT`] at the time of writing.
    pub format: u32,
    /// As `uname -m` says it.
    pub machine: String,
    /// `ID` and `VERSION_ID` of os-release, such as `debian-12`; empty in an image without one.
    pub os: String,
    /// As `uname -r`.
    pub kernel: String,
    /// As `uname -v`.
    pub kernel_build: String,
    /// The kernel's command line.
    pub kernel_command_line: Option<String>,
    /// As `uname -n`.
    pub hostname: String,
    /// The processor's model name.
    pub cpu_model: Option<String>,
    /// Processors that this process may use.
    pub cpus_allowed: u32,
    /// The frequency governor of the first of them.
    pub cpu_governor: Option<String>,
    /// The kernel's clock source.
    pub clock_source: Option<String>,
    /// Resolution of the monotonic clock.
    pub clock_resolution_ns: i64,
    /// Memory of the machine.
    pub memory_total_bytes: Option<u64>,
    /// Memory available at the start.
    pub memory_available_bytes: Option<u64>,
    /// Load average of the last minute at the start.
    pub load_1min: Option<f64>,
    /// Whether a hypervisor is visible from inside.
    pub hypervisor: Option<bool>,
    /// The workload's version.
    pub workload_version: String,
    /// The ROS master that was used, as the workload of a run knows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_master: Option<RosMasterRecord>,
    /// What the operating system granted of what the loops asked for.
    pub realtime: RealtimeGrant,
}

/// The ROS master of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RosMasterRecord {
    /// Which program it is.
    pub program: RosMaster,
    /// Its version: the workload's own for the embedded one.
    pub version: Option<String>,
}

/// What was granted of the real-time wishes. Never silently absent: a refusal carries the kernel's words.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeGrant {
    /// Priority that was asked for, 0 for none.
    pub priority_asked: u8,
    /// Priority that was granted, 0 for the ordinary scheduler.
    pub priority_granted: u8,
    /// Why the priority was refused.
    pub priority_refusal: Option<String>,
    /// Whether memory was to be locked.
    pub lock_asked: bool,
    /// Whether it is.
    pub locked: bool,
    /// Why it is not.
    pub lock_refusal: Option<String>,
}
