//! The kernel's limits on a process. The main function is [`check`].
//!
//! A program that meets one in the midst of its work fails in places that say nothing of it: a peer that is not served, an engine
//! that seems not to answer, a thread that cannot be started. So they are looked at before.

use std::io;

use nix::{
    errno::Errno,
    sys::{
        resource::{Resource, getrlimit, rlim_t, setrlimit},
        signal::{SigSet, Signal},
    },
};

/// Open files that are enough for a run: a workload that measures has some 60 files, sockets and pipes open, and `matrix` as many and
/// ten more for each host.
pub const OPEN_FILES: rlim_t = 256;

/// Bytes of address space that are enough for a run and its report. Most of it is never touched: it is the stacks of threads and
/// what the allocator reserves for each of them.
pub const ADDRESS_SPACE: rlim_t = 2 << 30;

const MEBIBYTE: rlim_t = 1 << 20;

/// A limit is below what is needed.
#[derive(Debug, thiserror::Error)]
pub enum LimitError {
    /// Too few open files, by the hard limit.
    #[error("this process may open {limit} files, and {needed} are needed")]
    OpenFiles {
        /// The hard limit.
        limit: rlim_t,
        /// What is needed.
        needed: rlim_t,
    },
    /// Too little address space.
    #[error("this process may have {} MiB of address space, and {} MiB are needed", limit / MEBIBYTE, ADDRESS_SPACE / MEBIBYTE)]
    AddressSpace {
        /// The limit, in bytes.
        limit: rlim_t,
    },
    /// A limit could not be read or set.
    #[error("the limits of this process cannot be read or raised")]
    Refused(#[source] io::Error),
}

impl LimitError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::OpenFiles { needed, .. } => raise(*needed),
            Self::Refused(_) => raise(OPEN_FILES),
            Self::AddressSpace { .. } => {
                "raise the limit with `ulimit -v unlimited` or `LimitAS=` of the service".to_owned()
            }
        }
    }
}

/// Compares the limits with what is needed, and raises the soft limit of open files if it is below. Children inherit it.
///
/// # Errors
/// When a limit is below what is needed.
pub fn check() -> Result<(), LimitError> {
    ensure_open_files(OPEN_FILES)?;
    // Whoever sets a soft limit of this means it: there is none by default.
    let (limit, _) = getrlimit(Resource::RLIMIT_AS).map_err(refused)?;
    if limit < ADDRESS_SPACE {
        return Err(LimitError::AddressSpace { limit });
    }
    Ok(())
}

/// Raises the soft limit of open files to so many if it is below. Children inherit it.
///
/// # Errors
/// When the hard limit is below.
pub fn ensure_open_files(needed: rlim_t) -> Result<(), LimitError> {
    let (soft, hard) = getrlimit(Resource::RLIMIT_NOFILE).map_err(refused)?;
    if hard < needed {
        return Err(LimitError::OpenFiles { limit: hard, needed });
    }
    if soft < needed {
        setrlimit(Resource::RLIMIT_NOFILE, needed, hard).map_err(refused)?;
    }
    Ok(())
}

fn refused(errno: Errno) -> LimitError {
    LimitError::Refused(errno.into())
}

fn raise(needed: rlim_t) -> String {
    format!(
        "raise the limit with `ulimit -n {needed}`, `LimitNOFILE=` of the service or the container's `nofile`"
    )
}

/// A write beyond the limit of a file's length (`ulimit -f`) fails with [`io::ErrorKind::FileTooLarge`] in this thread and all that
/// it starts. Otherwise the kernel ends the process there, without a word.
pub fn fail_at_the_longest_file() {
    // It fails for an invalid argument only.
    let _ = SigSet::from(Signal::SIGXFSZ).thread_block();
}

/// What to do about a file that there is no room for.
#[must_use]
pub fn room_hint(error: &io::Error) -> Option<&'static str> {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Some("make room on the disk"),
        io::ErrorKind::FileTooLarge => {
            Some("raise the limit of a file's length (`ulimit -f unlimited`, `LimitFSIZE=` of the service)")
        }
        _ => None,
    }
}
