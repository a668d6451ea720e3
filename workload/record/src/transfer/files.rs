//! The files of a user's experiment as a stream: `matrix` packs them once, before a run, and each environment unpacks them before its
//! first command. The functions are [`pack`] and [`unpack`].
//!
//! The stream is an LZ4 frame of a tar, in which all files are below [`layout::FILES`]. It depends on nothing but names, contents and which files are executable, so that the same
//! files always make the same stream, and its checksum is theirs.

use std::{
    fs::File,
    io::{self, Read, Write},
    path::{Path, PathBuf},
};

use lz4_flex::frame::{FrameDecoder, FrameEncoder};

use crate::layout;

/// The files of an experiment are no more, together: 64 MiB. `matrix` has them in memory while they are sent.
pub const MOST_BYTES: u64 = 64 << 20;

/// Packs files below a folder, named by their paths below it. The caller says in which order.
///
/// # Errors
/// When one cannot be read, is no regular file, or all together are too long; with its path.
pub fn pack(root: &Path, paths: &[PathBuf], out: impl Write) -> io::Result<()> {
    let mut archive = tar::Builder::new(FrameEncoder::new(out));
    let mut left = MOST_BYTES;
    for path in paths {
        let place = root.join(path);
        let failed = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", place.display()));
        add(&mut archive, path, &place, &mut left).map_err(failed)?;
    }
    archive.into_inner()?.finish().map_err(io::Error::from)?.flush()
}

fn add(
    archive: &mut tar::Builder<FrameEncoder<impl Write>>,
    path: &Path,
    place: &Path,
    left: &mut u64,
) -> io::Result<()> {
    use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
    // It may have become something else since it was listed.
    let flags = rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
    let file = File::options()
        .read(true)
        .custom_flags(flags.bits() as i32)
        .open(place)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "it is no regular file",
        ));
    }
    let bytes = metadata.len();
    *left = left.checked_sub(bytes).ok_or_else(|| {
        let message = format!("with it the files have more than {} MiB", MOST_BYTES >> 20);
        io::Error::new(io::ErrorKind::FileTooLarge, message)
    })?;
    let mut header = tar::Header::new_gnu();
    header.set_entry_type(tar::EntryType::Regular);
    header.set_size(bytes);
    header.set_mtime(0);
    let is_executable = metadata.permissions().mode() & 0o111 != 0;
    header.set_mode(if is_executable { 0o755 } else { 0o644 });
    // One that grows meanwhile is packed as long as it was; one that shrinks makes the archive's end an error.
    archive.append_data(&mut header, Path::new(layout::FILES).join(path), file.take(bytes))
}

/// The tar in such a stream, which begins with as many bytes of any other.
fn decompressed(stream: impl Read) -> impl Read {
    // Headers and padding are not counted by `pack`: an entry has at most a kilobyte of them, a long name two more.
    FrameDecoder::new(stream).take(2 * MOST_BYTES)
}

/// The tar in a stream, for who unpacks it by other means.
///
/// # Errors
/// When it is no such stream.
pub fn as_tar(stream: impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    decompressed(stream).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Unpacks such a stream into a folder that exists. Nothing is written outside of it.
///
/// # Errors
/// When it is no such stream, is too long, or a file cannot be written.
pub fn unpack(into: &Path, from: impl Read) -> io::Result<()> {
    let invalid = |message: &str| io::Error::new(io::ErrorKind::InvalidData, message.to_owned());
    let mut archive = tar::Archive::new(decompressed(from));
    archive.set_preserve_mtime(false);
    for entry in archive.entries()? {
        let mut entry = entry?;
        if entry.header().entry_type() != tar::EntryType::Regular {
            return Err(invalid("the archive has something that is no regular file"));
        }
        if !entry.unpack_in(into)? {
            return Err(invalid("the archive has a file outside of its folder"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt as _};

    use super::*;

    fn packed(root: &Path, paths: &[&str]) -> io::Result<Vec<u8>> {
        let paths: Vec<PathBuf> = paths.iter().map(PathBuf::from).collect();
        let mut stream = Vec::new();
        pack(root, &paths, &mut stream).map(|()| stream)
    }

    #[test]
    fn files_arrive_as_they_were_and_the_same_files_make_the_same_stream() {
        let (from, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        fs::create_dir_all(from.path().join("sim/deep")).unwrap();
        fs::write(from.path().join("sim/deep/a b.txt"), "a").unwrap();
        fs::write(from.path().join("setup.sh"), "#!/bin/sh\n").unwrap();
        fs::set_permissions(from.path().join("setup.sh"), fs::Permissions::from_mode(0o700)).unwrap();
        let paths = ["setup.sh", "sim/deep/a b.txt"];
        let stream = packed(from.path(), &paths).unwrap();
        unpack(to.path(), stream.as_slice()).unwrap();
        assert_eq!(fs::read(to.path().join("files/sim/deep/a b.txt")).unwrap(), b"a");
        let mode = |name: &str| {
            fs::metadata(to.path().join("files").join(name))
                .unwrap()
                .permissions()
                .mode()
                & 0o777
        };
        assert_eq!((mode("setup.sh"), mode("sim/deep/a b.txt")), (0o755, 0o644));
        assert_eq!(
            packed(&to.path().join("files"), &paths).unwrap(),
            stream,
            "from another folder, at another time"
        );
    }

    #[test]
    fn a_long_name_arrives() {
        let (from, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let path = format!("{}/{}", "d".repeat(120), "f".repeat(150));
        fs::create_dir_all(from.path().join("d".repeat(120))).unwrap();
        fs::write(from.path().join(&path), "x").unwrap();
        unpack(to.path(), packed(from.path(), &[&path]).unwrap().as_slice()).unwrap();
        assert!(to.path().join("files").join(&path).exists());
    }

    #[test]
    fn a_link_is_not_followed() {
        let from = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/etc/passwd", from.path().join("link")).unwrap();
        assert!(packed(from.path(), &["link"]).is_err());
    }

    #[test]
    fn nothing_is_written_outside_of_the_folder() {
        for (name, kind) in [
            ("../outside", tar::EntryType::Regular),
            ("link", tar::EntryType::Symlink),
            ("fifo", tar::EntryType::Fifo),
        ] {
            let mut header = tar::Header::new_gnu();
            header.as_gnu_mut().unwrap().name[..name.len()].copy_from_slice(name.as_bytes());
            header.set_entry_type(kind);
            header.set_size(0);
            header.set_cksum();
            let mut archive = tar::Builder::new(FrameEncoder::new(Vec::new()));
            archive.append(&header, io::empty()).unwrap();
            let stream = archive.into_inner().unwrap().finish().unwrap();
            let to = tempfile::tempdir().unwrap();
            assert!(unpack(to.path(), stream.as_slice()).is_err(), "{name}");
            assert_eq!(fs::read_dir(to.path()).unwrap().count(), 0);
        }
    }

    #[test]
    fn what_is_no_archive_is_an_error() {
        let to = tempfile::tempdir().unwrap();
        assert!(unpack(to.path(), &b"no lz4 frame at all"[..]).is_err());
    }
}
