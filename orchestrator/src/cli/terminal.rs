//! What a person or a pipe sees: results on standard output, everything else on standard error. The main type is
//! [`CommandError`].
//!
//! The only module that prints, and so the one that sees to it that what comes from a host, an engine, a run directory or another
//! user does nothing but be read ([`crate::escaping`]). A reader that went away (`matrix plan | head`) is not an error.

use std::{
    error::Error,
    io::{self, Write},
};

use annotate_snippets::Renderer;
use record::{causes::with_causes, exit::matrix::Exit};
use schemars::JsonSchema;
use serde::Serialize;

use crate::{
    escaping::{harmless, harmless_json, without_commands},
    matrix_file::{DiagnosticRecord, Diagnostics},
    preparation::PreparationError,
};

/// An error as a person gets it: what, because of what, what to do, and the exit code.
#[derive(Debug)]
pub struct CommandError {
    /// What failed.
    pub what: What,
    /// What to do about it.
    pub hint: Option<String>,
    /// The exit code.
    pub exit: Exit,
}

/// What a [`CommandError`] is about.
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

/// What a command with `--json` prints in place of its result if it fails.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "An error of a command with --json")]
pub struct ErrorDocument<'a> {
    /// `false`.
    ok: bool,
    /// The exit code of the command.
    exit_code: u8,
    /// What went wrong, with its causes; of several mistakes the first one.
    message: &'a str,
    /// What to do about it; null if nothing can be proposed.
    hint: Option<&'a str>,
    /// The mistakes in a matrix file or a selection; empty for any other error.
    diagnostics: Vec<DiagnosticRecord<'a>>,
}

/// The exit code where a file could not be written: what is there already is not overwritten, and another name is to be given.
pub fn exit_of_writing(error: &io::Error) -> Exit {
    match error.kind() {
        io::ErrorKind::AlreadyExists => Exit::Wrong,
        _ => Exit::Infrastructure,
    }
}

impl CommandError {
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
    pub fn to_json(&self) -> ErrorDocument<'_> {
        let mistakes = match &self.what {
            What::Failure(_) => None,
            What::Mistakes(mistakes) => Some(mistakes),
        };
        // The errors come before the warnings.
        let first = mistakes.and_then(|mistakes| mistakes.iter().next());
        ErrorDocument {
            ok: false,
            exit_code: self.exit.code(),
            message: match &self.what {
                What::Failure(failure) => failure.as_str(),
                What::Mistakes(_) => first.map_or("", |first| first.message.as_str()),
            },
            hint: first.map_or(&self.hint, |first| &first.help).as_deref(),
            diagnostics: mistakes.map_or_else(Vec::new, Diagnostics::to_json),
        }
    }
}

impl From<PreparationError> for CommandError {
    fn from(error: PreparationError) -> Self {
        Self::of_mistakes(error.into_mistakes())
    }
}

/// Prints a result.
pub fn result(text: &str) {
    print(&harmless(text));
}

/// Prints a text of our own, as it is: a script for a shell, or lines that a CI system is to take for commands, in which what comes
/// from elsewhere was escaped for that.
pub fn verbatim(text: &str) {
    print(text);
}

fn print(text: &str) {
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
    // Our own values can always be written.
    print(&harmless_json(
        &serde_json::to_string_pretty(value).unwrap_or_default(),
    ));
}

/// Prints a remark that is not a result.
pub fn print_note(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{}", harmless(text));
}

/// Prints what is wrong with a file, in colours where standard error is a terminal and the environment does not say
/// `NO_COLOR`. The renderer spells control characters out itself.
pub fn print_diagnostics(found: &Diagnostics) {
    let mut err = anstream::AutoStream::auto(io::stderr().lock());
    let rendered = found.render(&Renderer::styled());
    let lines: String = rendered
        .trim_end()
        .split_inclusive('\n')
        .map(without_commands)
        .collect();
    let _ = writeln!(err, "{lines}");
}

/// Prints an error.
pub fn print_error(error: &CommandError) {
    match &error.what {
        What::Failure(failure) => print_note(&format!("error: {failure}")),
        What::Mistakes(found) => print_diagnostics(found),
    }
    if let Some(hint) = &error.hint {
        print_note(&format!("  hint: {hint}"));
    }
}
