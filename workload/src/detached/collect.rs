//! `collect`: the data folder as a stream, from where an earlier one broke off. The function is [`collect`].

use std::io;

use record::{detached::AlreadyThere, transfer::send};

use super::{DetachedError, EnvironmentFolder, stream};

/// A thousand windows have some thousand files, of fifty bytes each here.
const MOST: u64 = 4 << 20;

/// Sends what standard input does not say to be there already.
///
/// # Errors
/// When there is no such environment, a file cannot be read or is shorter than what is there already, or when nobody
/// reads the stream.
pub fn collect(folder: &EnvironmentFolder) -> Result<(), DetachedError> {
    folder.look()?;
    let there: AlreadyThere = stream::read("lengths by path", MOST)?;
    Ok(send(&folder.data(), &there, io::stdout().lock())?)
}
