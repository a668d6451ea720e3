//! What the platform was, as seen from inside the environment: the `platform` part of `environment.json`.
//! The main type is [`PlatformRecord`].

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{field, settings::RosMaster};

/// The machine that this program was built for, as `uname -m` names it. The kernel may be another's.
pub const MACHINE: &str = if cfg!(target_arch = "x86") {
    "i686"
} else {
    std::env::consts::ARCH
};

/// `ID-VERSION_ID` of an os-release file, such as `debian-12`.
#[must_use]
pub fn os_name(os_release: &str) -> String {
    let value = |name: &str| {
        let line = os_release
            .lines()
            .find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
        line.map(|value| value.trim_matches('"').to_owned())
    };
    let parts = [value("ID"), value("VERSION_ID")];
    parts.into_iter().flatten().collect::<Vec<_>>().join("-")
}

/// `environment.json` as the workload writes it: the platform before the windows, with what it was after them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurveyRecord {
    /// Before the first window.
    #[serde(flatten)]
    pub before: PlatformRecord,
    /// After the last one; none if the run did not come to its end.
    #[serde(default)]
    pub after: Option<PlatformRecord>,
    /// What was no longer as it had been.
    #[serde(default)]
    pub changes: Vec<PlatformChange>,
}

/// Something about the platform that changed while it was measured.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlatformChange {
    /// Dotted path of the field of [`PlatformRecord`].
    pub what: String,
    /// Its value before the windows; none if there was none.
    pub before: Option<String>,
    /// Its value after them.
    pub after: Option<String>,
}

impl fmt::Display for PlatformChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = |value: &Option<String>| {
            value
                .as_ref()
                .map_or_else(|| "nothing".to_owned(), |it| format!("`{it}`"))
        };
        write!(
            f,
            "{} was {} and is {}",
            self.what,
            value(&self.before),
            value(&self.after)
        )
    }
}

/// The platform as the workload sees it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PlatformRecord {
    /// [`super::FORMAT`] at the time of writing.
    pub format: u32,
    /// The kernel's, as `uname -m` says it. A kernel of x86_64 runs the workload for i686 too.
    pub machine: String,
    /// The machine that the workload was built for, by the same names; none in records of earlier versions.
    #[serde(default)]
    pub workload_machine: Option<String>,
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
    /// The processor's microcode.
    #[serde(default)]
    pub cpu_microcode: Option<String>,
    /// Processors of the machine that are online, as the kernel lists them: `0-7`.
    #[serde(default)]
    pub cpus_online: Option<String>,
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
    /// What it calls itself, such as `KVMKVMKVM`, where it does.
    #[serde(default)]
    pub hypervisor_name: Option<String>,
    /// Maker and product of the machine, as its firmware says.
    #[serde(default)]
    pub firmware_machine: Option<String>,
    /// What the process's control groups may use, by the names of the kernel's files.
    #[serde(default)]
    pub cgroup_limits: BTreeMap<String, String>,
    /// Versions of installed packages that matter: libc, Mininet, Open vSwitch, ROS.
    #[serde(default)]
    pub packages: BTreeMap<String, String>,
    /// How the kernel's clock is steered; none where that may not be asked for.
    #[serde(default)]
    pub clock: Option<ClockRecord>,
    /// How the kernel's TCP controls congestion where nothing else is said; the virtual hosts inherit it.
    #[serde(default)]
    pub tcp_congestion_control: Option<String>,
    /// Daemons that were seen to run and steer the clock.
    #[serde(default)]
    pub time_daemons: Vec<String>,
    /// The workload's version.
    pub workload_version: String,
    /// The ROS master that was used, as the workload of a run knows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_master: Option<RosMasterRecord>,
    /// What the workload may do beside what any user's program may; none in records of earlier versions.
    #[serde(default)]
    pub privileges: Option<PrivilegeRecord>,
    /// What the operating system granted of what the loops asked for.
    pub realtime: RealtimeGrant,
}

/// What a workload has of root's rights while it measures (capabilities(7)); a right that one of its threads has it has.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PrivilegeRecord {
    /// Names without `CAP_`, such as `NET_ADMIN`. Those that an ordinary user has in a user namespace of its own count, too.
    pub capabilities: Vec<String>,
    /// What a program that it starts could have at most.
    pub bounding_capabilities: Vec<String>,
    /// Whether a program that it starts gets nothing that it has not itself.
    pub no_new_privileges: bool,
    /// Whether a seccomp filter is on all its threads, as a container's is.
    pub seccomp_filter: bool,
}

/// The ROS master of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RosMasterRecord {
    /// Which program it is.
    pub program: RosMaster,
    /// Its version: the workload's own for the embedded one.
    pub version: Option<String>,
}

/// How the kernel's clock is steered (adjtimex(2)).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockRecord {
    /// Whether somebody keeps it synchronised.
    pub synchronised: bool,
    /// The bits `STA_…`.
    pub status: i32,
    /// What is still to be slewed.
    pub offset_ns: i64,
    /// By how much its rate is corrected.
    pub frequency_ppm: f64,
    /// The largest error that it may have.
    pub max_error_us: i64,
}

/// Fields that change all the time and mean no other platform: the names from the record on.
const RESTLESS: [&[&str]; 7] = [
    &[CLOCK, field!(ClockRecord, frequency_ppm)],
    &[CLOCK, field!(ClockRecord, max_error_us)],
    &[CLOCK, field!(ClockRecord, offset_ns)],
    &[CLOCK, field!(ClockRecord, status)],
    &[field!(PlatformRecord, load_1min)],
    &[field!(PlatformRecord, memory_available_bytes)],
    &[field!(PlatformRecord, realtime)],
];
const CLOCK: &str = field!(PlatformRecord, clock);

impl PlatformRecord {
    /// What is not as it was, but for what always changes.
    #[must_use]
    pub fn changes(&self, after: &Self) -> Vec<PlatformChange> {
        let (before, after) = (self.facts(), after.facts());
        let names: std::collections::BTreeSet<&String> = before.keys().chain(after.keys()).collect();
        let changed = names
            .into_iter()
            .filter(|name| before.get(*name) != after.get(*name));
        changed
            .map(|name| PlatformChange {
                what: name.clone(),
                before: before.get(name).cloned(),
                after: after.get(name).cloned(),
            })
            .collect()
    }

    /// The fields that are not null, by their dotted paths.
    fn facts(&self) -> BTreeMap<String, String> {
        let mut facts = BTreeMap::new();
        // Plain data can always be written as JSON.
        collect("", &serde_json::to_value(self).unwrap_or_default(), &mut facts);
        facts
    }
}

fn collect(path: &str, value: &Value, facts: &mut BTreeMap<String, String>) {
    if RESTLESS
        .iter()
        .any(|names| path.split('.').eq(names.iter().copied()))
    {
        return;
    }
    match value {
        Value::Null => {}
        Value::Object(fields) => {
            for (name, field) in fields {
                let path = if path.is_empty() {
                    name.clone()
                } else {
                    format!("{path}.{name}")
                };
                collect(&path, field, facts);
            }
        }
        Value::String(text) => {
            facts.insert(path.to_owned(), text.clone());
        }
        other => {
            facts.insert(path.to_owned(), other.to_string());
        }
    }
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

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case::debian("PRETTY_NAME=\"Debian 12\"\nVERSION_ID=\"12\"\nID=debian\n", "debian-12")]
    #[case::rolling("ID=arch\nBUILD_ID=rolling\n", "arch")]
    #[case::without_any("", "")]
    fn an_os_is_named_by_id_and_version(#[case] os_release: &str, #[case] wanted: &str) {
        assert_eq!(os_name(os_release), wanted);
    }

    fn platform(edit: impl FnOnce(&mut PlatformRecord)) -> PlatformRecord {
        let mut platform = PlatformRecord {
            kernel: "6.1".into(),
            cpu_governor: Some("performance".into()),
            load_1min: Some(0.5),
            clock: Some(ClockRecord {
                synchronised: true,
                ..ClockRecord::default()
            }),
            ..PlatformRecord::default()
        };
        edit(&mut platform);
        platform
    }

    #[test]
    fn what_always_changes_is_no_change() {
        let after = platform(|it| {
            it.load_1min = Some(7.0);
            it.memory_available_bytes = Some(1);
            it.clock.as_mut().unwrap().offset_ns = 1234;
        });
        assert_eq!(platform(|_| ()).changes(&after), Vec::new());
    }

    /// serde could write a field under another name than the compiler knows.
    #[test]
    fn what_always_changes_is_written_under_its_names() {
        let written = serde_json::to_value(platform(|_| ())).unwrap();
        for names in RESTLESS {
            let pointer: String = names.iter().map(|name| format!("/{name}")).collect();
            assert!(written.pointer(&pointer).is_some(), "{pointer}");
        }
    }

    #[test]
    fn a_change_says_what_it_was_and_what_it_is() {
        let after = platform(|it| {
            it.cpu_governor = Some("powersave".into());
            it.clock.as_mut().unwrap().synchronised = false;
            it.cgroup_limits.insert("cpu.max".into(), "50000 100000".into());
        });
        let changes = platform(|_| ()).changes(&after);
        let told: Vec<_> = changes
            .iter()
            .map(|change| {
                (
                    change.what.as_str(),
                    change.before.as_deref(),
                    change.after.as_deref(),
                )
            })
            .collect();
        assert_eq!(
            told,
            [
                ("cgroup_limits.cpu.max", None, Some("50000 100000")),
                ("clock.synchronised", Some("true"), Some("false")),
                ("cpu_governor", Some("performance"), Some("powersave")),
            ]
        );
    }

    #[test]
    fn a_survey_reads_as_the_platform_before() {
        let survey = SurveyRecord {
            before: platform(|_| ()),
            after: Some(platform(|it| it.kernel = "6.2".into())),
            changes: Vec::new(),
        };
        let text = serde_json::to_string(&survey).unwrap();
        assert_eq!(
            serde_json::from_str::<PlatformRecord>(&text).unwrap(),
            survey.before
        );
        assert_eq!(serde_json::from_str::<SurveyRecord>(&text).unwrap(), survey);
    }
}
