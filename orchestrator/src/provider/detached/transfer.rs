//! The data folder as `workload detached collect` sends it: LZ4 of tar, each file from the byte that is already here. A
//! stream that was cut is taken up where it broke off. The function is [`collect`].
//!
//! Nothing that is sent is trusted: [`Allowance`] says which names and sizes there are.

use std::{
    io::{self, Read},
    os::unix::net::UnixStream,
    path::Path,
};

use record::{
    detached::{AlreadyThere, is_sent_whole},
    transfer::{Receiver, receive},
};
use tokio::io::AsyncWriteExt as _;

use super::{AgentClient, json};
use crate::provider::{
    ProviderError,
    backoff::Backoff,
    data_folder::{self, Allowance, Arriving as ArrivingFile},
};

const ACTION: &str = "collecting the data";

/// Brings the data folder of an environment into a folder that is empty, or has the beginnings of it.
///
/// # Errors
/// When the host refuses, a file cannot be written or is none of a workload's, or when the host stays away; what arrived
/// stays.
pub async fn collect(
    agent: &AgentClient,
    environment: &str,
    into: &Path,
    allowance: &Allowance,
) -> Result<(), ProviderError> {
    let mut backoff = Backoff::default();
    let mut before = 0;
    loop {
        backoff.pause().await;
        let there = already_there(into, allowance)?;
        let bytes: u64 = there.values().sum();
        if bytes > before {
            // What was cut had brought something: it is a bad way, not a lost one.
            backoff = Backoff::default();
            before = bytes;
        }
        match attempt(agent, environment, into, there, allowance).await {
            Ok(()) => return Ok(()),
            Err(error) => backoff.after(error)?,
        }
    }
}

async fn attempt(
    agent: &AgentClient,
    environment: &str,
    into: &Path,
    there: AlreadyThere,
    allowance: &Allowance,
) -> Result<(), ProviderError> {
    let mut running = agent.collect(environment).await?;
    let end = tokio::spawn(running.end.wait());
    // That it does not listen is told by its end.
    if running.stream.write_all(&json(&there)).await.is_ok() {
        let _ = running.stream.shutdown().await;
    }
    let refused = |source| ProviderError::of_this_machine(ACTION, source);
    let stream = running.stream.into_std().map_err(refused)?;
    stream.set_nonblocking(false).map_err(refused)?;
    let (into, allowance) = (into.to_owned(), allowance.clone());
    // Gigabytes at times: not on a thread that others wait for.
    let unpacking = tokio::task::spawn_blocking(move || {
        let mut arriving = Arriving { stream, ended: false };
        let unpacked = unpack(&mut arriving, &there, &into, &allowance);
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
        (_, Ok(exit)) if !exit.success() => Err(agent.refusal(ACTION, &exit)),
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
fn already_there(into: &Path, allowance: &Allowance) -> Result<AlreadyThere, ProviderError> {
    let mut there = AlreadyThere::new();
    for path in data_folder::files_below(into, Path::new(""))? {
        let name = path.file_name().and_then(|name| name.to_str());
        if let Some(text) = path.to_str()
            && allowance.file(&path).is_some()
            && !name.is_some_and(is_sent_whole)
        {
            let length = data_folder::length(&into.join(&path))?;
            there.insert(text.to_owned(), length);
        }
    }
    Ok(there)
}

/// Unpacks a stream into a folder that has so many bytes of some files.
pub(crate) fn unpack(
    mut stream: impl Read,
    there: &AlreadyThere,
    into: &Path,
    allowance: &Allowance,
) -> Result<(), ProviderError> {
    let mut unpacking = Unpacking {
        there,
        into,
        allowance,
        left: allowance.bytes().saturating_sub(there.values().sum()),
        file: None,
        failure: None,
    };
    let received = receive(&mut stream, &mut unpacking);
    match (unpacking.failure, received) {
        (Some(failure), _) => Err(failure),
        (None, Err(broken)) => Err(ProviderError::Data {
            what: "the archive with the workload's data".to_owned(),
            reason: broken.to_string(),
        }),
        (None, Ok(())) => Ok(()),
    }
}

/// A folder that files are unpacked into.
struct Unpacking<'a> {
    there: &'a AlreadyThere,
    into: &'a Path,
    allowance: &'a Allowance,
    /// Bytes that may still come, but for what the file has that is arriving.
    left: u64,
    /// The one that is arriving.
    file: Option<ArrivingFile>,
    /// What was wrong here, and not with the stream.
    failure: Option<ProviderError>,
}

impl Unpacking<'_> {
    fn done<T>(&mut self, done: Result<T, ProviderError>) -> io::Result<T> {
        done.map_err(|error| {
            self.failure = Some(error);
            io::Error::other("it is not taken")
        })
    }
}

impl Receiver for Unpacking<'_> {
    fn begin(&mut self, path: &Path) -> io::Result<bool> {
        if let Some(before) = self.file.take() {
            self.left = self.left.saturating_sub(before.taken());
        }
        let Some(file) = self.allowance.file(path) else {
            return Ok(false);
        };
        let begun = match path.to_str().and_then(|path| self.there.get(path)) {
            Some(length) => file
                .within(length.saturating_add(self.left))
                .append(self.into, *length),
            None => file.within(self.left).replace(self.into),
        };
        self.file = Some(self.done(begun)?);
        Ok(true)
    }

    fn take(&mut self, piece: &[u8]) -> io::Result<()> {
        let taken = match &mut self.file {
            Some(file) => file.take(piece),
            None => Ok(()),
        };
        self.done(taken)
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, path::PathBuf};

    use lz4_flex::frame::FrameEncoder;
    use proptest::prelude::*;
    use record::{quantity::TimeSpan, settings::Settings, transfer::send};
    use tar::EntryType;

    use super::*;
    use crate::provider::EnvironmentRequest;

    /// That of three windows of a minute.
    fn allowance() -> Allowance {
        Allowance::of(&EnvironmentRequest {
            environment: "e-1".to_owned(),
            run: "r".to_owned(),
            run_directory: PathBuf::from("/runs/r"),
            scenario: "s".to_owned(),
            host: "here".to_owned(),
            settings: Settings {
                window: TimeSpan::from_secs(60),
                ..Settings::default()
            },
            windows: vec![1, 2, 3],
            files: None,
        })
    }

    #[test]
    fn what_is_there_counts_and_other_windows_are_not_taken() {
        let outer = tempfile::tempdir().unwrap();
        let there = AlreadyThere::from([("window-1/control.csv".to_owned(), allowance().bytes() - 2)]);
        let sent = |content: &'static [u8]| {
            stream(&[
                ("window-9/control.csv", EntryType::Regular, b"not asked for"),
                ("window-2/control.csv", EntryType::Regular, content),
            ])
        };
        unpack(sent(b"xx").as_slice(), &there, outer.path(), &allowance()).unwrap();
        assert!(!outer.path().join("window-9").exists());
        let more = unpack(sent(b"xxx").as_slice(), &there, outer.path(), &allowance()).unwrap_err();
        assert!(more.to_string().contains("longer than 2 bytes"), "{more}");
    }

    /// A stream with entries as no workload makes them, each with its path as it stands.
    fn stream(entries: &[(&str, EntryType, &[u8])]) -> Vec<u8> {
        let mut archive = tar::Builder::new(FrameEncoder::new(Vec::new()));
        for (path, kind, content) in entries {
            let mut header = tar::Header::new_ustar();
            // Not through set_path, which refuses what we want to be sent.
            header.as_mut_bytes()[..path.len()].copy_from_slice(path.as_bytes());
            header.set_entry_type(*kind);
            header.set_mode(0o4777);
            header.set_size(content.len() as u64);
            if matches!(kind, EntryType::Symlink | EntryType::Link) {
                header.set_link_name("/etc/passwd").unwrap();
            }
            header.set_cksum();
            archive.append(&header, *content).unwrap();
        }
        archive.into_inner().unwrap().finish().unwrap()
    }

    /// Everything below a folder, with its content, in order; none of what is no regular file.
    fn below(folder: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
        let mut found = Vec::new();
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let kind = fs::symlink_metadata(&path).unwrap().file_type();
            if kind.is_dir() {
                found.extend(below(&path));
            } else {
                found.push((path.clone(), kind.is_file().then(|| fs::read(&path).unwrap())));
            }
        }
        found.sort();
        found
    }

    /// Paths and contents.
    type Files = Vec<(String, Vec<u8>)>;

    /// What a stream leaves below the folder that holds the folder it is unpacked into.
    fn left_by(stream: &[u8]) -> (Result<(), ProviderError>, Files) {
        let outer = tempfile::tempdir().unwrap();
        let into = outer.path().join("scenario/into");
        fs::create_dir_all(&into).unwrap();
        let unpacked = unpack(stream, &AlreadyThere::new(), &into, &allowance());
        let named = |(path, content): (PathBuf, Option<Vec<u8>>)| {
            let path = path.strip_prefix(&into).expect("it is within").to_str().unwrap();
            (path.to_owned(), content.expect("it is a regular file"))
        };
        (unpacked, below(outer.path()).into_iter().map(named).collect())
    }

    #[rstest::rstest]
    #[case::above("../environment.json", EntryType::Regular)]
    #[case::far_above("window-1/../../../evil", EntryType::Regular)]
    #[case::absolute("/tmp/matrix-evil", EntryType::Regular)]
    #[case::by_the_folder_itself("./environment.json", EntryType::Regular)]
    #[case::no_name_of_a_workloads("authorized_keys", EntryType::Regular)]
    #[case::no_file_of_a_windows("window-1/.bashrc", EntryType::Regular)]
    #[case::symbolic_link("window-1/control.csv", EntryType::Symlink)]
    #[case::hard_link("environment.json", EntryType::Link)]
    #[case::pipe("window-1/h1.pcap", EntryType::Fifo)]
    #[case::device("window-1/sta1.pcap", EntryType::Char)]
    #[case::folder("window-1", EntryType::Directory)]
    #[case::name_for_the_next("window-2/sta2.pcap", EntryType::GNULongName)]
    #[case::attributes_for_the_next("window-2/sta1.pcap", EntryType::XHeader)]
    fn what_is_no_file_of_a_workloads_is_not_brought(#[case] path: &str, #[case] kind: EntryType) {
        let (unpacked, left) = left_by(&stream(&[
            (path, kind, b""),
            ("window-3/control.csv", EntryType::Regular, b"t\n"),
        ]));
        unpacked.unwrap();
        assert_eq!(left, [("window-3/control.csv".to_owned(), b"t\n".to_vec())]);
        assert!(!Path::new("/tmp/matrix-evil").exists());
    }

    #[test]
    fn a_file_that_comes_twice_is_an_error() {
        let twice = ("window-1/control.csv", EntryType::Regular, b"one".as_slice());
        let (unpacked, left) = left_by(&stream(&[twice, twice]));
        assert!(unpacked.unwrap_err().to_string().contains("twice"));
        assert_eq!(left.len(), 1);
    }

    #[test]
    fn a_link_in_the_place_of_a_file_is_replaced_and_not_followed() {
        let outer = tempfile::tempdir().unwrap();
        let (secret, into) = (outer.path().join("secret"), outer.path().join("into"));
        fs::write(&secret, "mine").unwrap();
        fs::create_dir(&into).unwrap();
        std::os::unix::fs::symlink(&secret, into.join("environment.json")).unwrap();
        let sent = stream(&[("environment.json", EntryType::Regular, b"theirs")]);
        unpack(sent.as_slice(), &AlreadyThere::new(), &into, &allowance()).unwrap();
        assert_eq!(fs::read_to_string(&secret).unwrap(), "mine");
        assert_eq!(
            fs::read_to_string(into.join("environment.json")).unwrap(),
            "theirs"
        );
    }

    /// A data folder of two windows, some hundred kilobytes of it.
    fn data(folder: &Path) {
        let mut seed = 1_u64;
        for window in ["window-1", "window-2"] {
            fs::create_dir(folder.join(window)).unwrap();
            for (name, words) in [("control.csv", 9_000), ("h1.pcap", 4_000), ("window.json", 40)] {
                let content: Vec<u8> = (0..words)
                    .flat_map(|_| {
                        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                        (seed >> 40).to_le_bytes()
                    })
                    .collect();
                fs::write(folder.join(window).join(name), content).unwrap();
            }
        }
        fs::write(folder.join("environment.json"), "{}").unwrap();
    }

    fn sent(folder: &Path, there: &AlreadyThere) -> Vec<u8> {
        let mut stream = Vec::new();
        send(folder, there, &mut stream).unwrap();
        stream
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn cut_at_whatever_bytes_it_arrives_whole_in_the_end(cuts in prop::collection::vec(0.0..1.0_f64, 1..5)) {
            let (from, into) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            data(from.path());
            for cut in cuts {
                let there = already_there(into.path(), &allowance()).unwrap();
                let stream = sent(from.path(), &there);
                // A frame without its end mark alone has all that it says, but for the checksum.
                let length = ((stream.len() - 9) as f64 * cut) as usize;
                prop_assert!(unpack(&stream[..length], &there, into.path(), &allowance()).is_err());
            }
            let there = already_there(into.path(), &allowance()).unwrap();
            let stream = sent(from.path(), &there);
            unpack(stream.as_slice(), &there, into.path(), &allowance()).unwrap();
            let relative = |root: &Path| -> Vec<_> {
                let found = below(root).into_iter();
                found.map(|(path, content)| (path.strip_prefix(root).unwrap().to_owned(), content)).collect()
            };
            prop_assert_eq!(relative(into.path()), relative(from.path()));
        }

        /// Not every byte means something: zeros are the same wherever they are copied from.
        #[test]
        fn a_wrong_byte_is_an_error_or_changes_nothing(at in 0.0..1.0_f64, with in 1_u8..) {
            let from = tempfile::tempdir().unwrap();
            data(from.path());
            let mut stream = sent(from.path(), &AlreadyThere::new());
            let (_, whole) = left_by(&stream);
            let at = (stream.len() as f64 * at) as usize;
            stream[at] ^= with;
            let (unpacked, left) = left_by(&stream);
            prop_assert!(left.iter().all(|(path, _)| allowance().file(Path::new(path)).is_some()));
            prop_assert!(unpacked.is_err() || left == whole);
        }
    }
}
