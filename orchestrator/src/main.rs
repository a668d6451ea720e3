//! The `matrix` command.

use std::process::ExitCode;

use clap::Parser;
use orchestrator::{
    arguments::Arguments,
    command,
    exit::Exit,
    terminal::{self, Complaint},
};
use workload::limits;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    // Whoever asked for JSON reads one answer, and finds it where the result would be.
    let complain = |complaint: &Complaint| match arguments.command.wants_json() {
        true => terminal::json(&complaint.to_json()),
        false => terminal::complain(complaint),
    };
    limits::fail_at_the_longest_file();
    if let Err(error) = limits::check() {
        let complaint = Complaint::new(Exit::Infrastructure, &error, Some(error.hint()));
        complain(&complaint);
        return complaint.exit.into();
    }
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
            complain(&complaint);
            complaint.exit
        });
    // A thread that still waits for a lease must not keep the process alive.
    runtime.shutdown_background();
    exit.into()
}
