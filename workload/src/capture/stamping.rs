//! Waits until the kernel stamps packets on their way. The one function is [`wait_until_live`].
//!
//! The first socket that asks for stamps makes Linux turn stamping on from a work queue, some time after the socket
//! option is set (`net_enable_timestamp` in `net/core/dev.c`). A packet that comes before is stamped when it is read
//! instead, which is too late for a capture.

use std::{
    io::IoSliceMut,
    net::{Ipv4Addr, UdpSocket},
    os::fd::AsRawFd,
    thread,
    time::{Duration, Instant, SystemTime},
};

use nix::{
    cmsg_space,
    errno::Errno,
    sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt, sockopt},
};

use crate::network::errno;

/// The work queue takes less than a millisecond on an idle machine.
const LONGEST: Duration = Duration::from_secs(5);

/// Sends itself datagrams on the loopback interface of the calling thread's namespace until one is stamped before it
/// is read.
///
/// # Errors
/// What the kernel says, or ETIMEDOUT.
pub fn wait_until_live() -> Result<(), Errno> {
    let probe = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).map_err(|error| errno(&error))?;
    let address = probe.local_addr().map_err(|error| errno(&error))?;
    probe
        .set_read_timeout(Some(LONGEST))
        .map_err(|error| errno(&error))?;
    setsockopt(&probe, sockopt::ReceiveTimestampns, &true)?;
    let begun = Instant::now();
    while begun.elapsed() < LONGEST {
        probe.send_to(&[0], address).map_err(|error| errno(&error))?;
        let sent = SystemTime::now();
        if stamp_of_next(&probe)? <= sent {
            return Ok(());
        }
        thread::yield_now();
    }
    Err(Errno::ETIMEDOUT)
}

fn stamp_of_next(probe: &UdpSocket) -> Result<SystemTime, Errno> {
    let mut byte = [0];
    let mut parts = [IoSliceMut::new(&mut byte)];
    let mut control = cmsg_space!(libc::timespec);
    let message = recvmsg::<()>(
        probe.as_raw_fd(),
        &mut parts,
        Some(&mut control),
        MsgFlags::empty(),
    )?;
    let stamp = message.cmsgs()?.find_map(|part| match part {
        ControlMessageOwned::ScmTimestampns(stamp) => Some(SystemTime::UNIX_EPOCH + Duration::from(stamp)),
        _ => None,
    });
    stamp.ok_or(Errno::ENODATA)
}
