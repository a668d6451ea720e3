//! A copy of a run without the names, which can be handed on.

use std::{
    collections::BTreeMap,
    io,
    path::{Path, PathBuf},
};

use record::{
    field, layout,
    run_directory::{
        Chain, Event, FORMAT, Journal, JournalEntry, LONGEST_RECORD, Manifest, Place, ReadError,
        RunDirectory, RunRecords, ScenarioState, read_environment, read_file, read_record, read_window,
    },
};
use serde_json::{Map, Value};

use super::{
    Redaction,
    files::{Kind, files},
};

/// Why a redacted copy cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The run cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A name that was replaced is a word of the format.
    #[error("the copy of the journal cannot be understood")]
    Word(#[from] serde_json::Error),
    /// The operating system refused.
    #[error("{} cannot be written", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl CopyError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read(error) => error.hint(),
            Self::Word(_) => {
                "a name that was replaced is a word of the run directory's own: leave it in, or rename the host".to_owned()
            }
            Self::Io { source, .. } if source.kind() == io::ErrorKind::AlreadyExists => {
                "give another folder with `--output`, or remove this one".to_owned()
            }
            Self::Io { .. } => "see that the disk has room and that you may write there".to_owned(),
        }
    }
}

/// Makes a copy of a run without the names, from which a report can be made. Left out are what broke, the report, the files
/// of a user's experiment and what its commands printed, and lines of the journal that a crash cut. It has checksums of its own where the run has them.
///
/// # Errors
/// When there is something at that place, and when something cannot be read or written, or is damaged.
pub fn copy(run: &RunDirectory, to: &Path, redaction: &Redaction) -> Result<(), CopyError> {
    let records = RunRecords::read_unpruned(run)?;
    std::fs::create_dir_all(to.parent().unwrap_or(to)).map_err(at(to))?;
    std::fs::create_dir(to).map_err(at(to))?;
    let copy = RunDirectory::new(to);
    let mut sums = NewSums::default();
    for scenario in &records.plan.scenarios {
        let (from, to) = (run.scenario(&scenario.slug), copy.scenario(&scenario.slug));
        let known = records.state.scenario(&scenario.slug);
        copy_scenario(&from, &to, &known, redaction, &mut sums)?;
    }
    copy_document(&run.plan(), &copy.plan(), redaction, &mut sums)?;
    let mut manifest: Map<String, Value> = read_record(&run.manifest(), FORMAT)?;
    manifest.insert(field!(Manifest, redacted).to_owned(), true.into());
    let manifest = redaction.document(manifest.into());
    sums.write_document(&run.manifest(), &copy.manifest(), &manifest)?;
    write(
        &copy.journal(),
        &copied_journal(records.journal, redaction, &sums)?,
    )
}

/// SHA-256 of files of a run, with those that stand for them in its copy.
#[derive(Default)]
struct NewSums(BTreeMap<String, String>);

impl NewSums {
    /// Writes what stands for a file.
    fn write_document(&mut self, from: &Place, to: &Place, document: &Value) -> Result<(), CopyError> {
        write(to, format!("{document:#}\n").as_bytes())?;
        let [from, to] = [from, to].map(|it| it.digest().map_err(at(&it.path())));
        self.0.insert(from?.sha256, to?.sha256);
        Ok(())
    }

    /// What stands for a file that was copied; none for others.
    fn renew(&self, sha256: &mut Option<String>) {
        *sha256 = sha256.take().and_then(|old| self.0.get(&old).cloned());
    }
}

fn copied_journal(journal: Journal, redaction: &Redaction, sums: &NewSums) -> Result<Vec<u8>, CopyError> {
    let is_checked = journal.is_checked();
    let (mut chain, mut text) = (Chain::default(), Vec::new());
    for entry in journal.entries {
        let mut entry: JournalEntry = redaction.record(&entry)?;
        match &mut entry.event {
            Event::RunStarted {
                manifest_sha256,
                plan_sha256,
                ..
            } => {
                sums.renew(manifest_sha256);
                sums.renew(plan_sha256);
            }
            Event::WindowCollected { sha256, .. } => sums.renew(sha256),
            Event::EnvironmentRecorded { sha256, .. } => {
                let mut renewed = Some(sha256.clone());
                sums.renew(&mut renewed);
                match renewed {
                    Some(renewed) => *sha256 = renewed,
                    // It was written over.
                    None => continue,
                }
            }
            _ => {}
        }
        match is_checked {
            true => text.extend(chain.line(&entry)?),
            false => {
                serde_json::to_writer(&mut text, &entry)?;
                text.push(b'\n');
            }
        }
    }
    Ok(text)
}

fn copy_scenario(
    from: &Place,
    to: &Place,
    known: &ScenarioState,
    redaction: &Redaction,
    sums: &mut NewSums,
) -> Result<(), CopyError> {
    for file in files(from).map_err(at(&from.path()))? {
        let (path, above) = (file.path(), from.path());
        let copy = to.join(path.strip_prefix(above).unwrap_or(&path));
        match Kind::of(&file) {
            Some(Kind::Document) => {
                ensure_as_written(&file, known)?;
                copy_document(&file, &copy, redaction, sums)?;
            }
            Some(Kind::LeftOut) => {}
            Some(Kind::Text) => {
                let text = redaction.text(&String::from_utf8_lossy(&read_file(&file, LONGEST_RECORD)?));
                write(&copy, text.as_bytes())?;
            }
            None => {
                let Some(bytes) = measured_bytes(&file) else {
                    continue;
                };
                make_folder_of(&copy)?;
                let mut from = file.open_within(bytes).map_err(|source| ReadError::Io {
                    path: file.path(),
                    source,
                })?;
                let copied = copy.create().and_then(|mut to| io::copy(&mut from, &mut to));
                copied.map(drop).map_err(at(&copy.path()))?;
            }
        }
    }
    Ok(())
}

/// A copy has checksums of its own: what is damaged would be whole in it.
fn ensure_as_written(document: &Place, known: &ScenarioState) -> Result<(), ReadError> {
    match layout::window_of(document.parent().name()) {
        Some(window) => read_window(&document.parent(), known.window_sha256(window)).map(drop),
        None => read_environment(document, known.environment_sha256s()).map(drop),
    }
}

/// How long it was when it was measured, if the record of the window beside it names it.
fn measured_bytes(file: &Place) -> Option<u64> {
    let record = read_window(&file.parent(), None).ok()?;
    let recorded = record.files.iter().find(|it| it.name == file.name())?;
    Some(recorded.bytes)
}

fn copy_document(
    from: &Place,
    to: &Place,
    redaction: &Redaction,
    sums: &mut NewSums,
) -> Result<(), CopyError> {
    let mut document = redaction.document(read_record(from, FORMAT)?);
    // A window's record names the files that the copy has.
    if let Some(Value::Array(files)) = document.get_mut("files") {
        files.retain(|file| {
            let name = file.get("name").and_then(Value::as_str).unwrap_or_default();
            !layout::is_printed(name)
        });
    }
    sums.write_document(from, to, &document)
}

fn write(to: &Place, text: &[u8]) -> Result<(), CopyError> {
    make_folder_of(to)?;
    to.write(text).map_err(at(&to.path()))
}

fn make_folder_of(file: &Place) -> Result<(), CopyError> {
    let folder = file.parent();
    folder.make_folder().map_err(at(&folder.path()))
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> CopyError {
    let path = path.to_owned();
    |source| CopyError::Io { path, source }
}
