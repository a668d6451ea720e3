//! An experiment of the user's own: the `experiment:` section of a matrix file. It is a command that is run for each window; what it
//! writes is the window's sample. docs/your-experiment.md is the user's description. The main type is [`CommandExperiment`].

mod argument;
mod metric;
mod node;
mod problems;
mod values;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

pub use self::{
    argument::{Argument, Placeholder, Values, WindowValues},
    metric::{Compare, Metric},
    node::{NodeSettings, Ready, RosMasterSettings},
    values::{MOST_VALUES, ValueError, read_values},
};
use crate::{layout, name::name, quantity::TimeSpan, topology::Topology};

/// A command, what it needs, and what it measures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CommandExperiment {
    /// Its name, in reports and in files.
    #[serde(deserialize_with = "name")]
    pub name: String,
    /// Files and folders of the command, relative to the folder of the matrix file. They are copied into each environment, where the
    /// commands are run beside them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<String>,
    /// A command that is run once in each environment, before its windows: a program and its arguments, without a shell.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub prepare: Vec<Argument>,
    /// A command that is run once in each environment, after its windows, whatever became of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub restore: Vec<Argument>,
    /// How often `matrix` measures the missing windows of an errored scenario again, each time in a new environment. A window that was
    /// measured is never measured again.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub retries: u32,
    /// Whether the first window that does not count ends its scenario, which then has failed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub fail_fast: bool,
    /// The command that is run for each window: a program and its arguments, without a shell. Exit code 0 makes a window.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub run: Vec<Argument>,
    /// Programs that are started in each window on hosts of an emulated network, in place of `run`. The window ends with the last of
    /// those that are not in the background.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeSettings>,
    /// A ROS master for the nodes, started anew in each window. Left out, there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_master: Option<RosMasterSettings>,
    /// What a window is.
    #[serde(default)]
    pub window: CommandWindow,
    /// Values for `{parameters.NAME}`. Each can be an axis, as `parameters.NAME`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "BTreeMap<String, argument::Scalar>"))]
    pub parameters: BTreeMap<String, String>,
    /// What is measured, at least one.
    pub metrics: Vec<Metric>,
}

/// A window of a command: one call, or a stretch of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CommandWindow {
    /// How long the command may take. One that takes longer is ended with all that it started, and its window does not count.
    pub timeout: TimeSpan,
    /// Whether one call lasts for all windows of an environment. A window then has the rows that were added to the metrics' files in
    /// its time, and the call is asked to end after the last.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub continuous: bool,
    /// How long a window of a continuous command is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length: Option<TimeSpan>,
}

impl CommandWindow {
    /// How long a window takes at most.
    #[must_use]
    pub fn longest(&self) -> TimeSpan {
        self.length.unwrap_or(self.timeout)
    }
}

impl Default for CommandWindow {
    fn default() -> Self {
        Self {
            timeout: TimeSpan::from_secs(600),
            continuous: false,
            length: None,
        }
    }
}

/// The path of each setting that a problem may be about.
const PREFIX: &str = "experiment";

impl CommandExperiment {
    /// The name of the section in a matrix file, and of the setting.
    pub const SECTION: &str = PREFIX;
    /// It is handed to the workload as an argument of a program, which the kernel bounds by 128 KiB.
    const LONGEST: usize = 48 << 10;
    /// A file that a metric is read from is no longer, in bytes.
    pub const LONGEST_FILE: u64 = 1 << 30;
    /// A line of a file with values is no longer, in bytes.
    pub const LONGEST_LINE: u64 = 1 << 20;
    /// More retries hide a machine that does not work.
    const MOST_RETRIES: u32 = 10;
    /// A window is cut by a process that sleeps: some milliseconds are no window.
    const SHORTEST: TimeSpan = TimeSpan::from_millis(100);
    /// More files, arguments, parameters or metrics no experiment has.
    pub const MOST: usize = 100;

    /// How long a command may take if nothing is said.
    #[must_use]
    pub fn default_timeout() -> TimeSpan {
        CommandWindow::default().timeout
    }

    /// The files of a window beside its record that `matrix` writes, on that network.
    #[must_use]
    pub fn files_of_matrix(&self, topology: &Topology) -> BTreeSet<String> {
        if self.nodes.is_empty() {
            return [layout::STDOUT, layout::STDERR].map(str::to_owned).into();
        }
        let printed = self.nodes.iter().flat_map(|node| layout::printed_by(&node.name));
        printed
            .chain(topology.names().map(|host| layout::capture(&host)))
            .collect()
    }

    /// The names of the files that its metrics are read from, each once.
    #[must_use]
    pub fn measured_files(&self) -> BTreeSet<&str> {
        self.metrics.iter().map(|metric| metric.from.as_str()).collect()
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
const fn is_zero(retries: &u32) -> bool {
    *retries == 0
}

/// The seed of a window, for `{window.seed}`: from 0 to 2³¹ − 1, the same for windows of the same number in every scenario, so that
/// what they compute can be compared byte for byte.
#[must_use]
pub const fn seed_of(window: u32) -> u32 {
    // SplitMix64's finalizer (Steele, Lea and Flood, 2014): neighbouring windows have seeds that have nothing in common.
    let mut z = (window as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 33) as u32
}

#[cfg(test)]
mod tests;
