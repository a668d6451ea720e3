//! A place in a run directory, or in another folder whose content may come from anyone: nothing below the folder is opened
//! through a link, nothing but regular files and folders is opened at all, and what is written is new. The main type is
//! [`Place`].
//!
//! A path would be opened through whatever links it has. A place is not a path, so that nothing opens it by mistake.
//!
//! The folder is opened once, and its handle is kept by all places in it: whoever may rename it could otherwise put another in its
//! place between two looks, and have that one read and written.

mod digest;
mod kind;
mod root;
mod unfinished;

use std::{
    cmp::Ordering,
    ffi::OsStr,
    fmt,
    fs::File,
    hash::{Hash, Hasher},
    io::{self, BufWriter, Read as _, Seek as _, Write as _},
    os::unix::fs::MetadataExt as _,
    path::{Component, Path, PathBuf},
    sync::{Arc, OnceLock},
};

use cap_fs_ext::{DirExt as _, FollowSymlinks, OpenOptionsFollowExt as _};
use cap_std::fs::{Dir, OpenOptions, OpenOptionsExt as _};
use rustix::fs::{Mode, OFlags, SeekFrom, fsync, openat, seek};

pub use self::{digest::FileDigest, kind::Kind, unfinished::Unfinished};
use self::{
    kind::{not_a_file, of_kind},
    root::{Identity, Root, Way},
};

/// What is in one folder. A scenario has ten thousand windows at most.
const MOST_ENTRIES: usize = 1 << 18;

/// A file or folder below a root. Two are the same if their paths are.
#[derive(Debug, Clone)]
pub struct Place {
    root: Arc<Root>,
    below: PathBuf,
}

impl PartialEq for Place {
    fn eq(&self, other: &Self) -> bool {
        self.paths() == other.paths()
    }
}

impl Eq for Place {}

impl PartialOrd for Place {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Place {
    fn cmp(&self, other: &Self) -> Ordering {
        self.paths().cmp(&other.paths())
    }
}

impl Hash for Place {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.paths().hash(state);
    }
}

impl Place {
    /// The folder itself below which nothing is trusted, by a path that its user named. It is opened when it is first looked at, and is
    /// open as long as this place is there or one that was made of it.
    pub fn root(folder: impl Into<PathBuf>) -> Self {
        Self::of_root(folder.into(), Way::Named, None)
    }

    /// This folder as a root of its own, which is opened from the folder that it is in and through no link.
    #[must_use]
    pub fn as_root(&self) -> Self {
        Self::of_root(self.path(), Way::Found(self.clone()), None)
    }

    /// The root, not held open: it is opened anew when it is looked at, and must be the same folder then. Of thousands of folders not all
    /// can be open at once.
    ///
    /// # Errors
    /// When it cannot be opened now.
    pub fn to_reopen(&self) -> io::Result<Self> {
        let was = match self.root.was {
            Some(was) => was,
            None => Identity::of(&*self.open_root()?)?,
        };
        let way = match &self.root.way {
            Way::Named => Way::Named,
            Way::Found(place) => Way::Found(place.clone()),
        };
        Ok(Self::of_root(self.root.path.clone(), way, Some(was)))
    }

    fn of_root(path: PathBuf, way: Way, was: Option<Identity>) -> Self {
        let opened = OnceLock::new();
        Self {
            root: Arc::new(Root {
                path,
                way,
                was,
                opened,
            }),
            below: PathBuf::new(),
        }
    }

    /// Opens the root, unless it is open.
    ///
    /// # Errors
    /// When it is not there, is no folder or may not be opened, and when it is another than it was.
    pub fn ensure_root(&self) -> io::Result<()> {
        self.open_root().map(drop)
    }

    /// What is in this folder by that name. A name that leads out of it is at no place: whatever is done with it fails.
    #[must_use]
    pub fn join(&self, name: impl AsRef<Path>) -> Self {
        // `PathBuf::join` would let an absolute path take the place of all before it.
        let mut below = self.below.clone().into_os_string();
        if !below.is_empty() {
            below.push("/");
        }
        below.push(name.as_ref());
        Self {
            root: Arc::clone(&self.root),
            below: below.into(),
        }
    }

    /// What has that name beside this.
    #[must_use]
    pub fn beside(&self, name: impl AsRef<Path>) -> Self {
        self.parent().join(name)
    }

    /// The folder that it is in; of the root itself, the root.
    #[must_use]
    pub fn parent(&self) -> Self {
        Self {
            root: Arc::clone(&self.root),
            below: self.below.parent().map(Path::to_owned).unwrap_or_default(),
        }
    }

    /// The folder below which nothing is trusted.
    #[must_use]
    pub fn base(&self) -> &Path {
        &self.root.path
    }

    /// Its path, for messages and for programs that are told it. Not to be opened.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        match self.below.as_os_str().is_empty() {
            true => self.root.path.clone(),
            false => self.root.path.join(&self.below),
        }
    }

    /// Its name; empty if that is not UTF-8, which none of ours is.
    #[must_use]
    pub fn name(&self) -> &str {
        self.below.file_name().and_then(OsStr::to_str).unwrap_or_default()
    }

    /// What is there; none if nothing is.
    ///
    /// # Errors
    /// When a folder on the way is none, or may not be entered.
    pub fn kind(&self) -> io::Result<Option<Kind>> {
        let (folder, name) = match self.way() {
            Ok(found) => found,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error),
        };
        match folder.symlink_metadata(name) {
            Ok(about) => Ok(Some(about.file_type().into())),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Whether anything is there, a link too.
    #[must_use]
    pub fn exists(&self) -> bool {
        self.kind().is_ok_and(|kind| kind.is_some())
    }

    /// Whether a folder is there.
    #[must_use]
    pub fn is_folder(&self) -> bool {
        self.kind().is_ok_and(|kind| kind == Some(Kind::Folder))
    }

    /// Opens a regular file for reading.
    ///
    /// # Errors
    /// When it is not there, is something else, or says that it is longer than it has bytes on the disk.
    pub fn open(&self) -> io::Result<File> {
        let mut options = OpenOptions::new();
        options.read(true);
        let mut file = self.open_with(&options)?;
        ensure_it_has_no_holes(&mut file)?;
        Ok(file)
    }

    /// Opens a regular file of at most so many bytes for reading.
    ///
    /// # Errors
    /// As [`Self::open`], and when it is longer.
    pub fn open_within(&self, most_bytes: u64) -> io::Result<File> {
        let file = self.open()?;
        let bytes = file.metadata()?.len();
        match bytes > most_bytes {
            true => Err(io::Error::new(
                io::ErrorKind::FileTooLarge,
                format!("it has {bytes} bytes, and {most_bytes} at most are read"),
            )),
            false => Ok(file),
        }
    }

    /// Opens a regular file as `options` say, which do not create it.
    ///
    /// # Errors
    /// When it is not there, or is something else.
    pub fn open_with(&self, options: &OpenOptions) -> io::Result<File> {
        let (folder, name) = self.way()?;
        // Before it is opened: to open a device may do something.
        let kind = Kind::from(folder.symlink_metadata(name)?.file_type());
        let mut options = options.clone();
        // And what takes its place meanwhile is not waited for.
        options
            .follow(FollowSymlinks::No)
            .custom_flags(OFlags::NONBLOCK.bits() as i32);
        let opened = match kind {
            Kind::File => folder.open_with(name, &options)?.into_std(),
            Kind::Folder | Kind::Other => return Err(not_a_file(kind)),
        };
        match opened.metadata()?.is_file() {
            true => Ok(opened),
            false => Err(not_a_file(Kind::Other)),
        }
    }

    /// Opens a regular file that is to be written to as `options` say, which do not create it.
    ///
    /// # Errors
    /// As [`Self::open_with`], and when it has another name, by which something else would be written to.
    pub fn open_to_write(&self, options: &OpenOptions) -> io::Result<File> {
        let opened = self.open_with(options)?;
        match opened.metadata()?.nlink() {
            0 | 1 => Ok(opened),
            names => Err(io::Error::other(format!(
                "it is one file with {names} names (hard links), and matrix would write to all of them: put a copy in its place"
            ))),
        }
    }

    /// Reads a regular file of at most so many bytes.
    ///
    /// # Errors
    /// When it is not there, is something else, or is longer.
    pub fn read(&self, most_bytes: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.open()?
            .take(most_bytes.saturating_add(1))
            .read_to_end(&mut bytes)?;
        if bytes.len() as u64 > most_bytes {
            return Err(io::Error::new(
                io::ErrorKind::FileTooLarge,
                format!("it is longer than {most_bytes} bytes, and matrix writes none that long"),
            ));
        }
        Ok(bytes)
    }

    /// Length of a regular file.
    ///
    /// # Errors
    /// When it is not there, or is something else.
    pub fn bytes(&self) -> io::Result<u64> {
        Ok(self.open()?.metadata()?.len())
    }

    /// Reads all of a regular file for its checksum.
    ///
    /// # Errors
    /// When it is not there, is something else, or cannot be read.
    pub fn digest(&self) -> io::Result<FileDigest> {
        self.open().and_then(FileDigest::of)
    }

    /// Creates a file that is not there yet.
    ///
    /// # Errors
    /// When something is there, a link too, or the folder cannot be written.
    pub fn create(&self) -> io::Result<File> {
        let (folder, name) = self.way()?;
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true);
        Ok(folder.open_with(name, &options)?.into_std())
    }

    /// Begins a file that takes this place when it is finished: a reader sees what was there before, or all of it.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn begin(&self) -> io::Result<(Unfinished, BufWriter<File>)> {
        let mut name = self.below.file_name().unwrap_or_default().to_owned();
        name.push(".new");
        let unfinished = Unfinished {
            place: self.clone(),
            beside: self.beside(name),
        };
        // What an earlier one left; a link goes, and not what it leads to.
        unfinished.beside.remove_file()?;
        let file = unfinished.beside.create()?;
        Ok((unfinished, BufWriter::new(file)))
    }

    /// Puts a small file there in one step, and waits until it is on the disk.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn write(&self, bytes: &[u8]) -> io::Result<()> {
        let (unfinished, mut out) = self.begin()?;
        out.write_all(bytes)?;
        out.into_inner()?.sync_all()?;
        unfinished.finish()?;
        self.parent().sync()
    }

    /// Makes this folder, and those it is in, if they are not there.
    ///
    /// # Errors
    /// When something else is there, or the folder above cannot be written.
    pub fn make_folder(&self) -> io::Result<()> {
        self.root.make()?;
        let mut folder = self.open_root()?;
        for name in self.names() {
            let name = name?;
            match folder.create_dir(name) {
                Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
                _ => {}
            }
            folder = Arc::new(enter(&folder, name)?);
        }
        Ok(())
    }

    /// What is in this folder, by name.
    ///
    /// # Errors
    /// When it is no folder, has more in it than any of ours, or cannot be read.
    pub fn entries(&self) -> io::Result<Vec<(Self, Kind)>> {
        let mut entries = Vec::new();
        for entry in self.folder()?.entries()? {
            let entry = entry?;
            if entries.len() == MOST_ENTRIES {
                return Err(io::Error::other(format!(
                    "it has more than {MOST_ENTRIES} files and folders in it, and no folder of matrix has"
                )));
            }
            entries.push((self.join(entry.file_name()), entry.file_type()?.into()));
        }
        entries.sort_by(|(a, _), (b, _)| a.cmp(b));
        Ok(entries)
    }

    /// Moves it to another place of the same file system, over a file that is there.
    ///
    /// # Errors
    /// When it is not there, or cannot be moved.
    pub fn rename(&self, to: &Self) -> io::Result<()> {
        let (folder, name) = self.way()?;
        let (other, new_name) = to.way()?;
        folder.rename(name, &other, new_name)
    }

    /// Removes a file or a link, if there is one.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn remove_file(&self) -> io::Result<()> {
        let (folder, name) = self.way()?;
        absent_is_well(folder.remove_file(name))
    }

    /// Removes a folder with all that is in it, if there is one. Of links in it only they are removed.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn remove_folder(&self) -> io::Result<()> {
        match self.way() {
            Ok((folder, name)) => absent_is_well(folder.remove_dir_all(name)),
            Err(error) => absent_is_well(Err(error)),
        }
    }

    /// Waits until this folder's entries, or this file, are on the disk.
    ///
    /// # Errors
    /// When it is not there, or the disk fails.
    pub fn sync(&self) -> io::Result<()> {
        match self.is_folder() || self.below.as_os_str().is_empty() {
            // cap-std's own handle of a folder is none that can be synced.
            true => Ok(fsync(openat(
                self.folder()?,
                ".",
                OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC,
                Mode::empty(),
            )?)?),
            false => self.open()?.sync_all(),
        }
    }

    fn paths(&self) -> (&Path, &Path) {
        (&self.root.path, &self.below)
    }

    fn open_root(&self) -> io::Result<Arc<Dir>> {
        self.root.open()
    }

    /// This folder.
    fn folder(&self) -> io::Result<Arc<Dir>> {
        let mut folder = self.open_root()?;
        for name in self.names() {
            folder = Arc::new(enter(&folder, name?)?);
        }
        Ok(folder)
    }

    /// The folder that it is in, and its name there.
    fn way(&self) -> io::Result<(Arc<Dir>, &OsStr)> {
        let mut names = self.names();
        let mut name = names.next().unwrap_or_else(|| Err(leads_out()))?;
        let mut folder = self.open_root()?;
        for next in names {
            folder = Arc::new(enter(&folder, name)?);
            name = next?;
        }
        Ok((folder, name))
    }

    fn names(&self) -> impl Iterator<Item = io::Result<&OsStr>> {
        self.below.components().map(|component| match component {
            Component::Normal(name) => Ok(name),
            _ => Err(leads_out()),
        })
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path().display().fmt(f)
    }
}

/// A file of zeros takes no room on a disk, however long it says that it is: to read it to its end takes days, and a copy fills the
/// disk. matrix writes none. A short one is read sooner than its file system says where its holes are.
fn ensure_it_has_no_holes(file: &mut File) -> io::Result<()> {
    const SHORT: u64 = 16 << 20;
    let bytes = file.metadata()?.len();
    if bytes <= SHORT {
        return Ok(());
    }
    // A file system that does not know has no hole before the end.
    let whole = seek(&*file, SeekFrom::Hole(0)).unwrap_or(bytes);
    file.rewind()?;
    match whole < bytes {
        true => Err(io::Error::new(
            io::ErrorKind::FileTooLarge,
            format!("it has {bytes} bytes, not all of them on the disk: matrix writes no file with holes"),
        )),
        false => Ok(()),
    }
}

fn enter(folder: &Dir, name: &OsStr) -> io::Result<Dir> {
    let kind = Kind::from(folder.symlink_metadata(name)?.file_type());
    match kind {
        Kind::Folder => folder.open_dir_nofollow(name),
        Kind::File | Kind::Other => Err(io::Error::new(
            io::ErrorKind::NotADirectory,
            format!("{} is {}, and not a folder", quoted(name), of_kind(kind)),
        )),
    }
}

fn quoted(name: &OsStr) -> String {
    format!("`{}`", name.to_string_lossy().escape_default())
}

fn leads_out() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "its name leads out of its folder")
}

fn absent_is_well(done: io::Result<()>) -> io::Result<()> {
    match done {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests;
