//! Files out of a container, running or not, as the engine's tar stream. The functions are [`collect`] and
//! [`progress`].

use std::{
    io::{self, Read},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use bollard::{errors::Error, query_parameters::DownloadFromContainerOptionsBuilder};
use futures_util::{TryStreamExt as _, future};
use record::progress::Progress;
use tokio_util::io::{StreamReader, SyncIoBridge};

use super::{
    engine::{Engine, is_missing, translate},
    folders::DATA,
};
use crate::{
    provider::{
        ProviderError,
        data_folder::{self, Allowance},
        lines::Lines,
    },
    workload_binary,
};

const ACTION: &str = "copying the data out of the container";

/// Copies the container's data folder into a folder, in place of what an earlier try has brought. An engine hands files out
/// whole, so that what was cut is brought anew.
///
/// # Errors
/// When the engine stops answering, or the data is not a workload's; what arrived stays.
pub async fn collect(
    engine: &Engine,
    container: &str,
    into: &Path,
    allowance: &Allowance,
) -> Result<(), ProviderError> {
    let (into, allowance): (PathBuf, _) = (into.to_owned(), allowance.clone());
    data_folder::clear(&into)?;
    download(engine, container, DATA, move |stream| {
        data_folder::unpack(stream, DATA.trim_start_matches('/'), &into, &allowance)
    })
    .await
    .map(|_| ())
}

/// What the workload said, without its health, from its own record of it; nothing if it has not written any yet.
///
/// # Errors
/// When the engine stops answering, or the record is not a workload's.
pub async fn progress(engine: &Engine, container: &str) -> Result<Vec<Progress>, ProviderError> {
    let path = format!("{DATA}/progress.jsonl");
    let said = download(engine, container, &path, |stream| {
        let mut lines = Lines::default();
        lines.push(&first_file(stream).map_err(|error| ProviderError::Data {
            what: "the workload's progress.jsonl".to_owned(),
            reason: error.to_string(),
        })?);
        let mut said = Vec::new();
        while let Some(line) = lines.next_line()? {
            said.push(line);
        }
        Ok(said)
    })
    .await?;
    Ok(said.unwrap_or_default())
}

/// The SHA-256 of a file in a container, started or not, in hexadecimal; none if there is no such file.
///
/// # Errors
/// When the engine stops answering.
pub async fn sha256(engine: &Engine, container: &str, path: &str) -> Result<Option<String>, ProviderError> {
    let unreadable = |error: io::Error| ProviderError::Data {
        what: format!("{path} in the container {container}"),
        reason: error.to_string(),
    };
    let hashed = download(engine, container, path, |stream| {
        let hash = || match tar::Archive::new(stream).entries()?.next() {
            Some(entry) => workload_binary::hash_of_stream(entry?),
            None => Ok(String::new()),
        };
        Ok(hash())
    });
    hashed.await?.transpose().map_err(unreadable)
}

/// It has a few lines a window.
const LONGEST_PROGRESS: u64 = 64 << 20;

fn first_file(stream: impl Read) -> io::Result<Vec<u8>> {
    let mut content = Vec::new();
    if let Some(entry) = tar::Archive::new(stream).entries()?.next() {
        entry?.take(LONGEST_PROGRESS).read_to_end(&mut content)?;
    }
    Ok(content)
}

/// Hands the tar stream of a path to a reader on a thread where it may wait; none if there is no such path.
async fn download<T: Send + 'static>(
    engine: &Engine,
    container: &str,
    path: &str,
    read: impl FnOnce(&mut dyn Read) -> Result<T, ProviderError> + Send + 'static,
) -> Result<Option<T>, ProviderError> {
    let options = DownloadFromContainerOptionsBuilder::default().path(path).build();
    // The reader sees any failure of the stream as its own; what the engine said is kept for us.
    let failure = Arc::new(Mutex::new(None));
    let kept = Arc::clone(&failure);
    let stream = engine
        .api
        .download_from_container(container, Some(options))
        .or_else(move |error| {
            let words = io::Error::other(error.to_string());
            *kept.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            future::err::<_, io::Error>(words)
        });
    let mut reader = SyncIoBridge::new(StreamReader::new(Box::pin(stream)));
    let done = tokio::task::spawn_blocking(move || read(&mut reader))
        .await
        .map_err(|error| translate(ACTION, Error::from(io::Error::other(error))))?;
    let failure = failure.lock().unwrap_or_else(PoisonError::into_inner).take();
    match (done, failure) {
        (_, Some(error)) if is_missing(&error) => Ok(None),
        (_, Some(error)) => Err(translate(ACTION, error)),
        (done, None) => done.map(Some),
    }
}
