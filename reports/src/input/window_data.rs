//! What is read of a window that counts: the log of the ball on the plate, or what a user's command measured. The main type is
//! [`WindowData`]; [`read_metrics`] reads the latter.

use std::{collections::BTreeMap, io};

use record::{
    causes::with_causes,
    experiment::{CommandExperiment, Compare, Metric, read_values},
    run_directory::{ControlTrace, NotWhole, Place, ReadError, ensure_file_is_whole},
    window::{FileRecord, WindowRecord},
};

/// The data of a window.
#[derive(Debug, Clone, PartialEq)]
pub enum WindowData {
    /// The ball on the plate: its log, digested.
    Ball(ControlTrace),
    /// A command: what each of its metrics has, by the metric's name.
    Command(BTreeMap<String, MetricData>),
}

/// What a window has of a metric.
#[derive(Debug, Clone, PartialEq)]
pub enum MetricData {
    /// Values, never none, in the order of their file.
    Values(Vec<f64>),
    /// A file that is compared byte for byte.
    Bytes(FileContent),
}

/// A file that is compared byte for byte.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileContent {
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
    /// How long it is.
    pub bytes: u64,
    /// Its beginning: [`FileContent::KEPT`] bytes, or all of a shorter one.
    pub beginning: Vec<u8>,
}

impl FileContent {
    /// How much of a file is kept, in bytes, to say where it parts from another.
    pub const KEPT: u64 = 1 << 20;
}

impl WindowData {
    /// The log of the ball on the plate; none of a command.
    #[must_use]
    pub const fn trace(&self) -> Option<&ControlTrace> {
        match self {
            Self::Ball(trace) => Some(trace),
            Self::Command(_) => None,
        }
    }

    /// What a command's window has of a metric.
    #[must_use]
    pub fn metric(&self, name: &str) -> Option<&MetricData> {
        match self {
            Self::Ball(_) => None,
            Self::Command(metrics) => metrics.get(name),
        }
    }
}

/// Reads what a command's window has of each metric. Why the window does not count, if it does not.
///
/// # Errors
/// When the system does not let a file be read.
pub fn read_metrics(
    folder: &Place,
    experiment: &CommandExperiment,
    record: &WindowRecord,
) -> Result<Result<WindowData, String>, ReadError> {
    let mut metrics = BTreeMap::new();
    for name in experiment.measured_files() {
        let Some(file) = record.files.iter().find(|file| file.name == name) else {
            return Ok(Err(format!("window.json does not name {name}")));
        };
        match ensure_file_is_whole(folder, file) {
            Ok(()) => {}
            Err(NotWhole::Broken(reason)) => return Ok(Err(reason)),
            Err(NotWhole::Replaced(error) | NotWhole::Unreadable(error)) => return Err(error),
        }
        let place = folder.join(name);
        for metric in experiment.metrics.iter().filter(|metric| metric.from == name) {
            match read_metric(&place, metric, file) {
                Ok(Ok(data)) => drop(metrics.insert(metric.name.clone(), data)),
                Ok(Err(reason)) => return Ok(Err(reason)),
                Err(source) => {
                    return Err(ReadError::Io {
                        path: place.path(),
                        source,
                    });
                }
            }
        }
    }
    Ok(Ok(WindowData::Command(metrics)))
}

fn read_metric(place: &Place, metric: &Metric, file: &FileRecord) -> io::Result<Result<MetricData, String>> {
    let mut opened = place.open_within(file.bytes)?;
    Ok(match metric.compare {
        Compare::Ks => match read_values(metric, io::BufReader::new(opened)) {
            Ok(values) => Ok(MetricData::Values(values)),
            Err(error) => Err(with_causes(&error)),
        },
        Compare::Identical => {
            let mut beginning = Vec::new();
            io::Read::read_to_end(
                &mut io::Read::take(&mut opened, FileContent::KEPT),
                &mut beginning,
            )?;
            Ok(MetricData::Bytes(FileContent {
                sha256: file.sha256.clone(),
                bytes: file.bytes,
                beginning,
            }))
        }
    })
}
