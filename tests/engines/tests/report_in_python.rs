//! examples/report.py, which holds what it computes from the report's files against what the report says.

use std::{fs, path::Path, process::Command};

use tests::{Ran, Workplace};

const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/report.py");

fn example(workplace: &Workplace, arguments: &[&str]) -> Ran {
    let home = std::env::var_os("HOME").unwrap();
    let python = Path::new(&home).join(".cache/matrix-python/venv/bin/python");
    let mut command = Command::new(python);
    command.arg(EXAMPLE).args(arguments).current_dir(workplace.path());
    Ran::of(
        command
            .output()
            .expect("tests/prepare has put Python's packages there"),
    )
}

#[test]
fn the_example_finds_the_reports_own_numbers_and_draws_its_figure_again() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        "matrix: {hardware: [x86_64], labels: {kernel: [stable, preempt-rt, tickless]}, virtualization: [fake]}\n\
         hosts: {desk: {connect: local, hardware: x86_64, os: debian-12}}\n\
         workload: {windows: 4, window: 30s, period: 1s}\n\
         report: {baseline: {kernel: stable}}\n\
         providers: {fake: {scenarios: {x86-64-debian-12-kernel-preempt-rt-fake: {shift_m: 0.02}}}}\n",
    );
    assert_eq!(workplace.run(&["run", "m.yaml", "--quiet"]).code, Some(0));
    let run = workplace.run_directory();
    let ran = example(&workplace, &[run.to_str().unwrap(), "figure.png"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for said in [
        "SIMULATED, NOT MEASURED",
        "3 scenarios, 66 comparisons",
        "D = 29/29 = 1.000",
        // Table III, and Table V of the one control.
        "│ a   ┆ x86_64   ┆ debian-12 ┆ fake           ┆ 4               ┆ 6     ┆ 0",
        "│ a   ┆ fake             ┆ 16",
    ] {
        assert!(ran.out.contains(said), "{said}: {ran:?}");
    }
    let figure = fs::read(workplace.path().join("figure.png")).unwrap();
    assert!(figure.starts_with(b"\x89PNG") && figure.len() > 10_000);

    // It does compare: a report that says something else is found out.
    let path = run.join("report/report.json");
    let changed = fs::read_to_string(&path)
        .unwrap()
        .replace("\"rejected\": 16", "\"rejected\": 15");
    fs::write(&path, changed).unwrap();
    let ran = example(&workplace, &[run.to_str().unwrap()]);
    assert!(
        ran.code == Some(1) && ran.err.contains("AssertionError"),
        "{ran:?}"
    );
}
