//! `platform`: what the host is, before anything is put on it. The function is [`platform`].

use std::{
    path::Path,
    time::{Duration, SystemTime},
};

use record::{detached::Host, platform::RealtimeGrant};
use rustix::{fs::statvfs, io::Errno};

use super::DetachedError;
use crate::survey;

/// What the host says of itself; creates nothing, and the root need not be there.
///
/// # Errors
/// When the disk cannot be asked.
pub fn platform(root: &Path) -> Result<Host, DetachedError> {
    Ok(Host {
        platform: survey::platform(RealtimeGrant::default()),
        free_bytes: free_bytes(root)?,
        uid: rustix::process::geteuid().as_raw(),
        // Last, so that it is as new as can be when it is told.
        now_ns: nanoseconds(
            SystemTime::now()
                .duration_since(SystemTime::UNIX_EPOCH)
                .unwrap_or_default(),
        ),
    })
}

/// What an ordinary user may still write to the disk on which the folder is or would be.
fn free_bytes(root: &Path) -> Result<u64, DetachedError> {
    for folder in root.ancestors() {
        match statvfs(folder) {
            Ok(disk) => return Ok(disk.f_bavail.saturating_mul(disk.f_frsize)),
            Err(Errno::NOENT) => {}
            Err(error) => return Err(DetachedError::file("ask the disk of", folder)(error)),
        }
    }
    Err(DetachedError::Root {
        root: root.to_owned(),
    })
}

/// Good until the year 2554.
fn nanoseconds(since: Duration) -> u64 {
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
