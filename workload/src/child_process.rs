//! A program that the workload runs beside itself and that must not outlive it. The function is [`spawn`].
//!
//! The kernel sends it SIGKILL when the thread that started it ends (`PR_SET_PDEATHSIG`, prctl(2)), however that comes
//! about; so that thread has to stay for as long as the program is needed. It does not inherit the signals that the
//! workload blocks for itself, or it could not be ended by them, nor could what it starts.

// A function to be run between fork and exec can be given only so.
#![allow(unsafe_code)]

use std::{
    io,
    os::unix::process::CommandExt,
    process::{Child, Command},
};

use nix::{
    sys::{
        prctl,
        signal::{SigSet, Signal},
    },
    unistd::{Pid, getpid, getppid},
};

/// Starts the command, which is to end with the calling thread.
///
/// # Errors
/// If it cannot be started.
pub fn spawn(command: &mut Command) -> io::Result<Child> {
    let parent = getpid();
    // SAFETY: between fork and exec only system calls are made, no memory is allocated and no lock taken.
    unsafe {
        command.pre_exec(move || end_with(parent));
    }
    command.spawn()
}

/// Of a program that was started here and has not been waited for.
#[must_use]
pub fn pid(child: &Child) -> Pid {
    Pid::from_raw(i32::try_from(child.id()).unwrap_or(i32::MAX))
}

/// In the new process: it ends with its parent and takes all signals.
fn end_with(parent: Pid) -> io::Result<()> {
    prctl::set_pdeathsig(Signal::SIGKILL)?;
    // The parent may have ended before the kernel was told.
    if getppid() != parent {
        return Err(io::ErrorKind::BrokenPipe.into());
    }
    SigSet::empty().thread_set_mask()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::{io::Read as _, os::unix::process::ExitStatusExt as _, process::Stdio, thread};

    use super::*;

    #[test]
    fn it_blocks_no_signal_though_the_workload_does() {
        let said = thread::spawn(|| {
            SigSet::from_iter([Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP])
                .thread_block()
                .unwrap();
            let mut grep = Command::new("grep");
            grep.args(["SigBlk", "/proc/self/status"]).stdout(Stdio::piped());
            let child = spawn(&mut grep).unwrap();
            child.wait_with_output().unwrap().stdout
        })
        .join()
        .unwrap();
        assert_eq!(String::from_utf8(said).unwrap(), "SigBlk:\t0000000000000000\n");
    }

    #[test]
    fn it_ends_with_the_thread_that_started_it() {
        let mut child = thread::spawn(|| {
            let mut sleep = Command::new("sleep");
            sleep.arg("1000").stdout(Stdio::piped());
            spawn(&mut sleep).unwrap()
        })
        .join()
        .unwrap();
        // Its end closes the pipe.
        let mut rest = Vec::new();
        child.stdout.take().unwrap().read_to_end(&mut rest).unwrap();
        let ended = child.wait().unwrap();
        assert_eq!(ended.signal(), Some(Signal::SIGKILL as i32));
    }
}
