//! `kill -9` of `matrix` at every moment of a scenario on a real Docker Engine, and `resume`.

use std::process::Command;

use rstest::rstest;
use tests::{
    WHOLE_WINDOWS_COUNT, Workplace,
    killed::{go_on_whole, kill_at},
};

const MATRIX: &str = "\
matrix:
  virtualization: [docker]
workload:
  windows: 2
  window: 2s
  period: 500ms
  reference: {amplitude_m: 0.05}
";

/// The containers and volumes of a run that the engine has.
fn on_the_engine(run_directory: &str) -> Vec<String> {
    let filter = format!("label=matrix.run-directory={run_directory}");
    let kinds: [&[&str]; 2] = [&["ps", "--all"], &["volume", "ls"]];
    let mut found = Vec::new();
    for kind in kinds {
        let listed = Command::new("docker")
            .args(kind)
            .args(["--quiet", "--filter", &filter])
            .output()
            .unwrap();
        assert!(listed.status.success(), "{listed:?}");
        found.extend(
            String::from_utf8(listed.stdout)
                .unwrap()
                .lines()
                .map(str::to_owned),
        );
    }
    found
}

#[rstest]
#[case::creating("environment-creating")]
#[case::created("environment-created")]
#[case::measuring("workload/measuring")]
#[case::between_windows("workload/window-complete")]
#[case::collecting("workload/finished")]
#[case::collected("window-collected")]
#[case::discarding("environment-discarding")]
fn a_run_killed_on_docker_is_whole_after_resume(#[case] moment: &str) {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", format!("{MATRIX}  {WHOLE_WINDOWS_COUNT}\n"));
    kill_at(&workplace, moment);
    let directory = workplace.run_directory();
    let directory = directory.to_str().unwrap();
    if moment.starts_with("workload/") {
        let there = on_the_engine(directory);
        assert!(!there.is_empty(), "what was killed left something behind");
    }

    go_on_whole(&workplace);

    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert_eq!(on_the_engine(directory), Vec::<String>::new());
}
