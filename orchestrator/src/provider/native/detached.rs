//! Starting a process that outlives us: in a session of its own, so that neither the terminal's hanging up nor its
//! Ctrl-C reaches it. The function is [`spawn`].
#![allow(unsafe_code)] // `pre_exec`: the standard library has no stable way to ask for a new session.

use std::{
    io,
    os::unix::process::CommandExt as _,
    process::{Child, Command},
};

/// Starts the command in a session of its own.
///
/// # Errors
/// When it cannot be started.
pub fn spawn(command: &mut Command) -> io::Result<Child> {
    // SAFETY: between fork and exec only async-signal-safe functions may be called. setsid(2) is one, and rustix calls
    // it without allocating or locking.
    unsafe {
        command.pre_exec(|| {
            rustix::process::setsid()?;
            Ok(())
        });
    }
    command.spawn()
}
