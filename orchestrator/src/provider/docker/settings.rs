//! What a matrix file can say of containers: `providers.docker`. The main type is [`DockerSettings`].

use std::{fmt, path::Path};

use record::quantity::{Bytes, TimeSpan};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, de::DeserializeOwned};

use super::{folders::DATA, recipe::Recipe};
use crate::provider::{AskedRight, ProviderError};

/// What `virtualization` calls the provider.
pub const NAME: &str = "docker";

/// How containers are made. Without any of it, the image is the workload's own and nothing is limited.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DockerSettings {
    /// An image that the engine has already, for instance `debian:12`, to run the workload in. The workload is copied
    /// into the container, so that any Linux image of the host's architecture does. It is never pulled: a run must not
    /// depend on what a registry answers today. Left out, an image with nothing but the workload is built.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "image")]
    pub image: Option<String>,
    /// What to make an image of, in place of `image`: packages of Debian 12. It is made once, when the first container needs it, and known by
    /// its packages. It takes root here, mmdebstrap, and an engine for this machine's architecture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recipe: Option<Recipe>,
    /// A program of the image with its arguments, such as `[with-openvswitch]`. The workload's own command line follows
    /// them, and the program becomes it when it has done what it is for (`exec "$@"` of a shell).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub entrypoint: Vec<String>,
    /// Rights of the container's processes beside the six that every container of ours has, such as `[SETGID]`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub capabilities: Vec<Capability>,
    /// System calls beside those that the programs of every container of ours have: `[mount]` for Mininet. Who controls the
    /// image then controls the engine's host, unless AppArmor, SELinux or a user namespace is in the way.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub system_calls: Vec<SystemCalls>,
    /// Folders of the container that can be written, such as `[/run, /tmp]`: each is empty and in memory. All others but
    /// the data's are read only.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub writable: Vec<Folder>,
    /// The AppArmor profile of the containers, such as `unconfined`; the engine's own when left out, which lets no process
    /// mount anything, whatever capabilities it has. Without effect where the engine's host has no AppArmor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub apparmor: Option<String>,
    /// How many processors a container may use, such as `1.5`; all of them when left out.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "cpus")]
    pub cpus: Option<f64>,
    /// The processors a container may use, such as `0-1,3`; all of them when left out.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "cpuset")]
    pub cpuset: Option<String>,
    /// How much memory a container may use; three quarters of the machine's when left out.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "memory")]
    pub memory: Option<Bytes>,
    /// How much of each second the loops may run with real-time priority, such as `900ms`. Needed, and possible, only
    /// where the kernel divides real-time among groups (RT_GROUP_SCHED, cgroup v1) and the engine was started with
    /// `--cpu-rt-runtime`. Where the priority is refused, the workload records it and goes on without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub realtime_runtime: Option<TimeSpan>,
}

/// What the workload is put on in a container.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Base<'a> {
    /// Nothing: an image that has the workload and no other program.
    Nothing,
    /// An image that the engine has.
    Image(&'a str),
    /// One that is made of packages.
    Recipe(&'a Recipe),
}

impl DockerSettings {
    /// What the workload is put on.
    ///
    /// # Errors
    /// If the settings name two images: which of them is meant, nobody can tell.
    pub fn base(&self) -> Result<Base<'_>, ProviderError> {
        match (&self.image, &self.recipe) {
            (None, None) => Ok(Base::Nothing),
            (Some(image), None) => Ok(Base::Image(image)),
            (None, Some(recipe)) => Ok(Base::Recipe(recipe)),
            (Some(_), Some(_)) => Err(ProviderError::Unsupported {
                provider: NAME.to_owned(),
                reason: "providers.docker has an `image` and a `recipe` to make one of".to_owned(),
                hint: Some("take one of them out".to_owned()),
            }),
        }
    }
}

/// What a container's programs may call only where a matrix file asks for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SystemCalls {
    /// `mount` and `umount`, and namespaces of every kind: Mininet gives each of its hosts a `/sys` of its own.
    Mount,
}

impl SystemCalls {
    /// Their names for a seccomp profile.
    #[must_use]
    pub const fn names(self) -> &'static [&'static str] {
        match self {
            Self::Mount => &["mount", "umount", "umount2", "unshare", "setns"],
        }
    }
}

impl fmt::Display for SystemCalls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mount => "mount",
        })
    }
}

impl DockerSettings {
    /// What containers may do beyond what every container of ours may.
    #[must_use]
    pub fn asked_rights(&self) -> Vec<AskedRight> {
        let list = |asked: Vec<String>| (!asked.is_empty()).then(|| asked.join(", "));
        let rights = [
            (
                "providers.docker.capabilities",
                list(self.capabilities.iter().map(ToString::to_string).collect()),
                "rights of root's (capabilities(7)) for the programs of the image",
            ),
            (
                "providers.docker.system_calls",
                list(self.system_calls.iter().map(ToString::to_string).collect()),
                "who controls the image controls the engine's host, unless AppArmor, SELinux or a user namespace is in the way",
            ),
            (
                "providers.docker.apparmor",
                self.apparmor.clone(),
                "the programs of the image are confined by this profile of AppArmor and not by the engine's",
            ),
        ];
        let asked = rights.into_iter();
        asked
            .filter_map(|(setting, asked, means)| {
                Some(AskedRight {
                    setting,
                    asked: asked?,
                    means,
                })
            })
            .collect()
    }
}

/// More processors no machine has.
const MOST_CPUS: f64 = 65_536.0;
/// An engine refuses less.
const LEAST_MEMORY: u64 = 6 << 20;

fn image<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    // The name stands in an address of the engine's API.
    let is_name = |it: &String| {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-/:@".contains(&byte);
        it.len() <= 255 && it.bytes().all(plain) && it.starts_with(|it: char| it.is_ascii_alphanumeric())
    };
    checked(
        from,
        is_name,
        "is not the name of an image: write one such as `debian:12`",
    )
}

fn cpus<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    // Of a NaN an engine makes no limit.
    let is_number = |it: &f64| (0.01..=MOST_CPUS).contains(it);
    checked(
        from,
        is_number,
        "is no number of processors: write one from 0.01 on, such as `1.5`",
    )
}

fn cpuset<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    let is_range = |it: &str| {
        let number =
            |it: &str| !it.is_empty() && it.len() <= 5 && it.bytes().all(|byte| byte.is_ascii_digit());
        match it.split_once('-') {
            Some((first, last)) => number(first) && number(last),
            None => number(it),
        }
    };
    let is_set = |it: &String| it.len() <= 1000 && it.split(',').all(is_range);
    checked(
        from,
        is_set,
        "is no list of processors: write one such as `0-1,3`",
    )
}

fn memory<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Bytes>, D::Error> {
    let is_enough = |it: &Bytes| it.get() >= LEAST_MEMORY;
    checked(
        from,
        is_enough,
        "is less than a container can have: write `6MiB` or more",
    )
}

/// Reads what may be left out and is otherwise right.
fn checked<'de, T, D>(from: D, is_right: impl Fn(&T) -> bool, wrong: &str) -> Result<Option<T>, D::Error>
where
    T: DeserializeOwned + fmt::Display,
    D: Deserializer<'de>,
{
    match Option::<T>::deserialize(from)? {
        Some(given) if !is_right(&given) => Err(serde::de::Error::custom(format!("`{given}` {wrong}"))),
        given => Ok(given),
    }
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
    #[case(r#"{"cpus": 1.5}"#, true)]
    #[case(r#"{"cpus": 0}"#, false)]
    #[case(r#"{"cpus": -1}"#, false)]
    #[case(r#"{"cpus": 1e300}"#, false)]
    #[case(r#"{"cpuset": "0-1,3"}"#, true)]
    #[case(r#"{"cpuset": "0; rm"}"#, false)]
    #[case(r#"{"cpuset": ""}"#, false)]
    #[case(r#"{"memory": "512MiB"}"#, true)]
    #[case(r#"{"memory": "0B"}"#, false)]
    #[case(r#"{"image": "registry.example.org:5000/a/b:1.0"}"#, true)]
    #[case(r#"{"image": "debian@sha256:0123"}"#, true)]
    #[case(r#"{"image": "../../containers/x/kill?"}"#, false)]
    #[case(r#"{"image": "a b"}"#, false)]
    #[case(r#"{"recipe": {"packages": ["python3"]}}"#, true)]
    #[case(r#"{"recipe": {"packages": ["$(reboot)"]}}"#, false)]
    #[case(r#"{"recipe": {"package": ["python3"]}}"#, false)]
    fn what_an_engine_would_take_for_something_else_is_refused(#[case] given: &str, #[case] is_right: bool) {
        assert_eq!(serde_json::from_str::<DockerSettings>(given).is_ok(), is_right);
    }

    #[test]
    fn what_a_file_asks_for_is_listed_and_an_ordinary_one_asks_for_nothing() {
        assert_eq!(DockerSettings::default().asked_rights(), []);
        let settings: DockerSettings = serde_yaml::from_str(
            "{capabilities: [SETGID, CHOWN], system_calls: [mount], apparmor: unconfined, writable: [/run]}",
        )
        .unwrap();
        let asked: Vec<_> = settings
            .asked_rights()
            .into_iter()
            .map(|right| (right.setting, right.asked))
            .collect();
        let wanted = [
            ("providers.docker.capabilities", "SETGID, CHOWN"),
            ("providers.docker.system_calls", "mount"),
            ("providers.docker.apparmor", "unconfined"),
        ];
        assert_eq!(asked, wanted.map(|(setting, asked)| (setting, asked.to_owned())));
        assert!(serde_yaml::from_str::<DockerSettings>("system_calls: [bpf]").is_err());
    }

    #[test]
    fn no_number_is_no_number_of_processors() {
        let wrong = serde_yaml::from_str::<DockerSettings>("cpus: .nan").unwrap_err();
        assert!(
            wrong.to_string().contains("is no number of processors"),
            "{wrong}"
        );
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
