//! What may happen to a host over SSH while it is measured on: a real sshd, real disks, a real machine that reboots.

use std::{fs::File, io::Write as _, path::PathBuf, process::Command, time::Duration};

use rstest::rstest;
use serde_json::Value;
use tests::{
    Guest, There, WHOLE_WINDOWS_COUNT, Workplace, is_whole,
    killed::{go_on_whole, kill_at},
};

const WORKLOAD: &str =
    "  dynamics: robust\n  windows: 2\n  window: 3s\n  period: 1s\n  reference: {amplitude_m: 0.05}\n";

fn both_are_whole(workplace: &Workplace) -> bool {
    let scenario = workplace.scenario_directory();
    (1..=2).all(|window| is_whole(&scenario.join(format!("window-{window}"))))
}

#[test]
fn windows_are_whole_though_the_connection_is_cut_in_one() {
    let workplace = Workplace::measuring();
    let there = There::start();
    workplace.write("m.yaml", there.matrix(WORKLOAD));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    there.sshd.cut();
    running.wait_for("window 1 complete");
    there.sshd.cut();
    let ran = running.end();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let scenario = workplace.scenario_directory();
    assert!((1..=2).all(|window| is_whole(&scenario.join(format!("window-{window}")))));
    workplace.assert_lines_came_once();
    assert_eq!(there.environments(), Vec::<String>::new());
}

/// The one scenario, of which window 1 was kept though it could not go on.
fn errored_with_one_window(workplace: &Workplace) -> Value {
    let status = workplace.json(&["status", workplace.run_directory().to_str().unwrap()]);
    let scenario = &status["scenarios"][0];
    assert_eq!(scenario["state"], "errored", "{status:#}");
    assert_eq!(scenario["windows_collected"], 1, "{status:#}");
    scenario.clone()
}

/// A disk of its own for the state folder there, until it is dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn under(there: &There, size: &str) -> Self {
        let folder = there.sshd.folder().join("state");
        std::fs::create_dir_all(&folder).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}"), "matrix-test"])
            .arg(&folder)
            .output()
            .unwrap();
        assert!(mounted.status.success(), "only root can make a disk: {mounted:?}");
        Self(folder)
    }

    fn filler(&self) -> PathBuf {
        self.0.join("filler")
    }

    fn fill(&self) {
        let mut filler = File::create(self.filler()).unwrap();
        let piece = [0; 4096];
        while filler.write_all(&piece).is_ok() {}
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).output();
    }
}

#[test]
fn a_disk_that_fills_up_in_a_window_ends_the_scenario_and_keeps_the_windows_before() {
    let workplace = Workplace::measuring();
    let there = There::start();
    let disk = SmallDisk::under(&there, "24m");
    workplace.write(
        "m.yaml",
        there.matrix(WORKLOAD).replace("window: 3s", "window: 5s"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    disk.fill();
    let ran = running.end();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    let scenario = errored_with_one_window(&workplace);
    let reason = scenario["reason"].as_str().unwrap();
    assert!(reason.contains("No space left on device"), "{reason}");

    std::fs::remove_file(disk.filler()).unwrap();
    let resumed = workplace.run(&["resume", workplace.run_directory().to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(there.environments(), Vec::<String>::new());
}

#[test]
fn windows_that_a_disk_has_no_room_for_are_not_begun() {
    let workplace = Workplace::measuring();
    let there = There::start();
    let _disk = SmallDisk::under(&there, "24m");
    workplace.write(
        "m.yaml",
        there.matrix(WORKLOAD).replace("window: 3s", "window: 6000s"),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(ran.err.contains("the disk of host `there` has "), "{ran:?}");
    assert!(ran.err.contains("and 2 windows take about 1.0 GB"), "{ran:?}");
    assert_eq!(there.environments(), Vec::<String>::new());
}

#[test]
fn a_server_that_is_away_for_a_minute_in_a_window_costs_nothing() {
    let workplace = Workplace::measuring();
    let mut there = There::start();
    workplace.write(
        "m.yaml",
        there.matrix(&WORKLOAD.replace("window: 3s", "window: 40s")),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    // The time itself is what is tried: a cut that lasts.
    there.sshd.restart_after(Duration::from_secs(60));
    let ran = running.end();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(both_are_whole(&workplace));
    assert_eq!(there.environments(), Vec::<String>::new());
}

#[rstest]
#[case::creating("environment-creating")]
#[case::measuring("workload/measuring")]
#[case::collecting("workload/finished")]
#[case::discarding("environment-discarding")]
fn a_run_killed_over_ssh_is_whole_after_resume(#[case] moment: &str) {
    let workplace = Workplace::measuring();
    let there = There::start();
    workplace.write(
        "m.yaml",
        there.matrix(&format!("{WORKLOAD}  {WHOLE_WINDOWS_COUNT}\n")),
    );
    kill_at(&workplace, moment);
    go_on_whole(&workplace);
    assert_eq!(workplace.run(&["clean"]).code, Some(0));
    assert_eq!(there.environments(), Vec::<String>::new());
}

#[test]
fn a_host_that_reboots_in_a_window_is_an_error_with_the_windows_before_and_can_be_gone_on_with() {
    let workplace = Workplace::measuring();
    let mut guest = Guest::boot();
    workplace.write(
        "m.yaml",
        format!(
            "hosts:\n  there: {{hardware: x86_64, os: debian-12, connect: {}}}\nmatrix:\n  virtualization: [native]\n\
             workload:\n  rate: 20Hz\n  {WHOLE_WINDOWS_COUNT}\n{}",
            guest.connect(),
            WORKLOAD.replace("window: 3s", "window: 15s")
        ),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    // What is on its way to the disk gets there, as with any reboot that somebody asked for.
    guest.expect(&["sync"]);
    guest.reboot();
    let ran = running.end();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    errored_with_one_window(&workplace);

    let resumed = workplace.run(&["resume", workplace.run_directory().to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert!(both_are_whole(&workplace));
}
