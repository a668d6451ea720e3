//! A run directory as it was written once: format 1 must stay readable, whatever becomes of the types.

use std::path::PathBuf;

use captures::traffic::Traffic;
use reports::analyse;

fn fixture() -> PathBuf {
    PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/fixtures/run-format-1"
    ))
}

#[test]
fn a_run_directory_of_format_1_is_still_readable() {
    let run = reports::load(fixture()).unwrap();
    insta::assert_snapshot!(
        analyse(&run, Traffic::default(), &run.manifest.report)
            .present()
            .markdown()
    );
}
