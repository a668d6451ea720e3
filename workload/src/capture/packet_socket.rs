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
    sys::{
        eventfd::EventFd,
        socket::{
            AddressFamily, ControlMessageOwned, MsgFlags, SockFlag, SockType, recvmsg, setsockopt, socket,
            sockopt,
        },
    },
};
use record::virtual_host::VirtualHost;

use super::{
    error::CaptureError,
    filter::Instruction,
    packet_source::{Packet, PacketSource, Wakened, wait_for},
};

/// Room for packets that wait to be read: what the experiment sends in many seconds, so that a slow disk loses none.
const RECEIVE_BUFFER_BYTES: usize = 16 << 20;

/// `PACKET_STATISTICS` of `linux/if_packet.h`.
const PACKET_STATISTICS: libc::c_int = 6;

/// Longer than the kernel takes from stamping a packet to queueing it for the socket.
const LATEST_AFTER_NS: i64 = 10_000_000;

/// Sees all packets of one interface that its filter lets through. It never blocks but in [`PacketSource::wait`].
#[derive(Debug)]
pub struct PacketSocket {
    host: VirtualHost,
    socket: OwnedFd,
}

impl PacketSocket {
    /// Opens a socket on an interface of the calling thread's namespace.
    ///
    /// # Errors
    /// What failed, and what the kernel said.
    pub fn open(
        host: VirtualHost,
        interface: &str,
        filter: Option<&[Instruction]>,
    ) -> Result<Self, CaptureError> {
        let failed = |action| move |source| CaptureError::Socket { host, action, source };
        // Protocol 0 sees no packet: all options are set before the first one comes.
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        let socket = socket(AddressFamily::Packet, SockType::Raw, flags, None)
            .map_err(failed("opening a packet socket"))?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true).map_err(failed("asking for time stamps"))?;
        setsockopt(&socket, sockopt::RcvBufForce, &RECEIVE_BUFFER_BYTES)
            .or_else(|_| setsockopt(&socket, sockopt::RcvBuf, &RECEIVE_BUFFER_BYTES))
            .map_err(failed("asking for a large buffer"))?;
        if let Some(filter) = filter {
            attach(&socket, filter).map_err(failed("attaching the filter"))?;
        }
        let index = if_nametoindex(interface).map_err(failed("finding the interface"))?;
        bind_to_all_protocols(&socket, index).map_err(failed("binding the packet socket"))?;
        Ok(Self { host, socket })
    }

    fn failed(&self, action: &'static str) -> impl FnOnce(Errno) -> CaptureError + use<> {
        let host = self.host;
        move |source| CaptureError::Socket { host, action, source }
    }

    fn receive_one(&self, buffer: &mut [u8]) -> Result<Option<Packet>, Errno> {
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

    /// Packets that found no room in the buffer since the last call.
    fn dropped(&self) -> Result<u64, Errno> {
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

impl PacketSource for PacketSocket {
    fn wait(&self, wake: &EventFd, timeout: Option<Duration>) -> Result<Wakened, CaptureError> {
        wait_for(self.socket.as_fd(), wake, timeout).map_err(self.failed("waiting for packets"))
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Result<Option<Packet>, CaptureError> {
        self.receive_one(buffer).map_err(self.failed("reading packets"))
    }

    fn take_drops(&mut self) -> Result<u64, CaptureError> {
        self.dropped().map_err(self.failed("counting what was dropped"))
    }

    fn latest_after_ns(&self) -> i64 {
        LATEST_AFTER_NS
    }

    fn tool(&self) -> String {
        "builtin".to_owned()
    }
}

/// `SO_ATTACH_FILTER` of socket(7).
fn attach(socket: &OwnedFd, filter: &[Instruction]) -> Result<(), Errno> {
    let mut filter: Vec<libc::sock_filter> = filter
        .iter()
        .map(|instruction| libc::sock_filter {
            code: instruction.code,
            jt: instruction.jump_if,
            jf: instruction.jump_if_not,
            k: instruction.operand,
        })
        .collect();
    let program = libc::sock_fprog {
        len: u16::try_from(filter.len()).map_err(|_| Errno::EINVAL)?,
        filter: filter.as_mut_ptr(),
    };
    // SAFETY: the program and its instructions live until the call returns, in which the kernel copies them.
    let outcome = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_ATTACH_FILTER,
            (&raw const program).cast(),
            size_of_val(&program) as libc::socklen_t,
        )
    };
    Errno::result(outcome).map(drop)
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
