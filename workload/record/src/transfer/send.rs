//! A folder as a stream, from where an earlier one broke off. The function is [`send`]; [`super::receive()`] is the other
//! side.
//!
//! The stream is an LZ4 frame, with its checksum, of a tar (ustar) of the folder's regular files, two levels deep. An
//! entry's content begins at the byte that is already there, and its size is that of the rest. Links are not followed. A
//! file that grows meanwhile is sent as long as it was; one that shrinks is filled up with zeros, so that the archive
//! stays whole, and its checksum in `window.json` tells.

use std::{
    fs::File,
    io::{self, Read as _, Seek as _, SeekFrom, Write},
    os::fd::{AsFd, OwnedFd},
    path::{Path, PathBuf},
};

use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
use rustix::{
    fs::{Dir, FileType, Mode, OFlags, openat},
    io::Errno,
};

use crate::detached::{AlreadyThere, is_sent_whole};

/// Why a folder is not sent.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// More is said to be there already than the file has.
    #[error("{} has {length} bytes, and {there} are said to be there already", path.display())]
    Beyond {
        /// The file.
        path: PathBuf,
        /// Its length.
        length: u64,
        /// What is said to be there.
        there: u64,
    },
    /// A file or folder refused.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file or folder that could not be sent.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// The stream refused: nobody reads it.
    #[error("cannot send the data")]
    Stream(#[source] io::Error),
}

impl SendError {
    /// Of a file or folder, with the system's words to come.
    fn read<E: Into<io::Error>>(path: &Path) -> impl FnOnce(E) -> Self + use<E> {
        let path = path.to_owned();
        move |source| Self::Read {
            path,
            source: source.into(),
        }
    }
}

/// Sends the files of a folder, each from the byte that is there already. `window.json`, which is written last, comes after the
/// files that it describes.
///
/// # Errors
/// When a file cannot be read or is shorter than what is there already, or when nobody reads the stream.
pub fn send(path: &Path, there: &AlreadyThere, out: impl Write) -> Result<(), SendError> {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let data = rustix::fs::open(path, flags, Mode::empty()).map_err(SendError::read(path))?;
    let paths = files(&data, "", path)?;
    // Before anything is sent, so that it is told as what it is.
    for relative in &paths {
        open_entry(&data, relative, there, path)?;
    }
    let frame = FrameInfo::new()
        .block_size(BlockSize::Max256KB)
        .block_mode(BlockMode::Linked)
        .content_checksum(true);
    let mut stream = FrameEncoder::with_frame_info(frame, out);
    for relative in &paths {
        if let Some(entry) = open_entry(&data, relative, there, path)? {
            entry.send(relative, &mut stream, path)?;
        }
    }
    // A tar ends with two empty blocks.
    stream.write_all(&[0; 2 * BLOCK]).map_err(SendError::Stream)?;
    let mut out = stream
        .finish()
        .map_err(|error| SendError::Stream(io::Error::other(error)))?;
    out.flush().map_err(SendError::Stream)
}

/// The unit of a tar.
const BLOCK: usize = 512;

/// Regular files and, from the top, those of its folders, in the order of their names. A name that is not UTF-8 or that
/// a tar's header does not hold is none of a workload's.
fn files(folder: &impl AsFd, prefix: &str, root: &Path) -> Result<Vec<String>, SendError> {
    let failed = |error: Errno| SendError::read(&root.join(prefix))(error);
    let mut paths = Vec::new();
    for entry in Dir::read_from(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let Ok(name) = entry.file_name().to_str() else {
            continue;
        };
        if [".", ".."].contains(&name) || prefix.len() + name.len() >= 100 {
            continue;
        }
        let Some(opened) = open(folder, name).map_err(failed)? else {
            continue;
        };
        match kind(&opened).map_err(failed)? {
            FileType::RegularFile => paths.push(format!("{prefix}{name}")),
            FileType::Directory if prefix.is_empty() => {
                paths.extend(files(&opened, &format!("{name}/"), root)?);
            }
            _ => {}
        }
    }
    paths.sort();
    Ok(paths)
}

/// Opens what is there now, unless it is a link or gone. Does not wait for a pipe's other end.
fn open(folder: &impl AsFd, name: &str) -> Result<Option<OwnedFd>, Errno> {
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    match openat(folder, name, flags, Mode::empty()) {
        Ok(opened) => Ok(Some(opened)),
        // Links; what has gone meanwhile; sockets.
        Err(Errno::LOOP | Errno::NOENT | Errno::NXIO) => Ok(None),
        Err(error) => Err(error),
    }
}

fn kind(opened: &OwnedFd) -> Result<FileType, Errno> {
    rustix::fs::fstat(opened).map(|stat| FileType::from_raw_mode(stat.st_mode))
}

/// A file, at the byte from which it is sent, and how much of it is.
struct Entry {
    file: File,
    size: u64,
}

/// A path found by [`files`], if it still leads to a regular file; each step of it anew, since a link could have been
/// put there.
fn open_entry(
    data: &OwnedFd,
    relative: &str,
    there: &AlreadyThere,
    root: &Path,
) -> Result<Option<Entry>, SendError> {
    let path = root.join(relative);
    let failed = |error: Errno| SendError::read(&path)(error);
    let opened = match relative.split_once('/') {
        None => open(data, relative),
        Some((folder, name)) => match open(data, folder) {
            Ok(Some(folder)) => open(&folder, name),
            nothing => nothing,
        },
    };
    let Some(opened) = opened.map_err(failed)? else {
        return Ok(None);
    };
    if kind(&opened).map_err(failed)? != FileType::RegularFile {
        return Ok(None);
    }
    let mut file = File::from(opened);
    let length = file.metadata().map_err(SendError::read(&path))?.len();
    let name = relative.rsplit('/').next().unwrap_or_default();
    let there = match is_sent_whole(name) {
        true => 0,
        false => there.get(relative).copied().unwrap_or_default(),
    };
    let Some(size) = length.checked_sub(there) else {
        return Err(SendError::Beyond { path, length, there });
    };
    file.seek(SeekFrom::Start(there))
        .map_err(SendError::read(&path))?;
    Ok(Some(Entry { file, size }))
}

impl Entry {
    fn send(self, relative: &str, stream: &mut impl Write, root: &Path) -> Result<(), SendError> {
        let path = root.join(relative);
        let mut header = tar::Header::new_ustar();
        header.set_path(relative).map_err(SendError::read(&path))?;
        header.set_size(self.size);
        header.set_mode(0o644);
        header.set_cksum();
        stream.write_all(header.as_bytes()).map_err(SendError::Stream)?;
        let mut piece = vec![0_u8; 256 << 10];
        let mut left = self.size;
        let mut content = self.file.take(self.size);
        while left > 0 {
            let read = content.read(&mut piece).map_err(SendError::read(&path))?;
            if read == 0 {
                break;
            }
            stream
                .write_all(piece.get(..read).unwrap_or_default())
                .map_err(SendError::Stream)?;
            left -= read as u64;
        }
        io::copy(&mut io::repeat(0).take(left + padding(self.size)), stream)
            .map(drop)
            .map_err(SendError::Stream)
    }
}

/// What fills the last block of a file of that size.
const fn padding(size: u64) -> u64 {
    size.next_multiple_of(BLOCK as u64) - size
}
