//! A connection to a host that has let us in. The main type is [`Link`].
//!
//! libssh2 has one lock for each session, so that a link carries one channel at a time and belongs to the thread that
//! serves it. Whatever libssh2 waits for here has a bound. Its own clearing up has none where the other side is silent:
//! the connection is shut down before, so that a link can be dropped at any moment.

use std::{
    io,
    net::{Shutdown, TcpStream, ToSocketAddrs as _},
    os::{
        fd::{AsFd, AsRawFd, BorrowedFd, RawFd},
        unix::net::UnixStream,
    },
    thread,
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    net::sockopt::set_tcp_user_timeout,
};
use ssh2::{Channel, MethodType, Session};

use super::{
    SshError,
    hop::Hop,
    known_hosts::KnownHosts,
    login::log_in,
    pump::{self, BEAT},
};

/// How long connecting may take, and then each answer of the handshake, of the login and of what is asked for later.
const TIMEOUT: Duration = Duration::from_secs(10);
/// The fastest first: with AES-GCM a packet is encrypted and authenticated at once, by the processor's own instructions.
const CIPHERS: &str = "aes128-gcm@openssh.com,aes256-gcm@openssh.com,chacha20-poly1305@openssh.com,aes128-ctr,aes192-ctr,aes256-ctr";
/// How long what we have sent may stay without an acknowledgement before the kernel calls the connection dead.
const UNACKNOWLEDGED: Duration = Duration::from_secs(60);

/// An authenticated session.
pub struct Link {
    session: Session,
    wire: Wire,
}

/// What a session's bytes go over.
pub enum Wire {
    /// To the host itself.
    Tcp(TcpStream),
    /// To the thread that serves the link to a host on the way.
    Through(UnixStream),
}

impl Wire {
    fn try_clone(&self) -> io::Result<Self> {
        Ok(match self {
            Self::Tcp(stream) => Self::Tcp(stream.try_clone()?),
            Self::Through(stream) => Self::Through(stream.try_clone()?),
        })
    }

    fn shut_down(&self) {
        // That it is shut down already is what is wanted.
        let _ = match self {
            Self::Tcp(stream) => stream.shutdown(Shutdown::Both),
            Self::Through(stream) => stream.shutdown(Shutdown::Both),
        };
    }
}

impl AsFd for Wire {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Tcp(stream) => stream.as_fd(),
            Self::Through(stream) => stream.as_fd(),
        }
    }
}

impl AsRawFd for Wire {
    fn as_raw_fd(&self) -> RawFd {
        self.as_fd().as_raw_fd()
    }
}

impl Link {
    /// Connects to the last host of a route through those before it. Takes its time: not for a thread that has others to
    /// serve.
    ///
    /// # Errors
    /// With the host that could not be reached or did not let us in.
    pub fn connect(route: &[Hop]) -> Result<Self, SshError> {
        let mut hops = route.iter();
        let mut behind = hops
            .next()
            .ok_or_else(|| io::Error::other("a route without hosts"))?;
        let mut link = Self::log_in(Wire::Tcp(dial(behind)?), behind)?;
        for hop in hops {
            link = Self::log_in(link.pass_through(behind, hop)?, hop)?;
            behind = hop;
        }
        Ok(link)
    }

    fn log_in(wire: Wire, hop: &Hop) -> Result<Self, SshError> {
        let handshake = |source| SshError::Handshake {
            place: hop.place(),
            source,
        };
        let mut session = Session::new().map_err(handshake)?;
        session.set_timeout(milliseconds(TIMEOUT));
        session.set_tcp_stream(wire.try_clone()?);
        // From here on the wire is shut down whatever happens.
        let mut link = Self { session, wire };
        let known_hosts = KnownHosts::of(hop)?;
        known_hosts.prefer(&link.session).map_err(handshake)?;
        for direction in [MethodType::CryptCs, MethodType::CryptSc] {
            link.session.method_pref(direction, CIPHERS).map_err(handshake)?;
        }
        link.session.handshake().map_err(handshake)?;
        known_hosts.check(&link.session)?;
        log_in(&link.session, hop)?;
        Ok(link)
    }

    /// The wire to a host behind this one, which another thread serves from now on.
    fn pass_through(self, hop: &Hop, to: &Hop) -> Result<Wire, SshError> {
        let channel = self
            .session
            .channel_direct_tcpip(&to.host, to.port, None)
            .map_err(|source| SshError::Jump {
                through: hop.place(),
                place: to.place(),
                source,
            })?;
        let (ours, theirs) = UnixStream::pair()?;
        thread::Builder::new()
            .name("ssh-jump".to_owned())
            .spawn(move || {
                // What goes wrong is noticed by the session that goes through.
                let _ = pump::pump(&self, channel, theirs, BEAT, &|| true);
            })?;
        Ok(Wire::Through(ours))
    }

    /// A channel for a program.
    ///
    /// # Errors
    /// When the host refuses, or the link was cut.
    pub fn program(&self) -> Result<Channel, ssh2::Error> {
        self.session.channel_session()
    }

    /// A channel to a TCP port, of a name or address as the host resolves it.
    ///
    /// # Errors
    /// When the host refuses, nobody listens, or the link was cut.
    pub fn tcp(&self, host: &str, port: u16) -> Result<Channel, ssh2::Error> {
        self.session.channel_direct_tcpip(host, port, None)
    }

    /// A channel to a socket in the host's file system.
    ///
    /// # Errors
    /// When the host refuses, nobody listens, or the link was cut.
    pub fn unix(&self, path: &str) -> Result<Channel, ssh2::Error> {
        self.session.channel_direct_streamlocal(path, None)
    }

    /// Its session.
    pub(super) fn session(&self) -> &Session {
        &self.session
    }

    /// What it goes over.
    pub(super) fn wire(&self) -> &Wire {
        &self.wire
    }

    /// Ends it, so that nothing which is left of it can wait for an answer.
    pub(super) fn cut(&self) {
        self.wire.shut_down();
    }

    /// Whether nobody has ended it. That it was cut in silence is found out only by using it.
    pub fn is_open(&self) -> bool {
        let mut wire = [PollFd::new(&self.wire, PollFlags::RDHUP)];
        let ended = PollFlags::RDHUP | PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
        let looked = poll(&mut wire, Some(&Timespec::default()));
        looked.is_ok() && wire.iter().all(|wire| !wire.revents().intersects(ended))
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.cut();
    }
}

/// Connects to the first address that answers.
fn dial(hop: &Hop) -> Result<TcpStream, SshError> {
    let failed = |source| SshError::Connect {
        place: hop.place(),
        source,
    };
    let until = Instant::now() + TIMEOUT;
    let mut error = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    for address in (hop.host.as_str(), hop.port).to_socket_addrs().map_err(failed)? {
        let left = until.saturating_duration_since(Instant::now());
        // The bound must not be zero; who has had no time yet gets a little.
        match TcpStream::connect_timeout(&address, left.max(Duration::from_secs(1))) {
            Ok(stream) => {
                stream.set_nodelay(true).map_err(failed)?;
                set_tcp_user_timeout(&stream, milliseconds(UNACKNOWLEDGED))
                    .map_err(|error| failed(error.into()))?;
                return Ok(stream);
            }
            Err(another) => error = another,
        }
    }
    Err(failed(error))
}

/// For those who count them in 32 bits.
pub(super) fn milliseconds(time: Duration) -> u32 {
    u32::try_from(time.as_millis()).unwrap_or(u32::MAX)
}
