//! Reading a file of lines while another process appends to it, woken by the kernel (inotify(7)). The main type is
//! [`FollowedFile`].

use std::{
    fs::File,
    io::{self, Read as _},
    os::fd::OwnedFd,
    path::Path,
};

use rustix::{
    fs::inotify::{self, CreateFlags, WatchFlags},
    io::Errno,
};
use tokio::io::unix::AsyncFd;

use super::readiness;

/// The file, from its beginning.
#[derive(Debug)]
pub struct FollowedFile {
    file: File,
    changes: AsyncFd<OwnedFd>,
}

impl FollowedFile {
    /// Opens the file, which must exist.
    ///
    /// # Errors
    /// When it cannot be opened or watched.
    pub fn open(path: &Path) -> io::Result<Self> {
        // Watched before it is read for the first time: no change can fall between.
        let changes = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?;
        inotify::add_watch(&changes, path, WatchFlags::MODIFY)?;
        Ok(Self {
            file: File::open(path)?,
            changes: readiness::watch(changes)?,
        })
    }

    /// What was appended since the last call, as much as fits; 0 if nothing was.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.file.read(buffer)
    }

    /// Waits until something may have been appended. Cancel-safe.
    ///
    /// # Errors
    /// When the runtime cannot watch it.
    pub async fn changed(&self) -> io::Result<()> {
        let mut ready = self.changes.readable().await?;
        let mut events = [0_u8; 1024];
        loop {
            match rustix::io::read(self.changes.get_ref(), &mut events) {
                Ok(_) => {}
                Err(Errno::AGAIN) => break,
                Err(error) => return Err(error.into()),
            }
        }
        ready.clear_ready();
        Ok(())
    }
}
