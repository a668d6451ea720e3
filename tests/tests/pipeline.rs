//! The pipeline that `matrix ci-generate` prints, whose jobs are done here as a runner would.

use std::{
    path::Path,
    process::{Command, Output},
};

use serde_yaml::Value;
use tests::{FAKE, Workplace, matrix_binary};

/// Does a line of a job's script where the repository is.
fn done(workplace: &Workplace, script: &str) {
    let output = shell(workplace, script);
    assert!(output.status.success(), "{script}: {output:?}");
}

fn shell(workplace: &Workplace, script: &str) -> Output {
    let programs = matrix_binary().parent().unwrap();
    let path = std::env::var("PATH").unwrap();
    Command::new("sh")
        .args(["-c", script])
        .current_dir(workplace.path())
        .env("PATH", format!("{}:{path}", programs.display()))
        .env("MATRIX_STATE_DIR", workplace.path().join("state"))
        .env("MATRIX_LEASE", workplace.path().join("lease"))
        .output()
        .unwrap()
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

#[test]
fn a_mean_that_the_file_does_not_expect_fails_the_first_night_and_is_its_first_sentence() {
    let workplace = Workplace::new();
    let with = |limit: &str| {
        format!("{FAKE}report: {{expect: {{error: {{value: {limit}, below: 5%, above: 5%}}}}}}\n")
    };
    workplace.write("m.yaml", with("1mm"));
    let ran = workplace.run(&["run", "m.yaml", "--quiet"]);
    assert_eq!(ran.code, Some(7), "{ran:?}");
    let told = ran.out.replace('\n', " ");
    assert!(
        told.starts_with("Simulated, not measured: Not as expected: the error of a (place here) is"),
        "{told}"
    );
    assert!(told.contains("and at most 1.05 mm is expected."), "{told}");
    let report = workplace.run(&["report", "latest", "--json"]);
    assert_eq!(report.code, Some(7), "{report:?}");
    let report: serde_json::Value = serde_json::from_str(&report.out).unwrap();
    let a = &report["expected"][0];
    assert_eq!(
        (&a["scenario"], &a["as_expected"]),
        (&"a".into(), &false.into()),
        "{a:#}"
    );
    // What it is, is as expected; a run that failed says so and not this.
    let mean_mm = a["mean"]["value"].as_f64().unwrap() * 1e3;
    workplace.write("m.yaml", with(&format!("{mean_mm:.3}mm")));
    assert_eq!(workplace.run(&["run", "m.yaml", "--quiet"]).code, Some(0));
    let slug = &report["scenarios"][0]["slug"];
    let failing =
        format!("providers: {{fake: {{scenarios: {{{slug}: {{fail: {{at: measure, window: 3}}}}}}}}}}\n");
    workplace.write("m.yaml", format!("{}{failing}", with("1mm")));
    assert_eq!(workplace.run(&["run", "m.yaml", "--quiet"]).code, Some(1));
}

#[test]
fn the_nightly_script_tells_on_the_first_night_what_is_not_expected() {
    let workplace = Workplace::new();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/nightly/nightly .");
    for (limit, code) in [("1mm", 7), ("9m", 6)] {
        let night = format!("{FAKE}report: {{expect: {{error: {{value: {limit}, above: 5%}}}}}}\n");
        workplace.write("matrix.yaml", night);
        let ran = shell(&workplace, script);
        // Of one night, or two, drift says that it has too little data.
        assert_eq!(ran.status.code(), Some(code), "{limit}: {ran:?}");
    }
}
