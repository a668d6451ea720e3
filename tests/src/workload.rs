//! The `workload` binary by itself, as it is deployed: static and in the profile `deploy`.

use std::{
    path::{Path, PathBuf},
    sync::OnceLock,
};

/// Where the static `workload` binary for this machine's architecture is; built first if need be, in the folder in
/// which `orchestrator/build.rs` builds the one that `matrix` carries, so that it is built once.
///
/// # Panics
/// When it cannot be built.
pub fn workload_binary() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| built(deployed().bin("workload")))
}

/// Where the static `network_probe` is, built as the workload is: `workload/examples/network_probe.rs`.
///
/// # Panics
/// When it cannot be built.
pub fn network_probe() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| built(deployed().example("network_probe")))
}

fn deployed() -> escargot::CargoBuild {
    escargot::CargoBuild::new()
        .package("workload")
        .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml"))
        .env("RUSTFLAGS", "-C target-feature=+crt-static")
        .target(format!("{}-unknown-linux-gnu", std::env::consts::ARCH))
        .target_dir(target_directory().join("workload-static"))
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
