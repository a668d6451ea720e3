//! What the tests of the workload on a real machine share: the program that they start ([`workload_program`]), networks and
//! captures ([`real_network`]), and how late the machine itself is ([`control`]).
//!
//! The tests are in `tests/`. They need root, or an ordinary user with user namespaces. This crate uses no other crates of the
//! workspace but `workload` and `record`, so that `workload/builder/test` can run it on other machines, with their compiler.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::missing_panics_doc
)] // As in tests.

pub mod control;
pub mod real_network;

use std::{
    env,
    path::{Path, PathBuf},
    sync::OnceLock,
};

/// The `workload` program that the tests start: the one that `WORKLOAD_UNDER_TEST` names, of another build or a program that
/// starts it under an emulator; otherwise this workspace's in the profile `dev`, which is built first if need be.
pub fn workload_program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| match env::var_os("WORKLOAD_UNDER_TEST") {
        Some(given) => given.into(),
        None => {
            let built = escargot::CargoBuild::new()
                .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.toml"))
                // With the features that the whole workspace is built with: nothing is built twice.
                .arg("--workspace")
                .bin("workload")
                .run();
            built
                .expect("`cargo build --bin workload` works")
                .path()
                .to_owned()
        }
    })
}
