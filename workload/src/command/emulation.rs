//! The emulated network that an experiment's nodes are on, for all windows of an environment: hosts, links, captures. The main type
//! is [`Emulation`].

use std::{
    cell::RefCell,
    path::Path,
    time::{Duration, Instant},
};

use record::{
    causes::with_causes,
    progress::Progress,
    settings::{RosMaster, Settings},
    topology::{Topology, address},
    virtual_host::VirtualHost,
    window::{CaptureRecord, NoticesRecord},
};

use super::program::{Program, Running};
use crate::{
    capabilities::drop_unneeded,
    capture::{Capture, CaptureError},
    experiment::{ExperimentError, Reporter, window_folder::WindowFolder},
    network::{self, Network},
    realtime::{priority::above, unix_ns},
    ros::has_publisher,
    virtual_hosts::{
        NamespaceEntries, NoticeQueue, RunningMaster, keep_transcript, on_host, start_captures, start_master,
    },
};

/// How long a capture may take to be complete after its window.
const CAPTURES: Duration = Duration::from_secs(30);
/// How long the master may take to answer.
const ANSWER: Duration = Duration::from_secs(2);
/// TCP's state of a socket that listens (Linux, `include/net/tcp_states.h`).
const LISTEN: &str = "0A";

/// A network that is up until it is dropped.
pub struct Emulation {
    // Captures are in its namespaces.
    captures: Vec<(VirtualHost, Capture)>,
    board: RefCell<NoticeQueue>,
    _entries: NamespaceEntries,
    network: Box<dyn Network>,
}

impl Emulation {
    /// Builds the network, whose links are impaired from now on, and gives up the rights that were needed for it.
    ///
    /// # Errors
    /// If the platform lacks something.
    pub fn open(settings: &Settings, reporter: &Reporter) -> Result<Self, ExperimentError> {
        let network = network::open(&settings.network, above(settings.realtime.priority))?;
        // Before any program of the user's is started.
        drop_unneeded();
        let entries = NamespaceEntries::open(network.as_ref())?;
        // Each window is to meet the same network, from its first packet on.
        network.impair()?;
        let captures = start_captures(&settings.capture, network.as_ref())?;
        reporter.say(&Progress::NetworkUp);
        Ok(Self {
            captures,
            board: RefCell::new(NoticeQueue::on(network.topology().names())),
            _entries: entries,
            network,
        })
    }

    /// What carries the packets.
    #[must_use]
    pub fn network(&self) -> &dyn Network {
        self.network.as_ref()
    }

    /// Its hosts, switches and links.
    #[must_use]
    pub fn topology(&self) -> &Topology {
        self.network.topology()
    }

    /// How many captures a window has.
    #[must_use]
    pub fn captures(&self) -> usize {
        self.captures.len()
    }

    /// Starts a program on a host.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(&self, host: VirtualHost, program: Program) -> Result<Running, ExperimentError> {
        let (started, starts) = std::sync::mpsc::channel();
        // On the thread that stays in the host: the program ends with the thread that starts it.
        let give = self.network.give(
            host,
            Box::new(move || {
                let _ = started.send(program.start());
            }),
        );
        give.map_err(|source| ExperimentError::Thread {
            name: host.to_string().into(),
            source,
        })?;
        let ended = || ExperimentError::ThreadEnded {
            name: host.to_string().into(),
        };
        Ok(starts.recv().map_err(|_| ended())??)
    }

    /// Starts a ROS master on the host in that position.
    ///
    /// # Errors
    /// If it is not installed, or does not answer.
    pub fn start_master(
        &self,
        program: RosMaster,
        (host, position): (VirtualHost, usize),
    ) -> Result<Box<dyn RunningMaster>, ExperimentError> {
        let notices = self.board.borrow().of(host);
        on_host(self.network.as_ref(), host, move || {
            start_master(program, (host, address(position)), notices)
        })
    }

    /// Whether the master on that host knows a publisher of a topic.
    ///
    /// # Errors
    /// If it cannot be asked.
    pub fn has_publisher(&self, host: VirtualHost, uri: &str, topic: &str) -> Result<bool, ExperimentError> {
        let (uri, topic) = (uri.to_owned(), topic.to_owned());
        on_host(self.network.as_ref(), host, move || {
            Ok(has_publisher(&uri, &topic, Instant::now() + ANSWER)?)
        })
    }

    /// Whether something on that host listens on a TCP port. Nothing is sent, so that nothing notices.
    ///
    /// # Errors
    /// If the host cannot be asked.
    pub fn listens(&self, host: VirtualHost, port: u32) -> Result<bool, ExperimentError> {
        on_host(self.network.as_ref(), host, move || {
            let tables = ["tcp", "tcp6"]
                .map(|table| std::fs::read_to_string(format!("/proc/thread-self/net/{table}")));
            Ok(tables
                .into_iter()
                .flatten()
                .any(|table| is_listened_on(&table, port)))
        })
    }

    /// Begins the captures of a window.
    ///
    /// # Errors
    /// If a file cannot be created.
    pub fn begin_captures(&self, folder: &WindowFolder) -> Result<(), ExperimentError> {
        let now = unix_ns();
        for (host, capture) in &self.captures {
            capture.begin_window(folder.capture(*host), now)?;
        }
        Ok(())
    }

    /// Ends the captures of a window: those that are complete, and why the others are not.
    ///
    /// # Errors
    /// If a capture's thread has ended.
    pub fn end_captures(
        &self,
        folder: &WindowFolder,
    ) -> Result<(Vec<CaptureRecord>, Vec<String>), ExperimentError> {
        let now = unix_ns();
        for (_, capture) in &self.captures {
            capture.end(now)?;
        }
        let deadline = Instant::now() + CAPTURES;
        let (mut records, mut failures) = (Vec::new(), Vec::new());
        for (host, capture) in &self.captures {
            match completed(capture, &folder.capture(*host), deadline) {
                Some(Ok(record)) => records.push(record),
                Some(Err(error)) => failures.push(format!("a capture failed: {}", with_causes(&error))),
                None => failures.push(format!(
                    "the capture of {host} was not complete after {} s",
                    CAPTURES.as_secs()
                )),
            }
        }
        Ok((records, failures))
    }

    /// Adds what master and network noticed since the last look to a window's record, and says it.
    pub fn take_notices(&self, reporter: &Reporter, into: &mut NoticesRecord) {
        self.board
            .borrow_mut()
            .look(|progress| reporter.say(progress))
            .add_to(into);
    }

    /// Why the network carries nothing any more, if so.
    ///
    /// # Errors
    /// That.
    pub fn look(&self) -> Result<(), ExperimentError> {
        self.network.failure().map_or(Ok(()), |error| Err(error.into()))
    }

    /// Writes down how the network was made and what went through it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn keep_transcript(&self, data: &Path) -> Result<(), ExperimentError> {
        keep_transcript(data, self.network.as_ref())
    }
}

/// What became of the capture in that file. One of an earlier window that was late is passed by.
fn completed(
    capture: &Capture,
    file: &Path,
    deadline: Instant,
) -> Option<Result<CaptureRecord, CaptureError>> {
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let window = capture.completed().recv_timeout(left).ok()?;
        if window.file == file {
            return Some(window.outcome);
        }
    }
}

/// Whether a table of sockets (proc(5), `/proc/net/tcp`) has one that listens on the port.
fn is_listened_on(table: &str, port: u32) -> bool {
    let port = format!(":{port:04X}");
    let mut rows = table
        .lines()
        .map(|line| line.split_whitespace().collect::<Vec<_>>());
    rows.any(|row| match row.as_slice() {
        [_, local, _, state, ..] => *state == LISTEN && local.ends_with(&port),
        _ => false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_socket_that_listens_is_told_from_one_that_is_connected() {
        let table = "  sl  local_address rem_address   st tx_queue\n\
                     0: 0100000A:2C2F 00000000:0000 0A 00000000:00000000\n\
                     1: 0100000A:1F90 0200000A:2C30 01 00000000:00000000\n";
        assert!(is_listened_on(table, 11_311));
        assert!(!is_listened_on(table, 8080), "it is connected");
        assert!(!is_listened_on(table, 0x2C30), "that is the other end's");
        assert!(!is_listened_on("", 80));
    }
}
