//! Lines of JSON on the standard streams. The functions are [`read`], [`read_line`] and [`write_line`].

use std::io::{self, BufRead, Read as _, Write};

use serde::{Serialize, de::DeserializeOwned};

use super::DetachedError;

/// Reads standard input to its end: JSON of at most so many bytes, called `what` if it is not.
///
/// # Errors
/// When it is longer, something else, or cannot be read.
pub fn read<T: DeserializeOwned>(what: &'static str, most: u64) -> Result<T, DetachedError> {
    let mut text = Vec::new();
    io::stdin()
        .take(most + 1)
        .read_to_end(&mut text)
        .map_err(DetachedError::system("read standard input"))?;
    if text.len() as u64 > most {
        return Err(DetachedError::TooLong { most });
    }
    serde_json::from_slice(&text).map_err(|source| DetachedError::Input { what, source })
}

/// Reads one line of JSON of at most so many bytes, called `what` if it is not; what follows it stays to be read.
///
/// # Errors
/// When it is longer, something else, or cannot be read.
pub fn read_line<T: DeserializeOwned>(
    from: &mut impl BufRead,
    what: &'static str,
    most: u64,
) -> Result<T, DetachedError> {
    let mut text = Vec::new();
    from.take(most + 1)
        .read_until(b'\n', &mut text)
        .map_err(DetachedError::system("read standard input"))?;
    if text.len() as u64 > most {
        return Err(DetachedError::TooLong { most });
    }
    serde_json::from_slice(&text).map_err(|source| DetachedError::Input { what, source })
}

/// Writes one line.
///
/// # Errors
/// When nobody reads it any more.
pub fn write_line(out: &mut impl Write, answer: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(answer)?;
    line.push(b'\n');
    out.write_all(&line)?;
    out.flush()
}
