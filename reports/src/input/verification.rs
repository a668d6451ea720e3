//! Whether a run directory is as it was written: every file that has a checksum is read, those too that no report reads. The
//! main function is [`verify`].

use std::{collections::BTreeSet, path::PathBuf};

use rayon::prelude::*;
use record::{
    causes::with_causes,
    layout,
    run_directory::{
        Journal, Kind, Manifest, NotWhole, Place, PlannedScenario, ReadError, RunDirectory, RunRecords,
        ScenarioState, ensure_file_is_whole, read_environment, read_window,
    },
};

/// What was found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verification {
    /// Files that were read.
    pub files: u64,
    /// What they have together.
    pub bytes: u64,
    /// Files that are not as they were written, by their paths.
    pub damaged: Vec<Damage>,
    /// Whether the journal has checksums of itself and of the other files: not in runs of earlier versions.
    pub is_checked: bool,
}

/// A file that is not as it was written.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Damage {
    /// Where it is in the run directory.
    pub file: PathBuf,
    /// How it can be told.
    pub what: String,
}

/// Reads all of a run directory but for its reports and for what broke, windows side by side.
///
/// # Errors
/// When its manifest, plan or journal cannot be read or are damaged: what the other files should be is not known then.
pub fn verify(directory: &RunDirectory) -> Result<Verification, ReadError> {
    let records = RunRecords::read_unpruned(directory)?;
    let mut looks = [directory.manifest(), directory.plan(), directory.journal()]
        .map(|place| Look::at(place, Ok(())))
        .to_vec();
    looks.extend(experiment(directory, &records.manifest));
    let scenarios: Vec<(&PlannedScenario, ScenarioState)> = records
        .plan
        .scenarios
        .iter()
        .map(|planned| (planned, records.state.scenario(&planned.slug)))
        .collect();
    for (planned, known) in &scenarios {
        looks.extend(looks_at_environments(&directory.scenario(&planned.slug), known));
    }
    // Whoever planned a million windows has not measured them.
    let windows = scenarios.par_iter().flat_map(|(planned, known)| {
        let numbers = 1..=planned.settings.all_windows();
        numbers.into_par_iter().flat_map_iter(|number| {
            let folder = directory.window(&planned.slug, number);
            looks_at_window(&folder, number, known, &records.journal)
        })
    });
    looks.par_extend(windows);
    let mut found = Verification {
        is_checked: records.journal.is_checked(),
        ..Verification::default()
    };
    for look in looks {
        found.files += 1;
        found.bytes += look.bytes;
        found.damaged.extend(look.damage(directory));
    }
    found.damaged.sort();
    Ok(found)
}

/// The files of a user's experiment, of a run that has any. A redacted copy has none.
fn experiment(directory: &RunDirectory, manifest: &Manifest) -> Option<Look> {
    let sha256 = manifest
        .experiment_sha256
        .as_ref()
        .filter(|_| !manifest.redacted)?;
    let place = directory.experiment();
    let found = match place.digest() {
        Ok(found) if found.sha256 == *sha256 => Ok(()),
        Ok(_) => Err("it is not as manifest.json has it".to_owned()),
        Err(error) => Err(format!("it cannot be read: {error}")),
    };
    Some(Look::at(place, found))
}

fn looks_at_environments(folder: &Place, known: &ScenarioState) -> Vec<Look> {
    // A crash can come between the word in the journal and the file; no window is collected then.
    let recorded = known.environments_recorded();
    let mut missing: BTreeSet<&str> = recorded.filter(|it| known.has_windows_of(it)).collect();
    let mut looks = Vec::new();
    for place in environments(folder) {
        let read = read_environment(&place, known.environment_sha256s());
        if let Ok(record) = &read {
            missing.remove(record.environment.as_str());
        }
        looks.push(Look::at(
            place,
            read.map(drop).map_err(|error| with_causes(&error)),
        ));
    }
    // One that is damaged may be any of them.
    let is_whole = |look: &Look| look.found.is_ok();
    if looks.iter().all(is_whole) {
        looks.extend(missing.into_iter().map(|environment| {
            let what = format!("of {environment} there is none, and events.jsonl says that it was written");
            Look::at(folder.join(layout::ENVIRONMENT), Err(what))
        }));
    }
    looks
}

/// What there is of the platforms of a scenario.
fn environments(scenario: &Place) -> impl Iterator<Item = Place> {
    let is_one = |(place, kind): &(Place, Kind)| {
        let name = place.name();
        *kind != Kind::Folder && name.starts_with("environment") && name.ends_with(".json")
    };
    let entries = scenario.entries().unwrap_or_default().into_iter();
    entries.filter(is_one).map(|(place, _)| place)
}

fn looks_at_window(folder: &Place, number: u32, known: &ScenarioState, journal: &Journal) -> Vec<Look> {
    let sha256 = known.window_sha256(number);
    if !folder.exists() {
        // One that nobody has collected is only missing.
        let lost = sha256.map(|_| "it is not there, and events.jsonl says that it was collected".to_owned());
        let lost = lost.map(|what| Look::at(folder.clone(), Err(what)));
        return lost.into_iter().collect();
    }
    let record = folder.join(layout::WINDOW);
    if journal.is_checked() && !known.collected.contains_key(&number) {
        let what = "events.jsonl does not have its window as collected; `matrix resume` takes it in";
        return vec![Look::at(record, Err(what.to_owned()))];
    }
    match read_window(folder, sha256) {
        Ok(read) => {
            let files = read.files.iter().map(|file| {
                let whole = ensure_file_is_whole(folder, file).map_err(NotWhole::reason);
                Look::at(folder.join(&file.name), whole)
            });
            std::iter::once(Look::at(record, Ok(()))).chain(files).collect()
        }
        Err(error) => vec![Look::at(record, Err(NotWhole::from(error).reason()))],
    }
}

/// A file that was read.
#[derive(Debug, Clone)]
struct Look {
    place: Place,
    bytes: u64,
    found: Result<(), String>,
}

impl Look {
    fn at(place: Place, found: Result<(), String>) -> Self {
        Self {
            bytes: place.bytes().unwrap_or_default(),
            place,
            found,
        }
    }

    fn damage(self, directory: &RunDirectory) -> Option<Damage> {
        let path = self.place.path();
        let file = path.strip_prefix(directory.path()).unwrap_or(&path).to_owned();
        self.found.err().map(|what| Damage { file, what })
    }
}
