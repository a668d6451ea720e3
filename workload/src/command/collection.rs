//! What is kept of a window: the files that metrics are read from, and what was printed. The functions are [`collect`] and
//! [`keep_output`].

use std::{
    fs::File,
    io,
    path::{Path, PathBuf},
};

use record::{
    causes::with_causes,
    experiment::{CommandExperiment, Compare, Metric, read_values},
    layout,
};
use rustix::fs::{Mode, OFlags};

use super::program::Printed;
use crate::experiment::ExperimentError;

/// The files of what a command printed.
pub const OUTPUT: [&str; 2] = [layout::STDOUT, layout::STDERR];

/// Copies what the metrics are read from into the window's folder, and says what is wrong with it.
///
/// # Errors
/// If it cannot be written.
pub fn collect(
    experiment: &CommandExperiment,
    output: &Path,
    window: &Path,
) -> Result<Vec<String>, ExperimentError> {
    let mut wrong = Vec::new();
    for name in experiment.measured_files() {
        let to = window.join(name);
        match fetch(output, name, &to).map_err(write_error(&to))? {
            Some(why) => wrong.push(why),
            None => wrong.extend(check(experiment, name, window)?),
        }
    }
    Ok(wrong)
}

/// What is wrong with the metrics of a file in the window's folder.
///
/// # Errors
/// If it cannot be read.
pub fn check(
    experiment: &CommandExperiment,
    name: &str,
    window: &Path,
) -> Result<Vec<String>, ExperimentError> {
    let path = window.join(name);
    let of_it = experiment.metrics.iter().filter(|metric| metric.from == name);
    let wrong = of_it.map(|metric| check_metric(metric, &path).map_err(write_error(&path)));
    Ok(wrong
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .flatten()
        .collect())
}

/// Opens a regular file of the output folder, and no link. Why it cannot be, if that is the command's doing.
///
/// # Errors
/// What the system says.
pub fn open_below(output: &Path, name: &str) -> io::Result<Result<File, String>> {
    // A FIFO that nobody writes to would be waited for, and the folder itself may have become a link.
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let folder = rustix::fs::open(output, flags | OFlags::DIRECTORY, Mode::empty());
    let opened = folder.and_then(|folder| rustix::fs::openat(&folder, name, flags, Mode::empty()));
    let file = match opened {
        Ok(file) => File::from(file),
        Err(rustix::io::Errno::NOENT) => return Ok(Err(format!("the command wrote no `{name}`"))),
        Err(rustix::io::Errno::LOOP) => return Ok(Err(format!("`{name}` is a link and no file"))),
        Err(error) => return Ok(Err(format!("`{name}` cannot be read: {error}"))),
    };
    match file.metadata()?.is_file() {
        true => Ok(Ok(file)),
        false => Ok(Err(format!("`{name}` is no regular file"))),
    }
}

/// Copies a file of the output folder. Why it cannot be, if that is the command's doing.
fn fetch(output: &Path, name: &str, to: &Path) -> io::Result<Option<String>> {
    let file = match open_below(output, name)? {
        Ok(file) => file,
        Err(why) => return Ok(Some(why)),
    };
    let bytes = file.metadata()?.len();
    if bytes > CommandExperiment::LONGEST_FILE {
        return Ok(Some(format!(
            "`{name}` has {bytes} bytes, more than {}",
            CommandExperiment::LONGEST_FILE
        )));
    }
    // It ends where it ended: whoever wrote it is gone.
    io::copy(
        &mut io::Read::take(file, CommandExperiment::LONGEST_FILE),
        &mut File::create_new(to)?,
    )?;
    Ok(None)
}

/// What is wrong with what a metric is read from.
fn check_metric(metric: &Metric, path: &Path) -> io::Result<Option<String>> {
    let file = File::open(path)?;
    let is_empty = file.metadata()?.len() == 0;
    Ok(match metric.compare {
        Compare::Identical if is_empty => Some(format!("`{}` is empty", metric.from)),
        Compare::Identical => None,
        Compare::Ks => read_values(metric, io::BufReader::new(file))
            .err()
            .map(|error| with_causes(&error)),
    })
}

/// Writes down what was printed.
///
/// # Errors
/// If it cannot be written.
pub fn keep_output(
    folder: &Path,
    names: &[impl AsRef<Path>; 2],
    printed: &Printed,
) -> Result<(), ExperimentError> {
    for (name, kept) in names.iter().zip([&printed.stdout, &printed.stderr]) {
        let path = folder.join(name);
        let written = File::create_new(&path).and_then(|file| kept.write(file));
        written.map_err(write_error(&path))?;
    }
    Ok(())
}

/// What to make of a file that cannot be written.
pub fn write_error(path: &Path) -> impl FnOnce(io::Error) -> ExperimentError + use<> {
    let path: PathBuf = path.to_owned();
    move |source| ExperimentError::Write { path, source }
}
