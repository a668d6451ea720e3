//! What a person or a pipe sees: results on standard output, everything else on standard error. The main type is
//! [`Complaint`].
//!
//! The only module that prints. A reader that went away (`matrix plan | head`) is not an error.

use std::{
    error::Error,
    io::{self, BufWriter, Write},
};

use annotate_snippets::Renderer;
use serde::Serialize;
use serde_json::{Value, json};
use workload::causes::with_causes;

use crate::{exit::Exit, matrix_file::Diagnostics};

/// An error as a person gets it: what, because of what, what to do, and the exit code.
#[derive(Debug)]
pub struct Complaint {
    /// What failed.
    pub what: What,
    /// What to do about it.
    pub hint: Option<String>,
    /// The exit code.
    pub exit: Exit,
}

/// What a complaint is about.
#[derive(Debug)]
pub enum What {
    /// Something failed; with its causes, in one line.
    Failure(String),
    /// What a person wrote is wrong, in these places.
    Mistakes(Diagnostics),
}

impl From<String> for What {
    fn from(failure: String) -> Self {
        Self::Failure(failure)
    }
}

impl From<&str> for What {
    fn from(failure: &str) -> Self {
        Self::Failure(failure.to_owned())
    }
}

impl Complaint {
    /// Of an error, its causes in one line.
    #[must_use]
    pub fn new(exit: Exit, error: &dyn Error, hint: Option<String>) -> Self {
        Self {
            what: What::Failure(with_causes(error)),
            hint,
            exit,
        }
    }

    /// Of what a person wrote.
    #[must_use]
    pub fn of_mistakes(mistakes: Diagnostics) -> Self {
        Self {
            what: What::Mistakes(mistakes),
            hint: None,
            exit: Exit::Wrong,
        }
    }

    /// As a program reads it, in the place of the result that it asked for.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let mistakes = match &self.what {
            What::Failure(_) => None,
            What::Mistakes(mistakes) => Some(mistakes),
        };
        // The errors come before the warnings.
        let first = mistakes.and_then(|mistakes| mistakes.iter().next());
        json!({
            "ok": false,
            "exit_code": self.exit.code(),
            "message": match &self.what {
                What::Failure(failure) => failure.as_str(),
                What::Mistakes(_) => first.map_or("", |first| first.message.as_str()),
            },
            "hint": first.map_or(&self.hint, |first| &first.help),
            "diagnostics": mistakes.map_or_else(|| json!([]), Diagnostics::to_json),
        })
    }
}

/// Prints a result.
pub fn result(text: &str) {
    let mut out = io::stdout().lock();
    let _ = out
        .write_all(text.as_bytes())
        .and_then(|()| match text.ends_with('\n') {
            true => Ok(()),
            false => out.write_all(b"\n"),
        });
}

/// Prints a result as JSON.
pub fn json(value: &impl Serialize) {
    let mut out = BufWriter::new(io::stdout().lock());
    // As for any result: a reader that has gone wants no more.
    let _ = serde_json::to_writer_pretty(&mut out, value)
        .map_err(io::Error::from)
        .and_then(|()| out.write_all(b"\n"));
}

/// Prints a remark that is not a result.
pub fn remark(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Prints what is wrong with a file, in colours where standard error is a terminal and the environment does not say
/// `NO_COLOR`.
pub fn mistakes(found: &Diagnostics) {
    let mut err = anstream::AutoStream::auto(io::stderr().lock());
    let _ = writeln!(err, "{}", found.render(&Renderer::styled()).trim_end());
}

/// Prints an error.
pub fn complain(complaint: &Complaint) {
    match &complaint.what {
        What::Failure(failure) => remark(&format!("error: {failure}")),
        What::Mistakes(found) => mistakes(found),
    }
    if let Some(hint) = &complaint.hint {
        remark(&format!("  hint: {hint}"));
    }
}
