//! Whether the platform can run the experiment: tries what must be granted. The main function is [`check`].

use std::thread;

use nix::sys::mman::munlockall;
use record::{
    causes::with_causes,
    check::{Check, CheckRecord},
    platform::RealtimeGrant,
    settings::Settings,
};

use crate::{capabilities, capture, network, realtime, survey::VERSION, virtual_hosts};

/// Whether the experiment can run here with these settings. What is made for the trial is gone afterwards. Call
/// [`network::become_namespace_root`] first and hand over what it said.
#[must_use]
pub fn check(settings: &Settings, namespace_root: Result<(), network::NetworkError>) -> CheckRecord {
    let network = namespace_root.and_then(|()| network::survey(&settings.network));
    // As a run does before it starts the programs that are tried next.
    capabilities::drop_unneeded();
    let checks = vec![
        Check {
            name: "network".into(),
            required: true,
            available: network.is_ok(),
            reason: network.as_ref().err().map(|error| with_causes(error)),
            fix: network.as_ref().err().and_then(network::NetworkError::hint),
        },
        master_check(settings),
        capture_check(settings),
        priority_check(settings),
        memory_check(settings),
    ];
    CheckRecord {
        format: record::FORMAT,
        workload_version: VERSION.to_owned(),
        can_run: checks.iter().all(|check| check.available || !check.required),
        checks,
    }
}

fn master_check(settings: &Settings) -> Check {
    let found = virtual_hosts::survey_master(settings.ros.master);
    Check {
        name: "ros-master".into(),
        required: true,
        available: found.is_ok(),
        reason: found.as_ref().err().map(|error| with_causes(error)),
        fix: found
            .as_ref()
            .err()
            .and_then(|error| error.hint().map(str::to_owned)),
    }
}

fn capture_check(settings: &Settings) -> Check {
    let found = match settings.capture.enabled {
        true => capture::survey(&settings.capture),
        false => Ok(()),
    };
    Check {
        name: "capture".into(),
        required: true,
        available: found.is_ok(),
        reason: found.as_ref().err().map(|error| with_causes(error)),
        fix: found.as_ref().err().and_then(capture::CaptureError::hint),
    }
}

fn priority_check(settings: &Settings) -> Check {
    // On a thread of its own, whose priority ends with it.
    let asked = settings.realtime.clone();
    let refusal = match thread::spawn(move || realtime::enter_realtime(&asked)).join() {
        Ok(grant) => grant.priority_refusal,
        Err(_) => Some("the trial's thread ended early".to_owned()),
    };
    Check {
        name: "realtime-priority".into(),
        required: false,
        available: refusal.is_none(),
        fix: refusal.as_ref().map(|_| {
            format!(
                "run as root, or allow priority {} with `ulimit -r`; in a container, add the capability SYS_NICE, and \
                 where `/sys/fs/cgroup/cpu/cpu.rt_runtime_us` exists, give it a share of real time (dockerd and docker \
                 run: `--cpu-rt-runtime`)",
                settings.realtime.priority
            )
        }),
        reason: refusal,
    }
}

fn memory_check(settings: &Settings) -> Check {
    let mut grant = RealtimeGrant::default();
    realtime::lock_memory(&settings.realtime, &mut grant);
    if grant.locked {
        let _ = munlockall();
    }
    Check {
        name: "memory-lock".into(),
        required: false,
        available: grant.lock_refusal.is_none(),
        fix: grant.lock_refusal.as_ref().map(|_| {
            "run as root, or raise the limit with `ulimit -l`; in a container, add the capability IPC_LOCK".into()
        }),
        reason: grant.lock_refusal,
    }
}
