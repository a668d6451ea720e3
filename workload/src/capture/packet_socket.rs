//! A packet socket on one interface: see packet(7). The main type is [`PacketSocket`].

// Binding a packet socket and reading its statistics have no safe interface in nix.
#![allow(unsafe_code)]

use std::{
    io::IoSliceMut,
    mem,
    os::fd::{AsFd, AsRawFd, OwnedFd},
    time::Duration,
};

use nix::{
    cmsg_space,
    errno::Errno,
    net::if_::if_nametoindex,
    poll::{PollFd, PollFlags, ppoll},
    sys::{
        eventfd::EventFd,
        socket::{
            AddressFamily, ControlMessageOwned, MsgFlags, SockFlag, SockType, recvmsg, setsockopt, socket,
            sockopt,
        },
        time::TimeSpec,
    },
};

/// Room for packets that wait to be read: what the experiment sends in many seconds, so that a slow disk loses none.
const RECEIVE_BUFFER_BYTES: usize = 16 << 20;

/// `PACKET_STATISTICS` of `linux/if_packet.h`.
const PACKET_STATISTICS: libc::c_int = 6;

/// Sees all packets of one interface, both directions. It never blocks but in [`PacketSocket::wait`].
#[derive(Debug)]
pub struct PacketSocket {
    socket: OwnedFd,
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

impl PacketSocket {
    /// Opens a socket on an interface of the calling thread's namespace.
    ///
    /// # Errors
    /// What failed, and what the kernel said.
    pub fn open(interface: &str) -> Result<Self, (&'static str, Errno)> {
        let failed = |action| move |source| (action, source);
        // Protocol 0 sees no packet: all options are set before the first one comes.
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        let socket = socket(AddressFamily::Packet, SockType::Raw, flags, None)
            .map_err(failed("opening a packet socket"))?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true).map_err(failed("asking for time stamps"))?;
        setsockopt(&socket, sockopt::RcvBufForce, &RECEIVE_BUFFER_BYTES)
            .or_else(|_| setsockopt(&socket, sockopt::RcvBuf, &RECEIVE_BUFFER_BYTES))
            .map_err(failed("asking for a large buffer"))?;
        let index = if_nametoindex(interface).map_err(failed("finding the interface"))?;
        bind_to_all_protocols(&socket, index).map_err(failed("binding the packet socket"))?;
        Ok(Self { socket })
    }

    /// Sleeps until there is something to read, the eventfd is written, or the time is up.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn wait(&self, wake: &EventFd, patience: Option<Duration>) -> Result<Wakened, Errno> {
        let mut fds = [
            PollFd::new(self.socket.as_fd(), PollFlags::POLLIN),
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

    /// Reads the next packet into the buffer, as much of it as there is room for; nothing if none waits.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn receive(&self, buffer: &mut [u8]) -> Result<Option<Packet>, Errno> {
        let room = buffer.len();
        let mut control = cmsg_space!(libc::timespec);
        let mut parts = [IoSliceMut::new(buffer)];
        // With MSG_TRUNC the kernel says how long the packet was, not how much of it there was room for.
        let flags = MsgFlags::MSG_TRUNC | MsgFlags::MSG_DONTWAIT;
        let message = match recvmsg::<()>(self.socket.as_raw_fd(), &mut parts, Some(&mut control), flags) {
            Ok(message) => message,
            Err(Errno::EAGAIN | Errno::EINTR) => return Ok(None),
            Err(error) => return Err(error),
        };
        let stamp = message.cmsgs()?.find_map(|part| match part {
            ControlMessageOwned::ScmTimestampns(stamp) => Some(stamp),
            _ => None,
        });
        let since_1970 = Duration::from(stamp.ok_or(Errno::ENODATA)?);
        let stamp_unix_ns = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
        Ok(Some(Packet {
            stamp_unix_ns,
            kept_bytes: message.bytes.min(room),
            original_bytes: message.bytes,
        }))
    }

    /// How many packets found no room in the buffer since the last call.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn take_drops(&self) -> Result<u64, Errno> {
        // struct tpacket_stats: packets seen, packets dropped.
        let mut statistics = [0_u32; 2];
        let mut length = size_of_val(&statistics) as libc::socklen_t;
        // SAFETY: the buffer and its length live until the call returns, and the kernel writes no more than the length.
        let outcome = unsafe {
            libc::getsockopt(
                self.socket.as_raw_fd(),
                libc::SOL_PACKET,
                PACKET_STATISTICS,
                statistics.as_mut_ptr().cast(),
                &mut length,
            )
        };
        Errno::result(outcome)?;
        let [_, dropped] = statistics;
        Ok(dropped.into())
    }
}

fn bind_to_all_protocols(socket: &OwnedFd, interface_index: u32) -> Result<(), Errno> {
    // SAFETY: sockaddr_ll is plain data, for which all zero is a valid value.
    let mut address: libc::sockaddr_ll = unsafe { mem::zeroed() };
    address.sll_family = libc::AF_PACKET as u16;
    address.sll_protocol = (libc::ETH_P_ALL as u16).to_be();
    address.sll_ifindex = i32::try_from(interface_index).map_err(|_| Errno::EINVAL)?;
    let length = size_of_val(&address) as libc::socklen_t;
    // SAFETY: the address lives until the call returns and has the length that is given.
    let outcome = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) };
    Errno::result(outcome).map(drop)
}
