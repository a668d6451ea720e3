//! `matrix fit RUN`: writes what the platform of each measured scenario did to the experiment into a file that a simulated scenario can be
//! put on.

use std::{
    fmt::Write as _,
    fs::{self, OpenOptions},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use clap::{Args, ValueHint};
use record::{
    exit::matrix::Exit,
    platform_model::{PlatformModel, Quantile, Quantiles},
    quantity::TimeSpan,
    run_directory::{RunDirectory, RunRecords},
};
use reports::fit::{self, FittedPlatform};

use crate::cli::{
    command::report::unreadable,
    completion,
    run_argument::run_argument,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct FitArguments {
    /// The run directory.
    #[arg(value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
    /// The folder in which `SLUG.yaml` is written for each scenario. A file that is there is not overwritten.
    #[arg(long, value_name = "DIR", default_value = "platforms", value_hint = ValueHint::DirPath)]
    output: PathBuf,
    /// Only the windows of these numbers, such as `1,2`, so that the others can try what is found.
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    windows: Vec<u32>,
}

/// Pairs of a distribution that stand in a line of the file.
const PAIRS_A_LINE: usize = 6;

/// A file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}", path.display())]
struct FileError {
    path: PathBuf,
    source: io::Error,
}

/// Fits the platforms and writes their files.
///
/// # Errors
/// When the run directory cannot be read, has nothing to fit, or a file cannot be written.
pub fn execute(arguments: &FitArguments) -> Result<Exit, CommandError> {
    let directory = RunDirectory::new(&arguments.run);
    let file = |slug: &str| arguments.output.join(format!("{slug}.yaml"));
    // Fitting takes a while: what cannot be written is said before.
    let records = RunRecords::read_unpruned(&directory).map_err(|error| unreadable(&error))?;
    for planned in &records.plan.scenarios {
        let path = file(&planned.slug);
        if path.exists() {
            return Err(unwritten(path, io::ErrorKind::AlreadyExists.into()));
        }
    }
    let fitted = fit::fit(&directory, &arguments.windows)
        .map_err(|error| CommandError::new(Exit::Wrong, &error, Some(error.hint())))?;
    let mut text = String::new();
    for platform in &fitted {
        let path = file(&platform.slug);
        write(&path, platform).map_err(|source| unwritten(path.clone(), source))?;
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{} {}", platform.id, path.display());
        for remark in &platform.remarks {
            let _ = writeln!(text, "  {remark}");
        }
    }
    terminal::result(&text);
    Ok(Exit::Done)
}

fn unwritten(path: PathBuf, source: io::Error) -> CommandError {
    let hint = match source.kind() {
        io::ErrorKind::AlreadyExists => "name another folder with `--output DIR`, or remove the file",
        _ => "see that the disk has room and that you may write to the folder",
    };
    let exit = terminal::exit_of_writing(&source);
    CommandError::new(exit, &FileError { path, source }, Some(hint.to_owned()))
}

fn write(path: &Path, platform: &FittedPlatform) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
    file.write_all(yaml(&platform.model).as_bytes())
}

/// As a person would write it: a distribution in a few lines, and all of its times in one unit.
fn yaml(model: &PlatformModel) -> String {
    let mut text = format!("about: {}\n", serde_json::Value::from(model.about.as_str()));
    for (name, lateness) in [("controller", &model.controller), ("plant", &model.plant)] {
        let late = distribution(&lateness.late);
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "{name}:\n  late: {late}\n  persistence: {}\n",
            lateness.persistence
        );
    }
    let (per_hour, length) = (model.stalls.per_hour, distribution(&model.stalls.length));
    let _ = write!(text, "stalls:\n  per_hour: {per_hour}\n  length: {length}\n");
    let (stack, reading) = (microseconds(model.stack), distribution(&model.reading));
    let _ = write!(text, "stack: {stack}\nreading: {reading}\n");
    text
}

fn distribution(quantiles: &Quantiles) -> String {
    let pairs = quantiles.0.iter();
    let pairs: Vec<String> = pairs
        .map(|Quantile(p, time)| format!("[{p}, {}]", microseconds(*time)))
        .collect();
    let lines: Vec<String> = pairs.chunks(PAIRS_A_LINE).map(|line| line.join(", ")).collect();
    format!("[{}]", lines.join(",\n    "))
}

fn microseconds(time: TimeSpan) -> String {
    format!("{}us", time.as_nanos() as f64 / 1000.0)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use record::{
        platform_model::{StallModel, TickLateness},
        quantity::Fraction,
    };

    use super::*;

    #[test]
    fn a_file_reads_back_as_it_was_written_and_can_be_read_by_a_person() {
        let times = |tenths_us: &[(f64, u64)]| {
            let time = |tenths: u64| TimeSpan::from(Duration::from_nanos(tenths * 100));
            Quantiles(
                tenths_us
                    .iter()
                    .map(|(p, tenths)| Quantile(*p, time(*tenths)))
                    .collect(),
            )
        };
        let model = PlatformModel {
            about: "fitted to a: 1, \"2\" of r".to_owned(),
            controller: TickLateness {
                late: times(&[
                    (0.0, 1),
                    (0.01, 123),
                    (0.5, 704),
                    (0.9, 900),
                    (0.99, 1100),
                    (0.999, 20_000),
                    (1.0, 70_400),
                ]),
                persistence: Fraction::from_percent(19.1),
            },
            plant: TickLateness::default(),
            stalls: StallModel {
                per_hour: 12.5,
                length: times(&[(0.0, 150_000), (1.0, 980_000)]),
            },
            stack: TimeSpan::from_millis(1),
            reading: Quantiles::default(),
        };
        let text = yaml(&model);
        assert_eq!(serde_yaml::from_str::<PlatformModel>(&text).unwrap(), model);
        insta::assert_snapshot!(text, @r#"
        about: "fitted to a: 1, \"2\" of r"
        controller:
          late: [[0, 0.1us], [0.01, 12.3us], [0.5, 70.4us], [0.9, 90us], [0.99, 110us], [0.999, 2000us],
            [1, 7040us]]
          persistence: 19.1%
        plant:
          late: []
          persistence: 0%
        stalls:
          per_hour: 12.5
          length: [[0, 15000us], [1, 98000us]]
        stack: 1000us
        reading: []
        "#);
    }
}
