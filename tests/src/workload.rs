//! The `workload` binary by itself, as it is deployed: static and in the profile `deploy`.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::OnceLock,
};

/// Where the static `workload` binary for this machine's architecture is; built first if need be. Not in the folder of the
/// one that `matrix` carries: that has flags of its own, and each of the two would take the other's place, and `matrix` be
/// built again with the wrong one.
///
/// # Panics
/// When it cannot be built.
pub fn workload_binary() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| built(deployed().bin("workload")))
}

/// Where a static example of the workload's crate is, such as `network_probe`, built as the workload is: `workload/examples/NAME.rs`.
///
/// # Panics
/// When it cannot be built.
pub fn workload_example(name: &str) -> PathBuf {
    built(deployed().example(name))
}

fn deployed() -> escargot::CargoBuild {
    escargot::CargoBuild::new()
        .package("workload")
        .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml"))
        .env("RUSTFLAGS", "-C target-feature=+crt-static")
        .target(format!("{}-unknown-linux-gnu", std::env::consts::ARCH))
        .target_dir(target_directory().join("workload-tested"))
        .args(["--locked", "--profile", "deploy"])
}

fn built(build: escargot::CargoBuild) -> PathBuf {
    build
        .run()
        .expect("`cargo build -p workload` works")
        .path()
        .to_owned()
}

/// The test, example or benchmark that runs is at `<target directory>/<profile>/<kind>/<name>`.
fn target_directory() -> PathBuf {
    let program = std::env::current_exe().expect("the test knows where it is");
    let folder = program.ancestors().nth(3);
    folder
        .expect("tests run from cargo's target directory")
        .to_owned()
}

/// The folder with the workloads for other machines, made by the builder: as `MATRIX_WORKLOADS` names it.
///
/// # Panics
/// When the builder fails; it has said why.
#[must_use]
pub fn workloads_for(machines: &[&str]) -> PathBuf {
    let target = target_directory();
    let builder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../workload/builder/build");
    let built = Command::new(builder)
        .args(machines)
        .env("CARGO_TARGET_DIR", &target)
        .stdin(Stdio::null())
        .status()
        .expect("the builder starts");
    assert!(built.success(), "workload/builder/build {machines:?} failed");
    target.join("workloads")
}
