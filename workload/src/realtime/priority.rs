//! How the kernel schedules the calling thread: SCHED_FIFO for who must be on time, a low niceness for who must not
//! disturb (sched(7), setpriority(2)).

// sched_setscheduler(2) and setpriority(2) have no safe interface in nix.
#![allow(unsafe_code)]

use nix::errno::Errno;

/// Asks for SCHED_FIFO at this priority for the calling thread; 0 asks for nothing. Threads that it starts later
/// are ordinary ones.
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
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: the parameters live until the call returns; 0 names the calling thread.
    let outcome = unsafe { libc::sched_setscheduler(0, policy, &parameters) };
    Errno::result(outcome).map(drop)
}

/// The priority of what is more urgent than a thread of this one; 0, which asks for nothing, if that asks for nothing.
#[must_use]
pub const fn above(priority: u8) -> u8 {
    match priority {
        0 => 0,
        99.. => 99,
        priority => priority + 1,
    }
}

/// Puts the calling thread behind all ordinary ones. Lowering oneself is always allowed, so that nothing is reported.
pub fn step_back() {
    // SAFETY: no memory is involved; on Linux 0 names the calling thread, not its process.
    unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, 10) };
}
