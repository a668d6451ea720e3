//! tcpdump itself, as the paper captured: one process a virtual host for the whole run, which writes to a pipe. The main
//! type is [`Tcpdump`].
//!
//! It is not restarted from window to window, and does not rotate files itself: every packet comes through the one pipe,
//! and belongs to the window of its stamp, so that none is lost or doubled where two windows meet. SIGUSR1 makes it say
//! what it has seen and what the kernel dropped (tcpdump(8)).

use std::{
    io::{self, ErrorKind, Read},
    ops::Range,
    os::fd::AsFd,
    process::{Child, ChildStderr, ChildStdout, Command, Stdio},
    sync::Arc,
    time::{Duration, Instant},
};

use nix::{
    fcntl::{FcntlArg, OFlag, fcntl},
    poll::{PollFd, PollFlags, ppoll},
    sys::{
        eventfd::EventFd,
        signal::{Signal, kill},
        time::TimeSpec,
    },
};
use pcap_file::{PcapError, pcap::PcapParser};
use record::{settings::CaptureSettings, virtual_host::VirtualHost};

use super::{
    error::CaptureError,
    packet_source::{Packet, PacketSource, Wakened, wait_for},
};
use crate::child_process;

/// The command.
pub(super) const NAME: &str = "tcpdump";

/// Room in the pipe: what the experiment sends in some seconds.
const PIPE_BYTES: i32 = 1 << 20;
/// The longest that an answer on standard error is waited for.
const TIMEOUT: Duration = Duration::from_secs(5);
/// A packet comes through the kernel's ring, tcpdump and the pipe, of which only the last two are processes that may
/// have to wait for their turn.
const LATEST_AFTER_NS: i64 = 1_000_000_000;
/// No packet is longer, its header included.
const LONGEST_PACKET_BYTES: usize = (1 << 18) + 16;

/// A running tcpdump.
#[derive(Debug)]
pub struct Tcpdump {
    host: VirtualHost,
    child: Child,
    packets: ChildStdout,
    sayings: ChildStderr,
    version: String,
    /// What it has said since it was last asked.
    said: String,
    buffer: Vec<u8>,
    /// What of the buffer has come and not been given out.
    unread: Range<usize>,
    parser: Option<PcapParser>,
    dropped_before: u64,
}

/// Whether tcpdump can capture here.
///
/// # Errors
/// If it is not installed, or may not become what it wants to be.
pub fn survey() -> Result<(), CaptureError> {
    version()?;
    if may_set_groups() {
        Ok(())
    } else {
        Err(CaptureError::ToolRights)
    }
}

/// Started as root it sets its groups, even to run on as root, and ends if it may not. In an ordinary user's namespace
/// nobody may, and in a container only with SETGID.
fn may_set_groups() -> bool {
    const CAP_SETGID: u32 = 6;
    let read = |path| std::fs::read_to_string(path).unwrap_or_default();
    let status = read("/proc/thread-self/status");
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let effective = effective.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok());
    effective.is_none_or(|bits| bits >> CAP_SETGID & 1 == 1)
        && read("/proc/thread-self/setgroups").trim() != "deny"
}

/// The first line of `tcpdump --version`.
fn version() -> Result<String, CaptureError> {
    let output = Command::new(NAME)
        .arg("--version")
        .stdin(Stdio::null())
        .output()
        .map_err(not_started)?;
    // Some versions print it to standard error.
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    Ok(text.lines().next().unwrap_or(NAME).trim().to_owned())
}

pub(super) fn not_started(source: io::Error) -> CaptureError {
    CaptureError::Tool {
        source: Arc::new(source),
    }
}

impl Tcpdump {
    /// Starts it on an interface of the calling thread's namespace and waits until it listens. It ends when the calling
    /// thread does.
    ///
    /// # Errors
    /// If it is not installed, or says something else than that it listens.
    pub fn start(
        host: VirtualHost,
        interface: &str,
        settings: &CaptureSettings,
    ) -> Result<Self, CaptureError> {
        let version = version()?;
        let mut command = Command::new(NAME);
        command
            .args([
                "-i",
                interface,
                "-w",
                "-",
                "-U",
                "--immediate-mode",
                "--time-stamp-precision=nano",
            ])
            // It would give up its rights to a user that the environment may not have.
            .args(["-Z", "root", "-s", &settings.snaplen.get().to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        if let Some(expression) = &settings.filter {
            command.args(["--", expression]);
        }
        let mut child = child_process::spawn(&mut command).map_err(not_started)?;
        let (Some(packets), Some(sayings)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(not_started(io::Error::other("it has no pipes")));
        };
        let mut tcpdump = Self {
            host,
            child,
            packets,
            sayings,
            version,
            said: String::new(),
            buffer: vec![0; 2 * LONGEST_PACKET_BYTES],
            unread: 0..0,
            parser: None,
            dropped_before: 0,
        };
        // A smaller pipe does as well, as long as it is read in time.
        let _ = fcntl(&tcpdump.packets, FcntlArg::F_SETPIPE_SZ(PIPE_BYTES));
        for pipe in [tcpdump.packets.as_fd(), tcpdump.sayings.as_fd()] {
            fcntl(pipe, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).map_err(|errno| not_started(errno.into()))?;
        }
        tcpdump.hear(|said| said.contains("listening on").then_some(()))?;
        Ok(tcpdump)
    }

    /// Listens to its standard error until it has said what is wanted.
    fn hear<T>(&mut self, wanted: impl Fn(&str) -> Option<T>) -> Result<T, CaptureError> {
        let begun = Instant::now();
        loop {
            let ended = self.listen();
            if let Some(heard) = wanted(&self.said) {
                self.said.clear();
                return Ok(heard);
            }
            let left = TIMEOUT.saturating_sub(begun.elapsed());
            if ended || left.is_zero() {
                return Err(self.failure());
            }
            let mut fds = [PollFd::new(self.sayings.as_fd(), PollFlags::POLLIN)];
            let _ = ppoll(&mut fds, Some(TimeSpec::from(left)), None);
        }
    }

    /// Takes what it has said; true if it will say no more.
    fn listen(&mut self) -> bool {
        let mut bytes = [0; 1024];
        loop {
            match self.sayings.read(&mut bytes) {
                Ok(0) => return true,
                Ok(read) => self
                    .said
                    .push_str(&String::from_utf8_lossy(bytes.get(..read).unwrap_or_default())),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
        }
    }

    /// It has ended, or does not answer: its own words say why.
    fn failure(&mut self) -> CaptureError {
        self.listen();
        let lines: Vec<&str> = self
            .said
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty())
            .collect();
        CaptureError::ToolEnded {
            host: self.host,
            said: lines.join("; "),
        }
    }
}

impl PacketSource for Tcpdump {
    fn wait(&self, wake: &EventFd, timeout: Option<Duration>) -> Result<Wakened, CaptureError> {
        wait_for(self.packets.as_fd(), wake, timeout).map_err(|source| CaptureError::Socket {
            host: self.host,
            action: "waiting for packets",
            source,
        })
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Result<Option<Packet>, CaptureError> {
        loop {
            let unread = self.buffer.get(self.unread.clone()).unwrap_or_default();
            match next_packet(&mut self.parser, unread, buffer) {
                Ok(Some((taken, packet))) => {
                    self.unread.start += taken;
                    match packet {
                        Some(packet) => return Ok(Some(packet)),
                        None => continue,
                    }
                }
                Ok(None) => {}
                Err(error) => {
                    self.said = error.to_string();
                    return Err(self.failure());
                }
            }
            if self.unread.start >= LONGEST_PACKET_BYTES {
                self.buffer.copy_within(self.unread.clone(), 0);
                self.unread = 0..self.unread.len();
            }
            let room = self.buffer.get_mut(self.unread.end..).unwrap_or_default();
            match self.packets.read(room) {
                Ok(0) => return Err(self.failure()),
                Ok(read) => self.unread.end += read,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Err(self.failure()),
            }
        }
    }

    fn take_drops(&mut self) -> Result<u64, CaptureError> {
        kill(child_process::pid(&self.child), Signal::SIGUSR1).map_err(|source| CaptureError::Socket {
            host: self.host,
            action: "asking tcpdump what was dropped",
            source,
        })?;
        let dropped = self.hear(dropped_by_kernel)?;
        let since = dropped.saturating_sub(self.dropped_before);
        self.dropped_before = dropped;
        Ok(since)
    }

    fn latest_after_ns(&self) -> i64 {
        LATEST_AFTER_NS
    }

    fn tool(&self) -> String {
        self.version.clone()
    }
}

/// Ends with the capture.
impl Drop for Tcpdump {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The file's header, or a packet that is copied into the buffer, and how many bytes it took; none if it is not whole.
fn next_packet(
    parser: &mut Option<PcapParser>,
    unread: &[u8],
    buffer: &mut [u8],
) -> Result<Option<(usize, Option<Packet>)>, PcapError> {
    let taken = |rest: &[u8]| unread.len() - rest.len();
    let parsed = match parser {
        None => PcapParser::new(unread).map(|(rest, new)| {
            *parser = Some(new);
            (taken(rest), None)
        }),
        Some(parser) => parser.next_raw_packet(unread).map(|(rest, packet)| {
            let kept_bytes = packet.data.len().min(buffer.len());
            for (place, byte) in buffer.iter_mut().zip(packet.data.iter()) {
                *place = *byte;
            }
            let packet = Packet {
                stamp_unix_ns: i64::from(packet.ts_sec) * 1_000_000_000 + i64::from(packet.ts_frac),
                kept_bytes,
                original_bytes: packet.orig_len as usize,
            };
            (taken(rest), Some(packet))
        }),
    };
    match parsed {
        Ok(parsed) => Ok(Some(parsed)),
        Err(PcapError::IncompleteBuffer) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The number before "packets dropped by kernel", once the line is whole.
fn dropped_by_kernel(said: &str) -> Option<u64> {
    let (before, after) = said.split_once(" dropped by kernel")?;
    after.contains('\n').then_some(())?;
    let before = before
        .trim_end_matches("packets")
        .trim_end_matches("packet")
        .trim_end();
    before.rsplit(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(
        "tcpdump: 9 packets captured, 12 packets received by filter, 3 packets dropped by kernel\n",
        Some(3)
    )]
    #[case(
        "1 packet captured\n1 packet received by filter\n1 packet dropped by kernel\n",
        Some(1)
    )]
    #[case(
        "tcpdump: 9 packets captured, 12 packets received by filter, 3 packets dropped by kernel",
        None
    )]
    #[case("tcpdump: listening on sta1-eth0\n", None)]
    fn what_the_kernel_dropped_is_read_from_its_words(#[case] said: &str, #[case] dropped: Option<u64>) {
        assert_eq!(dropped_by_kernel(said), dropped);
    }
}
