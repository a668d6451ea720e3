//! The `matrix` command.

use std::process::ExitCode;

use clap::Parser;
use orchestrator::{arguments::Arguments, command, exit::Exit, terminal};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let runtime = match tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
    {
        Ok(runtime) => runtime,
        Err(error) => {
            terminal::remark(&format!("error: cannot start: {error}"));
            return Exit::Infrastructure.into();
        }
    };
    let exit = runtime
        .block_on(command::execute(&arguments.command))
        .unwrap_or_else(|complaint| {
            // Whoever asked for JSON reads one answer, and finds it where the result would be.
            match arguments.command.wants_json() {
                true => terminal::json(&complaint.to_json()),
                false => terminal::complain(&complaint),
            }
            complaint.exit
        });
    // A thread that still waits for a lease must not keep the process alive.
    runtime.shutdown_background();
    exit.into()
}
