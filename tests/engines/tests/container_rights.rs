//! What a container of ours may do, looked at from outside while it measures and tried from inside by an image that means harm;
//! and that an image counts by what is in it.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use rstest::rstest;
use serde_json::{Value, json};
use tests::{
    WHOLE_WINDOWS_COUNT, Workplace,
    engine::{Engine, mininet_image, on_the_engine},
};

/// Places in a capability set (`linux/capability.h`).
const SETPCAP: u32 = 8;
const SYS_ADMIN: u32 = 21;
/// `NET_ADMIN`, `NET_RAW`, `IPC_LOCK`, `SYS_NICE`.
const KEPT: u64 = 1 << 12 | 1 << 13 | 1 << 14 | 1 << 23;

fn matrix(settings: &str) -> String {
    format!(
        "matrix: {{virtualization: [docker]}}\nworkload:\n  dynamics: robust\n  windows: 1\n  window: 5s\n  period: 1s\n  \
         reference: {{amplitude_m: 0.05}}\n  {WHOLE_WINDOWS_COUNT}\n  {settings}\n"
    )
}

fn docker(arguments: &[&str]) -> String {
    let ran = Command::new("docker").args(arguments).output().unwrap();
    assert!(ran.status.success(), "{arguments:?}: {ran:?}");
    String::from_utf8(ran.stdout).unwrap().trim().to_owned()
}

/// A process's group of a controller: version 1 has a hierarchy for each, version 2 one for all.
fn group(pid: &str, controller: &str) -> PathBuf {
    let memberships = fs::read_to_string(format!("/proc/{pid}/cgroup")).unwrap();
    let of = |wanted: &str| {
        memberships.lines().find_map(|line| {
            let mut fields = line.splitn(3, ':').skip(1);
            let named = fields.next()?.split(',').any(|name| name == wanted);
            fields
                .next()
                .filter(|_| named)
                .map(|path| path.trim_start_matches('/').to_owned())
        })
    };
    match of(controller) {
        Some(path) => Path::new("/sys/fs/cgroup").join(controller).join(path),
        None => Path::new("/sys/fs/cgroup").join(of("").unwrap()),
    }
}

fn read(path: &Path) -> String {
    fs::read_to_string(path)
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()))
        .trim()
        .to_owned()
}

/// The `status` of every thread of every process in a control group.
fn threads(group: &Path) -> Vec<String> {
    let processes = read(&group.join("cgroup.procs"));
    let tasks = processes
        .lines()
        .flat_map(|pid| fs::read_dir(format!("/proc/{pid}/task")).unwrap());
    tasks
        .map(|task| read(&task.unwrap().path().join("status")))
        .collect()
}

fn field<'a>(status: &'a str, name: &str) -> &'a str {
    let value = status
        .lines()
        .find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
    value.unwrap_or_else(|| panic!("no {name} in {status}")).trim()
}

#[rstest]
#[case::threads("loops: {processes: threads}", 1)]
#[case::processes("loops: {processes: separate}", 4)]
fn a_container_that_measures_has_given_up_what_it_needed_to_begin(
    #[case] settings: &str,
    #[case] processes: usize,
) {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix(settings));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    let there = on_the_engine(&workplace);
    let container = there.first().unwrap();
    let pid = docker(&["inspect", "--format", "{{.State.Pid}}", container]);
    let pids = group(&pid, "pids");

    let threads = threads(&pids);
    let programs: BTreeSet<_> = threads.iter().map(|status| field(status, "Tgid")).collect();
    assert_eq!(programs.len(), processes);
    for status in &threads {
        for set in ["CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb"] {
            let set = u64::from_str_radix(field(status, set), 16).unwrap();
            assert_eq!(set & (1 << SYS_ADMIN | 1 << SETPCAP), 0, "{status}");
            assert_eq!(set & !KEPT, 0, "{status}");
        }
        assert_eq!(field(status, "NoNewPrivs"), "1", "{status}");
        assert_eq!(field(status, "Seccomp"), "2", "a filter: {status}");
    }

    let limit: u64 = read(&pids.join("pids.max")).parse().unwrap();
    let used: u64 = read(&pids.join("pids.current")).parse().unwrap();
    assert!(used * 10 < limit, "{used} of {limit} processes");
    let memory = group(&pid, "memory");
    let [limit, used] = match memory.join("memory.max").exists() {
        true => ["memory.max", "memory.current"],
        false => ["memory.limit_in_bytes", "memory.usage_in_bytes"],
    }
    .map(|file| read(&memory.join(file)).parse::<u64>().unwrap());
    let machine = docker(&["info", "--format", "{{.MemTotal}}"])
        .parse::<u64>()
        .unwrap();
    assert!(limit <= machine / 4 * 3, "{limit} of {machine} bytes");
    assert!(used * 10 < limit, "{used} of {limit} bytes");

    let ran = running.end();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let environment = fs::read(workplace.scenario_directory().join("environment.json")).unwrap();
    let environment: Value = serde_json::from_slice(&environment).unwrap();
    let kept = json!({
        "capabilities": ["NET_ADMIN", "NET_RAW", "IPC_LOCK", "SYS_NICE"],
        "bounding_capabilities": ["NET_ADMIN", "NET_RAW", "IPC_LOCK", "SYS_NICE"],
        "no_new_privileges": true,
        "seccomp_filter": true,
    });
    assert_eq!(environment["platform"]["privileges"], kept, "{environment:#}");
    let options = environment["facts"]["engine_parts"]["security_options"].to_string();
    assert!(options.contains("name=seccomp"), "{environment:#}");
}

/// Says what the kernel let it do, by the numbers that system calls have on x86_64, on its last line. What only fails since
/// its arguments are wrong was let.
#[cfg(target_arch = "x86_64")]
const PROBE: &str = r#"
my $MNT = "/mnt"; my $nothing = 0;
my @tried = (
    ["procfs", 165, "proc", $MNT, "proc", 0, 0], ["debugfs", 165, "debugfs", $MNT, "debugfs", 0, 0],
    ["cgroup", 165, "cgroup", $MNT, "cgroup", 0, "rdma"], ["tmpfs", 165, "tmpfs", $MNT, "tmpfs", 0, 0],
    ["writable /proc/sys", 165, "none", "/proc/sys", "none", 0x1020, 0],
    ["umount2", 166, "/proc/sys", 2], ["unshare mounts", 272, 0x20000], ["unshare users", 272, 0x10000000],
    ["open_tree", 428, -100, "/", 1], ["move_mount", 429, -1, "", -1, "", 0], ["fsopen", 430, "proc", 0],
    ["mount_setattr", 442, -100, "/", 0, 0, 0], ["pivot_root", 155, "/", "/"], ["bpf", 321, 0, 0, 0],
    ["keyctl", 250, 0, -3, 0], ["add_key", 248, "user", "x", "x", 1, -3], ["request_key", 249, "user", "x", 0, -3],
    ["open_by_handle_at", 304, -1, 0, 0], ["kexec_load", 246, 0, 0, 0, 0], ["init_module", 175, 0, 0, ""],
    ["ptrace", 101, 0, 0, 0, 0], ["process_vm_readv", 310, 1, 0, 0, 0, 0, 0], ["userfaultfd", 323, 1],
    ["perf_event_open", 298, 0, 0, -1, -1, 0], ["swapon", 167, "/x", 0], ["io_uring_setup", 425, 1, 0],
    ["setns of any kind", 308, -1, 0], ["sethostname", 170, "x", 1], ["a cipher's socket", 41, 38, 5, 0],
);
my @let;
for (@tried) {
    my ($name, @call) = @$_;
    $! = 0;
    push @let, $name if syscall($call[0], @call[1..$#call]) >= 0 || $! != 1;
}
print STDERR "let: ", join(", ", @let), "\n";
exit 1;
"#;

#[cfg(target_arch = "x86_64")]
#[rstest]
#[case::ordinary(json!({}), "let:")]
#[case::with_all_that_a_file_may_ask_for_but_mounting(json!({"capabilities": ["SYS_PTRACE", "DAC_READ_SEARCH", "SYS_MODULE"]}), "let:")]
#[case::with_mounting(
    json!({"system_calls": ["mount"]}),
    "let: procfs, debugfs, cgroup, tmpfs, writable /proc/sys, umount2, unshare mounts, unshare users, setns of any kind"
)]
fn an_image_that_means_harm_is_let_do_nothing_of_it_unless_the_file_asks(
    #[case] asked: Value,
    #[case] said: &str,
) {
    let workplace = Workplace::new();
    let mut docker = json!({"image": mininet_image(), "entrypoint": ["perl", "-e", PROBE]});
    docker
        .as_object_mut()
        .unwrap()
        .extend(asked.as_object().unwrap().clone());
    workplace.write(
        "m.yaml",
        json!({"matrix": {"virtualization": ["docker"]}, "providers": {"docker": docker}}).to_string(),
    );
    let scenario = workplace.json(&["plan", "m.yaml"])["scenarios"][0].clone();
    let reason = scenario["reason"].as_str().unwrap();
    let (_, told) = reason
        .split_once("could answer: ")
        .unwrap_or_else(|| panic!("{scenario:#}"));
    assert_eq!(told, said, "{scenario:#}");
}

#[test]
fn what_a_file_asks_for_beyond_the_ordinary_is_in_the_plan() {
    let workplace = Workplace::new();
    let plan = |docker: &str| {
        workplace.write(
            "m.yaml",
            format!("matrix: {{virtualization: [docker]}}\nproviders: {{docker: {docker}}}\n"),
        );
        workplace.json(&["plan", "m.yaml"])["rights"].clone()
    };
    assert_eq!(plan("{}"), json!([]));
    let rights = plan("{system_calls: [mount], capabilities: [SETGID]}");
    let settings: Vec<_> = rights
        .as_array()
        .unwrap()
        .iter()
        .map(|right| &right["setting"])
        .collect();
    assert_eq!(
        settings,
        ["providers.docker.capabilities", "providers.docker.system_calls"]
    );
    let text = workplace.run(&["plan", "m.yaml"]).out;
    assert!(
        text.contains("providers.docker.system_calls: mount: who controls the image"),
        "{text}"
    );
}

#[test]
fn an_image_of_our_name_with_another_workload_in_it_is_not_measured_with() {
    let mut workplace = Workplace::measuring();
    let engine = Engine::start(false);
    workplace.set("DOCKER_HOST", &engine.address());
    workplace.write("m.yaml", matrix(""));
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");

    // The same program, but for its last byte: it would measure as well.
    let name = engine
        .docker(&["images", "--format", "{{.Repository}}:{{.Tag}}"])
        .out;
    let name = name.trim();
    assert!(name.starts_with("matrix-workload:"), "{name}");
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("workload");
    let copy = copy.to_str().unwrap();
    let container = engine.docker(&["create", name]).out;
    let container = container.trim();
    assert_eq!(
        engine
            .docker(&["cp", &format!("{container}:/workload"), copy])
            .code,
        Some(0)
    );
    let mut program = fs::read(copy).unwrap();
    program.push(0);
    fs::write(copy, program).unwrap();
    assert_eq!(
        engine
            .docker(&["cp", copy, &format!("{container}:/workload")])
            .code,
        Some(0)
    );
    assert_eq!(engine.docker(&["commit", container, name]).code, Some(0));
    assert_eq!(engine.docker(&["rm", container]).code, Some(0));

    let mut again = workplace.beside();
    again.set("DOCKER_HOST", &engine.address());
    again.write("m.yaml", matrix(""));
    let ran = again.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    let report = again.json(&["report", again.run_directory().to_str().unwrap()]);
    let reason = report["scenarios"][0]["reason"].to_string();
    assert!(
        reason.contains("another workload than its name says"),
        "{report:#}"
    );
    assert_eq!(engine.docker(&["ps", "--all", "--quiet"]).out, "");
    assert_eq!(engine.docker(&["volume", "ls", "--quiet"]).out, "");
}
