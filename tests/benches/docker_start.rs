//! From `matrix run` to the first control step in Docker, against `docker run` of the same image to its first line.
//!
//! Side by side, in turn, in one run: `cargo bench --profile dev --workspace --bench docker_start`. Prints the medians and
//! their ratio; it is not a test and has no bound.

use std::{
    io::{BufRead, BufReader},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use tests::Workplace;

const ROUNDS: usize = 11;

const MATRIX: &str = "\
matrix:
  virtualization: [docker]
workload:
  windows: 1
  window: 2s
  dynamics: robust
  period: 1s
";

fn main() {
    let workplace = Workplace::measuring();
    workplace.write("matrix.yaml", MATRIX);
    // The first run makes the image, for both.
    let first = workplace.run(&["run", "matrix.yaml"]);
    assert_eq!(first.code, Some(0), "{first:?}");
    let image = image();
    let mut ours = Vec::new();
    let mut theirs = Vec::new();
    for _ in 0..ROUNDS {
        theirs.push(docker_run(&image));
        ours.push(matrix_run(&workplace));
    }
    let (ours, theirs) = (median(ours), median(theirs));
    println!(
        "matrix run to the first control step: {:.0} ms (median of {ROUNDS})",
        ours.as_secs_f64() * 1e3
    );
    println!(
        "docker run to the first line:         {:.0} ms (median of {ROUNDS})",
        theirs.as_secs_f64() * 1e3
    );
    println!(
        "ratio:                                {:.2}",
        ours.as_secs_f64() / theirs.as_secs_f64()
    );
    let clean = workplace.run(&["clean"]);
    assert_eq!(clean.code, Some(0), "{clean:?}");
}

fn image() -> String {
    let output = Command::new("docker")
        .args([
            "images",
            "--format",
            "{{.Repository}}:{{.Tag}}",
            "matrix-workload",
        ])
        .output()
        .expect("the docker command is there");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    text.lines()
        .next()
        .expect("the first run left its image")
        .to_owned()
}

fn docker_run(image: &str) -> Duration {
    let begin = Instant::now();
    let mut child = Command::new("docker")
        .args(["run", "--rm", "--network", "none", image, "check"])
        .stdout(Stdio::piped())
        .spawn()
        .expect("docker starts");
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("standard output is a pipe"))
        .read_line(&mut line)
        .expect("the pipe can be read");
    let took = begin.elapsed();
    assert!(!line.is_empty(), "the image says something");
    child.wait().expect("docker ends");
    took
}

fn matrix_run(workplace: &Workplace) -> Duration {
    let begin = Instant::now();
    let mut running = workplace.start(&["run", "matrix.yaml"]);
    running.wait_for("measuring window 1");
    let took = begin.elapsed();
    assert_eq!(running.end().code, Some(0));
    took
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort();
    times[times.len() / 2]
}
