//! Carrying bytes between a channel and a socket of ours, both ways, until one of them has ended. The main function is
//! [`pump`].
//!
//! ```text
//!             outgoing, 32 KiB
//! near  ────────────────────────────>  channel ── libssh2 ── wire
//!       <────────────────────────────
//!             incoming, 32 KiB          the end of standard error is kept
//! ```
//!
//! A buffer is filled when it is empty, so that who does not read holds up who writes, and nobody else. The thread sleeps
//! in poll(2) on both ends.

use std::{
    io::{self, ErrorKind, Read, Write},
    net::Shutdown,
    os::unix::net::UnixStream,
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};
use ssh2::{BlockDirections, Channel};

use super::link::{Link, milliseconds};

/// How long a host may say nothing before it is asked for a sign of life.
pub const BEAT: Duration = Duration::from_secs(15);

/// So many signs of life asked for without an answer: the connection is lost.
const MISSED_BEATS: u32 = 4;
/// How long an answer is waited for with nothing else done. One that takes longer is seen where all is waited for.
const ANSWER: Duration = Duration::from_secs(1);
/// What one read or write moves at most: several of the packets of 32 KiB that SSH has.
const BUFFER: usize = 256 << 10;
/// What is kept of standard error.
const LAST_WORDS: usize = 64 << 10;
/// How long the rest of its input may take to get to a program whose stream was dropped.
const DELIVERY: Duration = Duration::from_secs(10);
/// How long such a program may take to end by itself, once its input has ended.
const GRACE: Duration = Duration::from_secs(1);
/// How long the other side may take to agree that a channel is closed.
const CLOSING: Duration = Duration::from_secs(2);
/// Between two looks at what poll(2) does not tell.
const LOOK: Duration = Duration::from_millis(100);

/// How it ended.
#[derive(Debug, PartialEq, Eq)]
pub enum Ended {
    /// The other side closed the channel.
    There {
        /// Exit code; none when a signal ended the program.
        code: Option<i32>,
        /// The end of its standard error.
        last_words: Vec<u8>,
    },
    /// Our side's stream was dropped, and so the channel was closed.
    Here,
}

/// Carries bytes until the end. `abandoned` says whether nobody waits for the program's end any more.
///
/// Afterwards the link can be used again, unless it failed.
///
/// # Errors
/// When the connection was lost.
pub fn pump(
    link: &Link,
    channel: Channel,
    near: UnixStream,
    beat: Duration,
    abandoned: &dyn Fn() -> bool,
) -> io::Result<Ended> {
    let session = link.session();
    session.set_blocking(false);
    // When one is due is decided here; libssh2 takes no shorter interval.
    session.set_keepalive(true, 1);
    let mut pump = Pump {
        link,
        channel,
        near,
        beat,
        abandoned,
        outgoing: Buffer::default(),
        incoming: Buffer::default(),
        last_words: Vec::new(),
        near_ended: false,
        near_gone: None,
        eof_sent: None,
        eof_passed: false,
        heard: Instant::now(),
        missed_beats: 0,
    };
    let ended = near_is_ready(&pump.near).and_then(|()| pump.run());
    let closed = ended.and_then(|ended| pump.close().map(|()| ended));
    if closed.is_err() {
        // libssh2 would wait for an answer otherwise, when the channel is dropped.
        link.cut();
    }
    closed
}

fn near_is_ready(near: &UnixStream) -> io::Result<()> {
    near.set_nonblocking(true)
}

struct Pump<'a> {
    link: &'a Link,
    channel: Channel,
    near: UnixStream,
    beat: Duration,
    abandoned: &'a dyn Fn() -> bool,
    outgoing: Buffer,
    incoming: Buffer,
    last_words: Vec<u8>,
    /// Nothing more comes from our side.
    near_ended: bool,
    /// Since when our side takes nothing any more, either.
    near_gone: Option<Instant>,
    /// Since when the other side knows that nothing more comes.
    eof_sent: Option<Instant>,
    /// Our side knows that nothing more comes.
    eof_passed: bool,
    heard: Instant,
    missed_beats: u32,
}

impl Pump<'_> {
    fn run(&mut self) -> io::Result<Ended> {
        loop {
            let mut moved = self.take_from_near();
            moved |= self.pass_to_far()?;
            moved |= self.take_from_far()?;
            moved |= self.take_words()?;
            moved |= self.pass_to_near();
            if self.eof_passed && is_done(self.channel.wait_close())? {
                return self.ended_there();
            }
            if self.is_to_be_left() {
                return Ok(Ended::Here);
            }
            if !moved {
                self.wait()?;
            }
        }
    }

    fn take_from_near(&mut self) -> bool {
        if self.near_ended || !self.outgoing.is_empty() {
            return false;
        }
        match self.outgoing.fill(&mut &self.near) {
            Ok(0) => self.near_ended = true,
            Ok(_) => {}
            Err(error) if is_passing(&error) => return false,
            Err(_) => self.near_ended = true,
        }
        true
    }

    fn pass_to_far(&mut self) -> io::Result<bool> {
        if !self.outgoing.is_empty() {
            return match self.outgoing.drain(&mut self.channel) {
                Ok(passed) => Ok(passed > 0),
                Err(error) if is_passing(&error) => Ok(false),
                // It has ended without having read everything.
                Err(_) if self.channel.eof() => {
                    self.outgoing = Buffer::default();
                    self.near_ended = true;
                    Ok(true)
                }
                Err(error) => Err(error),
            };
        }
        if self.near_ended && self.eof_sent.is_none() && is_done(self.channel.send_eof())? {
            self.eof_sent = Some(Instant::now());
            return Ok(true);
        }
        Ok(false)
    }

    fn take_from_far(&mut self) -> io::Result<bool> {
        if !self.incoming.is_empty() {
            return Ok(false);
        }
        let taken = count(self.incoming.fill(&mut self.channel))?;
        Ok(taken > 0)
    }

    /// Standard error is taken however full the buffer for standard output is; libssh2's reading is what moves everything
    /// else, too.
    fn take_words(&mut self) -> io::Result<bool> {
        let mut piece = [0; 4096];
        let taken = count(self.channel.stderr().read(&mut piece))?;
        self.last_words
            .extend_from_slice(piece.get(..taken).unwrap_or_default());
        if self.last_words.len() > 2 * LAST_WORDS {
            self.keep_last_words();
        }
        Ok(taken > 0)
    }

    fn keep_last_words(&mut self) {
        let surplus = self.last_words.len().saturating_sub(LAST_WORDS);
        self.last_words.drain(..surplus);
    }

    fn pass_to_near(&mut self) -> bool {
        if !self.incoming.is_empty() {
            if self.near_gone.is_some() {
                self.incoming = Buffer::default();
                return true;
            }
            return match self.incoming.drain(&mut &self.near) {
                Ok(passed) => passed > 0,
                Err(error) if is_passing(&error) => false,
                Err(_) => {
                    self.near_gone = Some(Instant::now());
                    true
                }
            };
        }
        if !self.eof_passed && self.channel.eof() {
            // Who is gone need not be told.
            let _ = self.near.shutdown(Shutdown::Write);
            self.eof_passed = true;
            return true;
        }
        false
    }

    /// Whether our side is gone, and what it left has been seen to. Who has read everything may still ask how the program
    /// ended.
    fn is_to_be_left(&self) -> bool {
        match (self.near_gone, self.eof_sent) {
            (None, _) => false,
            (Some(since), None) => since.elapsed() > DELIVERY,
            (Some(_), Some(_)) if self.eof_passed => (self.abandoned)(),
            (Some(gone), Some(sent)) => gone.max(sent).elapsed() > GRACE,
        }
    }

    fn wait(&mut self) -> io::Result<()> {
        let out = match self.link.session().block_directions() {
            BlockDirections::Outbound | BlockDirections::Both => PollFlags::OUT,
            _ => PollFlags::empty(),
        };
        let mut for_near = PollFlags::empty();
        for_near.set(PollFlags::IN, !self.near_ended && self.outgoing.is_empty());
        for_near.set(PollFlags::OUT, !self.incoming.is_empty());
        let mut ends = vec![PollFd::new(self.link.wire(), PollFlags::IN | out)];
        let time = match self.near_gone {
            // It would be ready for ever.
            Some(_) => LOOK.min(self.beat),
            None => {
                ends.push(PollFd::new(&self.near, for_near));
                self.beat
            }
        };
        let time = Timespec::try_from(time).map_err(io::Error::other)?;
        match poll(&mut ends, Some(&time)) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        let happened = |end: usize| ends.get(end).map_or(PollFlags::empty(), PollFd::revents);
        let (wire, near) = (happened(0), happened(1));
        if near.intersects(PollFlags::HUP | PollFlags::ERR) {
            self.near_gone = Some(Instant::now());
        }
        if wire.intersects(PollFlags::IN) {
            self.hear();
            return Ok(());
        }
        self.keep_alive()
    }

    /// Asks for a sign of life when none has come for a while. A connection over others is not the kernel's to watch, and
    /// a host that is stopped still acknowledges.
    fn keep_alive(&mut self) -> io::Result<()> {
        if self.heard.elapsed() < self.beat {
            return Ok(());
        }
        if self.missed_beats >= MISSED_BEATS {
            return Err(io::Error::new(
                ErrorKind::TimedOut,
                "it has given no sign of life",
            ));
        }
        self.heard = Instant::now();
        self.missed_beats += 1;
        // A half-sent one would block what comes after it: libssh2 forgets where it stood.
        let mut wire = [PollFd::new(self.link.wire(), PollFlags::OUT)];
        poll(&mut wire, Some(&Timespec::default()))?;
        if wire.iter().any(|wire| wire.revents().intersects(PollFlags::OUT)) {
            self.link.session().keepalive_send()?;
            self.listen()?;
        }
        Ok(())
    }

    /// Waits a moment for the answer. One that comes before the next look would be read with the rest and not be seen:
    /// libssh2 keeps it to itself.
    fn listen(&mut self) -> io::Result<()> {
        let mut wire = [PollFd::new(self.link.wire(), PollFlags::IN)];
        let time = Timespec::try_from(ANSWER.min(self.beat)).map_err(io::Error::other)?;
        match poll(&mut wire, Some(&time)) {
            Ok(0) | Err(Errno::INTR) => {}
            Ok(_) => self.hear(),
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    fn hear(&mut self) {
        self.heard = Instant::now();
        self.missed_beats = 0;
    }

    fn ended_there(&mut self) -> io::Result<Ended> {
        self.keep_last_words();
        let signal = self.channel.exit_signal()?.exit_signal;
        let code = match signal {
            Some(_) => None,
            None => Some(self.channel.exit_status()?),
        };
        Ok(Ended::There {
            code,
            last_words: std::mem::take(&mut self.last_words),
        })
    }

    /// Closes the channel and leaves the session as it was, for whoever uses it next.
    fn close(&mut self) -> io::Result<()> {
        let session = self.link.session();
        session.set_keepalive(false, 0);
        session.set_blocking(true);
        let usual = session.timeout();
        session.set_timeout(milliseconds(CLOSING));
        let closed = self.channel.close();
        session.set_timeout(usual);
        Ok(closed?)
    }
}

/// How many bytes have come; none where none are there yet.
fn count(read: io::Result<usize>) -> io::Result<usize> {
    match read {
        Err(error) if is_passing(&error) => Ok(0),
        other => other,
    }
}

/// Whether libssh2 has done what it could not do at once.
fn is_done(done: Result<(), ssh2::Error>) -> io::Result<bool> {
    match done.map_err(io::Error::from) {
        Ok(()) => Ok(true),
        Err(error) if is_passing(&error) => Ok(false),
        Err(error) => Err(error),
    }
}

fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Bytes on their way. libssh2 wants to see the same ones at the same place when it is asked again.
struct Buffer {
    bytes: Box<[u8]>,
    start: usize,
    end: usize,
}

impl Default for Buffer {
    fn default() -> Self {
        Self {
            bytes: vec![0; BUFFER].into_boxed_slice(),
            start: 0,
            end: 0,
        }
    }
}

impl Buffer {
    fn is_empty(&self) -> bool {
        self.start == self.end
    }

    /// To be called when it is empty.
    fn fill(&mut self, from: &mut impl Read) -> io::Result<usize> {
        let read = from.read(&mut self.bytes)?;
        (self.start, self.end) = (0, read);
        Ok(read)
    }

    fn drain(&mut self, into: &mut impl Write) -> io::Result<usize> {
        let written = into.write(self.bytes.get(self.start..self.end).unwrap_or_default())?;
        self.start += written;
        Ok(written)
    }
}
