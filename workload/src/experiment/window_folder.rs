//! One window's folder: nothing in it counts until `window.json` is there, which is written last and appears whole. The
//! main type is [`WindowFolder`].

use std::{
    fs::{self, File},
    io::{self, Read, Write},
    path::{Path, PathBuf},
};

use record::{
    layout,
    virtual_host::VirtualHost,
    window::{FileRecord, WindowRecord},
};
use sha2::{Digest, Sha256};

use super::error::ExperimentError;

/// A window's folder below the data folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WindowFolder(PathBuf);

impl WindowFolder {
    /// Makes the folder. One that is there is never written to.
    ///
    /// # Errors
    /// If it exists or cannot be made.
    pub fn create(data: &Path, window: u32) -> Result<Self, ExperimentError> {
        let path = data.join(layout::window_folder(window));
        match fs::create_dir(&path) {
            Ok(()) => Ok(Self(path)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                Err(ExperimentError::Taken { path })
            }
            Err(source) => Err(ExperimentError::Write { path, source }),
        }
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Where a host's capture goes.
    #[must_use]
    pub fn capture(&self, host: VirtualHost) -> PathBuf {
        self.0.join(layout::capture(&host))
    }

    /// Removes the folder of a window that never began. What is in it, if anything is, stays.
    pub fn withdraw(self) {
        let _ = fs::remove_dir(self.0);
    }

    /// Completes the window: hashes and syncs every file, then writes the record with them as its `files`.
    ///
    /// # Errors
    /// If something cannot be read or written; there is no record then.
    pub fn seal(&self, mut record: WindowRecord) -> Result<(), ExperimentError> {
        record.files = self.files()?;
        self.write_record(&record)
    }

    fn files(&self) -> Result<Vec<FileRecord>, ExperimentError> {
        let failed = |source| ExperimentError::Write {
            path: self.0.clone(),
            source,
        };
        let entries = fs::read_dir(&self.0)
            .map_err(failed)?
            .collect::<Result<Vec<_>, _>>()
            .map_err(failed)?;
        let mut files = entries
            .iter()
            .map(|entry| {
                let path = entry.path();
                let name = entry.file_name().to_string_lossy().into_owned();
                file_record(&path, name).map_err(|source| ExperimentError::Write { path, source })
            })
            .collect::<Result<Vec<_>, _>>()?;
        files.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(files)
    }

    fn write_record(&self, record: &WindowRecord) -> Result<(), ExperimentError> {
        let path = self.0.join(layout::WINDOW);
        write_whole(&path, record).map_err(|source| ExperimentError::Write { path, source })
    }
}

/// Syncs a file and describes it.
fn file_record(path: &Path, name: String) -> io::Result<FileRecord> {
    let mut file = File::open(path)?;
    file.sync_all()?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 256 * 1024];
    let mut bytes = 0;
    loop {
        let read = file.read(&mut buffer)?;
        let Some(part) = buffer.get(..read).filter(|part| !part.is_empty()) else {
            break;
        };
        hash.update(part);
        bytes += part.len() as u64;
    }
    Ok(FileRecord {
        name,
        bytes,
        sha256: format!("{:x}", hash.finalize()),
        measured: None,
    })
}

/// Writes a file of JSON so that it is there whole or not at all, whenever the power goes.
///
/// # Errors
/// What the file system says.
pub fn write_whole(path: &Path, content: &impl serde::Serialize) -> io::Result<()> {
    let mut text = serde_json::to_vec_pretty(content)?;
    text.push(b'\n');
    let unfinished = path.with_extension("json.tmp");
    let mut file = File::create(&unfinished)?;
    file.write_all(&text)?;
    file.sync_all()?;
    fs::rename(&unfinished, path)?;
    File::open(above(path))?.sync_all()?;
    // The folder's own name is on the disk too before the window counts.
    File::open(above(above(path)))?.sync_all()
}

/// The folder in which a path is; a relative one begins in the working directory.
fn above(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_there_is_never_written_to() {
        let data = tempfile::tempdir().unwrap();
        WindowFolder::create(data.path(), 3).unwrap();
        let error = WindowFolder::create(data.path(), 3).unwrap_err();
        assert!(matches!(error, ExperimentError::Taken { .. }), "{error}");
    }

    #[test]
    fn a_file_is_known_by_its_sha_256() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        fs::write(&path, "abc").unwrap();
        let record = file_record(&path, "abc".into()).unwrap();
        // FIPS 180-2, appendix B.1.
        assert_eq!(
            record.sha256,
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        assert_eq!(record.bytes, 3);
    }

    #[test]
    fn a_relative_path_begins_in_the_working_directory() {
        assert_eq!(above(Path::new("/data/a.json")), Path::new("/data"));
        assert_eq!(above(Path::new("data/a.json")), Path::new("data"));
        assert_eq!(above(Path::new("data")), Path::new("."));
    }

    #[test]
    fn a_file_of_json_replaces_the_one_before_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("environment.json");
        write_whole(&path, &1).unwrap();
        write_whole(&path, &2).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "2\n");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
