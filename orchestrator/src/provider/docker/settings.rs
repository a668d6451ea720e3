//! What a matrix file can say of containers: `providers.docker`. The main type is [`DockerSettings`].

use std::{fmt, path::Path};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use workload::quantity::{Bytes, TimeSpan};

use super::container::DATA;

/// How containers are made. Without any of it, the image is the workload's own and nothing is limited.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DockerSettings {
    /// An image that the engine has already, for instance `debian:12`, to run the workload in. The workload is copied
    /// into the container, so that any Linux image of the host's architecture does. It is never pulled: a run must not
    /// depend on what a registry answers today. Left out, an image with nothing but the workload is built.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<String>,
    /// A program of the image with its arguments, such as `[with-openvswitch]`. The workload's own command line follows
    /// them, and the program becomes it when it has done what it is for (`exec "$@"` of a shell).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub entrypoint: Vec<String>,
    /// Rights of the container's processes beside the five that every container of ours has, such as `[SETGID]`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub capabilities: Vec<Capability>,
    /// Folders of the container that can be written, such as `[/run, /tmp]`: each is empty and in memory. All others but
    /// the data's are read only.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub writable: Vec<Folder>,
    /// The AppArmor profile of the containers, such as `unconfined`; the engine's own when left out, which lets no process
    /// mount anything, whatever capabilities it has. Without effect where the engine's host has no AppArmor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub apparmor: Option<String>,
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

/// A part of root's rights, by its name in capabilities(7) without `CAP_`, such as `SETGID`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
pub struct Capability(String);

/// Those of Linux 5.9 and later.
const CAPABILITIES: &str = "AUDIT_CONTROL AUDIT_READ AUDIT_WRITE BLOCK_SUSPEND BPF CHECKPOINT_RESTORE CHOWN DAC_OVERRIDE \
    DAC_READ_SEARCH FOWNER FSETID IPC_LOCK IPC_OWNER KILL LEASE LINUX_IMMUTABLE MAC_ADMIN MAC_OVERRIDE MKNOD NET_ADMIN \
    NET_BIND_SERVICE NET_BROADCAST NET_RAW PERFMON SETFCAP SETGID SETPCAP SETUID SYSLOG SYS_ADMIN SYS_BOOT SYS_CHROOT \
    SYS_MODULE SYS_NICE SYS_PACCT SYS_PTRACE SYS_RAWIO SYS_RESOURCE SYS_TIME SYS_TTY_CONFIG WAKE_ALARM";

/// Why a text is no capability or no folder.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// No capability has this name.
    #[error("`{0}` is not a capability: write its name in capabilities(7) without `CAP_`, such as `SETGID`")]
    Capability(String),
    /// Not an absolute path in its plain form.
    #[error("`{0}` is not the path of a folder: write it from the root on, such as `/run`")]
    Folder(String),
    /// What the container has there would be gone.
    #[error("`{0}` must stay as it is: name a folder that is the program's own, such as `/run`")]
    Taken(String),
}

impl TryFrom<String> for Capability {
    type Error = Refusal;

    fn try_from(name: String) -> Result<Self, Refusal> {
        match CAPABILITIES.split_whitespace().any(|known| known == name) {
            true => Ok(Self(name)),
            false => Err(Refusal::Capability(name)),
        }
    }
}

impl fmt::Display for Capability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The path of a folder in the container, from its root on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
pub struct Folder(String);

impl TryFrom<String> for Folder {
    type Error = Refusal;

    fn try_from(text: String) -> Result<Self, Refusal> {
        let path = Path::new(&text);
        let plain: std::path::PathBuf = path.components().collect();
        if !path.is_absolute() || plain.as_os_str() != text.as_str() || text.contains("/..") {
            return Err(Refusal::Folder(text));
        }
        let taken = ["/proc", "/sys", "/dev", DATA];
        if text == "/" || taken.iter().any(|taken| path.starts_with(taken)) {
            return Err(Refusal::Taken(text));
        }
        Ok(Self(text))
    }
}

impl fmt::Display for Folder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("SETGID", true)]
    #[case("CAP_SETGID", false)]
    #[case("setgid", false)]
    #[case("ALL", false)]
    #[case("", false)]
    fn a_capability_is_one_of_linuxs(#[case] name: &str, #[case] is_one: bool) {
        assert_eq!(Capability::try_from(name.to_owned()).is_ok(), is_one);
    }

    #[rstest::rstest]
    #[case::folder("/run", None)]
    #[case::deeper("/var/log/openvswitch", None)]
    #[case::relative("run", Some("is not the path of a folder"))]
    #[case::upwards("/run/../etc", Some("is not the path of a folder"))]
    #[case::slash_at_the_end("/run/", Some("is not the path of a folder"))]
    #[case::everything("/", Some("must stay as it is"))]
    #[case::kernels("/proc/sys", Some("must stay as it is"))]
    #[case::data("/data", Some("must stay as it is"))]
    fn a_folder_is_a_plain_path_and_not_one_that_is_taken(#[case] text: &str, #[case] refusal: Option<&str>) {
        let folder = Folder::try_from(text.to_owned());
        assert_eq!(folder.is_ok(), refusal.is_none());
        if let (Err(error), Some(words)) = (folder, refusal) {
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
