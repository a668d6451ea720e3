//! What the platform is, read from /proc and /sys. The main function is [`platform`].
//!
//! Sources: proc(5), os-release(5). Whatever cannot be read is `None`, since containers hide much of it.

mod clock_discipline;
mod hypervisor;
mod software;

use std::{fs, path::Path};

use nix::{
    sched::{CpuSet, sched_getaffinity},
    sys::utsname::uname,
    unistd::Pid,
};
use record::platform::{MACHINE, PlatformRecord, RealtimeGrant, os_name};

use crate::{capabilities, cgroup, realtime};

/// The workload's version.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The platform as it is now, with what was granted of the real-time wishes.
#[must_use]
pub fn platform(realtime: RealtimeGrant) -> PlatformRecord {
    let (machine, kernel, kernel_build, hostname) = kernel_names();
    let cpu_info = read("/proc/cpuinfo").unwrap_or_default();
    let memory = read("/proc/meminfo").unwrap_or_default();
    let cpus = cpus_allowed();
    PlatformRecord {
        format: record::FORMAT,
        machine,
        workload_machine: Some(MACHINE.to_owned()),
        os: read("/etc/os-release")
            .map(|text| os_name(&text))
            .unwrap_or_default(),
        kernel,
        kernel_build,
        kernel_command_line: read("/proc/cmdline"),
        hostname,
        cpu_model: field(&cpu_info, "model name").or_else(|| field(&cpu_info, "CPU part")),
        cpu_microcode: field(&cpu_info, "microcode"),
        cpus_online: read("/sys/devices/system/cpu/online"),
        cpus_allowed: u32::try_from(cpus.len()).unwrap_or(u32::MAX),
        cpu_governor: cpus.first().and_then(|cpu| {
            read(format!(
                "/sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor"
            ))
        }),
        clock_source: read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        clock_resolution_ns: realtime::resolution_ns(),
        memory_total_bytes: kibibytes(&memory, "MemTotal"),
        memory_available_bytes: kibibytes(&memory, "MemAvailable"),
        load_1min: read("/proc/loadavg").and_then(|text| text.split(' ').next()?.parse().ok()),
        hypervisor: hypervisor::is_present(&cpu_info),
        hypervisor_name: hypervisor::is_present(&cpu_info)
            .filter(|present| *present)
            .and_then(|_| hypervisor::name()),
        firmware_machine: hypervisor::machine(),
        cgroup_limits: cgroup::limits(),
        packages: software::packages(),
        clock: clock_discipline::read(),
        tcp_congestion_control: read("/proc/sys/net/ipv4/tcp_congestion_control"),
        time_daemons: software::time_daemons(),
        workload_version: VERSION.to_owned(),
        ros_master: None,
        privileges: Some(capabilities::of_all_threads()),
        realtime,
    }
}

/// Machine, release, version and node name.
fn kernel_names() -> (String, String, String, String) {
    let Ok(names) = uname() else {
        return Default::default();
    };
    let text = |name: &std::ffi::OsStr| name.to_string_lossy().into_owned();
    (
        text(names.machine()),
        text(names.release()),
        text(names.version()),
        text(names.nodename()),
    )
}

/// The processors that the process may use.
pub(crate) fn cpus_allowed() -> Vec<usize> {
    let allowed = sched_getaffinity(Pid::from_raw(0)).unwrap_or_default();
    (0..CpuSet::count())
        .filter(|cpu| allowed.is_set(*cpu).unwrap_or(false))
        .collect()
}

/// A short file's text without surrounding white space; none if it is empty or cannot be read.
fn read(path: impl AsRef<Path>) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

/// The first value of `name : value`.
fn field(text: &str, name: &str) -> Option<String> {
    text.lines()
        .filter_map(|line| line.split_once(':'))
        .find(|(key, _)| key.trim() == name)
        .map(|(_, value)| value.trim().to_owned())
}

fn kibibytes(text: &str, name: &str) -> Option<u64> {
    let value = field(text, name)?;
    value
        .strip_suffix(" kB")?
        .trim()
        .parse::<u64>()
        .ok()?
        .checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_proc_are_kibibytes() {
        let text = "MemTotal:       24592008 kB\nMemFree: 7 kB\n";
        assert_eq!(kibibytes(text, "MemTotal"), Some(25_182_216_192));
        assert_eq!(kibibytes(text, "MemAvailable"), None);
    }

    #[test]
    fn this_machine_has_a_kernel_and_a_processor() {
        let platform = platform(RealtimeGrant::default());
        assert!(!platform.kernel.is_empty() && !platform.machine.is_empty());
        assert!(platform.cpus_allowed > 0);
        assert!(platform.clock_resolution_ns > 0);
        assert!(platform.cpus_online.is_some());
        assert_eq!(
            platform.changes(&super::platform(RealtimeGrant::default())),
            Vec::new()
        );
    }
}
