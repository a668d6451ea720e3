//! `matrix ks X Y`: two files of numbers, one a line.

use std::{
    fs::{self, File},
    io::{self, BufRead, BufReader, Read as _},
    os::unix::fs::FileTypeExt as _,
    path::{Path, PathBuf},
};

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser as _},
};
use record::{exit::matrix::Exit, report_settings::Method};
use schemars::JsonSchema;
use serde::Serialize;
use statistics::ks::{Alternative, KsTest, Numbers, NumbersError, Procedure};

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
    numbers_at(path).map_err(|error| wrong(error.to_string(), error.hint()))
}

/// A line is no longer, in bytes: a number has some twenty digits, and a remark is a sentence.
const LONGEST_LINE: usize = 64 << 10;
/// A file is no longer: numbers with all their digits, and as many remarks.
const LONGEST: u64 = 256 << 20;

/// Why a file is not a sample.
#[derive(Debug, thiserror::Error)]
enum SampleError {
    /// It cannot be read.
    #[error("{0}")]
    Read(#[from] io::Error),
    /// Something that has no end, or does something when it is read.
    #[error("it is a device or a socket")]
    Special,
    /// It goes on.
    #[error("it is longer than {} MiB", LONGEST >> 20)]
    Long,
    /// A line goes on.
    #[error("line {line} is longer than {} KiB", LONGEST_LINE >> 10)]
    LongLine {
        /// From 1.
        line: usize,
    },
    /// Its lines are no numbers.
    #[error(transparent)]
    Numbers(#[from] NumbersError),
}

impl SampleError {
    const fn hint(&self) -> &'static str {
        match self {
            Self::Numbers(error) => error.hint(),
            Self::Special => {
                "give a text file with one number a line, or a command that writes it, as `<(command)`"
            }
            Self::Long => "give at most 3 million numbers, one a line",
            Self::Read(_) | Self::LongLine { .. } => "give a text file with one number a line",
        }
    }
}

/// The numbers of a file, or of a FIFO: `<(command)` of a shell is one, and ends when the command does.
fn numbers_at(path: &Path) -> Result<Vec<f64>, SampleError> {
    // Before it is opened: to open a device may do something.
    ensure_it_is_no_device(&fs::metadata(path)?)?;
    let file = File::open(path)?;
    ensure_it_is_no_device(&file.metadata()?)?;
    numbers_of(BufReader::new(file.take(LONGEST + 1)))
}

fn ensure_it_is_no_device(about: &fs::Metadata) -> Result<(), SampleError> {
    let kind = about.file_type();
    // To read a folder is an error that says so.
    match kind.is_file() || kind.is_fifo() || kind.is_dir() {
        true => Ok(()),
        false => Err(SampleError::Special),
    }
}

/// Line by line: what is kept of a line is its number.
fn numbers_of(mut lines: impl BufRead) -> Result<Vec<f64>, SampleError> {
    let (mut numbers, mut bytes, mut line) = (Numbers::default(), 0, Vec::new());
    for number in 1.. {
        line.clear();
        let read = (&mut lines)
            .take(LONGEST_LINE as u64 + 1)
            .read_until(b'\n', &mut line)?;
        bytes += read as u64;
        if read == 0 {
            break;
        }
        if bytes > LONGEST {
            return Err(SampleError::Long);
        }
        if read > LONGEST_LINE {
            return Err(SampleError::LongLine { line: number });
        }
        numbers.add(&String::from_utf8_lossy(&line))?;
    }
    Ok(numbers.all()?)
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

#[cfg(test)]
mod tests {
    use std::{io::Write as _, thread};

    use rstest::rstest;
    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    #[rstest]
    #[case("/dev/zero")]
    #[case("/dev/null")]
    fn a_device_is_not_read(#[case] path: &str) {
        let told = numbers_at(Path::new(path)).unwrap_err().to_string();
        assert_eq!(told, "it is a device or a socket");
    }

    #[test]
    fn what_a_command_writes_into_a_fifo_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let fifo = folder.path().join("63");
        mknodat(CWD, &fifo, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let path = fifo.clone();
        let writer = thread::spawn(move || {
            let mut fifo = File::options().write(true).open(path).unwrap();
            fifo.write_all(b"# from a command\n1\n2.5\n").unwrap();
        });
        assert_eq!(numbers_at(&fifo).unwrap(), [1.0, 2.5]);
        writer.join().unwrap();
    }

    /// A reader that would fill the memory, or never end.
    #[rstest]
    #[case::one_line("1", "line 1 is longer than 64 KiB")]
    #[case::numbers("1\n", "there are more than 3000000 numbers in it")]
    #[case::remarks(
        "#                                                   \n",
        "it is longer than 256 MiB"
    )]
    fn what_never_ends_is_given_up(#[case] again: &'static str, #[case] expected: &str) {
        struct Endless(&'static [u8]);
        impl io::Read for Endless {
            fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
                let length = bytes.len() / self.0.len() * self.0.len();
                for chunk in bytes.chunks_exact_mut(self.0.len()) {
                    chunk.copy_from_slice(self.0);
                }
                Ok(length)
            }
        }
        let told = numbers_of(BufReader::with_capacity(1 << 16, Endless(again.as_bytes())));
        assert_eq!(told.unwrap_err().to_string(), expected);
    }
}
