//! Where a capture's packets come from: our own socket, or tcpdump. The main type is [`PacketSource`]; [`open`] chooses.

use std::{
    os::fd::{AsFd, BorrowedFd},
    time::Duration,
};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, ppoll},
    sys::{eventfd::EventFd, time::TimeSpec},
};

use super::{CaptureError, filter, packet_socket::PacketSocket, stamping, tcpdump::Tcpdump};
use crate::{
    settings::{CaptureSettings, CaptureTool},
    virtual_host::VirtualHost,
};

/// Gives the packets of one interface, both directions, in the order in which the kernel queued them.
pub trait PacketSource: Send {
    /// Sleeps until there is something to read, the eventfd is written, or the time is up.
    ///
    /// # Errors
    /// If there will be no more packets.
    fn wait(&self, wake: &EventFd, patience: Option<Duration>) -> Result<Wakened, CaptureError>;

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

/// Opens a source on an interface of the calling thread's namespace, as the settings ask. Call it on the thread that
/// will read: a tool ends with the thread that started it.
///
/// # Errors
/// If there is no such interface, no right to it, or no such tool.
pub fn open(
    host: VirtualHost,
    interface: &str,
    settings: &CaptureSettings,
) -> Result<Box<dyn PacketSource>, CaptureError> {
    let source: Box<dyn PacketSource> = match settings.tool {
        CaptureTool::Builtin => {
            let filter = settings.filter.as_deref().map(filter::compile).transpose()?;
            Box::new(PacketSocket::open(host, interface, filter.as_deref())?)
        }
        CaptureTool::Tcpdump => Box::new(Tcpdump::start(host, interface, settings)?),
    };
    stamping::wait_until_live().map_err(|source| CaptureError::Socket {
        host,
        action: "waiting for the kernel to stamp packets",
        source,
    })?;
    Ok(source)
}

/// Sleeps until a source has something, the eventfd is written, or the time is up.
///
/// # Errors
/// What the kernel says.
pub(super) fn wait_for(
    source: BorrowedFd<'_>,
    wake: &EventFd,
    patience: Option<Duration>,
) -> Result<Wakened, Errno> {
    let mut fds = [
        PollFd::new(source, PollFlags::POLLIN),
        PollFd::new(wake.as_fd(), PollFlags::POLLIN),
    ];
    match ppoll(&mut fds, patience.map(TimeSpec::from), None) {
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

/// Whether such captures can be made here.
///
/// # Errors
/// What is missing.
pub fn survey(settings: &CaptureSettings) -> Result<(), CaptureError> {
    if settings.tool == CaptureTool::Tcpdump {
        super::tcpdump::survey()?;
    }
    settings
        .filter
        .as_deref()
        .map_or(Ok(()), |expression| filter::compile(expression).map(drop))
}
