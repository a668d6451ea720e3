//! Virtual machines through Vagrant and VirtualBox, from `vagrant up` to the report and to nothing: the real VirtualBox, its
//! machine's processor interpreted.

use std::{path::Path, process::Command};

use serde_json::Value;
use tests::{Ran, Workplace, virtualbox::VirtualBox};

/// Two control steps a second, of the machine's clock.
const WORKLOAD: &str = "\
workload:
  windows: 2
  rate: 2Hz
  window: 4s
  dynamics: robust
  period: 1s
  reference: {amplitude_m: 0.05}
";

#[test]
fn a_machine_of_virtualbox_is_made_measured_in_reported_and_removed() {
    let workplace = Workplace::measuring();
    let virtualbox = VirtualBox::below(workplace.path());
    let run = |arguments: &[&str]| {
        Ran::of(
            virtualbox
                .on(workplace.matrix(arguments))
                .output()
                .expect("matrix starts"),
        )
    };
    let json = |arguments: &[&str]| -> Value {
        let ran = run(&[arguments, &["--json"]].concat());
        serde_json::from_str(&ran.out).unwrap_or_else(|error| panic!("{arguments:?}: {error}\n{ran:?}"))
    };
    workplace.write(
        "m.yaml",
        format!(
            "matrix: {{virtualization: [virtualbox]}}\n{WORKLOAD}providers:\n{}",
            tests::virtualbox::PROVIDER
        ),
    );

    let other = std::fs::read_to_string(workplace.path().join("m.yaml")).unwrap();
    workplace.write(
        "other.yaml",
        other.replace("matrix/virtualbox", "matrix/not-there"),
    );
    let plan = json(&["plan", "other.yaml"]);
    assert_eq!(
        plan["scenarios"][0]["reason"], "Vagrant has no box `matrix/not-there` for virtualbox",
        "{plan:#}"
    );

    let plan = json(&["plan", "m.yaml"]);
    assert_eq!(plan["scenarios"][0]["feasible"], true, "{plan:#}");

    let ran = run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let directory = workplace.run_directory();
    let report = json(&["report", directory.to_str().unwrap()]);
    let scenario = &report["scenarios"][0];
    assert_eq!(scenario["outcome"], "completed", "{report:#}");
    let windows = scenario["windows"].as_array().unwrap();
    assert_eq!(windows.len(), 2, "{report:#}");
    for window in windows {
        // An interpreted processor may be too slow for a window to be valid: it counts, or the report says why not.
        let reasons = window["reasons"].as_array().unwrap();
        assert!(
            window["counted"] == true || !reasons.is_empty(),
            "{window:#}\n{ran:?}"
        );
        for reason in reasons {
            let beginning: String = reason.as_str().unwrap().chars().take(20).collect();
            assert!(ran.out.contains(&beginning), "{beginning}\n{ran:?}");
        }
    }

    let environment = workplace.scenario_directory().join("environment.json");
    let environment: Value = serde_json::from_slice(&std::fs::read(environment).unwrap()).unwrap();
    assert_eq!(environment["provider"], "virtualbox", "{environment:#}");
    assert_eq!(
        environment["facts"]["machine"]["box"], "matrix/virtualbox",
        "{environment:#}"
    );
    assert_eq!(environment["platform"]["hostname"], "guest", "{environment:#}");

    // Eight seconds and more of the machine's, which may be many more of ours: then the report says so.
    let clock = &environment["facts"]["clock"];
    let [seconds, drift_ms, within_ms] =
        ["seconds", "drift_ms", "within_ms"].map(|name| clock[name].as_f64().unwrap());
    assert!(seconds + drift_ms / 1e3 > 8.0, "{clock}");
    let another_speed = drift_ms.abs() > within_ms && drift_ms.abs() > seconds * 10.0;
    let report = run(&["report", directory.to_str().unwrap()]).out;
    assert_eq!(
        report.contains("its clock went"),
        another_speed,
        "{clock}\n{report}"
    );

    assert_eq!(virtualbox.machines(), "");
    let machines = workplace.path().join("state/machines");
    assert_eq!(std::fs::read_dir(machines).unwrap().count(), 0);
    let left = json(&["clean", "--dry-run"]);
    let machine = |it: &&Value| it["kind"] == "machine";
    assert_eq!(left["leftovers"].as_array().unwrap().iter().find(machine), None);
}

#[test]
fn virtualbox_takes_the_box_that_matrix_makes() {
    let workplace = Workplace::new();
    let virtualbox = VirtualBox::below(workplace.path());
    let recipe = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../vagrant/box/build");
    let made = Command::new(recipe)
        .args(["virtualbox", "x86_64"])
        .output()
        .expect("the recipe starts");
    assert!(made.status.success(), "{made:?}");
    let made = String::from_utf8_lossy(&made.stdout).trim().to_owned();
    let unpacked = Command::new("tar")
        .args(["--extract", "--file", &made, "--directory"])
        .arg(workplace.path())
        .status();
    assert!(unpacked.is_ok_and(|status| status.success()));
    let metadata = std::fs::read_to_string(workplace.path().join("metadata.json")).unwrap();
    assert_eq!(metadata.trim(), r#"{"provider": "virtualbox"}"#);

    let ovf = workplace.path().join("box.ovf");
    let mut import = Command::new("env");
    import.args(["VBoxManage", "import", "--dry-run"]).arg(ovf);
    let imported = Ran::of(virtualbox.on(import).output().expect("env starts"));
    assert_eq!(imported.code, Some(0), "{imported:?}");
    for part in [
        "Suggested OS type: \"Debian_64\"",
        "SATA controller, type AHCI",
        "source image=box.vmdk",
        "controller=8;port=0",
        "extra type=NAT",
    ] {
        assert!(
            imported.out.contains(part),
            "{part:?} is missing in\n{}",
            imported.out
        );
    }
}
