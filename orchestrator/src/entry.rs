//! The `matrix` command as a function, for programs that add providers of their own. The function is [`main_with`].

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser};
use clap_complete::CompleteEnv;
use record::{exit::matrix::Exit, limits};

use crate::{
    cli::{
        arguments::Arguments,
        command, completion,
        terminal::{self, CommandError},
    },
    provider::{Catalogue, ProviderKind},
};

/// Does what this process's command line asks, with the built-in providers and these. The whole of a program's `main`.
pub fn main_with(outside: &'static [ProviderKind]) -> ExitCode {
    // A shell that asks for completions gets them, and nothing else happens.
    // It is set once, here.
    let _ = completion::COMMAND_LINE.set(Arguments::command);
    CompleteEnv::with_factory(|| completion::with_paths(Arguments::command()))
        .var(completion::VARIABLE)
        .complete();
    let arguments = Arguments::parse();
    // Whoever asked for JSON reads one answer, and finds it where the result would be.
    let print = |failure: &CommandError| match arguments.command.wants_json() {
        true => terminal::json(&failure.to_json()),
        false => terminal::print_error(failure),
    };
    limits::fail_at_the_longest_file();
    if let Err(error) = limits::check() {
        let failure = CommandError::new(Exit::Infrastructure, &error, Some(error.hint()));
        print(&failure);
        return failure.exit.into();
    }
    let catalogue = match Catalogue::with(outside) {
        Ok(catalogue) => catalogue,
        Err(error) => {
            let failure = CommandError::new(Exit::Wrong, &error, Some(error.hint()));
            print(&failure);
            return failure.exit.into();
        }
    };
    let runtime = match tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
    {
        Ok(runtime) => runtime,
        Err(error) => {
            terminal::print_note(&format!("error: cannot start: {error}"));
            return Exit::Infrastructure.into();
        }
    };
    let exit = runtime
        .block_on(command::execute(&arguments.command, catalogue))
        .unwrap_or_else(|failure| {
            print(&failure);
            failure.exit
        });
    // A thread that still waits for a lease must not keep the process alive.
    runtime.shutdown_background();
    exit.into()
}
