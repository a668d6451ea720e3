//! Leases of run directories: one process at a time works on one. The main type is [`Lease`]. Those of hosts are in
//! [`crate::host::lease`], with the same [`Holder`].
//!
//! A lease is an advisory lock (`flock(2)`) on a file that says who holds it. The kernel releases it when its holder
//! dies, however it dies, so that no lease can be left behind.

use std::{
    fs::{File, Permissions, TryLockError},
    io::{self, Read, Seek, Write},
    os::unix::fs::{MetadataExt, PermissionsExt},
    path::{Path, PathBuf},
};

use record::run_directory::{OpenOptions, Place};
use serde::{Deserialize, Serialize};

/// A lease could not be asked for.
#[derive(Debug, thiserror::Error)]
#[error("the lease {} cannot be taken", path.display())]
pub struct LeaseError {
    path: PathBuf,
    source: io::Error,
}

/// Who holds a lease.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Its process number.
    pub pid: u32,
    /// The machine that it runs on, by its own name; empty where earlier versions wrote this.
    #[serde(default)]
    pub machine: String,
    /// The run directory it works on.
    pub run_directory: PathBuf,
    /// Since when, RFC 3339.
    pub since: String,
}

impl Holder {
    /// This process, from now on.
    #[must_use]
    pub fn this_process(run_directory: &Path) -> Self {
        Self {
            pid: std::process::id(),
            machine: rustix::system::uname().nodename().to_string_lossy().into_owned(),
            // Who reads it may be in another folder.
            run_directory: std::path::absolute(run_directory).unwrap_or_else(|_| run_directory.to_owned()),
            since: crate::journal::now(),
        }
    }
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "process {}{} with {} since {}",
            self.pid,
            Some(&self.machine)
                .filter(|machine| !machine.is_empty())
                .map(|machine| format!(" on {machine}"))
                .unwrap_or_default(),
            self.run_directory.display(),
            self.since
        )
    }
}

/// The answer to asking for a lease.
#[derive(Debug)]
pub enum Asked {
    /// It is ours until dropped.
    Granted(Lease),
    /// Another holds it.
    Held {
        /// Who, if they have said so by now.
        holder: Option<Holder>,
    },
}

impl Asked {
    /// The lease, or who holds it, in words.
    ///
    /// # Errors
    /// When another holds it.
    pub fn granted(self) -> Result<Lease, String> {
        match self {
            Self::Granted(lease) => Ok(lease),
            Self::Held { holder } => {
                Err(holder.map_or_else(|| "another process".to_owned(), |holder| holder.to_string()))
            }
        }
    }
}

/// A lease that is held; dropping it gives it back.
#[derive(Debug)]
pub struct Lease {
    _file: File,
}

/// What a holder says of itself is no longer.
const LONGEST_HOLDER: u64 = 64 << 10;

/// Asks for the lease at `place` without waiting.
///
/// # Errors
/// When the file cannot be opened or locked.
pub fn ask(place: &Place, holder: &Holder) -> Result<Asked, LeaseError> {
    let fail = |source| LeaseError {
        path: place.path(),
        source,
    };
    let file = open(place).map_err(fail)?;
    match file.try_lock() {
        // Its last holder has removed it after we had opened it: another will find another file there.
        Ok(()) if file.metadata().map_err(fail)?.nlink() == 0 => ask(place, holder),
        Ok(()) => hold(file, holder).map(Asked::Granted).map_err(fail),
        Err(TryLockError::WouldBlock) => {
            let holder = said_in(file).map_err(fail)?;
            Ok(Asked::Held { holder })
        }
        Err(TryLockError::Error(source)) => Err(fail(source)),
    }
}

/// What the holder of a lease says of itself in its file.
fn said_in(file: File) -> io::Result<Option<Holder>> {
    let mut text = Vec::new();
    file.take(LONGEST_HOLDER).read_to_end(&mut text)?;
    Ok(serde_json::from_slice(&text).ok())
}

/// Who holds the lease at `place` now, if somebody does and has said so.
#[must_use]
pub fn holder(place: &Place) -> Option<Holder> {
    let file = place.open().ok()?;
    match file.try_lock_shared() {
        Err(TryLockError::WouldBlock) => said_in(file).ok()?,
        _ => None,
    }
}

/// Whether some process holds the lease at `place` now.
#[must_use]
pub fn is_held(place: &Place) -> bool {
    match place.open() {
        Ok(file) => matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)),
        // It is another user's: nobody else can know.
        Err(error) => error.kind() == io::ErrorKind::PermissionDenied,
    }
}

/// Where the lease of a machine is: one for all its users.
pub const OF_A_MACHINE: &str = "/tmp/matrix-host.lease";

/// Where that of this machine is. `MATRIX_LEASE` moves it, for tests.
#[must_use]
pub fn of_this_machine() -> PathBuf {
    std::env::var_os("MATRIX_LEASE").map_or_else(|| PathBuf::from(OF_A_MACHINE), PathBuf::from)
}

/// For its owner alone: who can open a file can lock it.
fn open(place: &Place) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    let file = match place.open_to_write(&options) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => match place.create() {
            // Another has made it meanwhile.
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => place.open_to_write(&options)?,
            created => created?,
        },
        opened => opened?,
    };
    // One that another user made for all, as earlier versions did, stays as it is.
    let _ = file.set_permissions(Permissions::from_mode(0o600));
    Ok(file)
}

fn hold(mut file: File, holder: &Holder) -> io::Result<Lease> {
    file.set_len(0)?;
    file.rewind()?;
    serde_json::to_writer(&mut file, holder)?;
    file.flush()?;
    Ok(Lease { _file: file })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holder() -> Holder {
        Holder {
            pid: 7,
            machine: "lab".into(),
            run_directory: "/runs/one".into(),
            since: "2026-01-01T00:00:00.000Z".into(),
        }
    }

    #[test]
    fn the_second_to_ask_is_told_who_holds_the_lease() {
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join("lease");
        let Asked::Granted(lease) = ask(&place, &holder()).unwrap() else {
            panic!("nobody holds it")
        };
        assert!(is_held(&place));
        assert_eq!(super::holder(&place), Some(holder()));
        let Asked::Held { holder: told } = ask(&place, &holder()).unwrap() else {
            panic!("it is held")
        };
        assert_eq!(told, Some(holder()));
        drop(lease);
        assert!(!is_held(&place));
        assert_eq!(super::holder(&place), None);
        assert!(matches!(ask(&place, &holder()).unwrap(), Asked::Granted(_)));
    }
}
