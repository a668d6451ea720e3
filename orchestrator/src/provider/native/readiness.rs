//! Waiting for a file descriptor of the kernel's that is neither a socket nor a pipe. The function is [`watch`].
#![allow(unsafe_code)] // tokio cannot know of a foreign type that it keeps its descriptor open, and so asks us.

use std::{io, os::fd::OwnedFd};

use tokio::io::{Interest, unix::AsyncFd};

/// Registers the descriptor, to be waited for until it is readable.
///
/// # Errors
/// When the runtime cannot watch it.
pub fn watch(descriptor: OwnedFd) -> io::Result<AsyncFd<OwnedFd>> {
    // SAFETY: the descriptor must stay open, and the same, for as long as it is registered. An OwnedFd closes its
    // descriptor only when it is dropped, always names the same one, and is owned by the AsyncFd from here on.
    let registered = unsafe { AsyncFd::register_with_interest(descriptor, Interest::READABLE) };
    registered.map_err(io::Error::from)
}
