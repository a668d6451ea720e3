//! Virtual machines through Vagrant and libvirt, from `vagrant up` to the report and to nothing: real machines, their
//! processors emulated in software.

use std::process::Command;

use serde_json::Value;
use tests::{WHOLE_WINDOWS_COUNT, Workplace, example};

/// The box of `vagrant/box`, emulated: libvirt would take KVM otherwise, which not every machine has.
const LIBVIRT: &str = "\
providers:
  libvirt:
    options: {driver: qemu, cpu_mode: custom, cpu_model: qemu64, graphics_type: none, video_type: none}
";

fn matrix(virtualizations: &str, workload: &str) -> String {
    format!(
        "matrix:\n  virtualization: [{virtualizations}]\nworkload:\n  dynamics: robust\n  windows: 2\n  period: 1s\n  reference: \
         {{amplitude_m: 0.05}}\n  {WHOLE_WINDOWS_COUNT}\n{workload}{LIBVIRT}"
    )
}

/// What libvirt has of the workplace's run: machines and their disks. A box's own image stays, as an engine's would.
fn in_libvirt(workplace: &Workplace) -> Vec<String> {
    let run = workplace.run_directory();
    let ours = format!("matrix-{}-", run.file_name().unwrap().to_str().unwrap());
    let list = |arguments: &[&str]| {
        let output = Command::new("virsh")
            .args(["--connect", "qemu:///system"])
            .args(arguments)
            .output()
            .expect("virsh is there");
        assert!(output.status.success(), "{output:?}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let machines = list(&["list", "--all", "--name"]);
    let disks = list(&["vol-list", "default"]);
    let names = machines.lines().chain(disks.lines()).map(str::trim);
    names
        .filter(|name| name.starts_with(&ours))
        .map(str::to_owned)
        .collect()
}

fn scenario<'a>(report: &'a Value, virtualization: &str) -> &'a Value {
    let mut scenarios = report["scenarios"].as_array().unwrap().iter();
    scenarios
        .find(|scenario| scenario["axes"]["virtualization"] == virtualization)
        .unwrap()
}

#[test]
fn a_machine_is_made_measured_in_on_mininets_network_reported_and_removed() {
    let workplace = Workplace::measuring();
    workplace.write(
        "m.yaml",
        matrix("libvirt", "  window: 4s\n  network: {backend: mininet}\n"),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let directory = workplace.run_directory();
    let report = workplace.json(&["report", directory.to_str().unwrap()]);
    assert_eq!(scenario(&report, "libvirt")["outcome"], "completed", "{report:#}");
    assert_eq!(report["within"][0]["pairs"], 1, "{report:#}");

    let folder = workplace.scenario_directory();
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let environment: Value = serde_json::from_str(&read("environment.json")).unwrap();
    assert_eq!(environment["provider"], "libvirt");
    assert_eq!(environment["facts"]["machine"]["box"], "matrix/debian-12");
    let platform = &environment["platform"];
    assert_eq!(platform["hostname"], "guest", "{platform:#}");
    assert_eq!(platform["hypervisor"], true, "{platform:#}");
    assert!(read("network.txt").contains("ovs-vsctl show"));

    assert_eq!(in_libvirt(&workplace), Vec::<String>::new());
    let left = workplace.json(&["clean", "--dry-run"]);
    let machines = |it: &&Value| it["kind"] == "machine";
    assert_eq!(left["leftovers"].as_array().unwrap().iter().find(machines), None);
}

#[test]
fn a_machine_that_is_destroyed_in_a_window_is_an_error_and_the_other_scenarios_go_on() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix("libvirt, native", "  window: 3s\n"));
    let text = std::fs::read_to_string(workplace.path().join("m.yaml")).unwrap();
    let long = text.replace("  window: 3s\n", "  window: 60s\n");
    workplace.write("m.yaml", long);
    let mut running = workplace.start(&["run", "m.yaml", "--only", "virtualization=libvirt"]);
    let before = running.wait_for("libvirt: measuring window 1");
    let machines: Vec<_> = in_libvirt(&workplace)
        .into_iter()
        .filter(|name| name.ends_with("_machine"))
        .collect();
    let [machine] = machines.as_slice() else {
        panic!("one machine: {machines:?}\n{before}")
    };
    let destroyed = Command::new("virsh")
        .args(["--connect", "qemu:///system", "destroy", machine])
        .output()
        .unwrap();
    assert!(destroyed.status.success(), "{destroyed:?}");
    let ended = running.end();
    let directory = workplace.run_directory();
    let status = workplace.json(&["status", directory.to_str().unwrap()]);
    let libvirt = status["scenarios"]
        .as_array()
        .unwrap()
        .iter()
        .find(|scenario| scenario["slug"].as_str().unwrap().contains("libvirt"))
        .unwrap();
    assert_eq!(libvirt["state"], "errored", "{status:#}\n{ended:?}");
    let reason = libvirt["reason"].as_str().unwrap();
    assert!(reason.contains("does not run any more"), "{reason}");

    // Its disk still has what was measured: nothing of it is thrown away without being told to.
    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    assert!(resumed.err.contains("`vagrant up` in "), "{resumed:?}");
    assert!(in_libvirt(&workplace).contains(machine), "{resumed:?}");

    assert_eq!(workplace.run(&["clean"]).code, Some(0));
    assert_eq!(in_libvirt(&workplace), Vec::<String>::new());
}

#[test]
fn a_box_that_vagrant_does_not_have_makes_the_scenario_infeasible() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        "matrix: {virtualization: [libvirt]}\nproviders:\n  libvirt: {box: matrix/not-there}\n",
    );
    let plan = workplace.json(&["plan", "m.yaml"]);
    let scenario = &plan["scenarios"][0];
    assert_eq!(
        scenario["reason"], "Vagrant has no box `matrix/not-there` for libvirt",
        "{plan:#}"
    );
    let fix = scenario["fix"].as_str().unwrap();
    assert!(fix.contains("vagrant box add matrix/not-there"), "{fix}");
}

#[test]
fn vagrant_accepts_what_it_is_given_for_both_providers() {
    let folder = tempfile::tempdir().unwrap();
    let vagrantfile = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../vagrant/Vagrantfile");
    std::fs::copy(vagrantfile, folder.path().join("Vagrantfile")).unwrap();
    for (provider, options) in [
        (
            "libvirt",
            serde_json::json!({"driver": "qemu", "nic_model_type": "e1000"}),
        ),
        (
            "virtualbox",
            serde_json::json!({"gui": false, "customize": [["modifyvm", ":id", "--vm-execution-engine", "recompiler"]]}),
        ),
    ] {
        let machine = serde_json::json!({
            "provider": provider, "box": "matrix/debian-12", "boot_timeout_s": 300, "insert_key": true,
            "memory_mib": 1024, "cpus": 2, "guest": "linux", "options": options,
        });
        std::fs::write(folder.path().join("machine.json"), machine.to_string()).unwrap();
        let validated = Command::new("vagrant")
            .args(["validate"])
            .env("VAGRANT_CHECKPOINT_DISABLE", "1")
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(validated.status.success(), "{provider}: {validated:?}");
    }
}

#[test]
fn the_same_pile_of_bodies_falls_in_the_same_way_in_a_virtual_machine() {
    let workplace = example("falling-bodies");
    let fetched = Command::new("./get-wheels")
        .current_dir(workplace.path())
        .status()
        .unwrap();
    assert!(fetched.success());
    let text = std::fs::read_to_string(workplace.path().join("matrix.yaml")).unwrap();
    workplace.write(
        "m.yaml",
        text.replace("[native, docker, libvirt]", "[native, libvirt]")
            .replace("windows: 8", "windows: 2"),
    );
    let report = workplace.json(&["run", "m.yaml", "--profile", "guest"]);
    assert_eq!(scenario(&report, "libvirt")["outcome"], "completed", "{report:#}");
    let state = &report["agreements"][0];
    assert_eq!(state["windows"].as_array().unwrap().len(), 2, "{state:#}");
    assert_eq!(state["groups"].as_array().unwrap().len(), 1, "{state:#}");
    assert_eq!(in_libvirt(&workplace), Vec::<String>::new());
}
