//! The data folder as `workload detached collect` sends it: LZ4 of tar, each file from the byte that is already here. A
//! stream that was cut is taken up where it broke off. The function is [`collect`].
//!
//! Nothing that is sent is trusted: [`DataFile`] says which names and sizes there are.

use std::{
    collections::BTreeSet,
    io::{self, Read},
    os::unix::net::UnixStream,
    path::Path,
};

use lz4_flex::frame::FrameDecoder;
use tokio::io::AsyncWriteExt as _;
use workload::record::detached::{AlreadyThere, is_sent_whole};

use super::{Keeper, json};
use crate::provider::{
    ProviderError,
    data_folder::{self, DataFile},
    patience::Patience,
};

const ACTION: &str = "collecting the data";

/// Brings the data folder of an environment into a folder that is empty, or has the beginnings of it.
///
/// # Errors
/// When the host refuses, a file cannot be written or is none of a workload's, or when the host stays away; what arrived
/// stays.
pub async fn collect(keeper: &Keeper, environment: &str, into: &Path) -> Result<(), ProviderError> {
    let mut patience = Patience::default();
    let mut before = 0;
    loop {
        patience.pause().await;
        let there = already_there(into)?;
        let bytes: u64 = there.values().sum();
        if bytes > before {
            // What was cut had brought something: it is a bad way, not a lost one.
            patience = Patience::default();
            before = bytes;
        }
        match attempt(keeper, environment, into, there).await {
            Ok(()) => return Ok(()),
            Err(error) => patience.bear(error)?,
        }
    }
}

async fn attempt(
    keeper: &Keeper,
    environment: &str,
    into: &Path,
    there: AlreadyThere,
) -> Result<(), ProviderError> {
    let mut running = keeper.collect(environment).await?;
    let end = tokio::spawn(running.end.wait());
    // That it does not listen is told by its end.
    if running.stream.write_all(&json(&there)).await.is_ok() {
        let _ = running.stream.shutdown().await;
    }
    let refused = |source: io::Error| ProviderError::Refused {
        platform: "this machine".to_owned(),
        action: ACTION.to_owned(),
        hint: None,
        source: source.into(),
    };
    let stream = running.stream.into_std().map_err(refused)?;
    stream.set_nonblocking(false).map_err(refused)?;
    let into = into.to_owned();
    // Gigabytes at times: not on a thread that others wait for.
    let unpacking = tokio::task::spawn_blocking(move || {
        let mut arriving = Arriving { stream, ended: false };
        let unpacked = unpack(&mut arriving, &there, &into);
        (unpacked, arriving.ended)
    });
    let (unpacked, ended) = unpacking
        .await
        .map_err(|error| refused(io::Error::other(error)))?;
    let exit = end.await.map_err(|error| refused(io::Error::other(error)))?;
    match (unpacked, exit) {
        // We hung up: that it could not go on then is no news.
        (Err(ours), _) if !ended => Err(ours),
        (_, Err(lost)) => Err(lost.into()),
        (_, Ok(exit)) if !exit.success() => Err(keeper.refusal(ACTION, &exit)),
        (unpacked, Ok(_)) => unpacked,
    }
}

/// The stream, and whether its sender has ended it.
struct Arriving {
    stream: UnixStream,
    ended: bool,
}

impl Read for Arriving {
    fn read(&mut self, piece: &mut [u8]) -> io::Result<usize> {
        let read = self.stream.read(piece);
        self.ended |= matches!(read, Ok(0) | Err(_)) && !piece.is_empty();
        read
    }
}

/// Files that need not be sent from their beginnings, with the bytes that are here.
fn already_there(into: &Path) -> Result<AlreadyThere, ProviderError> {
    let mut there = AlreadyThere::new();
    for path in data_folder::files_below(into, Path::new(""))? {
        let name = path.file_name().and_then(|name| name.to_str());
        if let Some(text) = path.to_str()
            && DataFile::at(&path).is_some()
            && !name.is_some_and(is_sent_whole)
        {
            let length = data_folder::length(&into.join(&path))?;
            there.insert(text.to_owned(), length);
        }
    }
    Ok(there)
}

/// Unpacks a stream into a folder that has so many bytes of some files.
fn unpack(stream: impl Read, there: &AlreadyThere, into: &Path) -> Result<(), ProviderError> {
    let broken = |source: io::Error| damaged(source.to_string());
    let mut stream = FrameDecoder::new(stream);
    let mut archive = tar::Archive::new(&mut stream);
    let mut brought = BTreeSet::new();
    // As they are: the sender makes no entry that describes another.
    for entry in archive.entries().map_err(broken)?.raw(true) {
        let mut entry = entry.map_err(broken)?;
        let path = entry.path().map_err(broken)?.into_owned();
        let file = DataFile::at(&path).filter(|_| entry.header().entry_type().is_file());
        let Some(file) = file else {
            continue;
        };
        if !brought.insert(path.clone()) {
            return Err(damaged(format!("{} is in it twice", path.display())));
        }
        match path.to_str().and_then(|path| there.get(path)) {
            Some(length) => file.append(into, *length, &mut entry)?,
            None => file.replace(into, &mut entry)?,
        }
    }
    // Its checksum stands at its end.
    io::copy(&mut stream, &mut io::sink()).map(drop).map_err(broken)
}

fn damaged(reason: String) -> ProviderError {
    ProviderError::Data {
        what: "the archive with the workload's data".to_owned(),
        reason,
    }
}
