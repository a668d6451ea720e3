//! A matrix over machines of three architectures: this one, and an aarch64 and an i686 over SSH, emulated and real down to
//! their kernels; natively, in Docker and in a virtual machine.

use serde_json::Value;
use sha2::{Digest as _, Sha256};
use tests::{Fleet, WHOLE_WINDOWS_COUNT, Workplace, workloads_for};

fn of<'a>(report: &'a Value, host: &str, virtualization: &str) -> &'a Value {
    let mut scenarios = report["scenarios"].as_array().unwrap().iter();
    let hardware = match host {
        "arm" => "aarch64",
        "old" => "i686",
        _ => "x86_64",
    };
    scenarios
        .find(|it| it["axes"]["hardware"] == hardware && it["axes"]["virtualization"] == virtualization)
        .unwrap_or_else(|| panic!("{host} {virtualization} has a row: {report:#}"))
}

fn sha256(program: &[u8]) -> String {
    Sha256::digest(program)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[test]
fn every_scenario_of_three_architectures_is_measured_or_infeasible_with_its_reason() {
    let workloads = workloads_for(&["i686", "aarch64"]);
    let mut workplace = Workplace::measuring();
    workplace.set("MATRIX_WORKLOADS", &workloads.display().to_string());
    let fleet = Fleet::boot();
    let windows =
        "dynamics: robust\n  windows: 2\n  window: 4s\n  period: 1s\n  reference: {amplitude_m: 0.05}";
    workplace.write(
        "m.yaml",
        fleet.matrix(
            "[native, docker, libvirt]",
            &format!("  {windows}\n  {WHOLE_WINDOWS_COUNT}\n"),
            "",
        ),
    );
    let mut command = workplace.matrix(["run", "m.yaml", "--json", "--quiet"]);
    let output = command.output().expect("matrix starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();

    for (host, virtualization) in [
        ("here", "native"),
        ("here", "docker"),
        ("here", "libvirt"),
        ("arm", "native"),
        ("arm", "docker"),
        ("old", "native"),
    ] {
        let scenario = of(&report, host, virtualization);
        assert_eq!(scenario["outcome"], "completed", "{scenario:#}\n{said}");
    }
    for (host, virtualization, reason) in [
        ("arm", "libvirt", "Vagrant is not installed"),
        ("old", "docker", "docker.sock"),
        ("old", "libvirt", "Vagrant is not installed"),
    ] {
        let scenario = of(&report, host, virtualization);
        assert_eq!(scenario["outcome"], "infeasible", "{scenario:#}");
        assert!(
            scenario["reason"].as_str().unwrap().contains(reason),
            "{scenario:#}"
        );
    }
    for (slug, machine) in [
        ("aarch64-debian-12-native", "aarch64"),
        ("aarch64-debian-12-docker", "aarch64"),
        ("i686-debian-12-native", "i686"),
    ] {
        let path = workplace
            .run_directory()
            .join("scenarios")
            .join(slug)
            .join("environment.json");
        let environment: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        assert_eq!(environment["platform"]["machine"], machine, "{environment:#}");
        assert_eq!(
            environment["platform"]["workload_machine"], machine,
            "{environment:#}"
        );
        let program = std::fs::read(workloads.join(machine).join("workload")).unwrap();
        assert_eq!(
            environment["facts"]["workload_sha256"],
            sha256(&program),
            "{environment:#}"
        );
    }

    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    for kind in [
        ["docker", "ps", "--all", "--quiet"].as_slice(),
        &["docker", "volume", "ls", "--quiet"],
        &["docker", "images", "--quiet"],
    ] {
        assert_eq!(fleet.arm.expect(kind), "", "{kind:?}");
    }
    for guest in [&fleet.arm, &fleet.old] {
        let left = guest.run(&["sh", "-c", "ls /root/.local/state/matrix/environments"]);
        assert_eq!((left.code, left.out.as_str()), (Some(0), ""), "{left:?}");
    }
}
