//! A host that is a Mac, as far as it can be told from its answers: containers and virtual machines on it are measured
//! like anywhere else, and nothing is measured on it itself.
//!
//! sshd, the engine and the workload are real; that the system is macOS, and Vagrant with VirtualBox on it, are recorded
//! answers.

use serde_json::Value;
use tests::{MacOs, There, WHOLE_WINDOWS_COUNT, Workplace};

fn matrix(mac: &MacOs, virtualizations: &str) -> String {
    format!(
        "hosts:\n  mini: {{hardware: arm64, os: osx, connect: {}}}\n\
         matrix:\n  virtualization: {virtualizations}\n\
         workload:\n  dynamics: robust\n  windows: 1\n  window: 3s\n  period: 1s\n  reference: {{amplitude_m: 0.05}}\n  {WHOLE_WINDOWS_COUNT}\n",
        mac.sshd.connect()
    )
}

fn run(workplace: &Workplace) -> Value {
    let mut command = workplace.matrix(["run", "m.yaml", "--json", "--quiet"]);
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn of<'a>(report: &'a Value, virtualization: &str) -> &'a Value {
    let mut scenarios = report["scenarios"].as_array().unwrap().iter();
    let found = scenarios.find(|it| it["axes"]["virtualization"] == virtualization);
    found.unwrap_or_else(|| panic!("{virtualization}: {report:#}"))
}

#[test]
fn on_macos_containers_are_measured_and_the_system_itself_is_infeasible_with_the_reason() {
    let workplace = Workplace::measuring();
    let mac = MacOs::start();
    workplace.write("m.yaml", matrix(&mac, "[native, docker, libvirt]"));
    let doctor = workplace.json(&["doctor", "m.yaml"]);
    let mini = &doctor["hosts"][0];
    assert_eq!(mini["hardware"], "arm64", "{doctor:#}");
    assert_eq!(mini["os"], "macos-15.1", "{doctor:#}");
    assert_eq!(mini["kernel"], "24.1.0", "{doctor:#}");
    assert!(mini["free_bytes"].as_u64().unwrap() > 0, "{doctor:#}");

    let report = run(&workplace);
    assert_eq!(of(&report, "docker")["outcome"], "completed", "{report:#}");
    for (virtualization, reason) in [
        (
            "native",
            "it runs Darwin, and the workload is a program for Linux",
        ),
        ("libvirt", "Vagrant is not installed"),
    ] {
        let scenario = of(&report, virtualization);
        assert_eq!(scenario["outcome"], "infeasible", "{scenario:#}");
        assert_eq!(scenario["reason"], reason, "{scenario:#}");
    }
    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
}

/// Vagrant 2.4.3 as it answered on a Mac, with a machine that is another sshd. `$LOG` has what it was asked.
fn vagrant(log: &str, machine: &There) -> String {
    let port = machine.sshd.port();
    let identity = machine.sshd.identity();
    format!(
        r#"#!/bin/sh
echo "$*" >> {log}
machine=$VAGRANT_CWD/.vagrant/machines/machine/virtualbox
case $* in
    --version) echo "Vagrant 2.4.3" ;;
    "box list --machine-readable")
        echo "1731000000,,box-name,matrix/debian-12"
        echo "1731000000,,box-provider,virtualbox"
        echo "1731000000,,box-version,0" ;;
    "--machine-readable up --provider virtualbox")
        mkdir -p "$machine"
        echo "1731000001,machine,action,up,start"
        echo "1731000030,machine,action,up,end" ;;
    "--machine-readable status")
        if [ -d "$machine" ]; then state=running; else state=not_created; fi
        echo "1731000031,machine,metadata,provider,virtualbox"
        echo "1731000031,machine,state,$state"
        echo "1731000031,machine,state-human-short,$state" ;;
    ssh-config)
        printf 'Host machine\n  HostName 127.0.0.1\n  User %s\n  Port {port}\n' "$(id -un)"
        printf '  UserKnownHostsFile /dev/null\n  StrictHostKeyChecking no\n  PasswordAuthentication no\n'
        printf '  IdentityFile {identity}\n  IdentitiesOnly yes\n  LogLevel FATAL\n' ;;
    "--machine-readable destroy --force")
        rm -rf "$VAGRANT_CWD/.vagrant" ;;
    *) echo "vagrant: $*" >&2; exit 1 ;;
esac
"#,
        identity = identity.display()
    )
}

#[test]
fn on_macos_a_virtualbox_machine_is_made_measured_and_removed() {
    let workplace = Workplace::measuring();
    let (mac, machine) = (MacOs::start(), There::start());
    let log = workplace.path().join("vagrant.log").display().to_string();
    mac.install("vagrant", &vagrant(&log, &machine));
    mac.install(
        "VBoxManage",
        "#!/bin/sh\n[ \"$*\" = --version ] && echo 7.1.4r165100\n",
    );
    workplace.write("m.yaml", matrix(&mac, "[virtualbox]"));
    let report = run(&workplace);
    assert_eq!(of(&report, "virtualbox")["outcome"], "completed", "{report:#}");

    let asked = std::fs::read_to_string(&log).unwrap();
    let asked: Vec<_> = asked.lines().collect();
    let at = |call: &str| asked.iter().position(|it| *it == call);
    let up = at("--machine-readable up --provider virtualbox");
    let destroyed = at("--machine-readable destroy --force");
    assert!(up.is_some() && up < destroyed, "{asked:#?}");
    // The folder that Vagrant worked in went with the machine.
    let machines = mac.sshd.folder().join("state/machines");
    assert_eq!(std::fs::read_dir(machines).unwrap().count(), 0);
}
