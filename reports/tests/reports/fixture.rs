//! A run directory as it was written once: format 1 must stay readable, whatever becomes of the types.

use std::path::PathBuf;

use reports::{analyse, run_directory::Outcome};

use crate::synthetic::{Scenario, Synthetic};

fn fixture() -> PathBuf {
    PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/fixtures/run-format-1"
    ))
}

#[test]
fn a_run_directory_of_format_1_is_still_readable() {
    let run = reports::load(fixture()).unwrap();
    insta::assert_snapshot!(analyse(&run, &run.manifest.report).markdown());
}

#[test]
#[ignore = "writes the fixture anew: only for a new format, into a new folder"]
fn write_the_fixture() {
    let measured = |slug, errors_m: &[f64]| Scenario::measured(slug, errors_m).by("fake");
    let synthetic = Synthetic::new(&[
        measured("x86-debian-native", &[0.1, 0.1]),
        measured("x86-debian-docker", &[0.11, 0.12]),
        Scenario::infeasible("x86-debian-virtualbox", "VBoxManage is not installed"),
        Scenario::ended("arm-debian-native", Outcome::Errored, "no route to host"),
    ]);
    let copied = std::process::Command::new("cp")
        .arg("-r")
        .args([synthetic.directory.path(), &fixture()])
        .status();
    assert!(copied.unwrap().success());
}
