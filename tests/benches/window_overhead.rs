//! A window of `run: ["true"]` in a container and over SSH, against `docker exec CONTAINER true` and `ssh HOST true`.
//!
//! Side by side in one run: `cargo bench --profile dev --workspace --bench window_overhead`. Prints the medians and their
//! ratios; it is not a test and has no bound.

use std::{
    fs,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use serde_json::Value;
use tests::{There, Workplace, engine::debian_image};

const ROUNDS: usize = 51;

fn main() {
    let image = debian_image("matrix-python:debian-12", &["python3"]);
    let there = There::start();
    let ours = |hosts_and_axes: &str| median(windows(hosts_and_axes));

    let container = "matrix-window-overhead";
    succeeds(
        Command::new("docker")
            .args(["run", "--detach", "--rm", "--name", container])
            .args(["--network", "none", &image, "sleep", "600"]),
    );
    let exec = median(each(|| {
        let mut command = Command::new("docker");
        command.args(["exec", container, "true"]);
        command
    }));
    succeeds(Command::new("docker").args(["rm", "--force", container]));
    let in_docker = ours(&format!(
        "matrix: {{virtualization: [docker]}}\nproviders:\n  docker: {{image: \"{image}\"}}\n"
    ));
    print("docker exec CONTAINER true", exec, in_docker);

    let ssh = median(each(|| {
        let mut command = Command::new("ssh");
        let known_hosts = format!("UserKnownHostsFile={}", there.sshd.known_hosts().display());
        command
            .args(["-p", &there.sshd.port().to_string(), "-i"])
            .arg(there.sshd.identity());
        command.args(["-o", &known_hosts, "-o", "BatchMode=yes", "127.0.0.1", "true"]);
        command
    }));
    let over_ssh = ours(&format!(
        "hosts:\n  there: {{hardware: two, os: linux, connect: {}}}\nmatrix: {{virtualization: [native]}}\n",
        there.connect()
    ));
    print("ssh HOST true", ssh, over_ssh);
}

fn print(name: &str, theirs: Duration, ours: Duration) {
    println!(
        "{name}: {:.1} ms; a window: {:.1} ms; ratio {:.2} (medians of {ROUNDS})",
        theirs.as_secs_f64() * 1e3,
        ours.as_secs_f64() * 1e3,
        ours.as_secs_f64() / theirs.as_secs_f64()
    );
}

/// From the start of each window to the start of the next one: the command, its files, its record, and what is done between windows.
fn windows(hosts_and_axes: &str) -> Vec<Duration> {
    let workplace = Workplace::measuring();
    workplace.write(
        "m.yaml",
        format!(
            "experiment:\n  name: nothing\n  run: [\"true\"]\n  metrics: [{{name: none, from: none.txt}}]\nworkload: {{windows: \
             {}}}\n{hosts_and_axes}",
            ROUNDS + 1
        ),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let folder = workplace.scenario_directory();
    let started: Vec<u64> = (1..=ROUNDS + 1)
        .map(|window| {
            let text = fs::read(folder.join(format!("window-{window}/window.json")))
                .expect("each window has a record");
            let record: Value = serde_json::from_slice(&text).expect("a record is JSON");
            record["started_ns"].as_u64().expect("a window begins")
        })
        .collect();
    let pairs = started.iter().zip(started.iter().skip(1));
    pairs
        .map(|(one, next)| Duration::from_nanos(next - one))
        .collect()
}

fn each(command: impl Fn() -> Command) -> Vec<Duration> {
    let once = || {
        let begun = Instant::now();
        succeeds(&mut command());
        begun.elapsed()
    };
    (0..ROUNDS).map(|_| once()).collect()
}

fn succeeds(command: &mut Command) {
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).status();
    assert!(status.is_ok_and(|status| status.success()), "{command:?}");
}

fn median(mut all: Vec<Duration>) -> Duration {
    all.sort_unstable();
    all[all.len() / 2]
}
