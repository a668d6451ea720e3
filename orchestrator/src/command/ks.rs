//! `matrix ks X Y`: two files of numbers, one a line.

use std::path::{Path, PathBuf};

use clap::Args;
use reports::ks;
use serde_json::json;

use crate::{
    arguments::OutputArguments,
    exit::Exit,
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct KsArguments {
    /// One sample: a number a line.
    x: PathBuf,
    /// The other.
    y: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Compares and prints.
///
/// # Errors
/// When a file is not a sample.
pub fn execute(arguments: &KsArguments) -> Result<Exit, Complaint> {
    let x = read(&arguments.x)?;
    let y = read(&arguments.y)?;
    let test = ks::test(&x, &y)
        .map_err(|error| Complaint::new(Exit::Wrong, &error, Some(error.hint().to_owned())))?;
    if arguments.output.json {
        terminal::json(&json!(test));
    } else {
        terminal::result(&format!(
            "D = {:.6} ({}/{}), n = {}, m = {}, p = {:.6e} (log10 p = {:.4}), method {}",
            test.d,
            test.h,
            test.lcm,
            test.n,
            test.m,
            test.p,
            test.log10_p,
            test.method.name()
        ));
    }
    Ok(Exit::Done)
}

fn read(path: &Path) -> Result<Vec<f64>, Complaint> {
    let wrong = |what: String, hint: &str| Complaint {
        what: format!("{}: {what}", path.display()).into(),
        hint: Some(hint.to_owned()),
        exit: Exit::Wrong,
    };
    let text = std::fs::read_to_string(path)
        .map_err(|error| wrong(error.to_string(), "give a text file with one number a line"))?;
    ks::read_numbers(&text).map_err(|error| wrong(error.to_string(), error.hint()))
}
