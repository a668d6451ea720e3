//! The three files that every run directory has, read together since one has the checksums of the others. The main type
//! is [`RunRecords`].

use std::io;

use sha2::{Digest, Sha256};

use super::{
    Journal, Manifest, PlanRecord, RunDirectory, RunState,
    reading::{ReadError, read_manifest, read_plan},
};

/// What was asked, what was planned and what happened.
#[derive(Debug, Clone, PartialEq)]
pub struct RunRecords {
    /// What was asked.
    pub manifest: Manifest,
    /// What was planned.
    pub plan: PlanRecord,
    /// What happened.
    pub journal: Journal,
    /// What the journal has come to. It has the checksums of the other files.
    pub state: RunState,
}

impl RunRecords {
    /// Reads them; nothing that was measured is read.
    ///
    /// # Errors
    /// When it is no run directory, half-written, damaged or of a later format.
    pub fn read(directory: &RunDirectory) -> Result<Self, ReadError> {
        ensure_is_run_directory(directory)?;
        // What is wrong with the others is told first: a later version may have another journal too.
        let journal = Journal::read(&directory.journal());
        let entries = journal.iter().flat_map(|journal| &journal.entries);
        let state = RunState::replay(entries);
        let plan = read_plan(&directory.plan(), state.plan_sha256.as_deref())?;
        let place = directory.manifest();
        let manifest = read_manifest(&place, state.manifest_sha256.as_deref())?;
        if !manifest.has_its_matrix() {
            return Err(ReadError::Damaged {
                path: place.path(),
                how: "`matrix_sha256` is not the SHA-256 of `matrix_text`".to_owned(),
            });
        }
        Ok(Self {
            manifest,
            plan,
            journal: journal?,
            state,
        })
    }

    /// Reads them of a run of which what was measured is there, too.
    ///
    /// # Errors
    /// As [`Self::read`], and when the run was pruned.
    pub fn read_unpruned(directory: &RunDirectory) -> Result<Self, ReadError> {
        let records = Self::read(directory)?;
        match directory.pruned().exists() {
            true => Err(ReadError::Pruned {
                path: directory.path().to_owned(),
            }),
            false => Ok(records),
        }
    }
}

impl Manifest {
    /// Whether the matrix file in it is the one that it has the checksum of. A redacted copy has the checksum alone.
    fn has_its_matrix(&self) -> bool {
        self.redacted || format!("{:x}", Sha256::digest(&self.matrix_text)) == self.matrix_sha256
    }
}

fn ensure_is_run_directory(directory: &RunDirectory) -> Result<(), ReadError> {
    let path = directory.path().to_owned();
    let not_one = |why| {
        Err(ReadError::NotARunDirectory {
            path: path.clone(),
            why,
        })
    };
    match directory.root().ensure_root() {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => return not_one("it is not a folder"),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(ReadError::NotFound { path }),
        Err(source) => return Err(ReadError::Io { path, source }),
    }
    let others = [directory.plan(), directory.journal()];
    if !directory.manifest().exists() && !others.iter().any(|file| file.exists()) {
        return not_one("it has no manifest.json");
    }
    Ok(())
}
