//! Leases of run directories: one process at a time works on one. The main type is [`Lease`]. Those of hosts are in
//! [`crate::host::lease`], with the same [`Holder`].
//!
//! A lease is an advisory lock (`flock(2)`) on a file that says who holds it. The kernel releases it when its holder
//! dies, however it dies, so that no lease can be left behind.

use std::{
    fs::{File, OpenOptions, TryLockError},
    io::{Read, Seek, Write},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

/// A lease could not be asked for.
#[derive(Debug, thiserror::Error)]
#[error("the lease {} cannot be taken", path.display())]
pub struct LeaseError {
    path: PathBuf,
    source: std::io::Error,
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
            run_directory: run_directory.to_owned(),
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

/// A lease that is held; dropping it gives it back.
#[derive(Debug)]
pub struct Lease {
    _file: File,
}

/// Asks for the lease at `path` without waiting.
///
/// # Errors
/// When the file cannot be opened or locked.
pub fn ask(path: &Path, holder: &Holder) -> Result<Asked, LeaseError> {
    let fail = |source| LeaseError {
        path: path.to_owned(),
        source,
    };
    let mut file = open(path).map_err(fail)?;
    match file.try_lock() {
        Ok(()) => hold(file, holder).map(Asked::Granted).map_err(fail),
        Err(TryLockError::WouldBlock) => {
            let mut text = String::new();
            file.read_to_string(&mut text).map_err(fail)?;
            let holder = serde_json::from_str(&text).ok();
            Ok(Asked::Held { holder })
        }
        Err(TryLockError::Error(source)) => Err(fail(source)),
    }
}

/// Whether some process holds the lease at `path` now.
#[must_use]
pub fn is_held(path: &Path) -> bool {
    File::open(path).is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

/// Where the lease of this machine is: one for all its users. `MATRIX_LEASE` moves it, for tests.
#[must_use]
pub fn of_this_machine() -> PathBuf {
    std::env::var_os("MATRIX_LEASE").map_or_else(|| PathBuf::from("/tmp/matrix-host.lease"), PathBuf::from)
}

/// Opens without creating first: in a sticky folder the kernel refuses to "create" a file that another user made
/// (`fs.protected_regular`), even if it is open to all.
fn open(path: &Path) -> std::io::Result<File> {
    let existing = OpenOptions::new().read(true).write(true).open(path);
    match existing {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let file = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(path)?;
            file.set_permissions(std::fs::Permissions::from_mode(0o666))?;
            Ok(file)
        }
        other => other,
    }
}

fn hold(mut file: File, holder: &Holder) -> std::io::Result<Lease> {
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
        let path = folder.path().join("lease");
        let Asked::Granted(lease) = ask(&path, &holder()).unwrap() else {
            panic!("nobody holds it")
        };
        assert!(is_held(&path));
        let Asked::Held { holder: told } = ask(&path, &holder()).unwrap() else {
            panic!("it is held")
        };
        assert_eq!(told, Some(holder()));
        drop(lease);
        assert!(!is_held(&path));
        assert!(matches!(ask(&path, &holder()).unwrap(), Asked::Granted(_)));
    }
}
