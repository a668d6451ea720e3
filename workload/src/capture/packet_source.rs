//! Where a capture's packets come from. The trait is [`PacketSource`]; [`super::sources`] has those that there are.

use std::{
    os::fd::{AsFd, BorrowedFd},
    time::Duration,
};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, ppoll},
    sys::{eventfd::EventFd, time::TimeSpec},
};

use super::error::CaptureError;

/// Gives the packets of one interface, both directions, in the order in which the kernel queued them.
pub trait PacketSource: Send {
    /// Sleeps until there is something to read, the eventfd is written, or the time is up.
    ///
    /// # Errors
    /// If there will be no more packets.
    fn wait(&self, wake: &EventFd, timeout: Option<Duration>) -> Result<Wakened, CaptureError>;

    /// Reads the next packet into the buffer, as much of it as there is room for; nothing if none waits.
    ///
    /// # Errors
    /// If there will be no more packets.
    fn receive(&mut self, buffer: &mut [u8]) -> Result<Option<Packet>, CaptureError>;

    /// How many packets were lost before they could be read since the last call.
    ///
    /// # Errors
    /// If that cannot be known.
    fn take_drops(&mut self) -> Result<u64, CaptureError>;

    /// How long after its stamp a packet may come.
    fn latest_after_ns(&self) -> i64;

    /// What captures, and its version if it is not ours.
    fn tool(&self) -> String;
}

/// A packet that was read into a buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet {
    /// The kernel's stamp: wall clock, nanoseconds since 1970.
    pub stamp_unix_ns: i64,
    /// Bytes in the buffer.
    pub kept_bytes: usize,
    /// Bytes of the whole packet.
    pub original_bytes: usize,
}

/// Why a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wakened {
    /// The eventfd was written.
    ByOwner,
    /// Packets have come, or the time is up.
    ByPacketOrTime,
}

/// Sleeps until a source has something, the eventfd is written, or the time is up.
///
/// # Errors
/// What the kernel says.
pub(super) fn wait_for(
    source: BorrowedFd<'_>,
    wake: &EventFd,
    timeout: Option<Duration>,
) -> Result<Wakened, Errno> {
    let mut fds = [
        PollFd::new(source, PollFlags::POLLIN),
        PollFd::new(wake.as_fd(), PollFlags::POLLIN),
    ];
    match ppoll(&mut fds, timeout.map(TimeSpec::from), None) {
        Ok(_) => {}
        Err(Errno::EINTR) => return Ok(Wakened::ByPacketOrTime),
        Err(error) => return Err(error),
    }
    let [_, wake] = fds;
    Ok(if wake.any().unwrap_or(false) {
        Wakened::ByOwner
    } else {
        Wakened::ByPacketOrTime
    })
}
