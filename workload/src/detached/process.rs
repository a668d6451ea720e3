//! The processes of an environment, and those that hold leases, whoever started them. The main type is [`Process`].
//!
//! One is found by its command line and held by a pidfd (`pidfd_open(2)`, Linux 5.3): that tells when a process ends that
//! is not our child, and never means another process that got the same number.

use std::{
    fs, io, iter,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    path::Path,
    process::Child,
    thread,
    time::Duration,
};

use record::{call::word, layout};
use rustix::{
    event::{PollFd, PollFlags},
    io::Errno,
    process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal},
};

use super::{DetachedError, EnvironmentFolder, descriptor};

/// How long the kernel may take to end a process that was killed.
const KILLED: Duration = Duration::from_secs(10);

/// What a process is for its environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// `workload run`.
    Workload,
    /// `workload detached supervise`, which waits for it.
    Supervisor,
    /// `workload detached lease`, of no environment.
    Leaseholder,
    /// What a user's command started and its workload could not end, since it was killed.
    Command,
}

/// A process that lived when it was found.
#[derive(Debug)]
pub struct Process {
    /// What it is.
    pub role: Role,
    pid: Pid,
    pidfd: OwnedFd,
}

impl Process {
    /// Waits until it has ended, or for that long. Whether it has.
    ///
    /// # Errors
    /// When the kernel refuses.
    pub fn wait(&self, longest: Duration) -> Result<bool, DetachedError> {
        descriptor::wait(&mut [PollFd::new(&self.pidfd, PollFlags::IN)], Some(longest))
            .map_err(DetachedError::system("wait for a process"))
    }

    /// Asks it to end in order. If it has ended already, so be it.
    ///
    /// # Errors
    /// When we may not.
    pub fn ask_to_end(&self) -> Result<(), DetachedError> {
        self.signal(Signal::TERM)
    }

    /// Ends it by force, and returns once it has ended.
    ///
    /// # Errors
    /// When we may not, or it does not end even so.
    pub fn kill(&self) -> Result<(), DetachedError> {
        self.signal(Signal::KILL)?;
        match self.wait(KILLED)? {
            true => Ok(()),
            false => Err(DetachedError::Stubborn {
                pid: self.pid.as_raw_nonzero().get(),
                after: KILLED,
            }),
        }
    }

    fn signal(&self, signal: Signal) -> Result<(), DetachedError> {
        match pidfd_send_signal(&self.pidfd, signal) {
            Ok(()) | Err(Errno::SRCH) => Ok(()),
            Err(error) => Err(DetachedError::system("signal a process")(error)),
        }
    }
}

impl AsFd for Process {
    /// Readable once the process has ended, and for ever after.
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pidfd.as_fd()
    }
}

/// The workload of an environment and its supervisor, if they live now.
///
/// # Errors
/// When `/proc` cannot be read, or the kernel has no pidfd.
pub fn find(folder: &EnvironmentFolder) -> Result<Vec<Process>, DetachedError> {
    find_by(|pid| role(&command_line(pid), folder))
}

/// What a command of an environment started and nobody ended.
///
/// # Errors
/// When `/proc` cannot be read, or the kernel has no pidfd.
pub fn find_commands(folder: &EnvironmentFolder) -> Result<Vec<Process>, DetachedError> {
    find_by(|pid| is_of_command(pid, folder).then_some(Role::Command))
}

fn find_by(role: impl Fn(Pid) -> Option<Role>) -> Result<Vec<Process>, DetachedError> {
    let mut found = Vec::new();
    for pid in all().map_err(DetachedError::system("read /proc"))? {
        found.extend(hold(pid, &role)?);
    }
    Ok(found)
}

/// Waits until a child that was just spawned can be found, or has ended.
///
/// `spawn` returns a moment before: the kernel closes what an exec is to close (`begin_new_exec` of fs/exec.c), and sets the
/// command line only then (`create_elf_tables` of fs/binfmt_elf.c).
///
/// # Errors
/// When the kernel refuses.
pub fn wait_until_found(child: &mut Child) -> Result<(), DetachedError> {
    const LOOK: Duration = Duration::from_millis(1);
    while command_line(Pid::from_child(child)).is_empty() {
        let ended = child
            .try_wait()
            .map_err(DetachedError::system("look at a process"))?;
        if ended.is_some() {
            break;
        }
        thread::sleep(LOOK);
    }
    Ok(())
}

/// The process of that number, if it is one that holds, or waits for, the lease of that file.
///
/// # Errors
/// When the kernel has no pidfd.
pub fn leaseholder(pid: u32, lease: &Path) -> Result<Option<Process>, DetachedError> {
    match i32::try_from(pid).ok().and_then(Pid::from_raw) {
        Some(pid) => hold(pid, |pid| {
            is_leaseholder(&command_line(pid), lease).then_some(Role::Leaseholder)
        }),
        None => Ok(None),
    }
}

/// The process of that number, if it has a role.
fn hold(pid: Pid, role: impl Fn(Pid) -> Option<Role>) -> Result<Option<Process>, DetachedError> {
    let Some(role_now) = role(pid) else {
        return Ok(None);
    };
    // Always closed on exec, which the kernel does by itself.
    match pidfd_open(pid, PidfdFlags::empty()) {
        // The number could have passed to another process since we looked; now it cannot any more.
        Ok(pidfd) if role(pid) == Some(role_now) => Ok(Some(Process {
            role: role_now,
            pid,
            pidfd,
        })),
        Ok(_) | Err(Errno::SRCH) => Ok(None),
        Err(error) => Err(DetachedError::system("watch a process")(error)),
    }
}

fn all() -> io::Result<Vec<Pid>> {
    let mut pids = Vec::new();
    for entry in fs::read_dir("/proc")? {
        let name = entry?.file_name();
        if let Some(pid) = name.to_str().and_then(|name| name.parse().ok()) {
            pids.extend(Pid::from_raw(pid));
        }
    }
    Ok(pids)
}

/// Empty when the process has ended meanwhile, and of a zombie.
fn command_line(pid: Pid) -> Vec<u8> {
    fs::read(format!("/proc/{}/cmdline", pid.as_raw_nonzero())).unwrap_or_default()
}

/// What a process with this command line is for an environment. The data folder tells its workload from one in a
/// container, which the host's `/proc` shows too, with `/data`.
fn role(command_line: &[u8], folder: &EnvironmentFolder) -> Option<Role> {
    let arguments = arguments(command_line);
    let has = |option, value| has(&arguments, option, value);
    if !has(word::ENVIRONMENT, folder.environment().as_bytes()) {
        return None;
    }
    let (data, root) = (folder.data(), folder.root());
    if is_call(&arguments, &[word::RUN]) && has(word::DATA, data.as_os_str().as_encoded_bytes()) {
        Some(Role::Workload)
    } else if is_call(&arguments, &[word::DETACHED, word::SUPERVISE])
        && has(word::ROOT, root.as_os_str().as_encoded_bytes())
    {
        Some(Role::Supervisor)
    } else {
        None
    }
}

/// Whether a process was started, at whatever remove, by a command of the environment. One of another user's is not looked into.
fn is_of_command(pid: Pid, folder: &EnvironmentFolder) -> bool {
    let variables = fs::read(format!("/proc/{}/environ", pid.as_raw_nonzero())).unwrap_or_default();
    let work = folder.folders().work;
    let wanted = [
        layout::WORK_VARIABLE.as_bytes(),
        b"=",
        work.as_os_str().as_encoded_bytes(),
    ]
    .concat();
    variables
        .split(|byte| *byte == 0)
        .any(|variable| variable == wanted)
}

fn is_leaseholder(command_line: &[u8], lease: &Path) -> bool {
    let arguments = arguments(command_line);
    is_call(&arguments, &[word::DETACHED, word::LEASE])
        && has(&arguments, word::PATH, lease.as_os_str().as_encoded_bytes())
}

fn arguments(command_line: &[u8]) -> Vec<&[u8]> {
    command_line.split(|byte| *byte == 0).collect()
}

/// Whether the arguments after the program begin with these words.
fn is_call(arguments: &[&[u8]], words: &[&str]) -> bool {
    let given = arguments
        .iter()
        .skip(1)
        .copied()
        .map(Some)
        .chain(iter::repeat(None));
    words
        .iter()
        .zip(given)
        .all(|(word, given)| given == Some(word.as_bytes()))
}

/// Whether an option has that value.
fn has(arguments: &[&[u8]], option: &str, value: &[u8]) -> bool {
    arguments
        .windows(2)
        .any(|pair| pair[0].strip_prefix(b"--") == Some(option.as_bytes()) && pair[1] == value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(
        "/b/workload\0run\0--environment\0e-1\0--data\0/s/e-1/data\0",
        Some(Role::Workload)
    )]
    #[case(
        "/b/workload\0run\0--data\0/s/e-1/data\0--environment\0e-1\0",
        Some(Role::Workload)
    )]
    #[case("/workload\0run\0--environment\0e-1\0--data\0/data\0", None)]
    #[case("/b/workload\0run\0--environment\0e-11\0--data\0/s/e-1/data\0", None)]
    #[case(
        "/w\0detached\0supervise\0--root\0/s\0--environment\0e-1\0",
        Some(Role::Supervisor)
    )]
    #[case("/w\0detached\0supervise\0--root\0/t\0--environment\0e-1\0", None)]
    #[case("/w\0detached\0follow\0--root\0/s\0--environment\0e-1\0", None)]
    #[case("grep\0--environment\0e-1\0--data\0/s/e-1/data\0", None)]
    #[case("", None)]
    fn a_process_is_known_by_its_environment_and_its_folder(
        #[case] command_line: &str,
        #[case] known: Option<Role>,
    ) {
        let folder = EnvironmentFolder::of(Path::new("/s"), "e-1").unwrap();
        assert_eq!(role(command_line.as_bytes(), &folder), known);
    }

    #[rstest::rstest]
    #[case("/w\0detached\0lease\0--path\0/tmp/l\0", true)]
    #[case("/w\0detached\0lease\0--beat\x005min\0--path\0/tmp/l\0", true)]
    #[case("/w\0detached\0lease\0--path\0/tmp/l2\0", false)]
    #[case("/sbin/init\0--path\0/tmp/l\0", false)]
    #[case("", false)]
    fn a_leaseholder_is_known_by_its_file(#[case] command_line: &str, #[case] known: bool) {
        assert_eq!(
            is_leaseholder(command_line.as_bytes(), Path::new("/tmp/l")),
            known
        );
    }
}
