//! What `workload check` prints: whether this place can run the experiment. The main type is [`CheckRecord`].

use serde::{Deserialize, Serialize};

/// Whether the experiment can run here, and what was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CheckRecord {
    /// [`super::FORMAT`] at the time of writing.
    pub format: u32,
    /// The workload's version.
    pub workload_version: String,
    /// Whether nothing that is required is missing.
    pub can_run: bool,
    /// One for each thing that was looked at.
    pub checks: Vec<Check>,
}

/// One thing that the experiment needs or would like.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Check {
    /// Its name: `network`, `ros-master`, `capture`, `realtime-priority`, `memory-lock`; of a cluster's node also `clock`, `engine` and
    /// `hardware-and-os`.
    pub name: String,
    /// Whether the experiment cannot run without it. What is not required and missing is recorded with the results.
    pub required: bool,
    /// Whether it can be had.
    pub available: bool,
    /// Why not, when it cannot.
    pub reason: Option<String>,
    /// What would make it available, where that is known.
    pub fix: Option<String>,
}
