//! What a person or a pipe sees: results on standard output, everything else on standard error. The main type is
//! [`Complaint`].
//!
//! The only module that prints. A reader that went away (`matrix plan | head`) is not an error.

use std::{error::Error, io::Write};

use workload::causes::with_causes;

use crate::exit::Exit;

/// An error as a person gets it: what, because of what, what to do, and the exit code.
#[derive(Debug)]
pub struct Complaint {
    /// What failed, with its causes; several lines where a file is quoted.
    pub what: String,
    /// What to do about it.
    pub hint: Option<String>,
    /// The exit code.
    pub exit: Exit,
}

impl Complaint {
    /// Of an error, its causes in one line.
    #[must_use]
    pub fn new(exit: Exit, error: &dyn Error, hint: Option<String>) -> Self {
        Self {
            what: with_causes(error),
            hint,
            exit,
        }
    }

    /// That brings its own layout, as diagnostics of a file do.
    #[must_use]
    pub fn quoting(exit: Exit, text: String) -> Self {
        Self {
            what: text,
            hint: None,
            exit,
        }
    }
}

/// Prints a result.
pub fn result(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out
        .write_all(text.as_bytes())
        .and_then(|()| match text.ends_with('\n') {
            true => Ok(()),
            false => out.write_all(b"\n"),
        });
}

/// Prints a result as JSON.
pub fn json(value: &serde_json::Value) {
    result(&format!("{value:#}"));
}

/// Prints a remark that is not a result.
pub fn remark(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Prints an error.
pub fn complain(complaint: &Complaint) {
    match complaint.what.contains('\n') {
        // Diagnostics say themselves what they are, line by line.
        true => remark(complaint.what.trim_end()),
        false => remark(&format!("error: {}", complaint.what)),
    }
    if let Some(hint) = &complaint.hint {
        remark(&format!("  hint: {hint}"));
    }
}
