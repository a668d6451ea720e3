//! `matrix schema`.

use crate::{exit::Exit, matrix_file, terminal};

/// Prints the JSON Schema of matrix files.
#[must_use]
pub fn execute() -> Exit {
    terminal::json(&matrix_file::schema());
    Exit::Done
}
