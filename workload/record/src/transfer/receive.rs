//! The stream that [`super::send()`] writes, read again on the other side. The function is [`receive`].

use std::{
    collections::BTreeSet,
    io::{self, Read},
    path::Path,
};

use lz4_flex::frame::FrameDecoder;

/// As large as the largest block of the frame, so that one call takes it all.
const PIECE: usize = 256 << 10;

/// What becomes of the files of a stream.
pub trait Receiver {
    /// Takes note of the next file, before any of its content; whether it is wanted.
    ///
    /// # Errors
    /// To break off.
    fn begin(&mut self, path: &Path) -> io::Result<bool>;

    /// Takes a piece of the content of the file that was begun last.
    ///
    /// # Errors
    /// To break off.
    fn take(&mut self, piece: &[u8]) -> io::Result<()>;
}

/// Reads a stream to its end and hands out its regular files, each once, in pieces. Paths are as they come: not to be
/// trusted.
///
/// # Errors
/// When the stream cannot be read, breaks off, is not one or is damaged; and what the receiver says.
pub fn receive(stream: &mut dyn Read, receiver: &mut dyn Receiver) -> io::Result<()> {
    let mut stream = FrameDecoder::new(stream);
    let mut archive = tar::Archive::new(&mut stream);
    let mut brought = BTreeSet::new();
    let mut piece = vec![0; PIECE];
    // As they are: the sender makes no entry that describes another.
    for entry in archive.entries()?.raw(true) {
        let mut entry = entry?;
        let path = entry.path()?.into_owned();
        if !entry.header().entry_type().is_file() || !receiver.begin(&path)? {
            continue;
        }
        if !brought.insert(path.clone()) {
            return Err(io::Error::other(format!("{} is in it twice", path.display())));
        }
        let mut left = entry.header().size()?;
        while left > 0 {
            let read = entry.read(&mut piece)?;
            if read == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            left = left.saturating_sub(read as u64);
            receiver.take(piece.get(..read).unwrap_or_default())?;
        }
    }
    // Its checksum stands at its end.
    io::copy(&mut stream, &mut io::sink()).map(drop)
}
