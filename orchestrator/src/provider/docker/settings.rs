//! What a matrix file can say of containers: `providers.docker`. The main type is [`DockerSettings`].

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use workload::quantity::{Bytes, TimeSpan};

/// How containers are made. Without any of it, the image is the workload's own and nothing is limited.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DockerSettings {
    /// An image that the engine has already, for instance `debian:12`, to run the workload in. The workload is copied
    /// into the container, so that any Linux image of the host's architecture does. It is never pulled: a run must not
    /// depend on what a registry answers today. Left out, an image with nothing but the workload is built.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<String>,
    /// How many processors a container may use, such as `1.5`; all of them when left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpus: Option<f64>,
    /// The processors a container may use, such as `0-1,3`; all of them when left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpuset: Option<String>,
    /// How much memory a container may use; all of it when left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<Bytes>,
    /// How much of each second the loops may run with real-time priority, such as `900ms`. Needed, and possible, only
    /// where the kernel divides real-time among groups (RT_GROUP_SCHED, cgroup v1) and the engine was started with
    /// `--cpu-rt-runtime`. Where the priority is refused, the workload records it and goes on without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub realtime_runtime: Option<TimeSpan>,
}
