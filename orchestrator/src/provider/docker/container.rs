//! What we ask an engine for: a container with the workload as its main process, and its volume. Pure. The functions
//! are [`workload`], [`check`] and [`reader`].
//!
//! The workload makes network namespaces, TAP devices and packet captures and wants real-time priority; each of these
//! needs one capability. It gets those, what the matrix file asks for besides, and no network of the engine's. Two of them it
//! gives up again once its namespaces are there, and what SYS_ADMIN allows beside them is not in [`super::seccomp`].

use std::collections::HashMap;

use bollard::models::{
    ContainerCreateBody, DeviceMapping, HostConfig, HostConfigLogConfig, Mount, MountType, MountVolumeOptions,
};
use record::{call::Folders, quantity::Bytes, settings::Need};

use super::{
    folders::{DATA, WORK},
    image::Image,
    labels::Labels,
    seccomp,
    settings::DockerSettings,
};
use crate::provider::{EnvironmentRequest, capability_probe};

/// Where the Dockerfile puts the workload in our images.
pub const WORKLOAD: &str = "/workload";

/// Each with what it is for.
const CAPABILITIES: [&str; 6] = [
    "NET_ADMIN", // TAP devices, addresses, neighbours
    "NET_RAW",   // captures: AF_PACKET
    "SYS_ADMIN", // unshare(CLONE_NEWNET), until that is done
    "SETPCAP",   // giving up SYS_ADMIN for what is started, too; given up with it
    "SYS_NICE",  // SCHED_FIFO, whatever RLIMIT_RTPRIO is
    "IPC_LOCK",  // mlockall, whatever RLIMIT_MEMLOCK is
];

/// Processes and threads of a container. A scenario has some thirty, and Open vSwitch's daemon as many as the machine has
/// processors: far below, and far above what a machine can take.
pub const MOST_PROCESSES: i64 = 4096;

/// The host name of every container: that of its machine explains nothing.
pub const HOSTNAME: &str = "workload";

/// By which the networks of the userspace backend come to their devices.
pub const TUN: &str = "/dev/net/tun";

/// The container in which the workload runs.
#[must_use]
pub fn workload(
    request: &EnvironmentRequest,
    settings: &DockerSettings,
    image: &Image,
    machine_memory: Option<u64>,
) -> ContainerCreateBody {
    let arguments = request
        .arguments(Folders {
            data: DATA.into(),
            work: WORK.into(),
        })
        .into_iter()
        .map(|argument| argument.to_string_lossy().into_owned())
        .collect();
    ContainerCreateBody {
        host_config: Some(HostConfig {
            mounts: Some(volumes(request, image)),
            ..match request.settings.network_in_use() {
                Some(_) => rights_and_limits(settings, machine_memory, &CAPABILITIES),
                // A command on no network needs no right that the workload itself needs for one.
                None => HostConfig {
                    devices: None,
                    ..rights_and_limits(settings, machine_memory, &[])
                },
            }
        }),
        entrypoint: Some(entrypoint(settings, WORKLOAD.to_owned())),
        cmd: Some(arguments),
        // By its digest: what its name means may change at any moment.
        ..bare(&Labels::of_environment(request), &image.id)
    }
}

/// A container in which the workload says whether a need is met, of any image: the workload is copied to [`DATA`], a volume
/// without a name, before it is started. It is where the measuring one has its data, so that no image is built for it.
#[must_use]
pub fn check(
    need: &Need,
    settings: &DockerSettings,
    image: &str,
    machine_memory: Option<u64>,
) -> ContainerCreateBody {
    ContainerCreateBody {
        // As an image of ours has them, whatever the one below says.
        user: Some("0:0".to_owned()),
        working_dir: Some("/".to_owned()),
        host_config: Some(HostConfig {
            mounts: Some(vec![Mount {
                typ: Some(MountType::VOLUME),
                target: Some(DATA.to_owned()),
                ..Mount::default()
            }]),
            ..rights_and_limits(settings, machine_memory, &CAPABILITIES)
        }),
        entrypoint: Some(entrypoint(settings, format!("{DATA}{WORKLOAD}"))),
        cmd: Some(capability_probe::call(need).arguments().into()),
        ..bare(&Labels::of_check(), image)
    }
}

/// What the user's own program becomes, or is started at once: the workload.
fn entrypoint(settings: &DockerSettings, workload: String) -> Vec<String> {
    settings.entrypoint.iter().cloned().chain([workload]).collect()
}

/// A container of that image and ours, with nothing to run.
fn bare(labels: &Labels, image: &str) -> ContainerCreateBody {
    ContainerCreateBody {
        image: Some(image.to_owned()),
        hostname: Some(HOSTNAME.to_owned()),
        labels: Some(labels.write()),
        attach_stdout: Some(false),
        attach_stderr: Some(false),
        ..ContainerCreateBody::default()
    }
}

/// What the workload may do, and how much of the machine it has.
fn rights_and_limits(
    settings: &DockerSettings,
    machine_memory: Option<u64>,
    capabilities: &[&str],
) -> HostConfig {
    let asked_for = settings.capabilities.iter().map(ToString::to_string);
    let security = [
        "no-new-privileges:true".to_owned(),
        format!("seccomp={}", seccomp::profile(&settings.system_calls)),
    ];
    // What a scenario writes stays in memory too, as the kernel's copy of its files, and counts: a limit near what the
    // workload itself needs would have the kernel look for room while it measures.
    let memory = settings
        .memory
        .map(Bytes::get)
        .or_else(|| Some(machine_memory? / 4 * 3))
        .map(i64_of);
    let profile = settings
        .apparmor
        .iter()
        .map(|profile| format!("apparmor={profile}"));
    HostConfig {
        readonly_rootfs: Some(true),
        cap_drop: Some(vec!["ALL".to_owned()]),
        cap_add: Some(
            capabilities
                .iter()
                .copied()
                .map(str::to_owned)
                .chain(asked_for)
                .collect(),
        ),
        security_opt: Some(security.into_iter().chain(profile).collect()),
        tmpfs: Some(
            settings
                .writable
                .iter()
                .map(|folder| (folder.to_string(), String::new()))
                .collect(),
        ),
        network_mode: Some("none".to_owned()),
        devices: Some(vec![tun()]),
        // Whatever the engine's default is: this one can be followed from its first line. A size must be given, or
        // an engine with a default for it would drop what is older.
        log_config: Some(HostConfigLogConfig {
            typ: Some("json-file".to_owned()),
            config: Some(HashMap::from([("max-size".to_owned(), "64g".to_owned())])),
        }),
        nano_cpus: settings.cpus.map(|cpus| (cpus * 1e9).round() as i64),
        cpuset_cpus: settings.cpuset.clone(),
        memory,
        // No swap beyond the limit: a workload that is swapped out is not worth measuring.
        memory_swap: memory,
        pids_limit: Some(MOST_PROCESSES),
        cpu_realtime_period: settings.realtime_runtime.map(|_| 1_000_000),
        cpu_realtime_runtime: settings
            .realtime_runtime
            .map(|runtime| i64_of(runtime.as_nanos() / 1000)),
        ..HostConfig::default()
    }
}

/// A container that is never started: through it the engine hands out a volume whose container is gone.
#[must_use]
pub fn reader(request: &EnvironmentRequest, image: &Image) -> ContainerCreateBody {
    ContainerCreateBody {
        image: Some(image.name.clone()),
        labels: Some(Labels::of_environment(request).write()),
        host_config: Some(HostConfig {
            network_mode: Some("none".to_owned()),
            mounts: Some(vec![volume(request, image, &request.environment, DATA)]),
            ..HostConfig::default()
        }),
        ..ContainerCreateBody::default()
    }
}

/// The names of an environment's volumes: of its data, and of a command's work.
pub fn volume_names(request: &EnvironmentRequest) -> Vec<String> {
    let name = &request.environment;
    let of_a_command = request.settings.experiment.is_some();
    let work = of_a_command.then(|| format!("{name}-work"));
    [name.clone()].into_iter().chain(work).collect()
}

/// The volumes, which the engine makes with the container. They outlive it until the data are collected.
fn volumes(request: &EnvironmentRequest, image: &Image) -> Vec<Mount> {
    let names = volume_names(request);
    let named = names.iter().zip([DATA, WORK]);
    named
        .map(|(name, target)| volume(request, image, name, target))
        .collect()
}

fn volume(request: &EnvironmentRequest, image: &Image, name: &str, target: &str) -> Mount {
    let sha256 = image.workload_sha256.as_deref().unwrap_or_default();
    Mount {
        typ: Some(MountType::VOLUME),
        source: Some(name.to_owned()),
        target: Some(target.to_owned()),
        volume_options: Some(MountVolumeOptions {
            no_copy: Some(true),
            labels: Some(Labels::of_environment(request).with_workload(sha256).write()),
            ..MountVolumeOptions::default()
        }),
        ..Mount::default()
    }
}

fn tun() -> DeviceMapping {
    let device = || Some(TUN.to_owned());
    DeviceMapping {
        path_on_host: device(),
        path_in_container: device(),
        cgroup_permissions: Some("rw".to_owned()),
    }
}

fn i64_of(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

#[cfg(test)]
pub(super) mod tests {
    use record::{quantity::TimeSpan, settings::Settings};

    use super::*;
    use crate::provider::docker::settings::SystemCalls;

    pub fn request() -> EnvironmentRequest {
        EnvironmentRequest {
            environment: "matrix-r1-a-1".to_owned(),
            run: "r1".to_owned(),
            run_directory: "/runs/r1".into(),
            scenario: "a".to_owned(),
            host: "here".to_owned(),
            settings: Settings::default(),
            windows: vec![1, 2],
            files: None,
        }
    }

    fn image() -> Image {
        Image {
            name: "i".to_owned(),
            id: "sha256:1".to_owned(),
            base: None,
            workload_sha256: Some("abc".to_owned()),
        }
    }

    #[test]
    fn a_container_has_no_rights_beyond_those_that_are_listed() {
        let host = workload(&request(), &DockerSettings::default(), &image(), None)
            .host_config
            .unwrap();
        assert_eq!(host.cap_drop.unwrap(), ["ALL"]);
        assert_eq!(host.cap_add.unwrap(), CAPABILITIES);
        let profile = format!("seccomp={}", seccomp::profile(&[]));
        assert_eq!(host.security_opt.unwrap(), ["no-new-privileges:true", &profile]);
        assert_eq!(host.tmpfs.unwrap(), HashMap::new());
        assert_eq!((host.privileged, host.readonly_rootfs), (None, Some(true)));
        assert_eq!(host.network_mode.unwrap(), "none");
        assert_eq!(host.binds, None);
        assert_eq!(
            (host.memory, host.nano_cpus, host.cpuset_cpus),
            (None, None, None)
        );
        assert_eq!(host.pids_limit, Some(MOST_PROCESSES));
    }

    #[test]
    fn a_container_leaves_its_machine_a_quarter_of_the_memory_unless_the_file_says_otherwise() {
        let host = |settings: &DockerSettings| {
            let body = workload(&request(), settings, &image(), Some(8 << 30));
            let host = body.host_config.unwrap();
            (host.memory, host.memory_swap)
        };
        assert_eq!(host(&DockerSettings::default()), (Some(6 << 30), Some(6 << 30)));
        let settings = DockerSettings {
            memory: Some(Bytes::new(1 << 30)),
            ..DockerSettings::default()
        };
        assert_eq!(host(&settings), (Some(1 << 30), Some(1 << 30)));
    }

    #[test]
    fn a_check_has_the_rights_and_limits_of_a_measurement_and_a_volume_without_a_name() {
        let settings = DockerSettings {
            memory: Some(Bytes::new(512 << 20)),
            ..with_openvswitch()
        };
        let mut measuring = workload(&request(), &settings, &image(), None)
            .host_config
            .unwrap();
        let check = check(&Need::of_the_network(&Settings::default()), &settings, "i", None);
        let mut checking = check.host_config.unwrap();
        let mount = checking.mounts.take().unwrap().remove(0);
        assert_eq!((mount.source, mount.target.as_deref()), (None, Some(DATA)));
        assert_eq!(measuring.mounts.take().map(|mounts| mounts.len()), Some(1));
        assert_eq!(checking, measuring);
        assert_eq!(check.entrypoint.unwrap(), ["with-openvswitch", "/data/workload"]);
        assert_eq!(check.cmd.unwrap()[0], "check");
    }

    fn with_openvswitch() -> DockerSettings {
        DockerSettings {
            entrypoint: vec!["with-openvswitch".to_owned()],
            capabilities: vec!["SETGID".to_owned().try_into().unwrap()],
            system_calls: vec![SystemCalls::Mount],
            writable: vec!["/run".to_owned().try_into().unwrap()],
            apparmor: Some("unconfined".to_owned()),
            ..DockerSettings::default()
        }
    }

    #[test]
    fn what_a_matrix_file_asks_for_comes_beside_what_every_container_has() {
        let body = workload(&request(), &with_openvswitch(), &image(), None);
        assert_eq!(body.entrypoint.unwrap(), ["with-openvswitch", "/workload"]);
        let host = body.host_config.unwrap();
        assert_eq!(
            host.cap_add.unwrap(),
            [CAPABILITIES.as_slice(), &["SETGID"]].concat()
        );
        assert_eq!(
            host.tmpfs.unwrap(),
            HashMap::from([("/run".to_owned(), String::new())])
        );
        assert_eq!(
            host.security_opt.unwrap(),
            [
                "no-new-privileges:true".to_owned(),
                format!("seccomp={}", seccomp::profile(&[SystemCalls::Mount])),
                "apparmor=unconfined".to_owned()
            ]
        );
    }

    #[test]
    fn limits_reach_the_engine_in_its_own_units() {
        let settings = DockerSettings {
            cpus: Some(1.5),
            cpuset: Some("0-1".to_owned()),
            memory: Some(Bytes::new(512 << 20)),
            realtime_runtime: Some(TimeSpan::from_millis(900)),
            ..DockerSettings::default()
        };
        let host = workload(&request(), &settings, &image(), Some(8 << 30))
            .host_config
            .unwrap();
        assert_eq!(host.nano_cpus, Some(1_500_000_000));
        assert_eq!(host.cpuset_cpus.as_deref(), Some("0-1"));
        assert_eq!(
            (host.memory, host.memory_swap),
            (Some(536_870_912), Some(536_870_912))
        );
        assert_eq!(host.cpu_realtime_runtime, Some(900_000));
        assert_eq!(host.cpu_realtime_period, Some(1_000_000));
    }

    #[test]
    fn the_workload_is_the_main_process_with_its_data_on_the_volume() {
        let body = workload(&request(), &DockerSettings::default(), &image(), None);
        let arguments = body.cmd.unwrap();
        assert_eq!(arguments.first().unwrap(), "run");
        for pair in [
            ["--environment", "matrix-r1-a-1"],
            ["--data", DATA],
            ["--windows", "1,2"],
        ] {
            assert!(arguments.windows(2).any(|have| have == pair), "{arguments:?}");
        }
        let mount = body.host_config.unwrap().mounts.unwrap().remove(0);
        assert_eq!(
            (mount.source.unwrap().as_str(), mount.target.unwrap().as_str()),
            ("matrix-r1-a-1", DATA)
        );
        let labels = Labels::read(mount.volume_options.unwrap().labels);
        assert_eq!(
            labels.workload().as_deref(),
            Some("abc"),
            "which workload wrote it"
        );
    }
}
