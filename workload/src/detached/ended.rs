//! `ended`: whether the workload runs, how it ended and what it said last. The function is [`ended`].

use std::{
    io::{self, Read as _, Seek as _, SeekFrom},
    path::Path,
    time::Duration,
};

use record::detached::Ending;

use super::{
    DetachedError, EnvironmentFolder, folder,
    process::{self, Role},
};

/// What a person reads of a long complaint is its end.
const LAST_WORDS: u64 = 64 << 10;
/// How long a supervisor may take to write down an end that it has been told of.
const WRITING: Duration = Duration::from_secs(10);

/// What is known by now.
///
/// # Errors
/// When there is no such environment, or it cannot be read.
pub fn ended(folder: &EnvironmentFolder) -> Result<Ending, DetachedError> {
    folder.look()?;
    let running = folder.ended().is_none() && is_running(folder)?;
    let path = folder.errors();
    Ok(Ending {
        running,
        // The supervisor may have written it while we looked.
        ended: folder.ended().filter(|_| !running),
        last_words: last_words(&path).map_err(DetachedError::file("read", &path))?,
    })
}

/// Whether the workload runs, or is being started; not while its end is being written down.
fn is_running(folder: &EnvironmentFolder) -> Result<bool, DetachedError> {
    let living = process::find(folder)?;
    if living.iter().any(|process| process.role == Role::Workload) {
        return Ok(true);
    }
    for supervisor in living {
        if !supervisor.wait(WRITING)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The end of a file of words; empty where there is none.
///
/// # Errors
/// When it cannot be read.
pub fn last_words(path: &Path) -> io::Result<String> {
    let mut file = match folder::open(path) {
        // Of a workload that was never started.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(String::new()),
        file => file?,
    };
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(LAST_WORDS)))?;
    let mut words = Vec::new();
    file.take(LAST_WORDS).read_to_end(&mut words)?;
    Ok(String::from_utf8_lossy(&words).into_owned())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn of_a_long_complaint_the_end_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("errors.txt");
        assert_eq!(last_words(&path).unwrap(), "");
        fs::write(&path, "short\n").unwrap();
        assert_eq!(last_words(&path).unwrap(), "short\n");
        fs::write(&path, format!("{}\nthe end", "x".repeat(100_000))).unwrap();
        let told = last_words(&path).unwrap();
        assert_eq!(told.len() as u64, LAST_WORDS);
        assert!(told.ends_with("x\nthe end"));
        fs::write(&path, b"caf\xe9").unwrap();
        assert_eq!(last_words(&path).unwrap(), "caf\u{fffd}");
    }
}
