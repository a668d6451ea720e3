//! The static `workload` binary that this `matrix` carries and deploys into every environment. `build.rs` builds it, so
//! that one program is all a user has to install and both parts always speak the same format. Those of other machines
//! are built apart: [`machine`].

pub mod machine;

use std::{
    fmt::Write as _,
    fs, io,
    io::Write as _,
    os::unix::fs::OpenOptionsExt as _,
    path::{Path, PathBuf},
    process,
    sync::{
        OnceLock, PoisonError, RwLock,
        atomic::{AtomicU64, Ordering},
    },
};

use rustix::{
    io::Errno,
    process::{Pid, test_kill_process},
};
use sha2::{Digest as _, Sha256};

use crate::{
    failure::file_hint,
    state_directory::{self, StateDirectory},
};

/// The binary itself.
#[must_use]
pub fn bytes() -> &'static [u8] {
    include_bytes!(env!("WORKLOAD_BINARY"))
}

/// Its SHA-256, in hexadecimal.
#[must_use]
pub fn sha256() -> &'static str {
    static SHA256: OnceLock<String> = OnceLock::new();
    SHA256.get_or_init(|| hash_of(bytes()))
}

/// Held for writing while the binary's file is open for writing.
static WRITING: RwLock<()> = RwLock::new(());

/// How the name of one that is being written begins; its writer's process number follows.
const UNFINISHED: &str = ".workload.";

/// How many times this process has begun to install it.
static INSTALLED: AtomicU64 = AtomicU64::new(0);

/// Starts a process, whichever, by calling `spawn`, at a moment when the binary is not being written.
///
/// A child has its parent's open files from its fork to its exec. If the binary's were among them, the kernel would
/// refuse to run the binary (ETXTBSY) until that exec, though its writing was done long since. Tests start their programs by it too.
pub fn start<T>(spawn: impl FnOnce() -> T) -> T {
    let _not_writing = WRITING.read().unwrap_or_else(PoisonError::into_inner);
    spawn()
}

/// The file on this machine to start, written if it is not there yet. Its name has its hash, so that a newer `matrix`
/// never touches the binary that an older one's environments run from.
///
/// # Errors
/// When the state directory cannot be written; names the path that could not.
pub fn installed(state: &StateDirectory) -> Result<PathBuf, InstallError> {
    let directory = state.binaries();
    let path = directory.join(format!("workload-{}", sha256().get(..16).unwrap_or_default()));
    // The content is compared as well: a disk that was full, or a person, may have changed what has our name.
    if fs::read(&path).is_ok_and(|there| there == bytes()) {
        return Ok(path);
    }
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| InstallError { path, source }
    };
    fs::create_dir_all(&directory).map_err(failed(&directory))?;
    remove_unfinished(state);
    // Two hosts of one matrix may be this machine, and both want it at once.
    let temporary = directory.join(format!(
        "{UNFINISHED}{}.{}",
        process::id(),
        INSTALLED.fetch_add(1, Ordering::Relaxed)
    ));
    let written = write_executable(&temporary)
        .map_err(failed(&temporary))
        .and_then(|()| fs::rename(&temporary, &path).map_err(failed(&path)));
    if written.is_err() {
        // On a disk that is full.
        let _ = fs::remove_file(&temporary);
    }
    written.map(|()| path)
}

/// Removes what processes that were killed meanwhile had not finished writing.
pub fn remove_unfinished(state: &StateDirectory) {
    let is_abandoned = |path: &Path| {
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or_default();
        let writer = name
            .strip_prefix(UNFINISHED)
            .and_then(|rest| rest.split_once('.'))
            .and_then(|(pid, _)| pid.parse().ok())
            .and_then(Pid::from_raw);
        // Another user's process answers that we may not ask, and is there.
        writer.is_some_and(|process| test_kill_process(process) == Err(Errno::SRCH))
    };
    let Ok(entries) = fs::read_dir(state.binaries()) else {
        return;
    };
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        if is_abandoned(&path) {
            // What stays is some megabytes that the next one removes.
            let _ = fs::remove_file(path);
        }
    }
}

/// The deployed binary could not be put on this machine.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the workload to {}", .path.display())]
pub struct InstallError {
    /// Where it was to be.
    pub path: PathBuf,
    /// The cause.
    pub source: io::Error,
}

impl InstallError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self.source.kind() {
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
                Some(state_directory::CHOOSE.to_owned())
            }
            _ => file_hint(&self.source),
        }
    }
}

fn write_executable(path: &Path) -> io::Result<()> {
    let _writing = WRITING.write().unwrap_or_else(PoisonError::into_inner);
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut file = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o755)
        .open(path)?;
    file.write_all(bytes())?;
    file.sync_all()
}

/// The SHA-256 of a binary, in hexadecimal.
pub(crate) fn hash_of(content: &[u8]) -> String {
    in_hexadecimal(&Sha256::digest(content))
}

/// The same of what is read piece by piece.
pub(crate) fn hash_of_stream(mut content: impl io::Read) -> io::Result<String> {
    let mut hasher = Sha256::new();
    io::copy(&mut content, &mut hasher)?;
    Ok(in_hexadecimal(&hasher.finalize()))
}

fn in_hexadecimal(hash: &[u8]) -> String {
    hash.iter().fold(String::with_capacity(64), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn the_binary_is_a_small_program() {
        assert_eq!(bytes().get(..4).unwrap(), b"\x7fELF");
        assert!(bytes().len() < 6 << 20, "{} bytes", bytes().len());
    }

    #[test]
    fn what_a_killed_process_was_writing_is_removed_and_what_a_live_one_writes_stays() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateDirectory::new(folder.path());
        fs::create_dir_all(state.binaries()).unwrap();
        let mut child = start(|| process::Command::new("true").spawn()).unwrap();
        child.wait().unwrap();
        let written_by = |pid| state.binaries().join(format!("{UNFINISHED}{pid}.0"));
        let (killed, live) = (written_by(child.id()), written_by(process::id()));
        let installed = installed(&state).unwrap();
        for path in [&killed, &live] {
            fs::write(path, "half").unwrap();
        }
        remove_unfinished(&state);
        assert!(!killed.exists() && live.exists() && installed.exists());
    }

    #[test]
    fn the_binary_does_not_know_where_it_was_built() {
        let has = |text: &str| bytes().windows(text.len()).any(|part| part == text.as_bytes());
        assert!(has("/cargo/registry/src/"), "panics name their place");
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let sources = workspace.join("workload");
        // This test is target/debug/deps/….
        let program = std::env::current_exe().unwrap();
        let target = program.ancestors().nth(3).unwrap();
        for place in [
            sources.to_str().unwrap(),
            target.to_str().unwrap(),
            "/.cargo/",
            "/.rustup/",
        ] {
            assert!(!has(place), "{place}");
        }
    }

    #[test]
    fn two_hosts_that_are_this_machine_can_want_it_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateDirectory::new(folder.path());
        std::thread::scope(|scope| {
            let installing: Vec<_> = (0..8)
                .map(|_| scope.spawn(|| installed(&state).unwrap()))
                .collect();
            for path in installing.into_iter().map(|one| one.join().unwrap()) {
                assert_eq!(fs::read(path).unwrap(), bytes());
            }
        });
        assert_eq!(fs::read_dir(state.binaries()).unwrap().count(), 1);
    }

    #[test]
    fn the_binary_is_installed_once_and_can_be_run() {
        let state = tempfile::tempdir().unwrap();
        let state = StateDirectory::new(state.path());
        let path = installed(&state).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o755);
        let written = fs::metadata(&path).unwrap().modified().unwrap();
        assert_eq!(installed(&state).unwrap(), path);
        assert_eq!(fs::metadata(&path).unwrap().modified().unwrap(), written);
        assert_eq!(fs::read_dir(state.binaries()).unwrap().count(), 1);
    }

    #[test]
    fn a_binary_can_be_started_while_others_are_written() {
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..20 {
                        let state = tempfile::tempdir().unwrap();
                        let path = installed(&StateDirectory::new(state.path())).unwrap();
                        let mut command = process::Command::new(path);
                        command.arg("--version").stdout(process::Stdio::null());
                        let status = start(|| command.spawn()).unwrap().wait().unwrap();
                        assert!(status.success());
                    }
                });
            }
        });
    }

    #[test]
    fn a_binary_that_was_cut_short_is_written_again() {
        let state = tempfile::tempdir().unwrap();
        let state = StateDirectory::new(state.path());
        let path = installed(&state).unwrap();
        fs::remove_file(&path).unwrap();
        fs::write(&path, b"half").unwrap();
        assert_eq!(fs::read(installed(&state).unwrap()).unwrap(), bytes());
    }

    #[test]
    fn a_place_that_cannot_be_written_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = installed(&StateDirectory::new(file.path())).unwrap_err();
        assert!(
            error.to_string().contains(file.path().to_str().unwrap()),
            "{error}"
        );
    }

    #[test]
    fn the_hash_is_sha_256() {
        // FIPS 180-2, appendix B.1.
        assert_eq!(
            hash_of(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        assert_eq!(hash_of_stream(b"abc".as_slice()).unwrap(), hash_of(b"abc"));
    }
}
