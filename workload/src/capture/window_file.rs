//! One window's capture file: pcap with nanosecond stamps, as `draft-ietf-opsawg-pcap` describes it. The main type is
//! [`WindowFile`].

use std::{
    fs::{self, File},
    io::{self, BufWriter},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use pcap_file::{
    DataLink, Endianness, PcapError, TsResolution,
    pcap::{PcapHeader, PcapPacket, PcapWriter},
};

use super::error::CaptureError;

/// A file that packets are written to. The first error is kept until the file is completed, and ends the writing.
#[derive(Debug)]
pub struct WindowFile {
    path: PathBuf,
    writer: PcapWriter<BufWriter<File>>,
    packets: u64,
    failure: Option<io::Error>,
}

impl WindowFile {
    /// Creates the file, or empties the one that is there.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: PathBuf, snaplen: u32) -> Result<Self, CaptureError> {
        let header = PcapHeader {
            snaplen,
            datalink: DataLink::ETHERNET,
            ts_resolution: TsResolution::NanoSecond,
            endianness: Endianness::native(),
            ..PcapHeader::default()
        };
        let writer = File::create(&path).and_then(|file| {
            PcapWriter::with_header(BufWriter::with_capacity(64 << 10, file), header).map_err(into_io_error)
        });
        match writer {
            Ok(writer) => Ok(Self {
                path,
                writer,
                packets: 0,
                failure: None,
            }),
            Err(error) => Err(CaptureError::Write {
                file: path,
                source: Arc::new(error),
            }),
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends a packet of which so many bytes were kept.
    pub fn write(&mut self, stamp_unix_ns: i64, original_bytes: usize, kept: &[u8]) {
        if self.failure.is_some() {
            return;
        }
        let stamp = Duration::from_nanos(u64::try_from(stamp_unix_ns).unwrap_or(0));
        let original_bytes = u32::try_from(original_bytes).unwrap_or(u32::MAX);
        match self
            .writer
            .write_packet(&PcapPacket::new(stamp, original_bytes, kept))
        {
            Ok(_) => self.packets += 1,
            Err(error) => self.failure = Some(into_io_error(error)),
        }
    }

    /// Puts everything on the disk, and says how many packets the file has.
    ///
    /// # Errors
    /// The first error since the file was created.
    pub fn complete(self) -> Result<u64, CaptureError> {
        let Self {
            path,
            writer,
            packets,
            failure,
        } = self;
        let completed = match failure {
            Some(error) => Err(error),
            None => writer
                .into_writer()
                .into_inner()
                .map_err(io::IntoInnerError::into_error),
        };
        completed
            .and_then(|file| file.sync_all())
            .map(|()| packets)
            .map_err(|error| CaptureError::Write {
                file: path,
                source: Arc::new(error),
            })
    }

    /// Removes the file of a window that never began.
    pub fn discard(self) {
        // An empty capture that stays behind does no harm: no `window.json` will name it.
        let _ = fs::remove_file(&self.path);
    }
}

fn into_io_error(error: PcapError) -> io::Error {
    match error {
        PcapError::IoError(error) => error,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use pcap_file::pcap::PcapReader;

    use super::*;

    #[test]
    fn a_packet_reads_back_with_its_stamp_to_the_nanosecond_and_its_original_length() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("h1.pcap");
        let mut file = WindowFile::create(path.clone(), 96).unwrap();
        file.write(1_700_000_000_123_456_789, 1514, &[7; 96]);
        file.write(1_700_000_000_123_456_790, 60, &[8; 60]);
        assert_eq!(file.complete().unwrap(), 2);

        let mut reader = PcapReader::new(File::open(path).unwrap()).unwrap();
        assert_eq!(reader.header().snaplen, 96);
        assert_eq!(reader.header().ts_resolution, TsResolution::NanoSecond);
        let first = reader.next_raw_packet().unwrap().unwrap();
        assert_eq!((first.ts_sec, first.ts_frac), (1_700_000_000, 123_456_789));
        assert_eq!((first.orig_len, &*first.data), (1514, &[7; 96][..]));
        let second = reader.next_raw_packet().unwrap().unwrap();
        assert_eq!((second.ts_frac, second.orig_len), (123_456_790, 60));
        assert!(reader.next_raw_packet().is_none());
    }

    #[test]
    fn a_folder_that_is_not_there_is_named_in_the_error() {
        let error = WindowFile::create("/nowhere/at/all.pcap".into(), 96).unwrap_err();
        assert_eq!(error.to_string(), "cannot write the capture /nowhere/at/all.pcap");
    }

    #[test]
    fn a_full_disk_is_told_when_the_window_is_completed() {
        let mut file = WindowFile::create("/dev/full".into(), 65_535).unwrap();
        for _ in 0..100 {
            file.write(0, 1514, &[0; 1514]);
        }
        let error = file.complete().unwrap_err();
        assert!(
            error.hint().unwrap().starts_with("make room on the disk"),
            "{error:?}"
        );
    }

    #[test]
    fn a_window_that_never_began_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("h1.pcap");
        WindowFile::create(path.clone(), 96).unwrap().discard();
        assert!(!path.exists());
    }
}
