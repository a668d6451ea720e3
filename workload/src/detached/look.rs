//! `look`: what there is by now of an environment that a job on another machine writes. The function is [`look`].
//!
//! A file system that two machines share tells neither of the other's changes: each call opens the files anew.

use std::{
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    path::Path,
};

use record::detached::Looked;

use super::{DetachedError, EnvironmentFolder, ended::last_words, folder, stream};

/// Answers, and sends the lines from that byte on, as many as one answer may have.
///
/// # Errors
/// When there is no such environment, there are fewer lines, or nobody reads the answer.
pub fn look(folder: &EnvironmentFolder, from: u64) -> Result<(), DetachedError> {
    folder.look()?;
    // Before the lines: what was written until the end is read after it.
    let ended = folder.ended();
    let lines = lines(&folder.lines(), from)?;
    let words = [folder.errors(), folder.job_output()];
    let words = words.map(|path| last_words(&path).map_err(DetachedError::file("read", &path)));
    let [errors, output] = words;
    let answer = Looked {
        job: folder.job(),
        engine: folder.engine(),
        ended,
        last_words: format!("{}{}", output?, errors?),
        bytes: lines.len() as u64,
    };
    let mut out = io::stdout().lock();
    stream::write_line(&mut out, &answer)
        .and_then(|()| out.write_all(&lines))
        .and_then(|()| out.flush())
        .map_err(DetachedError::system("answer"))
}

fn lines(path: &Path, from: u64) -> Result<Vec<u8>, DetachedError> {
    let mut file = match folder::open(path) {
        // Of a job that has not begun.
        Err(error) if error.kind() == io::ErrorKind::NotFound && from == 0 => return Ok(Vec::new()),
        file => file.map_err(DetachedError::file("read", path))?,
    };
    let length = file.metadata().map_err(DetachedError::file("read", path))?.len();
    if from > length {
        return Err(DetachedError::Beyond {
            path: path.to_owned(),
            length,
            there: from,
        });
    }
    let mut lines = Vec::new();
    file.seek(SeekFrom::Start(from))
        .and_then(|_| file.take(Looked::MOST).read_to_end(&mut lines))
        .map_err(DetachedError::file("read", path))?;
    Ok(lines)
}
