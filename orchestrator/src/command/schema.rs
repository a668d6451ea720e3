//! `matrix schema`.

use clap::{Args, ValueEnum};

use crate::{exit::Exit, matrix_file, terminal};

/// What it takes.
#[derive(Debug, Args)]
pub struct SchemaArguments {
    /// Of which files.
    #[arg(value_enum, default_value = "matrix")]
    of: Schema,
}

/// Files that have one.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Schema {
    /// Matrix files.
    Matrix,
    /// `drift.yaml`, the changes that `matrix drift` is told of.
    Drift,
}

/// Prints a JSON Schema.
#[must_use]
pub fn execute(arguments: &SchemaArguments) -> Exit {
    terminal::json(&match arguments.of {
        Schema::Matrix => matrix_file::schema(),
        Schema::Drift => reports::drift::schema(),
    });
    Exit::Done
}
