//! The folder below which nothing is trusted, and its handle.

use std::{
    fs, io,
    path::PathBuf,
    sync::{Arc, OnceLock},
};

use cap_std::{
    ambient_authority,
    fs::{Dir, MetadataExt as _},
};

use super::Place;

/// The folder below which nothing is trusted.
#[derive(Debug)]
pub(super) struct Root {
    pub(super) path: PathBuf,
    pub(super) way: Way,
    /// Which folder it was before; none if it has not been opened before.
    pub(super) was: Option<Identity>,
    /// From the first opening on: a folder that takes its name later is another.
    pub(super) opened: OnceLock<Arc<Dir>>,
}

/// How a root is reached.
#[derive(Debug)]
pub(super) enum Way {
    /// By a path that its user named. Links on it are the user's own.
    Named,
    /// It was found in a folder that may be anyone's.
    Found(Place),
}

/// What tells a folder from another that takes its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Identity {
    device: u64,
    inode: u64,
}

impl Identity {
    pub(super) fn of(folder: &Dir) -> io::Result<Self> {
        let about = folder.dir_metadata()?;
        Ok(Self {
            device: about.dev(),
            inode: about.ino(),
        })
    }
}

impl Root {
    /// The handle, which is kept.
    pub(super) fn open(&self) -> io::Result<Arc<Dir>> {
        if let Some(opened) = self.opened.get() {
            return Ok(Arc::clone(opened));
        }
        let folder = match &self.way {
            Way::Named => Arc::new(Dir::open_ambient_dir(&self.path, ambient_authority())?),
            Way::Found(place) => place.folder()?,
        };
        if let Some(was) = self.was {
            if was != Identity::of(&folder)? {
                return Err(io::Error::other(
                    "another folder has taken its place since it was read: see who else writes there, and start again",
                ));
            }
        }
        // Of two threads both go on with the handle of the first.
        Ok(Arc::clone(self.opened.get_or_init(|| folder)))
    }

    /// Makes the folder. One that is open is there: if it was removed since, it is not to be made anew behind a handle that leads to
    /// the old one.
    pub(super) fn make(&self) -> io::Result<()> {
        match (&self.way, self.opened.get()) {
            (_, Some(_)) => Ok(()),
            (Way::Named, None) => fs::create_dir_all(&self.path),
            (Way::Found(place), None) => place.make_folder(),
        }
    }
}
