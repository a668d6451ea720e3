//! The paper's headline, for real: its network natively and in Docker, on a host over SSH that has netem and openvswitch in
//! its kernel, with the settings of `examples/paper.yaml`.

use std::{
    path::Path,
    process::{Command, Stdio},
    sync::OnceLock,
};

use serde_json::Value;
use tests::{Guest, WHOLE_WINDOWS_COUNT, Workplace, engine::mininet_image};

/// A host with Open vSwitch, and an engine that has the image of `dockerfiles/mininet`, brought there as docs/network.md says.
fn host() -> &'static Guest {
    static HOST: OnceLock<Guest> = OnceLock::new();
    HOST.get_or_init(|| {
        let image = mininet_image();
        let guest = Guest::boot();
        // Containers of ours have no network of the engine's.
        guest.expect(&[
            "sh",
            "-c",
            r#"printf '{"bridge": "none", "iptables": false}' >/etc/docker/daemon.json && systemctl start docker"#,
        ]);
        let mut saved = Command::new("docker")
            .args(["save", &image])
            .stdout(Stdio::piped())
            .spawn()
            .expect("docker starts");
        let loaded = guest
            .command(&["docker", "load", "--quiet"])
            .stdin(saved.stdout.take().expect("it is a pipe"))
            .output()
            .expect("ssh starts");
        assert!(saved.wait().is_ok_and(|status| status.success()));
        assert!(loaded.status.success(), "{loaded:?}");
        guest
    })
}

/// The settings of the paper's own file for scenarios on that host, in windows of seconds.
fn matrix(guest: &Guest, virtualizations: &str, windows: u32) -> String {
    let paper = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/paper.yaml");
    let paper = std::fs::read_to_string(paper).expect("the example is there");
    let (_, settings) = paper.split_once("\nworkload:\n").expect("it has settings");
    format!(
        "hosts:\n  guest:\n    hardware: x86_64\n    os: debian-12\n    connect: {}\n\
         matrix:\n  virtualization: [{virtualizations}]\n\
         workload:\n{settings}\n\
         profiles:\n  short:\n    workload:\n      windows: {windows}\n      window: 8s\n      period: 2s\n      \
         reference: {{amplitude_m: 0.2}}\n      {WHOLE_WINDOWS_COUNT}\n    report: {{figures: []}}\n",
        guest.connect()
    )
}

/// What is left in the host of networks, of containers and of processes.
fn left(guest: &Guest) -> String {
    let look = "docker ps --all --quiet; docker volume ls --quiet; ip -br link | grep -E '^(mx|ovs-netdev)'; \
                ps -eo args | grep -E '[m]ininet:|[o]vs-testcontroller|[n]etwork.py|[r]osmaster|[t]cpdump'";
    guest.run(&["sh", "-c", look]).out
}

fn read(workplace: &Workplace, slug: &str, file: &str) -> String {
    let path = workplace.run_directory().join("scenarios").join(slug).join(file);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn the_papers_network_is_measured_natively_and_in_docker_and_nothing_is_left() {
    let workplace = Workplace::measuring();
    let guest = host();
    guest.expect(&["systemctl", "start", "openvswitch-switch"]);
    workplace.write("m.yaml", matrix(guest, "docker, native", 2));
    let ran = workplace.run(&["run", "m.yaml", "--profile", "short"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");

    let report = workplace.json(&["report", workplace.run_directory().to_str().unwrap()]);
    for scenario in report["scenarios"].as_array().unwrap() {
        assert_eq!(scenario["outcome"], "completed", "{scenario:#}");
        assert_eq!(scenario["windows"].as_array().unwrap().len(), 2, "{scenario:#}");
    }
    assert_eq!(report["within"].as_array().unwrap().len(), 2, "{report:#}");
    for slug in ["x86-64-debian-12-docker", "x86-64-debian-12-native"] {
        let network = read(&workplace, slug, "network.txt");
        for part in [
            "is_connected: true",
            "nw_src=10.0.0.3,nw_dst=10.0.0.2",
            "qdisc netem 10: parent 5:1 limit 1000 delay 10ms  1ms loss 1%",
            "system@ovs-system:",
        ] {
            assert!(
                network.contains(part),
                "{part:?} is missing of {slug} in\n{network}"
            );
        }
        let environment: Value = serde_json::from_str(&read(&workplace, slug, "environment.json")).unwrap();
        assert!(
            environment["platform"]["ros_master"]
                .to_string()
                .contains("rosmaster"),
            "{environment:#}"
        );
        let window: Value = serde_json::from_str(&read(&workplace, slug, "window-1/window.json")).unwrap();
        for capture in window["captures"].as_array().unwrap() {
            assert!(capture["tool"].to_string().contains("tcpdump"), "{window:#}");
        }
    }
    assert_eq!(left(guest), "");
    assert_eq!(
        guest.expect(&["ovs-vsctl", "list-br"]),
        "",
        "the host's own Open vSwitch"
    );
}

#[test]
fn without_openvswitch_in_the_kernel_its_daemon_forwards_and_that_is_written_down() {
    let workplace = Workplace::measuring();
    let guest = host();
    guest.expect(&[
        "sh",
        "-c",
        "systemctl stop openvswitch-switch && echo install openvswitch /bin/false >/etc/modprobe.d/no-openvswitch.conf && \
         { [ ! -e /sys/module/openvswitch ] || modprobe --remove openvswitch; }",
    ]);
    workplace.write("m.yaml", matrix(guest, "docker", 1));
    let ran = workplace.run(&["run", "m.yaml", "--profile", "short"]);
    guest.expect(&["rm", "/etc/modprobe.d/no-openvswitch.conf"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let network = read(&workplace, "x86-64-debian-12-docker", "network.txt");
    for part in [
        "netdev@ovs-netdev:",
        "datapath_type: netdev",
        "nw_src=10.0.0.3,nw_dst=10.0.0.2",
        "qdisc netem 10: parent 5:1 limit 1000 delay 10ms  1ms loss 1%",
    ] {
        assert!(network.contains(part), "{part:?} is missing in\n{network}");
    }
    assert_eq!(left(guest), "");
}
