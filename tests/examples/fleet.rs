//! Runs a matrix over three architectures, two of them emulated, natively, in Docker and in virtual machines of two kinds,
//! and leaves the run directory with its report below the working directory's `runs/`:
//!
//! ```text
//! cargo run -p tests --example fleet
//! ```
//!
//! It takes some fifteen minutes. `tests/prepare` installs what it needs.

use std::{
    io,
    process::{Command, ExitCode},
};

use tests::{
    Fleet, matrix_binary,
    virtualbox::{self, VirtualBox},
    workloads_for,
};

/// Windows that emulated processors hold, mostly; validity says where they do not.
const WORKLOAD: &str =
    "  dynamics: robust\n  windows: 4\n  window: 10s\n  period: 1s\n  reference: {amplitude_m: 0.05}\n";

fn main() -> io::Result<ExitCode> {
    let workloads = workloads_for(&["i686", "aarch64"]);
    let folder = tempfile::tempdir()?;
    let virtualbox = VirtualBox::below(folder.path());
    let fleet = Fleet::boot();
    let file = folder.path().join("fleet.yaml");
    let matrix = fleet.matrix(
        "[native, docker, libvirt, virtualbox]",
        WORKLOAD,
        virtualbox::PROVIDER,
    );
    println!("{matrix}");
    std::fs::write(&file, matrix)?;
    let mut run = Command::new(matrix_binary());
    run.arg("run").arg(&file);
    let ended = virtualbox
        .on(run)
        .env("MATRIX_WORKLOADS", &workloads)
        .env("MATRIX_STATE_DIR", folder.path().join("state"))
        .status()?;
    let code = ended.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(ExitCode::FAILURE, ExitCode::from))
}
