//! The pipeline that `matrix ci-generate` prints, whose jobs are done here as a runner would.

use std::{path::Path, process::Command};

use serde_yaml::Value;
use tests::{FAKE, Workplace, matrix_binary};

/// Does a line of a job's script where the repository is.
fn done(workplace: &Workplace, script: &str) {
    let programs = matrix_binary().parent().unwrap();
    let path = std::env::var("PATH").unwrap();
    let output = Command::new("sh")
        .args(["-c", script])
        .current_dir(workplace.path())
        .env("PATH", format!("{}:{path}", programs.display()))
        .env("MATRIX_STATE_DIR", workplace.path().join("state"))
        .env("MATRIX_LEASE", workplace.path().join("lease"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{script}: {output:?}");
}

#[test]
fn the_jobs_of_a_pipeline_measure_each_scenario_and_make_one_report() {
    let workplace = Workplace::new();
    workplace.write("my matrix.yaml", FAKE);
    let printed = workplace.run(&["ci-generate", "my matrix.yaml", "--for", "gitlab"]);
    let pipeline: Value = serde_yaml::from_str(&printed.out).unwrap();
    let jobs = pipeline.as_mapping().unwrap();
    for stage in pipeline["stages"].as_sequence().unwrap() {
        for job in jobs.values().filter(|job| job.get("stage") == Some(stage)) {
            done(&workplace, job["script"][0].as_str().unwrap());
        }
    }
    let report = std::fs::read(workplace.path().join("report/report.json")).unwrap();
    let report: Value = serde_yaml::from_slice(&report).unwrap();
    let scenarios = report["scenarios"].as_sequence().unwrap();
    assert_eq!(scenarios.len(), 2);
    assert!(
        scenarios.iter().all(|it| it["outcome"] == "completed"),
        "{scenarios:#?}"
    );
    assert!(Path::new(&workplace.path().join("report/report.html")).is_file());
}

#[test]
fn the_jobs_of_a_workflow_have_the_same_scripts() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    let scripts = |system: &str| -> Vec<String> {
        let printed = workplace.run(&["ci-generate", "m.yaml", "--for", system]);
        assert_eq!(printed.code, Some(0), "{printed:?}");
        let lines = printed
            .out
            .lines()
            .filter_map(|line| line.split_once("matrix run"));
        let mut scripts: Vec<String> = lines.map(|(_, rest)| rest.to_owned()).collect();
        scripts.sort();
        scripts
    };
    assert_eq!(scripts("gitlab").len(), 2);
    assert_eq!(scripts("gitlab"), scripts("github"));
}
