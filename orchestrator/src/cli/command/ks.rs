//! `matrix ks X Y`: two files of numbers, one a line.

use std::path::{Path, PathBuf};

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser as _},
};
use record::{exit::matrix::Exit, report_settings::Method};
use schemars::JsonSchema;
use serde::Serialize;
use statistics::ks::{self, Alternative, KsTest, Procedure};

use crate::cli::{
    command::options::OutputArguments,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct KsArguments {
    /// One sample: a number a line.
    x: PathBuf,
    /// The other.
    y: PathBuf,
    /// How p is computed: exactly given the ties; in Kolmogorov's limit; or as the paper's tools did.
    #[arg(long, value_name = "HOW", default_value = "exact", value_parser = methods())]
    method: Method,
    /// Which distance is tested, as SciPy and R call it: `greater` is that by which X's distribution function lies above
    /// Y's, as where X's values are smaller.
    #[arg(long, value_name = "SIDE", default_value = "two-sided", value_parser = alternatives())]
    alternative: Alternative,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// The two-sample Kolmogorov-Smirnov test of two files of numbers.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix ks --json")]
pub struct KsDocument {
    /// The test's result.
    #[serde(flatten)]
    test: KsTest,
    /// The distance with its sign: negative where the first's distribution function lies below the second's.
    signed_d: f64,
    /// The value at which it is attained, in the unit of the files; null where it is 0.
    at: Option<f64>,
}

/// Compares and prints.
///
/// # Errors
/// When a file is not a sample.
pub fn execute(arguments: &KsArguments) -> Result<Exit, CommandError> {
    let x = read(&arguments.x)?;
    let y = read(&arguments.y)?;
    let procedure = Procedure {
        method: arguments.method,
        alternative: arguments.alternative,
    };
    let test = procedure
        .test(&x, &y)
        .map_err(|error| CommandError::new(Exit::Wrong, &error, Some(error.hint().to_owned())))?;
    let (signed_d, at) = test.signed_d();
    if arguments.output.json {
        terminal::json(&KsDocument { test, signed_d, at });
    } else {
        let place = at.map_or(String::new(), |at| format!(" at {at}"));
        terminal::result(&format!(
            "D = {signed_d:+.6} ({}/{}){place}, n = {}, m = {}, p = {:.6e} (log10 p = {:.4}), {}, method {}",
            test.h,
            test.lcm,
            test.n,
            test.m,
            test.p,
            test.log10_p,
            test.alternative.name(),
            test.method.name()
        ));
    }
    Ok(Exit::Done)
}

fn read(path: &Path) -> Result<Vec<f64>, CommandError> {
    let wrong = |what: String, hint: &str| CommandError {
        what: format!("{}: {what}", path.display()).into(),
        hint: Some(hint.to_owned()),
        exit: Exit::Wrong,
    };
    let text = std::fs::read_to_string(path)
        .map_err(|error| wrong(error.to_string(), "give a text file with one number a line"))?;
    ks::read_numbers(&text).map_err(|error| wrong(error.to_string(), error.hint()))
}

fn methods() -> impl clap::builder::TypedValueParser<Value = Method> {
    let named = |name: String| Method::ALL.into_iter().find(|method| method.name() == name);
    PossibleValuesParser::new(Method::ALL.map(Method::name)).map(move |name| named(name).unwrap_or_default())
}

fn alternatives() -> impl clap::builder::TypedValueParser<Value = Alternative> {
    let named = |name: String| Alternative::ALL.into_iter().find(|one| one.name() == name);
    PossibleValuesParser::new(Alternative::ALL.map(Alternative::name))
        .map(move |name| named(name).unwrap_or_default())
}
