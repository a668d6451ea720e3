//! The three files that every run directory has, read together since one has the checksums of the others. The main type
//! is [`RunRecords`].

use std::io;

use sha2::{Digest, Sha256};

use super::{
    Checksums, FORMAT, Journal, Manifest, PlanRecord, RunDirectory,
    reading::{ReadError, read_checked},
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
    /// What the journal says that the other files are.
    pub checksums: Checksums,
}

impl RunRecords {
    /// Reads them; nothing that was measured is read.
    ///
    /// # Errors
    /// When it is no run directory, half-written, damaged or of a later format.
    pub fn read(directory: &RunDirectory) -> Result<Self, ReadError> {
        see_that_it_is_one(directory)?;
        // What is wrong with the others is told first: a later version may have another journal too.
        let journal = Journal::read(&directory.journal());
        let checksums = journal.as_ref().map(Checksums::of).unwrap_or_default();
        let place = directory.plan();
        let plan: PlanRecord = read_checked(&place, FORMAT, checksums.plan())?;
        plan.check().map_err(|source| ReadError::Impossible {
            path: place.path(),
            source,
        })?;
        let place = directory.manifest();
        let manifest: Manifest = read_checked(&place, FORMAT, checksums.manifest())?;
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
            checksums,
        })
    }
}

impl Manifest {
    /// Whether the matrix file in it is the one that it has the checksum of. A redacted copy has the checksum alone.
    fn has_its_matrix(&self) -> bool {
        self.redacted || format!("{:x}", Sha256::digest(&self.matrix_text)) == self.matrix_sha256
    }
}

fn see_that_it_is_one(directory: &RunDirectory) -> Result<(), ReadError> {
    let path = directory.path();
    let about = path.metadata().map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => ReadError::NotFound {
            path: path.to_owned(),
        },
        _ => ReadError::Io {
            path: path.to_owned(),
            source,
        },
    })?;
    let not_one = |why| {
        Err(ReadError::NotARunDirectory {
            path: path.to_owned(),
            why,
        })
    };
    if !about.is_dir() {
        return not_one("it is not a folder");
    }
    let others = [directory.plan(), directory.journal()];
    if !directory.manifest().exists() && !others.iter().any(|file| file.exists()) {
        return not_one("it has no manifest.json");
    }
    Ok(())
}
