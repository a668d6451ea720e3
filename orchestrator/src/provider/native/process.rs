//! A workload's process on this machine, whether we started it or an earlier `matrix` did. The main type is
//! [`WorkloadProcess`].
//!
//! It is held by a pidfd (`pidfd_open(2)`, Linux 5.3): that tells when a process ends that is not our child, and never
//! means another process that got the same number.

use std::{
    fs, io,
    os::fd::OwnedFd,
    path::Path,
    process::{Child, ExitStatus},
    time::Duration,
};

use rustix::{
    io::Errno,
    process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal},
};
use tokio::io::unix::AsyncFd;

use super::readiness;

/// The process.
#[derive(Debug)]
pub struct WorkloadProcess {
    pidfd: AsyncFd<OwnedFd>,
    child: Option<Child>,
}

impl WorkloadProcess {
    /// One that we have just started.
    ///
    /// # Errors
    /// When the kernel has no pidfd.
    pub fn started(child: Child) -> io::Result<Self> {
        let pid = i32::try_from(child.id())
            .ok()
            .and_then(Pid::from_raw)
            .ok_or(Errno::SRCH)?;
        Ok(Self {
            pidfd: watch(pid)?,
            child: Some(child),
        })
    }

    /// The process that measures into this data folder for this environment, if there is one.
    ///
    /// # Errors
    /// When `/proc` cannot be read.
    pub fn find(environment: &str, data: &Path) -> io::Result<Option<Self>> {
        for pid in all_processes()? {
            if !measures(pid, environment, data) {
                continue;
            }
            match watch(pid) {
                // The number could have passed to another process since we looked; now it cannot any more.
                Ok(pidfd) if measures(pid, environment, data) => {
                    return Ok(Some(Self { pidfd, child: None }));
                }
                Ok(_) => {}
                Err(error) if error.raw_os_error() == Some(Errno::SRCH.raw_os_error()) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Waits until it has ended. Cancel-safe.
    ///
    /// # Errors
    /// When the runtime cannot watch it.
    pub async fn ended(&self) -> io::Result<()> {
        // Readable once the process has ended, and for ever after.
        self.pidfd.readable().await.map(|mut ready| ready.retain_ready())
    }

    /// How it ended, if it has and is our child.
    pub fn status(&mut self) -> Option<ExitStatus> {
        self.child.as_mut()?.try_wait().ok().flatten()
    }

    /// Asks it to end in order. If it has ended already, so be it.
    ///
    /// # Errors
    /// When we may not.
    pub fn ask_to_end(&self) -> io::Result<()> {
        self.signal(Signal::TERM)
    }

    /// Ends it: in order if it does so within `patience`, by force if not. Returns once it has ended.
    ///
    /// # Errors
    /// When we may not, or it does not end even so.
    pub async fn end(&mut self, patience: Duration) -> io::Result<()> {
        for signal in [Signal::TERM, Signal::KILL] {
            self.signal(signal)?;
            if let Ok(ended) = tokio::time::timeout(patience, self.ended()).await {
                ended?;
                // Reaps our child, so that no zombie is left.
                let _ = self.status();
                return Ok(());
            }
        }
        Err(io::ErrorKind::TimedOut.into())
    }

    fn signal(&self, signal: Signal) -> io::Result<()> {
        match pidfd_send_signal(self.pidfd.get_ref(), signal) {
            Ok(()) | Err(Errno::SRCH) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

fn watch(pid: Pid) -> io::Result<AsyncFd<OwnedFd>> {
    // Always closed on exec, which the kernel does by itself. Without flags: NONBLOCK came only with Linux 5.10.
    readiness::watch(pidfd_open(pid, PidfdFlags::empty())?)
}

fn all_processes() -> io::Result<Vec<Pid>> {
    let mut pids = Vec::new();
    for entry in fs::read_dir("/proc")? {
        let name = entry?.file_name();
        if let Some(pid) = name.to_str().and_then(|name| name.parse().ok()) {
            pids.extend(Pid::from_raw(pid));
        }
    }
    Ok(pids)
}

/// Whether the process's command line is that of this environment's workload. The data folder tells it from the
/// workload in a container, which this machine's `/proc` shows too, with `/data`. A zombie has no command line.
fn measures(pid: Pid, environment: &str, data: &Path) -> bool {
    let command_line = fs::read(format!("/proc/{}/cmdline", pid.as_raw_nonzero())).unwrap_or_default();
    is_command_line(&command_line, environment, data)
}

fn is_command_line(command_line: &[u8], environment: &str, data: &Path) -> bool {
    let arguments: Vec<_> = command_line.split(|byte| *byte == 0).collect();
    let has = |option: &[u8], value: &[u8]| arguments.windows(2).any(|pair| *pair == [option, value]);
    arguments.get(1) == Some(&b"run".as_slice())
        && has(b"--environment", environment.as_bytes())
        && has(b"--data", data.as_os_str().as_encoded_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("/b/workload\0run\0--environment\0e-1\0--data\0/s/e-1/data\0", true)]
    #[case("/b/workload\0run\0--data\0/s/e-1/data\0--environment\0e-1\0", true)]
    #[case("/workload\0run\0--environment\0e-1\0--data\0/data\0", false)]
    #[case("/b/workload\0run\0--environment\0e-11\0--data\0/s/e-1/data\0", false)]
    #[case("grep\0--environment\0e-1\0--data\0/s/e-1/data\0", false)]
    #[case("", false)]
    fn a_process_is_known_by_its_environment_and_its_data(#[case] command_line: &str, #[case] ours: bool) {
        let data = Path::new("/s/e-1/data");
        assert_eq!(is_command_line(command_line.as_bytes(), "e-1", data), ours);
    }
}
