//! `matrix completions SHELL`.

use clap::{Args, CommandFactory};

use crate::{arguments::Arguments, exit::Exit, terminal};

/// What it takes.
#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// The shell.
    shell: clap_complete::Shell,
}

/// Prints the completions.
#[must_use]
pub fn execute(arguments: &CompletionsArguments) -> Exit {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "matrix", &mut script);
    terminal::verbatim(&String::from_utf8_lossy(&script));
    Exit::Done
}
