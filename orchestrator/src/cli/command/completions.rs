//! `matrix completions SHELL`.

use std::{env, path::PathBuf};

use clap::Args;
use clap_complete::env::Shells;
use record::exit::matrix::Exit;

use crate::cli::{completion, terminal};

/// What it takes.
#[derive(Debug, Args)]
pub struct CompletionsArguments {
    /// The shell.
    shell: clap_complete::Shell,
}

/// Prints the script by which a shell asks this program for completions.
#[must_use]
pub fn execute(arguments: &CompletionsArguments) -> Exit {
    let shells = Shells::builtins();
    let mut script = Vec::new();
    if let Some(shell) = shells.completer(&arguments.shell.to_string()) {
        // Memory takes all that is written.
        let _ = shell.write_registration(completion::VARIABLE, "matrix", "matrix", &program(), &mut script);
    }
    terminal::verbatim(&String::from_utf8_lossy(&script));
    Exit::Done
}

/// How a shell starts this program from any folder: by its name if it was found in `PATH`, else by its whole path.
fn program() -> String {
    let name = env::args_os()
        .next()
        .map_or_else(|| "matrix".into(), PathBuf::from);
    let path = match name.components().count() {
        0 | 1 => name,
        _ => std::path::absolute(&name).unwrap_or(name),
    };
    path.to_string_lossy().into_owned()
}
