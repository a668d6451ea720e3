//! `matrix man`.

use std::path::PathBuf;

use clap::{Args, CommandFactory as _};
use clap_mangen::Man;
use record::exit::matrix::Exit;

use crate::cli::{
    arguments::Arguments,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct ManArguments {
    /// Write the pages of `matrix` and of each command into this folder, as `matrix.1`, `matrix-run.1` and so on, and print
    /// none.
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Prints the page of `matrix`, or writes all pages.
///
/// # Errors
/// When the folder cannot be written.
pub fn execute(arguments: &ManArguments) -> Result<Exit, CommandError> {
    let command = Arguments::command().disable_help_subcommand(true);
    let written = match &arguments.output {
        Some(folder) => clap_mangen::generate_to(command, folder),
        None => {
            let mut page = Vec::new();
            let rendered = Man::new(command).render(&mut page);
            rendered.map(|()| terminal::verbatim(&String::from_utf8_lossy(&page)))
        }
    };
    written.map(|()| Exit::Done).map_err(|error| CommandError {
        what: format!("cannot write the manual pages: {error}").into(),
        hint: Some("give a folder that exists and can be written with `--output`".to_owned()),
        exit: Exit::Wrong,
    })
}
