//! What the state folder knows of runs. The main types are [`Entry`] and [`AtWork`].
//!
//! Which runs of this user went to other machines, and to which: kept from before anything is created there until
//! `matrix clean` finds nothing there any more, so that it can be found without the run directory. And which runs are
//! worked on now, whatever becomes of their run directory's name meanwhile.

use std::{
    collections::BTreeSet,
    fs, io,
    path::{Path, PathBuf},
};

use record::run_directory::{HostRecord, Manifest, Place, PlanRecord};
use serde::{Deserialize, Serialize};

use crate::{
    lease::{self, Holder, Lease, LeaseError},
    state_directory::StateDirectory,
};

/// A run with hosts elsewhere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The run's id, which is the name of its folder.
    pub run: String,
    /// Where its run directory is; empty in entries of earlier versions.
    #[serde(default)]
    pub run_directory: PathBuf,
    /// What its environments are made with.
    #[serde(default)]
    pub providers: BTreeSet<String>,
    /// The hosts that are not this machine.
    pub hosts: Vec<HostRecord>,
}

impl Entry {
    /// Of a run; none if all of it is on this machine.
    #[must_use]
    pub fn of(manifest: &Manifest, plan: &PlanRecord, run_directory: &Path) -> Option<Self> {
        let providers = plan.scenarios.iter().map(|it| it.provider());
        let elsewhere = |host: &&HostRecord| !host.connect.is_this_machine();
        let hosts: Vec<_> = manifest.hosts.iter().filter(elsewhere).cloned().collect();
        (!hosts.is_empty()).then(|| Self {
            run: manifest.run.clone(),
            run_directory: run_directory.to_owned(),
            providers: providers.collect(),
            hosts,
        })
    }

    /// Writes it down, whole or not at all.
    ///
    /// # Errors
    /// When the state folder cannot be written.
    pub fn enter(&self, state: &StateDirectory) -> io::Result<()> {
        let path = file(state, &self.run);
        let unfinished = path.with_extension("new");
        fs::create_dir_all(state.runs())?;
        fs::write(&unfinished, serde_json::to_vec_pretty(self)?)?;
        fs::rename(unfinished, path)
    }

    /// Forgets it; it may be forgotten already.
    ///
    /// # Errors
    /// When the state folder cannot be written.
    pub fn strike(&self, state: &StateDirectory) -> io::Result<()> {
        match fs::remove_file(file(state, &self.run)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }
}

/// A run that is worked on, by its name, until this is dropped.
#[derive(Debug)]
pub struct AtWork {
    place: Place,
    _lease: Lease,
}

impl Drop for AtWork {
    fn drop(&mut self) {
        // While it is locked. One that stays is removed by the next who takes it.
        let _ = self.place.remove_file();
    }
}

/// Takes a run for this process; its holder in words if another has it.
///
/// # Errors
/// When the state folder cannot be written.
pub fn take(
    state: &StateDirectory,
    holder: &Holder,
    run: &str,
) -> Result<Result<AtWork, String>, LeaseError> {
    let place = lock(state, run);
    // Without it the lease says what is wrong.
    let _ = fs::create_dir_all(state.runs());
    let asked = lease::ask(&place, holder)?.granted();
    Ok(asked.map(|lease| AtWork { place, _lease: lease }))
}

/// Whether a process works on a run now.
#[must_use]
pub fn is_taken(state: &StateDirectory, run: &str) -> bool {
    lease::is_held(&lock(state, run))
}

fn lock(state: &StateDirectory, run: &str) -> Place {
    Place::root(state.runs()).join(format!("{run}.lock"))
}

/// All that are written down. What cannot be read is none of ours.
#[must_use]
pub fn entries(state: &StateDirectory) -> Vec<Entry> {
    let read = |path: &Path| serde_json::from_slice(&fs::read(path).ok()?).ok();
    let Ok(found) = fs::read_dir(state.runs()) else {
        return Vec::new();
    };
    let mut paths: Vec<PathBuf> = found
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "json"))
        .collect();
    paths.sort();
    paths.iter().filter_map(|path| read(path)).collect()
}

fn file(state: &StateDirectory, run: &str) -> PathBuf {
    state.runs().join(format!("{run}.json"))
}

#[cfg(test)]
mod tests {
    use record::{
        connection::{Connection, Ssh},
        run_directory::RecordedConnection,
    };

    use super::*;

    #[test]
    fn what_is_entered_is_found_until_it_is_struck() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateDirectory::new(folder.path());
        assert_eq!(entries(&state), []);
        let entry = |run: &str| Entry {
            run: run.to_owned(),
            run_directory: "/runs".into(),
            providers: BTreeSet::from(["native".to_owned()]),
            hosts: vec![HostRecord {
                name: "lab".to_owned(),
                connect: RecordedConnection::Known(Connection::Ssh(Ssh {
                    address: "me@lab".parse().unwrap(),
                    identity: None,
                    jump: None,
                    known_hosts: None,
                })),
                hardware: String::new(),
                os: String::new(),
                kernel: String::new(),
            }],
        };
        let (one, two) = (entry("20260101-1"), entry("20260101-2"));
        two.enter(&state).unwrap();
        one.enter(&state).unwrap();
        one.enter(&state).unwrap();
        fs::write(state.runs().join("notes.json"), "mine").unwrap();
        assert_eq!(entries(&state), [one.clone(), two.clone()]);
        one.strike(&state).unwrap();
        one.strike(&state).unwrap();
        assert_eq!(entries(&state), [two]);
    }

    #[test]
    fn a_run_is_taken_by_one_and_nothing_stays_when_it_is_given_back() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateDirectory::new(folder.path());
        let holder = Holder::this_process(Path::new("/runs/r"));
        assert!(!is_taken(&state, "r"));
        let taken = take(&state, &holder, "r").unwrap().unwrap();
        assert!(is_taken(&state, "r") && !is_taken(&state, "other"));
        let words = take(&state, &holder, "r").unwrap().unwrap_err();
        assert!(words.contains("/runs/r"), "{words}");
        drop(taken);
        assert!(!is_taken(&state, "r"));
        assert_eq!(fs::read_dir(state.runs()).unwrap().count(), 0);
        drop(take(&state, &holder, "r").unwrap().unwrap());
    }
}
