//! The image of `dockerfiles/mininet` on this machine's engine: what a container of it needs, and that it is said before a run
//! what is missing. `guest_mininet_docker.rs` measures in it, on a kernel that has all.

use rstest::rstest;
use serde_json::Value;
use tests::{WHOLE_WINDOWS_COUNT, Workplace, engine::mininet_image};

const MININET: &str = "network: {backend: mininet}";
const TCPDUMP: &str = "capture: {tool: tcpdump}";

/// The one scenario of a plan in which containers have what `docker` says beside the image.
fn planned(settings: &str, docker: &str) -> Value {
    let workplace = Workplace::new();
    let image = mininet_image();
    workplace.write(
        "m.yaml",
        format!(
            "matrix: {{virtualization: [docker]}}\nworkload:\n  {settings}\nproviders:\n  docker: {{image: '{image}'{docker}}}\n"
        ),
    );
    workplace.json(&["plan", "m.yaml"])["scenarios"][0].clone()
}

#[rstest]
#[case::nothing_may_be_mounted(
    MININET,
    ", entrypoint: [with-openvswitch], writable: [/run, /tmp]",
    "Mininet cannot make a host here",
    "system_calls: [mount]"
)]
#[case::nobody_starts_open_vswitch(
    MININET,
    ", writable: [/run, /tmp], system_calls: [mount]",
    "Open vSwitch does not answer",
    "entrypoint: [with-openvswitch]"
)]
#[case::open_vswitch_cannot_write(
    MININET,
    ", entrypoint: [with-openvswitch]",
    "Read-only file system",
    "`writable` folders"
)]
#[case::tcpdump_may_not_set_its_groups(
    TCPDUMP,
    "",
    "tcpdump may not set its groups",
    "capabilities: [SETGID]"
)]
#[case::no_such_program(MININET, ", entrypoint: [with-openvswich]", "with-openvswich", "")]
fn what_a_container_lacks_is_said_before_a_run(
    #[case] settings: &str,
    #[case] docker: &str,
    #[case] reason: &str,
    #[case] fix: &str,
) {
    let scenario = planned(settings, docker);
    assert_eq!(scenario["feasible"], false, "{scenario:#}");
    assert!(
        scenario["reason"].as_str().unwrap().contains(reason),
        "{scenario:#}"
    );
    assert!(
        scenario["fix"].as_str().unwrap_or_default().contains(fix),
        "{scenario:#}"
    );
}

#[test]
fn with_all_that_the_image_needs_the_kernel_alone_decides() {
    let scenario = planned(
        MININET,
        ", entrypoint: [with-openvswitch], writable: [/run, /tmp], system_calls: [mount]",
    );
    let kernel = planned("network: {backend: kernel}", "");
    assert_eq!(
        scenario["feasible"], kernel["feasible"],
        "{scenario:#}\n{kernel:#}"
    );
    assert_eq!(scenario["reason"], kernel["reason"]);
}

#[test]
fn an_entry_point_without_an_image_is_refused() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        "matrix: {virtualization: [docker]}\nproviders: {docker: {entrypoint: [with-openvswitch]}}\n",
    );
    let scenario = workplace.json(&["plan", "m.yaml"])["scenarios"][0].clone();
    let reason = scenario["reason"].as_str().unwrap();
    assert!(
        reason.contains("the built-in image has none but the workload"),
        "{scenario:#}"
    );
}

#[test]
fn rosmaster_and_tcpdump_measure_in_a_container_that_may_set_its_groups() {
    let workplace = Workplace::measuring();
    let image = mininet_image();
    workplace.write(
        "m.yaml",
        format!(
            "matrix: {{virtualization: [docker]}}\n\
             workload:\n  windows: 1\n  window: 3s\n  period: 1s\n  reference: {{amplitude_m: 0.05}}\n  \
             {WHOLE_WINDOWS_COUNT}\n  {TCPDUMP}\n  ros: {{master: rosmaster}}\n\
             providers:\n  docker: {{image: '{image}', entrypoint: [with-openvswitch], capabilities: [SETGID], writable: \
             [/run, /tmp]}}\n"
        ),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let folder = workplace.scenario_directory();
    let read =
        |file: &str| -> Value { serde_json::from_slice(&std::fs::read(folder.join(file)).unwrap()).unwrap() };
    let tool = read("window-1/window.json")["captures"][0]["tool"].to_string();
    assert!(tool.contains("tcpdump"), "{tool}");
    let environment = read("environment.json");
    assert_eq!(
        environment["facts"]["limits"]["capabilities"],
        serde_json::json!(["SETGID"]),
        "{environment:#}"
    );
    assert!(
        environment["platform"]["ros_master"]
            .to_string()
            .contains("rosmaster"),
        "{environment:#}"
    );
}
