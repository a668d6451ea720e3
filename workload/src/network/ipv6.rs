//! Keeps IPv6 off the links: without an address the kernel neither looks for routers nor reports multicast groups, so
//! that captures show the experiment's packets and no others.
//!
//! The usual switch, `/proc/sys/net/ipv6/conf/…`, is read-only in a Docker container. The netlink attribute
//! `IFLA_INET6_ADDR_GEN_MODE` (rtnetlink(7), Linux `net/ipv6/addrconf.c`) works the same everywhere.

use std::os::fd::{AsRawFd, OwnedFd};

use nix::{
    errno::Errno,
    libc,
    sys::socket::{AddressFamily, MsgFlags, SockFlag, SockProtocol, SockType, recv, send, socket},
};

/// `IN6_ADDR_GEN_MODE_NONE` of `linux/if_link.h`.
const GENERATE_NO_ADDRESS: u8 = 1;

/// `IFLA_INET6_ADDR_GEN_MODE` of `linux/if_link.h`.
const IFLA_INET6_ADDR_GEN_MODE: u16 = 8;

/// `NLM_F_REQUEST | NLM_F_ACK`.
const REQUEST_WITH_ANSWER: u16 = 0x01 | 0x04;

/// Length of a netlink message's header, `struct nlmsghdr`.
const HEADER_BYTES: usize = 16;

/// Has the interface of the calling thread's namespace make no IPv6 address when it goes up. A kernel without IPv6 has
/// nothing to silence.
pub fn silence(interface_index: u32) -> Result<(), Errno> {
    let netlink = socket(
        AddressFamily::Netlink,
        SockType::Raw,
        SockFlag::SOCK_CLOEXEC,
        SockProtocol::NetlinkRoute,
    )?;
    send(
        netlink.as_raw_fd(),
        &set_link_message(interface_index),
        MsgFlags::empty(),
    )?;
    match answer(&netlink) {
        Err(Errno::EAFNOSUPPORT | Errno::EOPNOTSUPP) => Ok(()),
        outcome => outcome,
    }
}

/// `RTM_SETLINK` with the one attribute.
fn set_link_message(interface_index: u32) -> Vec<u8> {
    let mode = attribute(IFLA_INET6_ADDR_GEN_MODE, &[GENERATE_NO_ADDRESS]);
    let family = attribute(libc::AF_INET6 as u16, &mode);
    let families = attribute(libc::IFLA_AF_SPEC, &family);

    // struct ifinfomsg: family, padding, type, index, flags, changed flags.
    let mut link = vec![0; 4];
    link.extend(interface_index.to_ne_bytes());
    link.extend([0; 8]);

    let length = (HEADER_BYTES + link.len() + families.len()) as u32;
    let mut message = length.to_ne_bytes().to_vec();
    message.extend(libc::RTM_SETLINK.to_ne_bytes());
    message.extend(REQUEST_WITH_ANSWER.to_ne_bytes());
    message.extend([0; 8]); // sequence number and sender
    message.extend(link);
    message.extend(families);
    message
}

/// An attribute with its length and type, padded to four bytes.
fn attribute(kind: u16, value: &[u8]) -> Vec<u8> {
    let length = (4 + value.len()) as u16;
    let mut attribute = length.to_ne_bytes().to_vec();
    attribute.extend(kind.to_ne_bytes());
    attribute.extend(value);
    attribute.resize(attribute.len().next_multiple_of(4), 0);
    attribute
}

/// Reads the kernel's answer: `NLMSG_ERROR` with a negative error number, or 0 for done.
fn answer(netlink: &OwnedFd) -> Result<(), Errno> {
    let mut buffer = [0; 512];
    let bytes = recv(netlink.as_raw_fd(), &mut buffer, MsgFlags::empty())?;
    let number = buffer
        .get(..bytes)
        .and_then(|message| message.get(HEADER_BYTES..))
        .and_then(|body| body.first_chunk())
        .map(|number| i32::from_ne_bytes(*number));
    match number {
        Some(0) => Ok(()),
        Some(negative) => Err(Errno::from_raw(-negative)),
        None => Err(Errno::EBADMSG),
    }
}
