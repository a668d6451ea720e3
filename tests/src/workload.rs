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
    BINARY.get_or_init(|| {
        escargot::CargoBuild::new()
            .package("workload")
            .bin("workload")
            .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml"))
            .env("RUSTFLAGS", "-C target-feature=+crt-static")
            .target(format!("{}-unknown-linux-gnu", std::env::consts::ARCH))
            .target_dir(target_directory().join("workload-static"))
            .args(["--locked", "--profile", "deploy"])
            .run()
            .expect("`cargo build -p workload` works")
            .path()
            .to_owned()
    })
}

/// Cargo tags the target directory; the test that runs is in it.
fn target_directory() -> PathBuf {
    let test = std::env::current_exe().expect("the test knows where it is");
    test.ancestors()
        .find(|folder| folder.join("CACHEDIR.TAG").is_file())
        .expect("tests run from cargo's target directory")
        .to_owned()
}
