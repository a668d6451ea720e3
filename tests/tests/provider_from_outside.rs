//! A program with a provider of its own: what the command line makes of it.

use std::process::{Command, Output};

use serde_json::Value;
use tests::program_with_another_provider;

fn run(folder: &tempfile::TempDir, arguments: &[&str]) -> Output {
    let mut program = Command::new(program_with_another_provider());
    program.args(arguments).current_dir(folder.path());
    program.output().unwrap()
}

#[test]
fn the_matrix_file_its_schema_and_its_mistakes_know_a_provider_from_outside() {
    let folder = tempfile::tempdir().unwrap();
    let schema = run(&folder, &["schema"]);
    assert!(schema.status.success(), "{schema:?}");
    let schema: Value = serde_json::from_slice(&schema.stdout).unwrap();
    assert!(schema.to_string().contains("\"nice\""), "{schema:#}");

    let file = folder.path().join("m.yaml");
    std::fs::write(
        &file,
        "matrix: {virtualization: [native, nice]}\nproviders: {nice: {level: 10}}\n",
    )
    .unwrap();
    let checked = run(&folder, &["check", "m.yaml"]);
    assert!(checked.status.success(), "{checked:?}");

    std::fs::write(
        &file,
        "matrix: {virtualization: [nice]}\nproviders: {nice: {lvl: 10}}\n",
    )
    .unwrap();
    let refused = run(&folder, &["check", "m.yaml"]);
    let said = String::from_utf8(refused.stderr).unwrap();
    assert_eq!(refused.status.code(), Some(2), "{said}");
    assert!(
        said.contains("m.yaml:2") && said.contains("`nice` does not take these settings"),
        "{said}"
    );
}
