//! How everything that waits is told to end. The main type is [`Stop`].
//!
//! A thread here waits for a socket; closing the socket from elsewhere races with the next one being opened. So each
//! wait also watches one end of a socket pair, which is hung up for good when the stop is raised.

use std::{
    io,
    net::Shutdown,
    os::{
        fd::{AsFd, BorrowedFd},
        unix::net::UnixStream,
    },
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, PollTimeout, poll},
};

/// Raised once, for all that hold a clone.
#[derive(Debug, Clone)]
pub(super) struct Stop(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    raised: AtomicBool,
    held: UnixStream,
    watched: UnixStream,
}

/// Why a wait ended without what it waited for.
#[derive(Debug, thiserror::Error)]
pub(super) enum WaitError {
    #[error("the node is shutting down")]
    Stopped,
    #[error("it took too long")]
    TimedOut,
    #[error("the peer closed the connection")]
    Closed,
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl Stop {
    pub fn new() -> io::Result<Self> {
        let (held, watched) = UnixStream::pair()?;
        Ok(Self(Arc::new(Inner {
            raised: AtomicBool::new(false),
            held,
            watched,
        })))
    }

    pub fn raise(&self) {
        self.0.raised.store(true, Ordering::SeqCst);
        // It fails only if it has been shut down before.
        let _ = self.0.held.shutdown(Shutdown::Both);
    }

    pub fn is_raised(&self) -> bool {
        self.0.raised.load(Ordering::SeqCst)
    }

    /// Waits until one of the files is ready for what is wanted of it.
    pub fn wait(
        &self,
        files: &[(BorrowedFd<'_>, PollFlags)],
        deadline: Option<Instant>,
    ) -> Result<(), WaitError> {
        let mut watched: Vec<PollFd<'_>> = files.iter().map(|(fd, want)| PollFd::new(*fd, *want)).collect();
        watched.push(PollFd::new(self.0.watched.as_fd(), PollFlags::POLLIN));
        loop {
            if self.is_raised() {
                return Err(WaitError::Stopped);
            }
            match poll(&mut watched, until(deadline)) {
                Ok(0) if deadline.is_some_and(|deadline| deadline <= Instant::now()) => {
                    return Err(WaitError::TimedOut);
                }
                Ok(0) | Err(Errno::EINTR) => {}
                Ok(_) if self.is_raised() => return Err(WaitError::Stopped),
                Ok(_) => return Ok(()),
                Err(errno) => return Err(WaitError::Io(errno.into())),
            }
        }
    }

    /// Waits for this long, or until the stop is raised.
    pub fn rest(&self, time: Duration) -> Result<(), WaitError> {
        match self.wait(&[], Some(Instant::now() + time)) {
            Err(WaitError::TimedOut) => Ok(()),
            other => other,
        }
    }
}

/// The time to a deadline, in the whole milliseconds that `poll` takes; rounded up, so that it is not asked in vain.
fn until(deadline: Option<Instant>) -> PollTimeout {
    deadline.map_or(PollTimeout::NONE, |deadline| {
        let left = deadline.saturating_duration_since(Instant::now());
        let milliseconds = left.as_micros().div_ceil(1000);
        PollTimeout::try_from(milliseconds).unwrap_or(PollTimeout::MAX)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raised_stop_ends_a_wait_without_deadline() {
        let stop = Stop::new().unwrap();
        let waiting = std::thread::spawn({
            let stop = stop.clone();
            move || stop.wait(&[], None)
        });
        stop.raise();
        assert!(matches!(waiting.join().unwrap(), Err(WaitError::Stopped)));
        assert!(matches!(
            stop.rest(Duration::from_secs(60)),
            Err(WaitError::Stopped)
        ));
    }

    #[test]
    fn a_wait_ends_at_its_deadline() {
        let stop = Stop::new().unwrap();
        let before = Instant::now();
        stop.rest(Duration::from_millis(5)).unwrap();
        assert!(before.elapsed() >= Duration::from_millis(5));
    }
}
