//! Captures are compressed once they are here: not in a window, and not where others are still measured. The main
//! function is [`compress_captures`].

use std::{
    fs::{self, File},
    io::{self, Read, Write},
    path::Path,
};

use sha2::{Digest, Sha256};
use workload::{
    experiment::write_whole,
    record::window::{FileRecord, MeasuredFile, WindowRecord},
};

/// zstd's own default: captures of small messages shrink to a quarter, at hundreds of megabytes a second.
const LEVEL: i32 = 3;
const PIECE_BYTES: usize = 256 << 10;

/// Compresses the captures of a verified window: `h1.pcap` becomes `h1.pcap.zst`, and `window.json` says so, with the
/// length and checksum that the capture was measured with. At any moment `window.json` describes files that are there.
///
/// # Errors
/// What the file system says; the window is then as it was, or has a compressed file too many.
pub fn compress_captures(folder: &Path) -> io::Result<()> {
    let about = folder.join("window.json");
    let mut record: WindowRecord = serde_json::from_slice(&fs::read(&about)?)?;
    let mut done = Vec::new();
    for file in &mut record.files {
        if file.name.ends_with(".pcap") {
            let path = folder.join(&file.name);
            *file = compress(folder, file)?;
            done.push(path);
        }
    }
    if done.is_empty() {
        return Ok(());
    }
    write_whole(&about, &record)?;
    done.into_iter().try_for_each(fs::remove_file)
}

/// Writes the compressed file and describes it.
fn compress(folder: &Path, file: &FileRecord) -> io::Result<FileRecord> {
    let name = format!("{}.zst", file.name);
    let mut source = File::open(folder.join(&file.name))?;
    let counting = Counting {
        inner: File::create(folder.join(&name))?,
        hash: Sha256::new(),
        bytes: 0,
    };
    let mut packing = zstd::stream::write::Encoder::new(counting, LEVEL)?;
    packing.include_checksum(true)?;
    let mut piece = vec![0; PIECE_BYTES];
    loop {
        let read = source.read(&mut piece)?;
        match piece.get(..read) {
            Some(bytes) if read > 0 => packing.write_all(bytes)?,
            _ => break,
        }
    }
    let Counting { inner, hash, bytes } = packing.finish()?;
    inner.sync_all()?;
    Ok(FileRecord {
        name,
        bytes,
        sha256: format!("{:x}", hash.finalize()),
        measured: Some(MeasuredFile {
            bytes: file.bytes,
            sha256: file.sha256.clone(),
        }),
    })
}

/// A file that is hashed as it is written.
struct Counting {
    inner: File,
    hash: Sha256,
    bytes: u64,
}

impl Write for Counting {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.hash.update(bytes.get(..written).unwrap_or_default());
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

#[cfg(test)]
mod tests {
    use workload::settings::Settings;

    use super::*;
    use crate::{
        provider::fake::window::{FakeWindow, Noise, write},
        run::collection::verify,
    };

    #[test]
    fn a_compressed_window_is_whole_and_its_captures_are_those_that_were_measured() {
        let folder = tempfile::tempdir().unwrap();
        let settings = Settings {
            window: workload::quantity::TimeSpan::from_secs(10),
            period: workload::quantity::TimeSpan::from_secs(10),
            ..Settings::default()
        };
        let window = FakeWindow {
            environment: "e-1",
            settings: &settings,
            window: 1,
            before: 0,
            steps: settings.steps_per_window(),
            noise: Noise {
                seed: 1,
                scenario: "a",
                mean_m: 0.0,
                deviation_m: 0.0,
            },
        };
        write(&window, folder.path(), true).unwrap();
        let read = || -> WindowRecord {
            serde_json::from_slice(&fs::read(folder.path().join("window.json")).unwrap()).unwrap()
        };
        let (before, plain) = (read(), fs::read(folder.path().join("sta1.pcap")).unwrap());
        compress_captures(folder.path()).unwrap();
        verify(folder.path()).unwrap();
        assert!(!folder.path().join("sta1.pcap").exists());
        let packed = fs::read(folder.path().join("sta1.pcap.zst")).unwrap();
        assert_eq!(zstd::decode_all(&*packed).unwrap(), plain);
        let after = read();
        assert_ne!(before.files, after.files);
        let measured: Vec<FileRecord> = after.files.iter().map(FileRecord::as_measured).collect();
        assert_eq!(before.files, measured);
        // Once more changes nothing.
        compress_captures(folder.path()).unwrap();
        verify(folder.path()).unwrap();
    }
}
