//! Debian's rosmaster as a process of the workload's: its death, its end, and what is said where it is missing.

use std::{
    fs,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};

use machine_workload::workload_program;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use record::{check::CheckRecord, progress::Progress};

use crate::{
    settings,
    stage::{Stage, TIMEOUT, machine, pid},
};

/// The one child that the workload has.
fn rosmaster_of(stage: &Stage) -> Pid {
    let tasks = fs::read_dir(format!("/proc/{}/task", stage.pid())).unwrap();
    let children = tasks.map(|task| fs::read_to_string(task.unwrap().path().join("children")).unwrap());
    let children: Vec<_> = children
        .collect::<String>()
        .split_whitespace()
        .map(|child| Pid::from_raw(child.parse().unwrap()))
        .collect();
    assert_eq!(children.len(), 1, "{children:?}");
    let command = fs::read(format!("/proc/{}/cmdline", children[0])).unwrap();
    assert!(String::from_utf8_lossy(&command).contains("rosmaster"));
    children[0]
}

fn wait_until_gone(process: Pid) {
    let deadline = Instant::now() + TIMEOUT;
    while Path::new(&format!("/proc/{process}")).exists() {
        assert!(Instant::now() < deadline, "{process} is still there");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_rosmaster_that_dies_is_started_again_and_knows_our_topics_while_messages_flow() {
    let _machine = machine();
    let mut stage = Stage::rehearse(&settings("rosmaster"), &[]);
    let listener = stage.node("h1", "listener.py", &["listener"]);
    listener.wait_for("received 50");
    for _ in 0..2 {
        let former = rosmaster_of(&stage);
        kill(former, Signal::SIGKILL).unwrap();
        let ended = stage.wait_for_notice("rosmaster ended and is started again");
        assert!(ended.contains("signal: 9"), "{ended}");
        for _ in 0..2 {
            stage.wait_for_notice("has registered with the master that came after");
        }
        assert_ne!(rosmaster_of(&stage), former);
        assert_eq!(
            stage.output("sta2", "/usr/bin/rostopic", &["list"]),
            "/command\n/state\n"
        );
        let info = stage.output("sta2", "/usr/bin/rostopic", &["info", "/command"]);
        assert!(
            info.contains("Publishers: \n * /controller") && info.contains("Subscribers: \n * /plant"),
            "{info}"
        );
    }
    let heard = listener.said();
    assert!(heard.iter().all(|line| line.starts_with("received")), "{heard:?}");
    drop(listener);
    let said = stage.end();
    let lost = |progress: &&Progress| matches!(progress, Progress::Notice { text, .. } if text.contains("no connection"));
    assert_eq!(said.iter().filter(lost).count(), 0, "{said:#?}");
}

#[test]
fn rosmaster_ends_with_its_workload() {
    let _machine = machine();
    let stage = Stage::rehearse(&settings("rosmaster"), &[]);
    let rosmaster = rosmaster_of(&stage);
    stage.end();
    wait_until_gone(rosmaster);
}

#[test]
fn rosmaster_ends_with_a_workload_that_is_killed() {
    let _machine = machine();
    let stage = Stage::rehearse(&settings("rosmaster"), &[]);
    let rosmaster = rosmaster_of(&stage);
    kill(pid(&stage.child), Signal::SIGKILL).unwrap();
    wait_until_gone(rosmaster);
}

fn check(path: &str) -> CheckRecord {
    let output = Command::new(workload_program())
        .args(["check", "--settings", &settings("rosmaster")])
        .env("PATH", path)
        .output()
        .unwrap();
    assert!(output.status.success());
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn whether_rosmaster_can_be_had_is_said_before_the_run_with_what_to_install() {
    let _machine = machine();
    assert!(check("/usr/bin").can_run);
    // Where there is none.
    let record = check("/nowhere");
    assert!(!record.can_run);
    let missing = record
        .checks
        .iter()
        .find(|check| !check.available && check.required)
        .unwrap();
    assert_eq!(missing.name, "ros-master");
    assert!(
        missing.fix.as_ref().unwrap().contains("apt-get install"),
        "{missing:?}"
    );
}
