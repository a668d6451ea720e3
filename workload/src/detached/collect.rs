//! `collect`: the data folder as a stream, from where an earlier one broke off. The functions are [`collect`], and [`send`]
//! for any folder and stream; [`super::receive()`] is the other side.
//!
//! The stream is an LZ4 frame, with its checksum, of a tar (ustar) of the folder's regular files, two levels deep. An
//! entry's content begins at the byte that is already there, and its size is that of the rest. Links are not followed. A
//! file that grows meanwhile is sent as long as it was; one that shrinks is filled up with zeros, so that the archive
//! stays whole, and its checksum in `window.json` tells.

use std::{
    fs::File,
    io::{self, Read as _, Seek as _, SeekFrom, Write},
    os::fd::{AsFd, OwnedFd},
    path::Path,
};

use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
use record::detached::{AlreadyThere, is_sent_whole};
use rustix::{
    fs::{Dir, FileType, Mode, OFlags, openat},
    io::Errno,
};

use super::{DetachedError, EnvironmentFolder, stream};

/// A thousand windows have some thousand files, of fifty bytes each here.
const MOST: u64 = 4 << 20;
const READ: &str = "read";
const SEND: &str = "send the data";

/// Sends what standard input does not say to be there already. `window.json`, which is written last, comes after the
/// files that it describes.
///
/// # Errors
/// When there is no such environment, a file cannot be read or is shorter than what is there already, or when nobody
/// reads the stream.
pub fn collect(folder: &EnvironmentFolder) -> Result<(), DetachedError> {
    folder.look()?;
    let there: AlreadyThere = stream::read("lengths by path", MOST)?;
    send(&folder.data(), &there, io::stdout().lock())
}

/// Sends the files of a folder, each from the byte that is there already.
///
/// # Errors
/// When a file cannot be read or is shorter than what is there already, or when nobody reads the stream.
pub fn send(path: &Path, there: &AlreadyThere, out: impl Write) -> Result<(), DetachedError> {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let data = rustix::fs::open(path, flags, Mode::empty()).map_err(DetachedError::file(READ, path))?;
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
    stream
        .write_all(&[0; 2 * BLOCK])
        .map_err(DetachedError::system(SEND))?;
    let mut out = stream
        .finish()
        .map_err(|error| DetachedError::system(SEND)(io::Error::other(error)))?;
    out.flush().map_err(DetachedError::system(SEND))
}

/// The unit of a tar.
const BLOCK: usize = 512;

/// Regular files and, from the top, those of its folders, in the order of their names. A name that is not UTF-8 or that
/// a tar's header does not hold is none of a workload's.
fn files(folder: &impl AsFd, prefix: &str, root: &Path) -> Result<Vec<String>, DetachedError> {
    let failed = |error: Errno| DetachedError::file(READ, &root.join(prefix))(error);
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
) -> Result<Option<Entry>, DetachedError> {
    let path = root.join(relative);
    let failed = |error: Errno| DetachedError::file(READ, &path)(error);
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
    let length = file.metadata().map_err(DetachedError::file(READ, &path))?.len();
    let name = relative.rsplit('/').next().unwrap_or_default();
    let there = match is_sent_whole(name) {
        true => 0,
        false => there.get(relative).copied().unwrap_or_default(),
    };
    let Some(size) = length.checked_sub(there) else {
        return Err(DetachedError::Beyond { path, length, there });
    };
    file.seek(SeekFrom::Start(there))
        .map_err(DetachedError::file(READ, &path))?;
    Ok(Some(Entry { file, size }))
}

impl Entry {
    fn send(self, relative: &str, stream: &mut impl Write, root: &Path) -> Result<(), DetachedError> {
        let path = root.join(relative);
        let mut header = tar::Header::new_ustar();
        header
            .set_path(relative)
            .map_err(DetachedError::file(READ, &path))?;
        header.set_size(self.size);
        header.set_mode(0o644);
        header.set_cksum();
        let send = DetachedError::system(SEND);
        stream.write_all(header.as_bytes()).map_err(&send)?;
        let mut piece = vec![0_u8; 256 << 10];
        let mut left = self.size;
        let mut content = self.file.take(self.size);
        while left > 0 {
            let read = content
                .read(&mut piece)
                .map_err(DetachedError::file(READ, &path))?;
            if read == 0 {
                break;
            }
            stream
                .write_all(piece.get(..read).unwrap_or_default())
                .map_err(&send)?;
            left -= read as u64;
        }
        io::copy(&mut io::repeat(0).take(left + padding(self.size)), stream)
            .map(drop)
            .map_err(&send)
    }
}

/// What fills the last block of a file of that size.
const fn padding(size: u64) -> u64 {
    size.next_multiple_of(BLOCK as u64) - size
}
