//! The real-time priority of the emulator's thread (sched(7)).

// sched_setscheduler(2) has no safe interface in nix.
#![allow(unsafe_code)]

use nix::errno::Errno;

/// Asks for SCHED_FIFO at this priority for the calling thread; 0 asks for nothing.
///
/// # Errors
/// What the kernel says, such as EPERM without CAP_SYS_NICE.
pub fn request_fifo(priority: u8) -> Result<(), Errno> {
    if priority == 0 {
        return Ok(());
    }
    let parameters = libc::sched_param {
        sched_priority: priority.into(),
    };
    // SAFETY: the parameters live until the call returns; 0 names the calling thread.
    let outcome = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &parameters) };
    Errno::result(outcome).map(drop)
}
