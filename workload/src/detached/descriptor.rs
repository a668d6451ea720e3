//! Waiting for file descriptors. The function is [`wait`].

use std::{
    io,
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, Timespec, poll},
    io::Errno,
};

/// Waits until one of them has what it is waited for, or for that long. Whether one had.
///
/// # Errors
/// When the kernel refuses.
pub fn wait(descriptors: &mut [PollFd<'_>], longest: Option<Duration>) -> io::Result<bool> {
    // A time too far off to be told is as good as none.
    let deadline = longest.and_then(|longest| Instant::now().checked_add(longest));
    loop {
        let left = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        let timeout = left.and_then(|left| Timespec::try_from(left).ok());
        match poll(descriptors, timeout.as_ref()) {
            Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
            Ok(ready) => return Ok(ready > 0),
        }
    }
}
