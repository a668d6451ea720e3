//! The `matrix` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    orchestrator::main_with(&[])
}
