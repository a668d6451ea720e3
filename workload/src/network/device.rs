//! A TAP device in a host's namespace, configured without any tool: images `FROM scratch` have none. The main type is
//! [`Tap`]. See `Documentation/networking/tuntap.rst`, netdevice(7) and arp(7).
//!
//! The device is not persistent, so it goes with its last handle. Without `IFF_VNET_HDR` a TAP offers no offloads: the
//! kernel cuts segments to the MTU and fills in checksums before a packet reaches the device or a capture on it.

// Device ioctls have no safe interface in nix.
#![allow(unsafe_code)]

use std::{
    ffi::CString,
    fs::{File, OpenOptions},
    mem,
    net::Ipv4Addr,
    os::{
        fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd},
        unix::fs::OpenOptionsExt,
    },
};

use nix::{
    errno::Errno,
    net::if_::if_nametoindex,
    sys::socket::{AddressFamily, SockFlag, SockType, socket},
    unistd,
};
use record::topology::{Topology, address, mac};

use super::{error::NetworkError, ipv6, namespace::errno};

/// The network mask of 10.0.0.0/8.
const MASK: Ipv4Addr = Ipv4Addr::new(255, 0, 0, 0);

/// Ethernet's.
const MTU: i32 = 1500;

/// A device's name, hardware address and address.
#[derive(Debug, Clone)]
pub struct Interface {
    /// At most 15 bytes.
    pub name: String,
    /// Hardware address.
    pub mac: [u8; 6],
    /// Address, in a network of 8 bits.
    pub address: Ipv4Addr,
}

impl Interface {
    /// That of the host in that position, and those of all others.
    ///
    /// # Errors
    /// If the topology has no such host.
    pub fn and_neighbours(topology: &Topology, position: usize) -> Result<(Self, Vec<Self>), NetworkError> {
        let interfaces = topology.names().enumerate().map(|(at, host)| Self {
            name: host.interface(),
            mac: mac(at),
            address: address(at),
        });
        let mut others: Vec<Self> = interfaces.collect();
        match position < others.len() {
            true => Ok((others.remove(position), others)),
            false => Err(NetworkError::NoHost {
                host: position.to_string(),
            }),
        }
    }
}

/// A TAP device: what the host sends is read from it, what is written to it reaches the host. It never blocks.
#[derive(Debug)]
pub struct Tap {
    file: File,
}

impl Tap {
    /// Makes a device in the calling thread's namespace. It is down.
    ///
    /// # Errors
    /// If there is no `/dev/net/tun`, or the kernel refuses.
    pub fn create(name: &str) -> Result<Self, NetworkError> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open("/dev/net/tun")
            .map_err(|error| NetworkError::TunDevice {
                source: errno(&error),
            })?;
        let mut request = Request::about(name)?;
        // TAP and no packet information both fit in 16 bits.
        request.0.ifr_ifru.ifru_flags = (libc::IFF_TAP | libc::IFF_NO_PI) as libc::c_short;
        request.make(&file, libc::TUNSETIFF, "making it")?;
        Ok(Self { file })
    }

    /// Takes a frame that the host sent; nothing if there is none.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn receive(&self, buffer: &mut [u8]) -> Result<Option<usize>, Errno> {
        match unistd::read(&self.file, buffer) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(Errno::EAGAIN | Errno::EINTR) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Hands the host a frame.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn send(&self, frame: &[u8]) -> Result<(), Errno> {
        unistd::write(&self.file, frame).map(drop)
    }
}

impl AsFd for Tap {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

/// Gives a device of the calling thread's namespace its addresses, makes its neighbours known and brings it and the
/// loopback interface up.
///
/// Neighbours are given since the first packet would otherwise wait for ARP, and ARP's packets would be lost at times.
///
/// # Errors
/// If the kernel refuses a step.
pub fn configure(interface: &Interface, neighbours: &[Interface]) -> Result<(), NetworkError> {
    let name = interface.name.as_str();
    let control = socket(
        AddressFamily::Inet,
        SockType::Datagram,
        SockFlag::SOCK_CLOEXEC,
        None,
    )
    .map_err(|source| refused(name, "opening a socket for it", source))?;
    let index = if_nametoindex(name).map_err(|source| refused(name, "finding it", source))?;
    // Before it goes up, or the kernel sends router solicitations and multicast reports.
    ipv6::silence(index).map_err(|source| refused(name, "silencing IPv6 on it", source))?;

    let mut request = Request::about(name)?;
    request.0.ifr_ifru.ifru_hwaddr = hardware_address(interface.mac);
    request.make(&control, libc::SIOCSIFHWADDR, "setting its hardware address")?;
    request.0.ifr_ifru.ifru_mtu = MTU;
    request.make(&control, libc::SIOCSIFMTU, "setting its MTU")?;
    request.0.ifr_ifru.ifru_addr = internet_address(interface.address);
    request.make(&control, libc::SIOCSIFADDR, "setting its address")?;
    request.0.ifr_ifru.ifru_netmask = internet_address(MASK);
    request.make(&control, libc::SIOCSIFNETMASK, "setting its network mask")?;
    bring_up(&control, name)?;
    bring_up(&control, "lo")?;
    neighbours
        .iter()
        .try_for_each(|neighbour| add_neighbour(&control, name, neighbour))
}

fn bring_up(control: &OwnedFd, name: &str) -> Result<(), NetworkError> {
    let mut request = Request::about(name)?;
    request.0.ifr_ifru.ifru_flags = (libc::IFF_UP | libc::IFF_RUNNING) as libc::c_short;
    request.make(control, libc::SIOCSIFFLAGS, "bringing it up")
}

/// An interface request (netdevice(7)).
struct Request(libc::ifreq);

impl Request {
    fn about(name: &str) -> Result<Self, NetworkError> {
        // SAFETY: ifreq is plain data, for which all zero is a valid value.
        let mut request: libc::ifreq = unsafe { mem::zeroed() };
        copy_name(&mut request.ifr_name, name)?;
        Ok(Self(request))
    }

    /// Makes the request of the kernel.
    fn make(
        &mut self,
        on: &impl AsFd,
        operation: libc::Ioctl,
        action: &'static str,
    ) -> Result<(), NetworkError> {
        // SAFETY: every operation used here takes a pointer to an ifreq, which lives until the call returns.
        let outcome = unsafe { libc::ioctl(on.as_fd().as_raw_fd(), operation, &mut self.0) };
        Errno::result(outcome)
            .map(drop)
            .map_err(|source| refused(self.name(), action, source))
    }

    fn name(&self) -> String {
        let bytes = self
            .0
            .ifr_name
            .iter()
            .map(|c| *c as u8)
            .take_while(|byte| *byte != 0);
        String::from_utf8_lossy(&bytes.collect::<Vec<u8>>()).into_owned()
    }
}

/// `struct arpreq` of `net/if_arp.h`, which libc lacks on Linux.
#[repr(C)]
struct ArpRequest {
    protocol_address: libc::sockaddr,
    hardware_address: libc::sockaddr,
    flags: libc::c_int,
    netmask: libc::sockaddr,
    device: [libc::c_char; 16],
}

/// `ATF_COM`, the address is complete, and `ATF_PERM`, it never expires.
const PERMANENT: libc::c_int = 0x02 | 0x04;

fn add_neighbour(control: &OwnedFd, name: &str, neighbour: &Interface) -> Result<(), NetworkError> {
    let mut request = ArpRequest {
        protocol_address: internet_address(neighbour.address),
        hardware_address: hardware_address(neighbour.mac),
        flags: PERMANENT,
        netmask: internet_address(Ipv4Addr::UNSPECIFIED),
        device: [0; 16],
    };
    copy_name(&mut request.device, name)?;
    // SAFETY: SIOCSARP takes a pointer to an arpreq, whose layout ArpRequest has, and which lives until it returns.
    let outcome = unsafe { libc::ioctl(control.as_raw_fd(), libc::SIOCSARP, &mut request) };
    Errno::result(outcome)
        .map(drop)
        .map_err(|source| refused(name, "adding a neighbour on it", source))
}

fn copy_name(field: &mut [libc::c_char; 16], name: &str) -> Result<(), NetworkError> {
    let bytes = CString::new(name)
        .map_err(|_| refused(name, "naming it", Errno::EINVAL))?
        .into_bytes_with_nul();
    if bytes.len() > field.len() {
        return Err(refused(name, "naming it", Errno::ENAMETOOLONG));
    }
    for (to, from) in field.iter_mut().zip(bytes) {
        *to = from as libc::c_char;
    }
    Ok(())
}

fn hardware_address(mac: [u8; 6]) -> libc::sockaddr {
    socket_address(libc::ARPHRD_ETHER, 0, &mac)
}

/// As `sockaddr_in`: two bytes of port before the address.
fn internet_address(address: Ipv4Addr) -> libc::sockaddr {
    socket_address(libc::AF_INET as libc::sa_family_t, 2, &address.octets())
}

fn socket_address(family: libc::sa_family_t, offset: usize, bytes: &[u8]) -> libc::sockaddr {
    let mut data = [0; 14];
    for (to, from) in data.iter_mut().skip(offset).zip(bytes) {
        *to = *from as libc::c_char;
    }
    libc::sockaddr {
        sa_family: family,
        sa_data: data,
    }
}

fn refused(interface: impl Into<String>, action: &'static str, source: Errno) -> NetworkError {
    NetworkError::Interface {
        interface: interface.into(),
        action,
        source,
    }
}
