//! The limit of open files. The main function is [`make_room`].
//!
//! A program that meets it in the midst of its work fails in places that say nothing of it: a peer that is not served, an engine
//! that seems not to answer. So it is looked at before.

use std::io;

use nix::{
    errno::Errno,
    sys::resource::{Resource, getrlimit, rlim_t, setrlimit},
};

/// What is enough for a run: a workload that measures has some 60 files, sockets and pipes open, and `matrix` as many and ten more
/// for each host.
pub const ENOUGH: rlim_t = 256;

/// A process may open too few files.
#[derive(Debug, thiserror::Error)]
pub enum DescriptorError {
    /// The hard limit is below what is needed.
    #[error("this process may open {limit} files, and {ENOUGH} are needed")]
    TooFew {
        /// The hard limit.
        limit: rlim_t,
    },
    /// The limit could not be read or set.
    #[error("the limit of open files cannot be raised to {ENOUGH}")]
    Refused(#[source] io::Error),
}

impl DescriptorError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        format!(
            "raise the limit with `ulimit -n {ENOUGH}`, `LimitNOFILE=` of the service or the container's `nofile`"
        )
    }
}

/// Raises the soft limit to [`ENOUGH`] if it is below. Children inherit it.
///
/// # Errors
/// When the hard limit is below that.
pub fn make_room() -> Result<(), DescriptorError> {
    let refused = |errno: Errno| DescriptorError::Refused(errno.into());
    let (soft, hard) = getrlimit(Resource::RLIMIT_NOFILE).map_err(refused)?;
    if hard < ENOUGH {
        return Err(DescriptorError::TooFew { limit: hard });
    }
    if soft < ENOUGH {
        setrlimit(Resource::RLIMIT_NOFILE, ENOUGH, hard).map_err(refused)?;
    }
    Ok(())
}
