//! The fuzzer, for the target that `MATRIX_FUZZ_TARGET` names. Where `MATRIX_FUZZ_SEEDS` names a folder, what it begins with is written
//! there first.

#![no_main]

use std::sync::OnceLock;

use fuzz::{TARGETS, Target};

static TARGET: OnceLock<&Target> = OnceLock::new();

fn chosen() -> &'static Target {
    TARGET.get_or_init(|| {
        let name = std::env::var("MATRIX_FUZZ_TARGET").unwrap_or_default();
        let target = TARGETS.iter().find(|target| target.name == name);
        target.unwrap_or_else(|| panic!("there is no target {name:?}"))
    })
}

libfuzzer_sys::fuzz_target!(
    init: {
        if let Some(folder) = std::env::var_os("MATRIX_FUZZ_SEEDS") {
            fuzz::write_seeds(chosen(), folder.as_ref());
        }
    },
    |bytes: &[u8]| (chosen().read)(bytes)
);
