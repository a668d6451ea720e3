//! Files that a matrix file or an SSH configuration names: keys and lists of keys, and nothing that never ends. The function is
//! [`read`].

use std::{
    fs::OpenOptions,
    io::{self, Read as _},
    os::unix::fs::OpenOptionsExt as _,
    path::Path,
};

use rustix::fs::OFlags;

/// A `known_hosts` of ten thousand hosts is some megabytes.
const MOST: u64 = 16 << 20;

/// Reads a file of at most 16 MiB.
///
/// # Errors
/// When it is not there, cannot be read or is longer. `/dev/null` is a file of nothing, as people name it.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    // A FIFO would be waited for.
    let flags = OFlags::NONBLOCK.bits() as i32;
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    let mut bytes = Vec::new();
    file.take(MOST + 1).read_to_end(&mut bytes)?;
    match bytes.len() as u64 > MOST {
        true => Err(io::Error::new(
            io::ErrorKind::FileTooLarge,
            "it is longer than 16 MiB",
        )),
        false => Ok(bytes),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("/dev/zero")]
    #[case("/dev")]
    fn what_is_no_file_is_refused_at_once(#[case] path: &str) {
        assert!(read(Path::new(path)).is_err());
        assert_eq!(read(Path::new("/dev/null")).unwrap(), b"");
    }

    #[test]
    fn a_file_is_read_to_its_end_unless_that_is_far() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        std::fs::write(&path, "a key").unwrap();
        assert_eq!(read(&path).unwrap(), b"a key");
        let file = std::fs::File::create(&path).unwrap();
        file.set_len(MOST + 1).unwrap();
        assert_eq!(read(&path).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    }
}
