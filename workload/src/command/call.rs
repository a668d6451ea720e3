//! One call of a command, from its start to the end of all that it started. The main type is [`Call`].

// wait4(2), which says what a process used, has no safe wrapper.
#![allow(unsafe_code)]

use std::{
    io::{self, Read},
    mem::MaybeUninit,
    os::unix::process::{CommandExt as _, ExitStatusExt as _},
    path::Path,
    process::{Command, ExitStatus, Stdio},
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, channel},
    },
    thread,
    time::{Duration, Instant},
};

use nix::{
    errno::Errno,
    sys::signal::{Signal, kill, killpg},
    unistd::Pid,
};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fs::statvfs,
    process::{PidfdFlags, Resource, Rlimit, pidfd_open, prlimit},
};

use record::layout;

use super::{CommandError, output::Kept};
use crate::{child_process, descendants::Descendants, experiment::ExperimentError};

/// How often the workload looks whether it is to stop and whether the disk is full. The command's end is noticed at once.
const LOOK: Duration = Duration::from_secs(1);
/// How long a command may take to end once it was asked to.
const GRACE: Duration = Duration::from_secs(5);
/// Once all processes are gone nothing can hold their streams.
const STREAMS: Duration = Duration::from_secs(10);
/// No file that a command writes may be longer: 4 GiB.
const LONGEST_FILE: u64 = 4 << 30;
/// What must stay free on the disk of the command's folder: 512 MiB.
const RESERVE: u64 = 512 << 20;
/// Where programs are looked for if nothing is said, as Debian has it.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// A command to be called.
pub struct Call<'a> {
    /// The program and its arguments; not empty.
    pub arguments: Vec<String>,
    /// In which it runs.
    pub folder: &'a Path,
    /// The folder for all commands of the environment, which names it.
    pub work: &'a Path,
    /// For how long at most.
    pub timeout: Duration,
    /// Those of this process, of which the command's are.
    pub descendants: &'a Descendants,
    /// Ends it once it is set.
    pub stop: &'a AtomicBool,
}

/// What came of it.
#[derive(Debug)]
pub struct Ended {
    /// How it ended.
    pub outcome: Outcome,
    /// What it used.
    pub usage: Usage,
    /// What it printed on standard output.
    pub stdout: Kept,
    /// What it printed on standard error.
    pub stderr: Kept,
    /// Processes that it left behind, which are ended.
    pub left_behind: u64,
}

/// How a call ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// By itself, with this exit code.
    Exited(i32),
    /// By a signal that was not ours.
    Killed {
        /// Which.
        signal: i32,
    },
    /// It took longer than it may.
    TimedOut,
    /// It left too little room on the disk.
    DiskFull,
    /// The workload was asked to stop.
    Stopped,
}

/// What a command used, with all that it started and waited for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// Processors' time.
    pub cpu_ns: u64,
    /// Of one process, the most at once.
    pub peak_memory_bytes: u64,
}

impl Outcome {
    /// The exit code; none where it has none.
    #[must_use]
    pub const fn exit_code(self) -> Option<i32> {
        match self {
            Self::Exited(code) => Some(code),
            _ => None,
        }
    }

    /// What happened to the command, for a sentence that begins with it.
    #[must_use]
    pub fn in_words(self, timeout: Duration) -> String {
        match self {
            Self::Exited(code) => format!("ended with exit code {code}"),
            Self::Killed { signal } => format!("was killed by signal {signal}"),
            Self::TimedOut => format!("was ended since it took longer than {} s", timeout.as_secs_f64()),
            Self::DiskFull => format!(
                "was ended since the disk had less than {} MiB left",
                RESERVE >> 20
            ),
            Self::Stopped => "was interrupted".to_owned(),
        }
    }
}

impl Ended {
    /// The end of what it printed, on standard error unless there is nothing.
    #[must_use]
    pub fn last_words(&self, most: usize) -> String {
        let on_stderr = self.stderr.last_words(most);
        match on_stderr.is_empty() {
            true => self.stdout.last_words(most),
            false => on_stderr,
        }
    }
}

impl Call<'_> {
    /// Calls it, tells `watch` about once a second for how long it has been running, and ends all that it left behind.
    ///
    /// # Errors
    /// When it cannot be started or what it left behind does not end.
    pub fn run(&self, mut watch: impl FnMut(Duration)) -> Result<Ended, ExperimentError> {
        let (program, arguments) = self.arguments.split_first().ok_or(CommandError::NoWork)?;
        let mut command = Command::new(program);
        command
            .args(arguments)
            .current_dir(self.folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0);
        for (name, value) in [
            ("PATH", PATH.as_ref()),
            ("HOME", self.folder.as_os_str()),
            ("LANG", "C.UTF-8".as_ref()),
        ] {
            if std::env::var_os(name).is_none() {
                command.env(name, value);
            }
        }
        command.env(layout::WORK_VARIABLE, self.work);
        let begun = Instant::now();
        let mut child = child_process::spawn(&mut command).map_err(|source| CommandError::Start {
            program: program.clone(),
            source,
        })?;
        let pid = child_process::pid(&child);
        let streams = (keep(child.stdout.take()), keep(child.stderr.take()));
        self.limit(pid);
        let cut = self.wait(pid, begun, &mut watch)?;
        if cut.is_some() {
            let _ = killpg(pid, Signal::SIGTERM);
            if !ends_within(pid, GRACE)? {
                // Its group may be another one by now.
                let _ = killpg(pid, Signal::SIGKILL);
                let _ = kill(pid, Signal::SIGKILL);
            }
        }
        let (status, usage) = wait4(pid).map_err(CommandError::system("wait for the command"))?;
        let left_behind = self.descendants.end_all()?;
        let (stdout, stderr) = (kept(&streams.0), kept(&streams.1));
        let by_itself = match (status.code(), status.signal()) {
            (Some(code), _) => Outcome::Exited(code),
            (None, signal) => Outcome::Killed {
                signal: signal.unwrap_or_default(),
            },
        };
        Ok(Ended {
            outcome: cut.unwrap_or(by_itself),
            usage,
            stdout,
            stderr,
            left_behind,
        })
    }

    /// It may have ended already, and then needs no limit.
    fn limit(&self, pid: Pid) {
        let pid = rustix::process::Pid::from_raw(pid.as_raw());
        for (resource, limit) in [(Resource::Fsize, LONGEST_FILE), (Resource::Core, 0)] {
            let limit = Rlimit {
                current: Some(limit),
                maximum: Some(limit),
            };
            let _ = prlimit(pid, resource, limit);
        }
    }

    /// Waits for its end; why it is not to go on, if it did not end by itself.
    fn wait(
        &self,
        pid: Pid,
        begun: Instant,
        watch: &mut impl FnMut(Duration),
    ) -> Result<Option<Outcome>, CommandError> {
        loop {
            let elapsed = begun.elapsed();
            if self.stop.load(Ordering::Relaxed) {
                return Ok(Some(Outcome::Stopped));
            }
            let left = self.timeout.saturating_sub(elapsed);
            if left.is_zero() {
                return Ok(Some(Outcome::TimedOut));
            }
            if ends_within(pid, left.min(LOOK))? {
                return Ok(None);
            }
            watch(begun.elapsed());
            let free = statvfs(self.folder).map(|disk| disk.f_bavail.saturating_mul(disk.f_frsize));
            if free.is_ok_and(|free| free < RESERVE) {
                return Ok(Some(Outcome::DiskFull));
            }
        }
    }
}

/// Whether the child ends within that time. It stays a zombie.
fn ends_within(pid: Pid, longest: Duration) -> Result<bool, CommandError> {
    let watch = CommandError::system("watch the command");
    let Some(pid) = rustix::process::Pid::from_raw(pid.as_raw()) else {
        return Ok(true);
    };
    let pidfd = match pidfd_open(pid, PidfdFlags::empty()) {
        Ok(pidfd) => pidfd,
        Err(error) => return Err(watch(io::Error::from(error))),
    };
    let deadline = Instant::now() + longest;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let timeout = Timespec::try_from(left).ok();
        match poll(&mut [PollFd::new(&pidfd, PollFlags::IN)], timeout.as_ref()) {
            Ok(0) => return Ok(false),
            Ok(_) => return Ok(true),
            Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(watch(io::Error::from(error))),
        }
    }
}

/// Waits for a child, and says what it used.
fn wait4(pid: Pid) -> io::Result<(ExitStatus, Usage)> {
    let mut status = 0;
    let mut usage = MaybeUninit::<libc::rusage>::zeroed();
    loop {
        // SAFETY: both pointers are to memory of ours of the right type, which the kernel fills in.
        let waited = unsafe { libc::wait4(pid.as_raw(), &raw mut status, 0, usage.as_mut_ptr()) };
        match Errno::result(waited) {
            Ok(_) => break,
            Err(Errno::EINTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
    // SAFETY: it was zeroed, which is a value of it, and then filled in.
    let usage = unsafe { usage.assume_init() };
    let ns = |time: libc::timeval| {
        let (seconds, micros) = (u64::try_from(time.tv_sec), u64::try_from(time.tv_usec));
        seconds.unwrap_or(0) * 1_000_000_000 + micros.unwrap_or(0) * 1000
    };
    let usage = Usage {
        cpu_ns: ns(usage.ru_utime) + ns(usage.ru_stime),
        // In kibibytes, getrusage(2).
        peak_memory_bytes: u64::try_from(usage.ru_maxrss).unwrap_or(0) * 1024,
    };
    Ok((ExitStatus::from_raw(status), usage))
}

/// Reads a stream in a thread of its own, so that the command never waits for its reader.
fn keep(stream: Option<impl Read + Send + 'static>) -> Receiver<Kept> {
    let (sender, receiver) = channel();
    // Without the thread the stream is closed, and nothing of it is kept.
    let _ = thread::Builder::new().name("output".into()).spawn(move || {
        let kept = stream.map(Kept::read).unwrap_or_default();
        let _ = sender.send(kept);
    });
    receiver
}

fn kept(stream: &Receiver<Kept>) -> Kept {
    stream.recv_timeout(STREAMS).unwrap_or_default()
}
