//! Runs a matrix over three architectures, two of them emulated, and leaves the run directory with its report below the
//! working directory's `runs/`:
//!
//! ```text
//! cargo run -p tests --example fleet
//! ```
//!
//! It takes some ten minutes. `tests/prepare` installs what it needs.

use std::{
    io,
    process::{Command, ExitCode},
};

use tests::{Fleet, matrix_binary, workloads_for};

/// Windows that emulated processors hold, mostly; validity says where they do not.
const WORKLOAD: &str = "  windows: 4\n  window: 10s\n";

fn main() -> io::Result<ExitCode> {
    let workloads = workloads_for(&["i686", "aarch64"]);
    let fleet = Fleet::boot();
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("fleet.yaml");
    let matrix = fleet.matrix(WORKLOAD);
    println!("{matrix}");
    std::fs::write(&file, matrix)?;
    let ended = Command::new(matrix_binary())
        .arg("run")
        .arg(&file)
        .env("MATRIX_WORKLOADS", &workloads)
        .status()?;
    let code = ended.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(ExitCode::FAILURE, ExitCode::from))
}
