//! The packet capture on one virtual host: a source of packets on its interface (our packet socket, or tcpdump), a
//! reading thread, and one nanosecond pcap file a window. The main type is [`Capture`].
//!
//! Each packet carries the kernel's stamp (`SO_TIMESTAMPNS`, the wall clock). A packet that the host sends is stamped
//! when its stack hands it to the device, after any queueing in the host and before the first link; one that it
//! receives when the emulator's write enters the host's stack, after the last link. So a stamp on one host minus the
//! stamp on another is the time on the links plus the emulator's lateness, and leaves out the sockets at both ends.

mod error;
mod filter;
mod packet_socket;
mod packet_source;
mod sources;
mod stamping;
mod tcpdump;
pub(crate) mod window_file;
mod window_sequence;

use std::{
    path::PathBuf,
    sync::{
        Arc,
        mpsc::{self, Receiver, Sender, TryRecvError},
    },
    thread::JoinHandle,
    time::{Duration, SystemTime},
};

use nix::sys::eventfd::{EfdFlags, EventFd};
use record::{settings::CaptureSettings, virtual_host::VirtualHost, window::CaptureRecord};

pub use self::{error::CaptureError, sources::survey};
use self::{
    packet_source::{PacketSource, Wakened},
    window_file::WindowFile,
    window_sequence::{Boundary, WindowSequence},
};
use crate::network::{self, Network};

/// A capture on one virtual host's interface, both directions, from [`Capture::start`] until it is dropped.
#[derive(Debug)]
pub struct Capture {
    host: VirtualHost,
    snaplen: u32,
    boundaries: Option<Sender<Boundary<WindowFile>>>,
    wake: Arc<EventFd>,
    completed: Receiver<CapturedWindow>,
    thread: Option<JoinHandle<()>>,
}

/// One window's file, complete and on the disk, or why not.
#[derive(Debug)]
pub struct CapturedWindow {
    /// The file.
    pub file: PathBuf,
    /// What is in it.
    pub outcome: Result<CaptureRecord, CaptureError>,
}

impl Capture {
    /// Opens the source that the settings ask for on the host's interface and starts a thread that reads it. Packets are
    /// thrown away until a window begins. The calling thread stays in its own namespace.
    ///
    /// # Errors
    /// If the source cannot be opened.
    pub fn start(
        network: &dyn Network,
        host: VirtualHost,
        settings: &CaptureSettings,
    ) -> Result<Self, CaptureError> {
        let snaplen = u32::try_from(settings.snaplen.get()).unwrap_or(u32::MAX);
        let wake = EventFd::from_flags(EfdFlags::EFD_CLOEXEC | EfdFlags::EFD_NONBLOCK).map_err(|source| {
            CaptureError::Socket {
                host,
                action: "making an eventfd",
                source,
            }
        })?;
        let wake = Arc::new(wake);
        let (boundaries, to_come) = mpsc::channel();
        let (completes, completed) = mpsc::channel();
        let (opened, opens) = mpsc::channel();
        let interface = host.interface();
        let settings = settings.clone();
        let for_reader = Arc::clone(&wake);
        let read = move || match sources::open(host, &interface, &settings) {
            Ok(source) => {
                let _ = opened.send(Ok(()));
                Reader {
                    host,
                    windows: WindowSequence::with_grace(source.latest_after_ns()),
                    source,
                    wake: for_reader,
                    to_come,
                    completes,
                    buffer: vec![0; usize::try_from(snaplen).unwrap_or(usize::MAX)],
                }
                .run();
            }
            Err(error) => {
                let _ = opened.send(Err(error));
            }
        };
        let thread = network::spawn(network, host, format!("capture-{host}"), read).map_err(|error| {
            CaptureError::Thread {
                host,
                source: Arc::new(error),
            }
        })?;
        // Nothing is sent only if the thread ended early.
        opens.recv().unwrap_or(Err(CaptureError::Ended { host }))?;
        Ok(Self {
            host,
            snaplen,
            boundaries: Some(boundaries),
            wake,
            completed,
            thread: Some(thread),
        })
    }

    /// Packets stamped at or after `starts_unix_ns` (wall clock, nanoseconds since 1970) go to `file`; the window
    /// before is completed shortly after that time, whether or not a further packet comes. Call it ahead of that time,
    /// from a thread that need not be on time: the file is created now.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn begin_window(&self, file: PathBuf, starts_unix_ns: i64) -> Result<(), CaptureError> {
        let file = WindowFile::create(file, self.snaplen)?;
        self.announce(Boundary {
            at_unix_ns: starts_unix_ns,
            next: Some(file),
        })
    }

    /// Ends the last window at that time. A window that was to begin then or later never begins: its file is removed.
    ///
    /// # Errors
    /// If the reading thread is gone.
    pub fn end(&self, at_unix_ns: i64) -> Result<(), CaptureError> {
        self.announce(Boundary {
            at_unix_ns,
            next: None,
        })
    }

    /// One for each completed window, in order. It closes when the reading thread ends.
    #[must_use]
    pub fn completed(&self) -> &Receiver<CapturedWindow> {
        &self.completed
    }

    fn announce(&self, boundary: Boundary<WindowFile>) -> Result<(), CaptureError> {
        let ended = CaptureError::Ended { host: self.host };
        let sender = self.boundaries.as_ref().ok_or(ended.clone())?;
        sender.send(boundary).map_err(|_| ended)?;
        // An eventfd's counter takes 2^64 − 2 of these.
        let _ = self.wake.write(1);
        Ok(())
    }
}

/// Ends the window under way, as far as it got.
impl Drop for Capture {
    fn drop(&mut self) {
        self.boundaries = None;
        let _ = self.wake.write(1);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The reading thread.
struct Reader {
    host: VirtualHost,
    source: Box<dyn PacketSource>,
    wake: Arc<EventFd>,
    to_come: Receiver<Boundary<WindowFile>>,
    windows: WindowSequence<WindowFile>,
    completes: Sender<CapturedWindow>,
    buffer: Vec<u8>,
}

impl Reader {
    fn run(mut self) {
        let failure = self.read_until_dropped().err();
        let (current, cancelled) = self.windows.take_windows();
        if let Some(window) = current {
            self.complete(window, failure);
        }
        cancelled.into_iter().for_each(WindowFile::discard);
    }

    fn read_until_dropped(&mut self) -> Result<(), CaptureError> {
        loop {
            let timeout = self.windows.next_crossing_unix_ns().map(time_until);
            let wakened = self.source.wait(&self.wake, timeout)?;
            // The time is read before the source is emptied: what was stamped before it is then in its file.
            let now_unix_ns = unix_now_ns();
            if wakened == Wakened::ByOwner && !self.take_boundaries() {
                return Ok(());
            }
            while let Some(packet) = self.source.receive(&mut self.buffer)? {
                let kept = self.buffer.get(..packet.kept_bytes).unwrap_or(&self.buffer);
                if let Some(window) = self.windows.at(packet.stamp_unix_ns) {
                    window.write(packet.stamp_unix_ns, packet.original_bytes, kept);
                }
            }
            while let Some(ended) = self.windows.cross(now_unix_ns) {
                self.cross(ended);
            }
        }
    }

    /// False when there are no more, since the capture was dropped.
    fn take_boundaries(&mut self) -> bool {
        // Empties the counter; it is empty already if several owners' calls came as one.
        let _ = self.wake.read();
        loop {
            match self.to_come.try_recv() {
                Ok(boundary) => self
                    .windows
                    .announce(boundary)
                    .into_iter()
                    .for_each(WindowFile::discard),
                Err(TryRecvError::Empty) => return true,
                Err(TryRecvError::Disconnected) => return false,
            }
        }
    }

    /// A boundary has passed, and with it perhaps a window.
    fn cross(&mut self, ended: Option<WindowFile>) {
        match ended {
            Some(window) => self.complete(window, None),
            // Drops of the time without a window are nobody's: reading the counter clears it.
            None => drop(self.source.take_drops()),
        }
    }

    fn complete(&mut self, window: WindowFile, failure: Option<CaptureError>) {
        let host = self.host;
        let drops = self.source.take_drops();
        let file = window.path().to_owned();
        let written = window.complete();
        let outcome = match (failure, written, drops) {
            (Some(error), _, _) | (None, Err(error), _) | (None, Ok(_), Err(error)) => Err(error),
            (None, Ok(packets), Ok(dropped)) => Ok(CaptureRecord {
                host,
                packets,
                dropped,
                tool: self.source.tool(),
            }),
        };
        // Nobody may want to know any more.
        let _ = self.completes.send(CapturedWindow { file, outcome });
    }
}

/// The wall clock, in nanoseconds since 1970.
fn unix_now_ns() -> i64 {
    let since = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

/// How long it is until a time on the wall clock; nothing if it has passed.
fn time_until(unix_ns: i64) -> Duration {
    let ns = unix_ns.saturating_sub(unix_now_ns());
    Duration::from_nanos(u64::try_from(ns).unwrap_or(0))
}
