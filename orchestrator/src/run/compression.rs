//! Captures are compressed once they are here: not in a window, and not where others are still measured. The main
//! function is [`compress_captures`].

use std::{
    fs::File,
    io::{self, Read, Write},
};

use record::{
    layout,
    run_directory::{Place, read_window},
    window::{FileRecord, MeasuredFile},
};
use sha2::{Digest, Sha256};

/// zstd's own default: captures of small messages shrink to a quarter, at hundreds of megabytes a second.
const LEVEL: i32 = 3;
const PIECE_BYTES: usize = 256 << 10;

/// Compresses the captures of a verified window: `h1.pcap` becomes `h1.pcap.zst`, and `window.json` says so, with the
/// length and checksum that the capture was measured with. At any moment `window.json` describes files that are there.
///
/// # Errors
/// What the file system says; the window is then as it was, or has a compressed file too many.
pub fn compress_captures(folder: &Place) -> io::Result<()> {
    let about = folder.join(layout::WINDOW);
    let mut record = read_window(folder, None).map_err(io::Error::other)?;
    let mut done = Vec::new();
    for file in &mut record.files {
        // A metric of the user's may be read from a file of any name.
        if record
            .captures
            .iter()
            .any(|it| layout::capture(&it.host) == file.name)
        {
            let capture = folder.join(&file.name);
            *file = compress(folder, file)?;
            done.push(capture);
        }
    }
    if done.is_empty() {
        return Ok(());
    }
    let mut text = serde_json::to_vec_pretty(&record)?;
    text.push(b'\n');
    about.write(&text)?;
    done.iter().try_for_each(Place::remove_file)
}

/// Writes the compressed file and describes it.
fn compress(folder: &Place, file: &FileRecord) -> io::Result<FileRecord> {
    let name = format!("{}.zst", file.name);
    let mut source = folder.join(&file.name).open()?;
    let packed = folder.join(&name);
    // What an earlier try left.
    packed.remove_file()?;
    let counting = Counting {
        inner: packed.create()?,
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
    use std::fs;

    use record::{run_directory::ensure_window_is_whole, settings::Settings, window::WindowRecord};

    use super::*;
    use crate::provider::fake::window::{FakeWindow, Noise, write};

    #[test]
    fn a_compressed_window_is_whole_and_its_captures_are_those_that_were_measured() {
        let folder = tempfile::tempdir().unwrap();
        let settings = Settings {
            window: record::quantity::TimeSpan::from_secs(10),
            period: record::quantity::TimeSpan::from_secs(10),
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
        let place = Place::root(folder.path());
        compress_captures(&place).unwrap();
        ensure_window_is_whole(&place, 1, None).unwrap();
        assert!(!folder.path().join("sta1.pcap").exists());
        let packed = fs::read(folder.path().join("sta1.pcap.zst")).unwrap();
        assert_eq!(zstd::decode_all(&*packed).unwrap(), plain);
        let after = read();
        assert_ne!(before.files, after.files);
        let measured: Vec<FileRecord> = after.files.iter().map(FileRecord::as_measured).collect();
        assert_eq!(before.files, measured);
        // Once more changes nothing.
        compress_captures(&place).unwrap();
        ensure_window_is_whole(&place, 1, None).unwrap();
    }
}
