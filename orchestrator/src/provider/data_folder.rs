//! The workload's data folder as it comes out of an environment: which files it may have, and how they are brought
//! here. The main type is [`DataFile`].
//!
//! ```text
//! environment.json  network.txt  progress.jsonl
//! window-N/         control.csv  plant.csv  h1.pcap  sta1.pcap  sta2.pcap  window.json
//!                   of a command: stdout.txt  stderr.txt  the files of its metrics  window.json
//!                   of nodes: NODE.stdout.txt  NODE.stderr.txt  HOST.pcap  the files of the metrics  window.json
//! prepare/          of a command: stdout.txt  stderr.txt
//! restore/          the same
//! ```
//!
//! Names and sizes from the other side are not trusted: what is not one of these is not brought, nothing but regular
//! files is, and nothing is written outside the folder that was asked for.

use std::{
    collections::BTreeSet,
    fs, io,
    io::{Read, Write as _},
    os::unix::fs::OpenOptionsExt as _,
    path::{Component, Path, PathBuf},
};

use record::{layout, settings::Settings, virtual_host::VirtualHost, window::WindowRecord};
use rustix::fs::{Mode, OFlags};

use super::{EnvironmentRequest, ProviderError};
use crate::disk_space;

/// What is taken of the data folder of an environment: its own windows, and no more than they can come to, whatever its host
/// sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Allowance {
    windows: Vec<u32>,
    bytes: u64,
    /// The files of a command in each window's folder; none for the ball on the plate.
    of_a_command: Option<BTreeSet<String>>,
}

impl Allowance {
    /// That of the environment that is made of a request.
    #[must_use]
    pub fn of(request: &EnvironmentRequest) -> Self {
        Self {
            windows: request.windows.clone(),
            bytes: disk_space::windows_take_at_most(&request.settings, request.windows.len()),
            of_a_command: window_files(&request.settings),
        }
    }

    /// Bytes that a data folder may have in all.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The file that `path`, relative to the data folder, is; none if it is not taken.
    #[must_use]
    pub fn file(&self, path: &Path) -> Option<DataFile> {
        let mut names = path.components().map(|component| match component {
            Component::Normal(name) => name.to_str(),
            _ => None,
        });
        let longest = match (names.next()??, names.next(), names.next()) {
            (layout::ENVIRONMENT | layout::NETWORK, None, None) => WindowRecord::MOST_BYTES,
            (layout::PROGRESS, None, None) => LONGEST_PROGRESS,
            (layout::PREPARE | layout::RESTORE, Some(Some(layout::STDOUT | layout::STDERR)), None)
                if self.of_a_command.is_some() =>
            {
                WindowRecord::LONGEST_FILE
            }
            (folder, Some(Some(file)), None) => {
                let window = layout::window_of(folder)?;
                self.windows
                    .contains(&window)
                    .then(|| self.longest_of_window(file))??
            }
            _ => return None,
        };
        Some(DataFile {
            path: path.to_owned(),
            longest,
        })
    }

    fn longest_of_window(&self, file: &str) -> Option<u64> {
        if file == layout::WINDOW {
            return Some(WindowRecord::MOST_BYTES);
        }
        let is_capture = || {
            VirtualHost::OF_THE_BALL
                .iter()
                .any(|host| layout::capture(host) == file)
        };
        let is_known = match &self.of_a_command {
            Some(files) => files.contains(file),
            None => matches!(file, layout::CONTROL_LOG | layout::PLANT_LOG) || is_capture(),
        };
        is_known.then_some(WindowRecord::LONGEST_FILE)
    }
}

/// What a window of a command has beside its record; none of the ball on the plate.
fn window_files(settings: &Settings) -> Option<BTreeSet<String>> {
    let experiment = settings.experiment.as_ref()?;
    let mut files = experiment.files_of_matrix(&settings.network.topology());
    files.extend(experiment.measured_files().into_iter().map(str::to_owned));
    Some(files)
}

/// A file that a data folder may have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DataFile {
    path: PathBuf,
    longest: u64,
}

/// What one read moves at most.
const PIECE: usize = 256 << 10;
/// A line a second: half a year.
const LONGEST_PROGRESS: u64 = 4 << 30;

impl DataFile {
    /// The same, of which so many bytes are taken at most.
    #[must_use]
    pub fn within(self, bytes: u64) -> Self {
        Self {
            longest: self.longest.min(bytes),
            ..self
        }
    }

    /// Begins the file below `into`, which has no file of that name yet.
    fn begin(&self, into: &Path) -> Result<Arriving, ProviderError> {
        let path = into.join(&self.path);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|source| file_error("create", folder, source))?;
        }
        let file = fs::OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o644)
            .open(&path)
            .map_err(|source| file_error("create", &path, source))?;
        Ok(self.arriving(file, path, 0))
    }

    /// Begins the file below `into` in place of what an earlier try has brought of it.
    pub(super) fn replace(&self, into: &Path) -> Result<Arriving, ProviderError> {
        let path = into.join(&self.path);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(file_error("replace", &path, error)),
            _ => self.begin(into),
        }
    }

    /// Goes on with the file below `into`, of which so many bytes are there.
    pub(super) fn append(&self, into: &Path, there: u64) -> Result<Arriving, ProviderError> {
        let path = into.join(&self.path);
        let file = fs::OpenOptions::new()
            .append(true)
            .open(&path)
            .map_err(|source| file_error("write", &path, source))?;
        Ok(self.arriving(file, path, there))
    }

    fn arriving(&self, file: fs::File, path: PathBuf, there: u64) -> Arriving {
        Arriving {
            file,
            path,
            room: self.longest.saturating_sub(there),
            there,
            longest: self.longest.max(there),
        }
    }

    /// Writes the file below `into`, which has no file of that name yet; how many bytes it has.
    fn write(&self, into: &Path, content: &mut dyn Read) -> Result<u64, ProviderError> {
        let mut arriving = self.begin(into)?;
        let mut piece = vec![0; PIECE];
        loop {
            match content.read(&mut piece) {
                Ok(0) => return Ok(arriving.taken()),
                Ok(read) => arriving.take(piece.get(..read).unwrap_or_default())?,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(file_error("write", &arriving.path, error)),
            }
        }
    }
}

/// A file that is being written.
#[derive(Debug)]
pub struct Arriving {
    file: fs::File,
    path: PathBuf,
    /// Bytes that it may still get.
    room: u64,
    /// Bytes that were there before.
    there: u64,
    longest: u64,
}

impl Arriving {
    /// Bytes that have come.
    pub(super) const fn taken(&self) -> u64 {
        self.longest - self.there - self.room
    }

    /// Writes its next bytes.
    pub(super) fn take(&mut self, piece: &[u8]) -> Result<(), ProviderError> {
        let fits = usize::try_from(self.room).unwrap_or(usize::MAX).min(piece.len());
        self.file
            .write_all(piece.get(..fits).unwrap_or_default())
            .map_err(|source| file_error("write", &self.path, source))?;
        self.room -= fits as u64;
        if fits < piece.len() {
            return Err(ProviderError::Data {
                what: format!("the file {}", self.path.display()),
                reason: format!(
                    "it is longer than {} bytes, which is more than its windows come to",
                    self.longest
                ),
            });
        }
        Ok(())
    }
}

/// Copies a data folder that is on this machine.
///
/// # Errors
/// When a file cannot be read or written, or there is more than any workload writes; what was copied stays.
pub fn copy(from: &Path, into: &Path, allowance: &Allowance) -> Result<(), ProviderError> {
    let mut left = allowance.bytes;
    for path in files_below(from, Path::new(""))? {
        if let Some(file) = allowance.file(&path) {
            let source = from.join(&path);
            let mut content = open_no_link(&source).map_err(|error| file_error("read", &source, error))?;
            left -= file.within(left).write(into, &mut content)?;
        }
    }
    Ok(())
}

/// Not through a symbolic link: the file may have been exchanged since we looked.
fn open_no_link(path: &Path) -> io::Result<fs::File> {
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    Ok(rustix::fs::open(path, flags, Mode::empty())?.into())
}

/// How many bytes a file has.
pub(super) fn length(path: &Path) -> Result<u64, ProviderError> {
    match fs::symlink_metadata(path) {
        Ok(found) => Ok(found.len()),
        Err(error) => Err(file_error("read", path, error)),
    }
}

/// Makes a folder empty, whose files are all a data folder's.
pub(super) fn clear(folder: &Path) -> Result<(), ProviderError> {
    for path in files_below(folder, Path::new(""))? {
        let path = folder.join(path);
        fs::remove_file(&path).map_err(|source| file_error("replace", &path, source))?;
    }
    Ok(())
}

/// Regular files, two levels deep, relative to `root`.
pub(super) fn files_below(root: &Path, folder: &Path) -> Result<Vec<PathBuf>, ProviderError> {
    let here = root.join(folder);
    let failed = |source| file_error("read", &here, source);
    let mut files = Vec::new();
    for entry in fs::read_dir(&here).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let kind = entry.file_type().map_err(failed)?;
        let path = folder.join(entry.file_name());
        if kind.is_file() {
            files.push(path);
        } else if kind.is_dir() && folder.as_os_str().is_empty() {
            files.extend(files_below(root, &path)?);
        }
    }
    Ok(files)
}

/// Unpacks a data folder from a tar stream whose entries begin with `root`, as an engine sends it.
///
/// # Errors
/// When the stream breaks off, a file cannot be written, or there is more than any workload writes; what arrived stays.
pub fn unpack(
    stream: impl Read,
    root: &str,
    into: &Path,
    allowance: &Allowance,
) -> Result<(), ProviderError> {
    let broken = |source: io::Error| ProviderError::Data {
        what: "the archive with the workload's data".to_owned(),
        reason: source.to_string(),
    };
    let mut archive = tar::Archive::new(stream);
    let mut left = allowance.bytes;
    for entry in archive.entries().map_err(broken)? {
        let mut entry = entry.map_err(broken)?;
        if entry.header().entry_type() != tar::EntryType::Regular {
            continue;
        }
        let path = entry.path().map_err(broken)?.into_owned();
        let path = path.strip_prefix(root).ok();
        if let Some(file) = path.and_then(|path| allowance.file(path)) {
            left -= file.within(left).write(into, &mut entry)?;
        }
    }
    Ok(())
}

fn file_error(action: &'static str, path: &Path, source: io::Error) -> ProviderError {
    ProviderError::File {
        action,
        path: path.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[rstest::rstest]
    #[case("environment.json", true)]
    #[case("network.txt", true)]
    #[case("progress.jsonl", true)]
    #[case("window-1/control.csv", true)]
    #[case("window-1/plant.csv", true)]
    #[case("window-4/sta2.pcap", true)]
    #[case("window-4/window.json", true)]
    #[case("./environment.json", false)]
    #[case("../environment.json", false)]
    #[case("/environment.json", false)]
    #[case("window-1/../../environment.json", false)]
    #[case("window-5/control.csv", false)]
    #[case("window-0/control.csv", false)]
    #[case("window-01/control.csv", false)]
    #[case("window-+1/control.csv", false)]
    #[case("window-1/h2.pcap", false)]
    #[case("window-1/.pcap", false)]
    #[case("window-1/window.json/x", false)]
    #[case("window-1", false)]
    #[case("window-1/stdout.txt", false)]
    #[case("prepare/stdout.txt", false)]
    #[case("notes.txt", false)]
    #[case("", false)]
    fn only_a_workloads_files_are_known(#[case] path: &str, #[case] known: bool) {
        let allowance = Allowance {
            windows: vec![1, 4],
            ..allowance(1)
        };
        assert_eq!(allowance.file(Path::new(path)).is_some(), known);
    }

    #[rstest::rstest]
    #[case("environment.json", true)]
    #[case("prepare/stderr.txt", true)]
    #[case("prepare/errors.csv", false)]
    #[case("window-1/window.json", true)]
    #[case("window-1/stdout.txt", true)]
    #[case("window-1/errors.csv", true)]
    #[case("window-1/others.csv", false)]
    #[case("window-1/control.csv", false)]
    #[case("window-1/h1.pcap", false)]
    #[case("window-4/errors.csv", false)]
    fn of_a_command_the_files_of_its_metrics_are_taken(#[case] path: &str, #[case] known: bool) {
        let run = serde_json::json!({"run": ["true"]});
        assert_eq!(allowance_of(run).file(Path::new(path)).is_some(), known);
    }

    #[rstest::rstest]
    #[case("window-1/errors.csv", true)]
    #[case("window-1/robot.stdout.txt", true)]
    #[case("window-1/sta1.pcap", true)]
    #[case("network.txt", true)]
    #[case("window-1/stdout.txt", false)]
    #[case("window-1/other.stdout.txt", false)]
    #[case("window-1/other.pcap", false)]
    fn of_nodes_also_what_each_printed_and_what_was_captured(#[case] path: &str, #[case] known: bool) {
        let nodes = serde_json::json!({"nodes": [{"name": "robot", "host": "sta1", "run": ["true"]}]});
        assert_eq!(allowance_of(nodes).file(Path::new(path)).is_some(), known);
    }

    /// Of a command or nodes that measure `errors.csv`.
    fn allowance_of(mut experiment: serde_json::Value) -> Allowance {
        experiment["name"] = "reach".into();
        experiment["metrics"] = serde_json::json!([{"name": "error", "from": "errors.csv"}]);
        let settings = serde_json::json!({ "experiment": experiment });
        Allowance {
            of_a_command: window_files(&serde_json::from_value(settings).unwrap()),
            ..allowance(1)
        }
    }

    /// Of three windows of the ball on the plate.
    fn allowance(bytes: u64) -> Allowance {
        Allowance {
            windows: vec![1, 2, 3],
            bytes,
            of_a_command: None,
        }
    }

    fn entry(archive: &mut tar::Builder<Vec<u8>>, path: &str, kind: tar::EntryType, content: &[u8]) {
        let mut header = tar::Header::new_gnu();
        // Not through set_path, which refuses what we want to be sent.
        let name = &mut header.as_gnu_mut().unwrap().name;
        name.get_mut(..path.len())
            .unwrap()
            .copy_from_slice(path.as_bytes());
        header.set_entry_type(kind);
        header.set_size(content.len() as u64);
        header.set_mode(0o4777);
        if kind.is_symlink() {
            header.set_link_name("/etc/passwd").unwrap();
        }
        header.set_cksum();
        archive.append(&header, content).unwrap();
    }

    /// Every file below `folder`, with its content, in order.
    fn content(folder: &Path) -> Vec<(String, String)> {
        let mut files: Vec<_> = files_below(folder, Path::new(""))
            .unwrap()
            .into_iter()
            .map(|path| {
                let text = fs::read_to_string(folder.join(&path)).unwrap();
                (path.to_str().unwrap().to_owned(), text)
            })
            .collect();
        files.sort();
        files
    }

    #[test]
    fn an_archive_brings_what_a_workload_writes_and_nothing_else() {
        use tar::EntryType;
        let mut archive = tar::Builder::new(Vec::new());
        entry(&mut archive, "data/", EntryType::Directory, b"");
        entry(&mut archive, "data/environment.json", EntryType::Regular, b"{}");
        entry(
            &mut archive,
            "data/window-1/control.csv",
            EntryType::Regular,
            b"step",
        );
        entry(&mut archive, "data/window-1/h1.pcap", EntryType::Symlink, b"");
        entry(&mut archive, "data/window-1/sta1.pcap", EntryType::Fifo, b"");
        entry(&mut archive, "data/window-2/notes.txt", EntryType::Regular, b"no");
        entry(&mut archive, "data/../../evil", EntryType::Regular, b"no");
        entry(&mut archive, "/data/environment.json", EntryType::Regular, b"no");
        entry(&mut archive, "other/progress.jsonl", EntryType::Regular, b"no");
        let outer = tempfile::tempdir().unwrap();
        let into = outer.path().join("into");
        fs::create_dir(&into).unwrap();
        unpack(
            &*archive.into_inner().unwrap(),
            "data",
            &into,
            &allowance(1 << 20),
        )
        .unwrap();
        let expected = [("environment.json", "{}"), ("window-1/control.csv", "step")];
        assert_eq!(
            content(&into),
            expected.map(|(a, b)| (a.to_owned(), b.to_owned()))
        );
        assert_eq!(fs::read_dir(outer.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_archive_that_breaks_off_is_an_error_and_what_arrived_stays() {
        let mut archive = tar::Builder::new(Vec::new());
        entry(
            &mut archive,
            "data/environment.json",
            tar::EntryType::Regular,
            b"{}",
        );
        entry(
            &mut archive,
            "data/window-1/control.csv",
            tar::EntryType::Regular,
            &[b'x'; 4000],
        );
        let bytes = archive.into_inner().unwrap();
        let into = tempfile::tempdir().unwrap();
        let error = unpack(
            bytes.get(..2500).unwrap(),
            "data",
            into.path(),
            &allowance(1 << 20),
        )
        .unwrap_err();
        assert!(
            matches!(error, ProviderError::Data { .. } | ProviderError::File { .. }),
            "{error}"
        );
        assert!(into.path().join("environment.json").exists());
    }

    #[test]
    fn a_file_is_never_written_over() {
        let mut archive = tar::Builder::new(Vec::new());
        entry(
            &mut archive,
            "data/environment.json",
            tar::EntryType::Regular,
            b"one",
        );
        entry(
            &mut archive,
            "data/environment.json",
            tar::EntryType::Regular,
            b"two",
        );
        let into = tempfile::tempdir().unwrap();
        assert!(
            unpack(
                &*archive.into_inner().unwrap(),
                "data",
                into.path(),
                &allowance(1 << 20)
            )
            .is_err()
        );
        assert_eq!(
            fs::read_to_string(into.path().join("environment.json")).unwrap(),
            "one"
        );
    }

    #[test]
    fn a_folder_is_copied_without_what_does_not_belong_there() {
        let from = tempfile::tempdir().unwrap();
        let path = |name: &str| from.path().join(name);
        fs::create_dir_all(path("window-1/deeper")).unwrap();
        fs::write(path("environment.json"), "{}").unwrap();
        fs::write(path("secret"), "no").unwrap();
        fs::write(path("window-1/window.json"), "{}").unwrap();
        symlink(path("secret"), path("window-1/control.csv")).unwrap();
        symlink(path("window-1"), path("window-2")).unwrap();
        let into = tempfile::tempdir().unwrap();
        copy(from.path(), into.path(), &allowance(1 << 20)).unwrap();
        let expected = [("environment.json", "{}"), ("window-1/window.json", "{}")];
        assert_eq!(
            content(into.path()),
            expected.map(|(a, b)| (a.to_owned(), b.to_owned()))
        );
    }

    #[test]
    fn no_more_is_taken_than_the_windows_can_come_to_and_no_other_windows() {
        let mut archive = tar::Builder::new(Vec::new());
        for window in 1..=9 {
            let path = format!("data/window-{window}/control.csv");
            entry(&mut archive, &path, tar::EntryType::Regular, &[b'x'; 400]);
        }
        let bytes = archive.into_inner().unwrap();
        for (most, whole) in [(1200, true), (1199, false)] {
            let into = tempfile::tempdir().unwrap();
            let unpacked = unpack(&*bytes, "data", into.path(), &allowance(most));
            assert_eq!(unpacked.is_ok(), whole, "{unpacked:?}");
            let there: usize = content(into.path()).iter().map(|(_, text)| text.len()).sum();
            assert_eq!(
                (there, fs::read_dir(into.path()).unwrap().count()),
                (most as usize, 3)
            );
            let again = tempfile::tempdir().unwrap();
            assert!(copy(into.path(), again.path(), &allowance(1200)).is_ok());
            let fewer = tempfile::tempdir().unwrap();
            assert!(copy(into.path(), fewer.path(), &allowance(1198)).is_err());
        }
    }

    #[test]
    fn a_file_that_is_too_long_is_refused() {
        let into = tempfile::tempdir().unwrap();
        let file = DataFile {
            path: "environment.json".into(),
            longest: 3,
        };
        file.write(into.path(), &mut b"abc".as_slice()).unwrap();
        let file = DataFile {
            path: "progress.jsonl".into(),
            longest: 3,
        };
        let error = file.write(into.path(), &mut b"abcd".as_slice()).unwrap_err();
        assert!(matches!(error, ProviderError::Data { .. }), "{error}");
    }
}
