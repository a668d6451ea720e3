//! A TCP connection on which nothing waits longer than it was told to. The main type is [`Socket`].

use std::{
    io::{self, ErrorKind, Read, Write},
    net::{SocketAddr, SocketAddrV4, TcpListener, TcpStream},
    os::fd::{AsFd, AsRawFd},
    sync::Arc,
    time::{Duration, Instant},
};

use nix::{
    errno::Errno,
    poll::PollFlags,
    sys::socket::{self, AddressFamily, SockFlag, SockType, SockaddrIn, setsockopt, sockopt},
};

use super::stop::{Stop, WaitError};

/// When further attempts at a connection are begun beside the first. A lost SYN is sent again after a second only; at
/// the paper's 2 % loss each way that would befall one connection in twenty-five, and a start needs a dozen of them.
const FURTHER_ATTEMPTS: [Duration; 3] = [
    Duration::from_millis(150),
    Duration::from_millis(450),
    Duration::from_millis(1050),
];

/// As rospy: a peer whose host has vanished is noticed after two and a half minutes.
const KEEPALIVE_IDLE_S: u32 = 60;
const KEEPALIVE_INTERVAL_S: u32 = 10;
const KEEPALIVE_PROBES: u32 = 9;

/// A connection whose waits end at deadlines, or when the stop is raised.
#[derive(Debug)]
pub(super) struct Socket {
    stream: Arc<TcpStream>,
    stop: Stop,
}

impl Socket {
    /// Takes over an accepted connection.
    pub fn adopt(stream: TcpStream, stop: Stop) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        setsockopt(&stream, sockopt::KeepAlive, &true)?;
        setsockopt(&stream, sockopt::TcpKeepIdle, &KEEPALIVE_IDLE_S)?;
        setsockopt(&stream, sockopt::TcpKeepInterval, &KEEPALIVE_INTERVAL_S)?;
        setsockopt(&stream, sockopt::TcpKeepCount, &KEEPALIVE_PROBES)?;
        Ok(Self {
            stream: Arc::new(stream),
            stop,
        })
    }

    /// Connects; the first of several attempts to succeed wins, see [`FURTHER_ATTEMPTS`].
    pub fn connect(to: SocketAddrV4, stop: &Stop, deadline: Instant) -> Result<Self, WaitError> {
        let begun = Instant::now();
        let mut further = FURTHER_ATTEMPTS.iter().map(|after| begun + *after).peekable();
        let mut attempts = vec![begin_to_connect(to)?];
        loop {
            let files: Vec<_> = attempts
                .iter()
                .map(|stream| (stream.as_fd(), PollFlags::POLLOUT))
                .collect();
            let next = further.peek().copied().filter(|next| *next < deadline);
            match stop.wait(&files, Some(next.unwrap_or(deadline))) {
                Ok(()) => {}
                Err(WaitError::TimedOut) if next.is_some() => {
                    further.next();
                    attempts.push(begin_to_connect(to)?);
                    continue;
                }
                Err(error) => return Err(error),
            }
            let mut pending = Vec::with_capacity(attempts.len());
            for stream in attempts {
                if let Some(error) = stream.take_error()? {
                    return Err(error.into());
                }
                match stream.peer_addr() {
                    Ok(_) => return Ok(Self::adopt(stream, stop.clone())?),
                    Err(error) if error.kind() == ErrorKind::NotConnected => pending.push(stream),
                    Err(error) => return Err(error.into()),
                }
            }
            attempts = pending;
        }
    }

    /// The stream itself, which does not block.
    pub fn stream(&self) -> &Arc<TcpStream> {
        &self.stream
    }

    pub fn set_nodelay(&self) -> io::Result<()> {
        self.stream.set_nodelay(true)
    }

    /// Waits for bytes and reads what is there: at least one, unless the peer has closed.
    pub fn read(&self, buffer: &mut [u8], deadline: Option<Instant>) -> Result<usize, WaitError> {
        loop {
            if self.stop.is_raised() {
                return Err(WaitError::Stopped);
            }
            match (&*self.stream).read(buffer) {
                Ok(0) => return Err(WaitError::Closed),
                Ok(count) => return Ok(count),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    self.stop
                        .wait(&[(self.stream.as_fd(), PollFlags::POLLIN)], deadline)?;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Writes all of it.
    pub fn write_all(&self, mut bytes: &[u8], deadline: Instant) -> Result<(), WaitError> {
        while !bytes.is_empty() {
            match (&*self.stream).write(bytes) {
                Ok(0) => return Err(WaitError::Closed),
                Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    self.stop
                        .wait(&[(self.stream.as_fd(), PollFlags::POLLOUT)], Some(deadline))?;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }
}

/// Starts a connection without waiting for it.
fn begin_to_connect(to: SocketAddrV4) -> io::Result<TcpStream> {
    let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
    let socket = socket::socket(AddressFamily::Inet, SockType::Stream, flags, None)?;
    match socket::connect(socket.as_raw_fd(), &SockaddrIn::from(to)) {
        Ok(()) | Err(Errno::EINPROGRESS) => Ok(TcpStream::from(socket)),
        Err(errno) => Err(errno.into()),
    }
}

/// Accepts connections until the stop is raised, and gives each to `on_connection`.
pub(super) fn accept_all(
    listener: &TcpListener,
    stop: &Stop,
    mut on_connection: impl FnMut(TcpStream, SocketAddr),
) -> Result<(), WaitError> {
    listener.set_nonblocking(true)?;
    loop {
        match listener.accept() {
            Ok((stream, peer)) => on_connection(stream, peer),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                stop.wait(&[(listener.as_fd(), PollFlags::POLLIN)], None)?;
            }
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::Interrupted | ErrorKind::ConnectionAborted
                ) => {}
            // Out of file descriptors or memory: the connection stays in the backlog, and others may end meanwhile.
            Err(_) => stop.rest(Duration::from_millis(100))?,
        }
        if stop.is_raised() {
            return Err(WaitError::Stopped);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn soon() -> Instant {
        Instant::now() + Duration::from_secs(10)
    }

    fn v4(listener: &TcpListener) -> SocketAddrV4 {
        match listener.local_addr().unwrap() {
            SocketAddr::V4(address) => address,
            SocketAddr::V6(address) => panic!("{address}"),
        }
    }

    #[test]
    fn a_refused_connection_fails_at_once() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = v4(&listener);
        drop(listener);
        let error = Socket::connect(address, &Stop::new().unwrap(), soon()).unwrap_err();
        assert!(
            matches!(&error, WaitError::Io(io) if io.kind() == ErrorKind::ConnectionRefused),
            "{error}"
        );
    }

    #[test]
    fn bytes_go_through_and_a_closed_end_is_told_apart_from_a_silent_one() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let stop = Stop::new().unwrap();
        let near = Socket::connect(v4(&listener), &stop, soon()).unwrap();
        let far = Socket::adopt(listener.accept().unwrap().0, stop).unwrap();
        near.write_all(b"hello", soon()).unwrap();
        let mut buffer = [0; 16];
        assert_eq!(far.read(&mut buffer, Some(soon())).unwrap(), 5);
        let silent = far.read(&mut buffer, Some(Instant::now() + Duration::from_millis(1)));
        assert!(matches!(silent, Err(WaitError::TimedOut)));
        drop(near);
        assert!(matches!(
            far.read(&mut buffer, Some(soon())),
            Err(WaitError::Closed)
        ));
    }
}
