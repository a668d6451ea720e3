//! Windows that follow on each other without a gap in one environment: their captures are one stream, so that a message
//! that was under way at a boundary is whole. The main type is [`Stretch`].

use std::path::Path;

use record::{
    layout,
    run_directory::Place,
    virtual_host::VirtualHost,
    window::{FileRecord, WindowRecord},
};

use super::{CaptureFile, CaptureReadError, Packet, Topic};

/// A window whose captures are read.
#[derive(Debug, Clone, PartialEq)]
pub struct CapturedWindow {
    /// Its folder.
    pub folder: Place,
    /// What it says of itself.
    pub record: WindowRecord,
}

impl CapturedWindow {
    /// Its control log, and how long it was when it was measured.
    pub fn log(&self) -> (Place, u64) {
        let recorded = self
            .record
            .files
            .iter()
            .find(|file| file.name == layout::CONTROL_LOG);
        let bytes = recorded.map_or(WindowRecord::LONGEST_FILE, |file| file.bytes);
        (self.folder.join(layout::CONTROL_LOG), bytes)
    }

    /// Whether its captures are there to be read.
    pub fn is_captured(&self) -> bool {
        Topic::ALL
            .into_iter()
            .all(|topic| self.capture_of(topic.sender()).is_some())
    }

    /// The capture of a host.
    fn capture_of(&self, host: VirtualHost) -> Option<(Place, FileRecord)> {
        let names = [format!("{host}.pcap"), format!("{host}.pcap.zst")];
        let file = self.record.files.iter().find(|file| names.contains(&file.name))?;
        Some((self.folder.join(&file.name), file.clone()))
    }
}

/// Windows without a gap.
#[derive(Debug, Clone, PartialEq)]
pub struct Stretch {
    /// In order.
    pub windows: Vec<CapturedWindow>,
}

impl Stretch {
    /// Cuts windows, in the order of their numbers, where one does not follow on the one before.
    pub fn cut(windows: impl IntoIterator<Item = CapturedWindow>) -> Vec<Self> {
        let mut stretches: Vec<Self> = Vec::new();
        for window in windows {
            let goes_on = |stretch: &&mut Self| {
                stretch.windows.last().is_some_and(|last| {
                    !window.record.starts_run
                        && last.record.environment == window.record.environment
                        && last.record.ended_ns == window.record.started_ns
                })
            };
            match stretches.last_mut().filter(goes_on) {
                Some(stretch) => stretch.windows.push(window),
                None => stretches.push(Self {
                    windows: vec![window],
                }),
            }
        }
        stretches
    }

    /// Gives each packet of the controller's and the plant's captures to `take`, in the order of their stamps, with the file that
    /// it is in.
    ///
    /// # Errors
    /// If a capture cannot be read or is another than its record says, and what `take` fails with.
    pub fn read<E: From<CaptureReadError>>(
        &self,
        mut take: impl FnMut(VirtualHost, &Packet<'_>, &CaptureFile) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut sources = Topic::ALL.map(|topic| (topic.sender(), self.packets(topic.sender())));
        for (_, packets) in &mut sources {
            packets.advance()?;
        }
        while let Some((host, packets)) = sources
            .iter_mut()
            .min_by_key(|(_, packets)| packets.stamp_unix_ns())
            && let Some((packet, file)) = packets.packet()
        {
            take(*host, &packet, file)?;
            packets.advance()?;
        }
        Ok(())
    }

    /// The packets of a host.
    fn packets(&self, host: VirtualHost) -> HostPackets {
        let files: Vec<_> = self
            .windows
            .iter()
            .filter_map(|window| window.capture_of(host))
            .collect();
        HostPackets {
            files: files.into_iter(),
            open: None,
        }
    }

    /// The window that a time on the experiment's clock is in; what is before the first or after the last is theirs.
    pub fn window_at(&self, ns: i64) -> Option<&CapturedWindow> {
        let after = self
            .windows
            .partition_point(|window| window.record.started_ns <= ns);
        self.windows.get(after.saturating_sub(1))
    }

    /// A capture's stamp on the experiment's clock. The wall clock that captures are stamped with may be slewed: within
    /// a window it is taken to have gone evenly.
    pub fn on_experiments_clock(&self, unix_ns: i64) -> Option<i64> {
        let (window, since_ns) = self.place_of(unix_ns)?;
        Some(self.windows.get(window)?.record.started_ns + since_ns)
    }

    /// The window that a capture's stamp is in, as an index, and how long after its beginning on the experiment's clock; what
    /// is before the first or after the last is theirs.
    pub fn place_of(&self, unix_ns: i64) -> Option<(usize, i64)> {
        let after = self
            .windows
            .partition_point(|window| window.record.started_unix_ns <= unix_ns);
        let window = after.saturating_sub(1);
        let record = &self.windows.get(window)?.record;
        let since_ns = unix_ns - record.started_unix_ns;
        let length = record.ended_unix_ns - record.started_unix_ns;
        let slewed = (length - (record.ended_ns - record.started_ns)) as f64;
        let share = since_ns as f64 / length.max(1) as f64;
        Some((window, since_ns - (slewed * share.clamp(0.0, 1.0)).round() as i64))
    }

    /// The windows before and after the one that has this capture.
    pub fn without(mut self, capture: &Path) -> [Option<Self>; 2] {
        let is_it = |window: &CapturedWindow| Some(window.folder.path().as_path()) == capture.parent();
        let at = self.windows.iter().position(is_it).unwrap_or(self.windows.len());
        let after = self.windows.split_off((at + 1).min(self.windows.len()));
        self.windows.truncate(at);
        [self.windows, after].map(|windows| (!windows.is_empty()).then_some(Self { windows }))
    }

    /// The number of the window that has this capture.
    pub fn window_of(&self, capture: &Path) -> Option<u32> {
        let is_it = |window: &&CapturedWindow| Some(window.folder.path().as_path()) == capture.parent();
        Some(self.windows.iter().find(is_it)?.record.window)
    }
}

/// The packets of one host, file after file.
#[derive(Debug)]
struct HostPackets {
    files: std::vec::IntoIter<(Place, FileRecord)>,
    open: Option<CaptureFile>,
}

impl HostPackets {
    /// Goes to the next packet; false at the end of the last file.
    ///
    /// # Errors
    /// If a file cannot be read, or is another than its record says.
    fn advance(&mut self) -> Result<bool, CaptureReadError> {
        loop {
            if let Some(open) = &mut self.open
                && open.advance()?
            {
                return Ok(true);
            }
            match self.files.next() {
                Some((place, record)) => self.open = Some(CaptureFile::open_recorded(&place, &record)?),
                None => return Ok(false),
            }
        }
    }

    /// The current packet and its file; none after the last one.
    fn packet(&self) -> Option<(Packet<'_>, &CaptureFile)> {
        let file = self.open.as_ref()?;
        Some((file.packet()?, file))
    }

    /// Its stamp; later than all when there is none.
    fn stamp_unix_ns(&self) -> i64 {
        self.packet().map_or(i64::MAX, |(packet, _)| packet.stamp_unix_ns)
    }
}
