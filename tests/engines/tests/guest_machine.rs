//! The guest itself: what the tests of real networks stand on.

use std::process::Command;

use tests::Guest;

#[test]
fn a_guest_has_the_modules_and_tools_of_real_networks_and_two_do_not_meet() {
    let guest = Guest::boot();
    for module in ["sch_netem", "sch_htb", "openvswitch", "veth", "bridge", "tun"] {
        guest.expect(&["modprobe", module]);
    }
    for tool in [
        "tc",
        "ip",
        "mn",
        "ovs-vsctl",
        "rosmaster",
        "rostopic",
        "tcpdump",
        "cyclictest",
        "iperf3",
        "ethtool",
    ] {
        guest.expect(&["which", tool]);
    }
    guest.expect(&["systemctl", "start", "openvswitch-switch"]);
    assert!(guest.expect(&["ovs-vsctl", "show"]).contains("ovs_version"));

    let folder = tempfile::tempdir().unwrap();
    let (sent, back) = (folder.path().join("sent"), folder.path().join("back"));
    std::fs::write(&sent, "it's here\n").unwrap();
    guest.put(&sent, "/root/first file");
    guest.get("/root/first file", &back);
    assert_eq!(std::fs::read_to_string(back).unwrap(), "it's here\n");
    assert_eq!(
        guest.run(&["sh", "-c", "echo $0; exit 3", "a 'word'"]).code,
        Some(3)
    );

    let other = Guest::boot();
    assert_ne!(guest.ssh_port(), other.ssh_port());
    assert_eq!(
        other.run(&["cat", "/root/first file"]).code,
        Some(1),
        "every boot begins with the same disk"
    );
    let port = format!("hostfwd=tcp:127.0.0.1:{}-:22", other.ssh_port());
    assert!(running(&port));
    drop(other);
    assert!(!running(&port), "a dropped guest has ended");
    assert_eq!(guest.run(&["true"]).code, Some(0));
}

/// Whether a process of this machine has the text in its command line.
fn running(text: &str) -> bool {
    let output = Command::new("ps")
        .args(["-eo", "args"])
        .output()
        .expect("ps is there");
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .any(|line| line.starts_with("qemu-system") && line.contains(text))
}
