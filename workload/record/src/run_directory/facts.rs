//! What providers say of the environments that they make: the `facts` of `environment.json`. The main module is [`fact`].
//!
//! Each provider has facts of its own, and one from outside this workspace has any: as a whole they are a free map. Here are
//! those that a reader knows: their names, and types where a fact has fields that a reader knows.

use serde::{Deserialize, Serialize};

/// Names of facts.
pub mod fact {
    /// The box that a virtual machine was made of: a [`super::VagrantBox`].
    pub const BOX: &str = "box";
    /// The id of a container, in records of earlier versions.
    pub const CONTAINER: &str = "container";
    /// What a Docker Engine makes containers with: [`super::EngineParts`].
    pub const ENGINE_PARTS: &str = "engine_parts";
    /// The version of a Docker Engine.
    pub const ENGINE_VERSION: &str = "engine_version";
    /// The id of a container's image.
    pub const IMAGE_ID: &str = "image_id";
    /// The batch system whose job measured, with its version.
    pub const BATCH_SYSTEM: &str = "batch_system";
    /// The number of that job.
    pub const JOB: &str = "job";
    /// The node that a batch system gave, by its name there.
    pub const NODE: &str = "node";
    /// What the batch system was asked for: options of `sbatch`.
    pub const JOB_WISHES: &str = "job_wishes";
    /// The version of libvirt.
    pub const LIBVIRT: &str = "libvirt";
    /// The provider's name. The record has it, too.
    pub const PROVIDER: &str = "provider";
    /// The version of QEMU.
    pub const QEMU: &str = "qemu";
    /// The version of VirtualBox.
    pub const VIRTUALBOX: &str = "virtualbox";
    /// SHA-256 of the workload's program, in hexadecimal.
    pub const WORKLOAD_SHA256: &str = "workload_sha256";
}

/// What a Docker Engine makes containers with, by its own words; none where it does not say.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EngineParts {
    /// How the layers of images become one file system, such as `overlay2`.
    pub storage_driver: Option<String>,
    /// The runtime of containers that name none, such as `runc`.
    pub default_runtime: Option<String>,
    /// The version of runc.
    pub runc_version: Option<String>,
    /// The version of containerd.
    pub containerd_version: Option<String>,
    /// The version of the host's control groups: `1` or `2`.
    pub cgroup_version: Option<String>,
    /// Who makes control groups: `cgroupfs` or `systemd`.
    pub cgroup_driver: Option<String>,
    /// What stands between containers and the host, such as `name=apparmor`, `name=userns` or `name=rootless`.
    pub security_options: Vec<String>,
}

/// The box that a virtual machine was made of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct VagrantBox {
    /// The name by which Vagrant knows it, such as `matrix/debian-12`.
    pub name: String,
    /// Its version; `0` of a box that was made here.
    pub version: String,
    /// SHA-256 of the list of its files with theirs, in hexadecimal; none where it could not be had.
    pub sha256: Option<String>,
}
