//! A pcap file, plain or compressed with zstd, packet after packet. The main type is [`CaptureFile`].
//!
//! The format is that of `draft-ietf-opsawg-pcap`, which `pcap-file` parses from our buffer: its own reader lends a
//! packet in such a way that two captures could not be read side by side.

use std::{
    fs::File,
    io::{self, Read},
    ops::Range,
    path::PathBuf,
};

use pcap_file::{DataLink, PcapError, TsResolution, pcap::PcapParser};
use record::{run_directory::Place, window::FileRecord};
use sha2::{Digest, Sha256};

use super::TooMuch;

/// What is asked of the file at once.
const FIRST_BUFFER_BYTES: usize = 1 << 18;
/// No packet is longer: the largest `snaplen` that libpcap takes, and its header.
const LONGEST_PACKET_BYTES: usize = (1 << 18) + 16;

/// A capture that is read from its beginning to its end.
pub struct CaptureFile {
    path: PathBuf,
    source: Box<dyn Read>,
    buffer: Vec<u8>,
    /// What of the buffer has been read from the file and not been parsed.
    unread: Range<usize>,
    parser: PcapParser,
    packets: u64,
    current: Option<PacketPlace>,
}

/// The current packet, and where its bytes are in the buffer.
#[derive(Debug, Clone)]
struct PacketPlace {
    stamp_unix_ns: i64,
    original_bytes: usize,
    bytes: Range<usize>,
}

/// One packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet<'a> {
    /// The kernel's stamp: wall clock, nanoseconds since 1970.
    pub stamp_unix_ns: i64,
    /// Its length on the wire, from the Ethernet header on.
    pub original_bytes: usize,
    /// What was kept of it.
    pub bytes: &'a [u8],
}

/// A capture that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{} cannot be used", path.display())]
pub struct CaptureReadError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub source: CaptureFault,
}

/// What is wrong with a capture.
#[derive(Debug, thiserror::Error)]
pub enum CaptureFault {
    /// It is not pcap, or not of Ethernet.
    #[error("it is no pcap file of Ethernet packets: {what}")]
    NotOurs {
        /// How it can be told.
        what: String,
    },
    /// It ends within a packet, or within the compressed stream.
    #[error("it is cut after {packets} packets")]
    Cut {
        /// Whole packets in it.
        packets: u64,
    },
    /// A packet's header cannot be right.
    #[error("packet {number} is damaged: {what}")]
    Damaged {
        /// Which, from 1.
        number: u64,
        /// What is wrong.
        what: String,
    },
    /// It is not the file that was sealed.
    #[error("it has {found} bytes, and window.json says {expected}")]
    Changed {
        /// As window.json has it.
        expected: u64,
        /// As it is.
        found: u64,
    },
    /// What is in it is not what was sealed.
    #[error(transparent)]
    NotAsRecorded(#[from] NotAsRecorded),
    /// It is whole, and nobody follows what is in it.
    #[error(transparent)]
    TooMuch(#[from] TooMuch),
    /// The operating system refused, or the file is not there.
    #[error("it cannot be read")]
    Io(#[source] io::Error),
}

impl CaptureReadError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match &self.source {
            CaptureFault::Io(_) => "see that the file is there and that you may read it",
            CaptureFault::NotOurs { .. } => {
                "give a capture as the workload writes it: pcap, plain or compressed with zstd"
            }
            CaptureFault::TooMuch(_) => {
                "if the experiment sends so much, keep it out with `capture.filter` in the matrix file; otherwise restore the file \
                 from a copy, or move the window's folder away"
            }
            CaptureFault::Cut { .. }
            | CaptureFault::Damaged { .. }
            | CaptureFault::Changed { .. }
            | CaptureFault::NotAsRecorded(_) => {
                "the file was changed after it was measured: restore it from a copy, or move the window's folder away"
            }
        }
    }
}

/// The logarithm of the window that a packed capture may ask for: ours ask for 21. A frame may ask for 128 MiB, of each that is open.
const WINDOW_LOG_MAX: u32 = 23;

fn unpacked<R: Read>(packed: R) -> io::Result<zstd::stream::read::Decoder<'static, io::BufReader<R>>> {
    let mut unpacking = zstd::stream::read::Decoder::new(packed)?;
    unpacking.window_log_max(WINDOW_LOG_MAX)?;
    Ok(unpacking)
}

impl CaptureFile {
    /// Opens a capture; one whose name ends with `.zst` is unpacked as it is read.
    ///
    /// # Errors
    /// If it is not there, or no pcap file of Ethernet packets.
    pub fn open(place: &Place) -> Result<Self, CaptureReadError> {
        let failed = |source| CaptureReadError {
            path: place.path(),
            source,
        };
        let file = place.open().map_err(|error| failed(CaptureFault::Io(error)))?;
        let source: Box<dyn Read> = if place.name().ends_with(".zst") {
            let unpacking = unpacked(file);
            Box::new(unpacking.map_err(|error| failed(CaptureFault::Io(error)))?)
        } else {
            Box::new(file)
        };
        Self::from_source(place.path(), source)
    }

    /// Opens a capture that a window's record describes. Its last packet is followed by an error if it is another file than that,
    /// and no more is unpacked of it than was measured.
    ///
    /// # Errors
    /// As [`Self::open`], and if it is not as long as its record says.
    pub fn open_recorded(place: &Place, record: &FileRecord) -> Result<Self, CaptureReadError> {
        let failed = |source| CaptureReadError {
            path: place.path(),
            source,
        };
        let file = place.open().map_err(|error| failed(CaptureFault::Io(error)))?;
        let about = file.metadata().map_err(|error| failed(CaptureFault::Io(error)))?;
        let (expected, found) = (record.bytes, about.len());
        if found != expected {
            return Err(failed(CaptureFault::Changed { expected, found }));
        }
        let sealed = Sealed {
            inner: file,
            hasher: Sha256::new(),
            sha256: record.sha256.clone(),
        };
        let most = record.as_measured().bytes;
        let source: Box<dyn Read> = if place.name().ends_with(".zst") {
            let unpacking = unpacked(sealed);
            let inner = unpacking.map_err(|error| failed(CaptureFault::Io(error)))?;
            Box::new(NoLonger {
                inner,
                most,
                left: most,
            })
        } else {
            Box::new(sealed)
        };
        Self::from_source(place.path(), source)
    }

    /// Reads a pcap stream that is known as `path` in errors.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn from_source(path: PathBuf, mut source: Box<dyn Read>) -> Result<Self, CaptureReadError> {
        let mut buffer = vec![0; FIRST_BUFFER_BYTES];
        let mut unread = 0..0;
        loop {
            let available = buffer.get(unread.clone()).unwrap_or_default();
            let fault = match PcapParser::new(available) {
                Ok((rest, parser)) if parser.header().datalink == DataLink::ETHERNET => {
                    unread.start = unread.end - rest.len();
                    return Ok(Self {
                        path,
                        source,
                        buffer,
                        unread,
                        parser,
                        packets: 0,
                        current: None,
                    });
                }
                Ok((_, parser)) => CaptureFault::NotOurs {
                    what: format!("its packets are of the kind {:?}", parser.header().datalink),
                },
                Err(PcapError::IncompleteBuffer) => match fill(&mut *source, &mut buffer, &mut unread) {
                    Ok(0) => CaptureFault::NotOurs {
                        what: "it ends within its first 24 bytes".to_owned(),
                    },
                    Ok(_) => continue,
                    Err(error) => fault_of_reading(error, 0),
                },
                Err(error) => CaptureFault::NotOurs {
                    what: error.to_string(),
                },
            };
            return Err(CaptureReadError { path, source: fault });
        }
    }

    /// Goes to the next packet; false at the end of the file.
    ///
    /// # Errors
    /// If the file is cut or damaged.
    pub fn advance(&mut self) -> Result<bool, CaptureReadError> {
        self.current = None;
        loop {
            let available = self.buffer.get(self.unread.clone()).unwrap_or_default();
            let number = self.packets + 1;
            let fault = match self.parser.next_raw_packet(available) {
                Ok((_, packet)) if packet.incl_len > packet.orig_len => CaptureFault::Damaged {
                    number,
                    what: format!(
                        "{} bytes are kept of a packet of {}",
                        packet.incl_len, packet.orig_len
                    ),
                },
                Ok((rest, packet)) => {
                    let fraction_ns = match self.parser.header().ts_resolution {
                        TsResolution::NanoSecond => i64::from(packet.ts_frac),
                        TsResolution::MicroSecond => i64::from(packet.ts_frac) * 1000,
                    };
                    let end = self.unread.end - rest.len();
                    self.current = Some(PacketPlace {
                        stamp_unix_ns: i64::from(packet.ts_sec) * 1_000_000_000 + fraction_ns,
                        original_bytes: packet.orig_len as usize,
                        bytes: end - packet.data.len()..end,
                    });
                    self.unread.start = end;
                    self.packets = number;
                    return Ok(true);
                }
                Err(PcapError::IncompleteBuffer) if available.len() >= LONGEST_PACKET_BYTES => {
                    CaptureFault::Damaged {
                        number,
                        what: "it is longer than a packet can be".to_owned(),
                    }
                }
                Err(PcapError::IncompleteBuffer) => {
                    match fill(&mut *self.source, &mut self.buffer, &mut self.unread) {
                        Ok(0) if self.unread.is_empty() => return Ok(false),
                        Ok(0) => CaptureFault::Cut {
                            packets: self.packets,
                        },
                        Ok(_) => continue,
                        Err(error) => fault_of_reading(error, self.packets),
                    }
                }
                Err(error) => CaptureFault::Damaged {
                    number,
                    what: error.to_string(),
                },
            };
            return Err(CaptureReadError {
                path: self.path.clone(),
                source: fault,
            });
        }
    }

    /// The packet that [`Self::advance`] went to last; none before the first and after the last one.
    #[must_use]
    pub fn packet(&self) -> Option<Packet<'_>> {
        let place = self.current.as_ref()?;
        Some(Packet {
            stamp_unix_ns: place.stamp_unix_ns,
            original_bytes: place.original_bytes,
            bytes: self.buffer.get(place.bytes.clone())?,
        })
    }

    /// That this capture has too much of something, which its current packet shows.
    #[must_use]
    pub fn has_too_much(&self, of: TooMuch) -> CaptureReadError {
        CaptureReadError {
            path: self.path.clone(),
            source: of.into(),
        }
    }

    /// Bytes that the file keeps of a packet at most.
    #[must_use]
    pub fn snaplen(&self) -> u32 {
        self.parser.header().snaplen
    }
}

/// How a capture differs from what its window's record says of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotAsRecorded {
    /// Of the same length, and another.
    #[error("its SHA-256 is not the one that window.json has")]
    Another,
    /// Compressed as no capture is.
    #[error("it unpacks to more than the {most_bytes} bytes that window.json says")]
    Longer {
        /// What was measured.
        most_bytes: u64,
    },
}

/// A file that ends in an error if it is not the one that was sealed.
struct Sealed {
    inner: File,
    hasher: Sha256,
    /// In hexadecimal.
    sha256: String,
}

impl Read for Sealed {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.hasher.update(buffer.get(..read).unwrap_or_default());
        let is_end = read == 0 && !buffer.is_empty();
        if is_end && format!("{:x}", self.hasher.clone().finalize()) != self.sha256 {
            return Err(io::Error::other(NotAsRecorded::Another));
        }
        Ok(read)
    }
}

/// A stream that ends in an error if it is longer than it may be.
struct NoLonger<R> {
    inner: R,
    most: u64,
    left: u64,
}

impl<R: Read> Read for NoLonger<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        let left = self.left.checked_sub(read as u64);
        self.left = left.ok_or_else(|| {
            io::Error::other(NotAsRecorded::Longer {
                most_bytes: self.most,
            })
        })?;
        Ok(read)
    }
}

/// A compressed stream that breaks off ends in this error; a plain file just ends.
fn fault_of_reading(error: io::Error, packets: u64) -> CaptureFault {
    let cause = error.get_ref().and_then(|cause| cause.downcast_ref());
    if let Some(unlike) = cause {
        return CaptureFault::NotAsRecorded(*unlike);
    }
    match error.kind() {
        io::ErrorKind::UnexpectedEof => CaptureFault::Cut { packets },
        _ => CaptureFault::Io(error),
    }
}

/// Brings what is unread to the buffer's front and reads behind it, at least one byte if there is one.
fn fill(source: &mut dyn Read, buffer: &mut Vec<u8>, unread: &mut Range<usize>) -> io::Result<usize> {
    buffer.copy_within(unread.clone(), 0);
    *unread = 0..unread.len();
    if unread.end == buffer.len() {
        buffer.resize(2 * buffer.len(), 0);
    }
    loop {
        match source.read(buffer.get_mut(unread.end..).unwrap_or_default()) {
            Ok(read) => {
                unread.end += read;
                return Ok(read);
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

impl std::fmt::Debug for CaptureFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CaptureFile")
            .field("path", &self.path)
            .field("packets", &self.packets)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use pcap_file::{
        Endianness,
        pcap::{PcapHeader, PcapPacket, PcapWriter},
    };
    use record::window::MeasuredFile;
    use rstest::rstest;

    use super::*;

    fn pcap(packets: &[(u64, usize)], header: PcapHeader) -> Vec<u8> {
        let mut writer = PcapWriter::with_header(Vec::new(), header).unwrap();
        for (stamp_ns, bytes) in packets {
            let data = vec![7; (*bytes).min(header.snaplen as usize)];
            let packet = PcapPacket::new(Duration::from_nanos(*stamp_ns), *bytes as u32, &data);
            writer.write_packet(&packet).unwrap();
        }
        writer.into_writer()
    }

    fn nanoseconds() -> PcapHeader {
        PcapHeader {
            snaplen: 96,
            datalink: DataLink::ETHERNET,
            ts_resolution: TsResolution::NanoSecond,
            ..PcapHeader::default()
        }
    }

    /// A source that gives a few bytes at a time.
    struct Dripping(io::Cursor<Vec<u8>>);

    impl Read for Dripping {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let few = buffer.len().min(5);
            self.0.read(&mut buffer[..few])
        }
    }

    type Found = Vec<(i64, usize, usize)>;

    fn read_all(bytes: Vec<u8>) -> (Found, Result<(), CaptureFault>) {
        let mut found = Vec::new();
        let source = Box::new(Dripping(io::Cursor::new(bytes)));
        let mut file = match CaptureFile::from_source("x.pcap".into(), source) {
            Ok(file) => file,
            Err(error) => return (found, Err(error.source)),
        };
        loop {
            match file.advance() {
                Ok(true) => {
                    let packet = file.packet().unwrap();
                    found.push((packet.stamp_unix_ns, packet.original_bytes, packet.bytes.len()));
                }
                Ok(false) => return (found, Ok(())),
                Err(error) => return (found, Err(error.source)),
            }
        }
    }

    #[rstest]
    #[case::nanoseconds(nanoseconds(), 1_700_000_000_123_456_789)]
    #[case::microseconds(PcapHeader { ts_resolution: TsResolution::MicroSecond, ..nanoseconds() }, 1_700_000_000_123_456_000)]
    #[case::from_another_machine(PcapHeader { endianness: Endianness::Big, ..nanoseconds() }, 1_700_000_000_123_456_789)]
    fn packets_read_back_with_their_stamps_and_lengths(#[case] header: PcapHeader, #[case] stamp: i64) {
        let bytes = pcap(
            &[(1_700_000_000_123_456_789, 60), (1_700_000_000_123_456_789, 1514)],
            header,
        );
        let (found, outcome) = read_all(bytes);
        assert_eq!(found, [(stamp, 60, 60), (stamp, 1514, 96)]);
        assert!(outcome.is_ok());
    }

    #[test]
    fn a_compressed_capture_reads_as_the_plain_one() {
        let bytes = pcap(&[(1, 60), (2, 61)], nanoseconds());
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join("h1.pcap.zst");
        std::fs::write(place.path(), zstd::encode_all(&*bytes, 3).unwrap()).unwrap();
        let mut file = CaptureFile::open(&place).unwrap();
        assert_eq!(file.snaplen(), 96);
        assert!(file.advance().unwrap() && file.advance().unwrap());
        assert_eq!(file.packet().unwrap().original_bytes, 61);
        assert!(!file.advance().unwrap());
        assert_eq!(file.packet(), None);
    }

    #[test]
    fn a_capture_cut_anywhere_says_after_how_many_packets() {
        let bytes = pcap(&[(1, 60), (2, 61)], nanoseconds());
        let ends = [24, 24 + 16 + 60, bytes.len()];
        for length in 0..bytes.len() {
            let (found, outcome) = read_all(bytes[..length].to_vec());
            match outcome {
                Ok(()) => assert!(ends.contains(&length), "cut to {length} bytes"),
                Err(CaptureFault::Cut { packets }) => assert_eq!(packets, found.len() as u64),
                Err(CaptureFault::NotOurs { .. }) => assert!(length < 24),
                Err(other) => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn a_cut_compressed_capture_is_cut() {
        let packets: Vec<(u64, usize)> = (0..20_000)
            .map(|number| (number * 977, 60 + number as usize % 30))
            .collect();
        let bytes = zstd::encode_all(&*pcap(&packets, nanoseconds()), 3).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join("h1.pcap.zst");
        std::fs::write(place.path(), &bytes[..bytes.len() - 7]).unwrap();
        let mut file = CaptureFile::open(&place).unwrap();
        let error = loop {
            match file.advance() {
                Ok(more) => assert!(more, "it does not end as if it were whole"),
                Err(error) => break error,
            }
        };
        assert!(matches!(error.source, CaptureFault::Cut { .. }), "{error:?}");
    }

    #[rstest]
    #[case::text(b"step,scheduled_ns,actual_ns".to_vec())]
    #[case::another_link(pcap(&[], PcapHeader { datalink: DataLink::RAW, ..nanoseconds() }))]
    fn what_is_no_capture_of_ethernet_is_refused(#[case] bytes: Vec<u8>) {
        assert!(matches!(read_all(bytes).1, Err(CaptureFault::NotOurs { .. })));
    }

    #[test]
    fn a_length_that_lies_is_refused_before_memory_is_spent_on_it() {
        let mut bytes = pcap(&[(1, 60)], nanoseconds());
        bytes[32..36].copy_from_slice(&u32::MAX.to_le_bytes());
        bytes[36..40].copy_from_slice(&u32::MAX.to_le_bytes());
        bytes.resize(1 << 20, 0);
        assert!(matches!(
            read_all(bytes).1,
            Err(CaptureFault::Damaged { number: 1, .. })
        ));
    }

    fn record_of(name: &str, bytes: &[u8], measured: u64) -> FileRecord {
        FileRecord {
            name: name.to_owned(),
            bytes: bytes.len() as u64,
            sha256: format!("{:x}", Sha256::digest(bytes)),
            measured: name.ends_with(".zst").then(|| MeasuredFile {
                bytes: measured,
                sha256: String::new(),
            }),
        }
    }

    /// How the reading of a recorded capture ends, and after how many packets.
    fn end_of(name: &str, bytes: &[u8], record: &FileRecord) -> (u64, Result<(), CaptureFault>) {
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join(name);
        std::fs::write(place.path(), bytes).unwrap();
        let mut file = match CaptureFile::open_recorded(&place, record) {
            Ok(file) => file,
            Err(error) => return (0, Err(error.source)),
        };
        loop {
            match file.advance() {
                Ok(true) => {}
                Ok(false) => return (file.packets, Ok(())),
                Err(error) => return (file.packets, Err(error.source)),
            }
        }
    }

    #[test]
    fn any_byte_that_is_another_than_was_sealed_is_found() {
        let plain = pcap(&[(1, 60), (2, 61)], nanoseconds());
        let packed = zstd::encode_all(&*plain, 3).unwrap();
        for (name, bytes) in [("h1.pcap", &plain), ("h1.pcap.zst", &packed)] {
            let record = record_of(name, bytes, plain.len() as u64);
            assert!(matches!(end_of(name, bytes, &record), (2, Ok(()))));
            for at in 0..bytes.len() {
                let mut changed = bytes.clone();
                changed[at] ^= 1;
                assert!(end_of(name, &changed, &record).1.is_err(), "byte {at} of {name}");
            }
        }
    }

    #[test]
    fn no_more_is_unpacked_than_was_measured() {
        let mut bytes = pcap(&[(1, 60)], nanoseconds());
        let measured = bytes.len() as u64;
        // 64 MiB of packets without content, in a few kilobytes.
        let empty = pcap(&[(2, 0)], nanoseconds()).split_off(24).repeat(1 << 16);
        (0..64).for_each(|_| bytes.extend_from_slice(&empty));
        let packed = zstd::encode_all(&*bytes, 1).unwrap();
        drop(bytes);
        let record = record_of("h1.pcap.zst", &packed, measured);
        let (packets, end) = end_of("h1.pcap.zst", &packed, &record);
        assert!(
            matches!(end, Err(CaptureFault::NotAsRecorded(NotAsRecorded::Longer { most_bytes })) if most_bytes == measured),
            "{end:?}"
        );
        assert_eq!(packets, 0, "the first piece that is unpacked is too long already");
    }

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let error = CaptureFile::open(&Place::root("/nowhere").join("h1.pcap")).unwrap_err();
        assert_eq!(error.to_string(), "/nowhere/h1.pcap cannot be used");
        assert!(error.hint().contains("is there"));
    }
}
