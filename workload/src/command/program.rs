//! One program of the user's: started with little around it, watched by its pidfd, its output kept. The main types are [`Program`]
//! and [`Running`].

// wait4(2), which says what a process used, has no safe wrapper.
#![allow(unsafe_code)]

use std::{
    io::{self, Read},
    mem::MaybeUninit,
    os::unix::process::{CommandExt as _, ExitStatusExt as _},
    path::PathBuf,
    process::{Command, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, channel},
    },
    thread,
    time::{Duration, Instant},
};

use nix::{
    errno::Errno,
    sys::signal::{Signal, kill, killpg},
    unistd::{Pid, SysconfVar, sysconf},
};
use record::layout;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{PidfdFlags, Resource, Rlimit, WaitId, WaitIdOptions, pidfd_open, prlimit, waitid},
};

use super::{
    CommandError,
    output::{Kept, Sought},
};
use crate::child_process;

/// Once all processes are gone nothing can hold their streams.
const STREAMS: Duration = Duration::from_secs(10);
/// No file that a command writes may be longer: 4 GiB.
const LONGEST_FILE: u64 = 4 << 30;
/// How much of what a program printed last is a reason of its window, in characters.
const LAST_WORDS: usize = 300;
/// Where programs are looked for if nothing is said, as Debian has it.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// A program to be started.
#[derive(Debug, Clone)]
pub struct Program {
    /// The program and its arguments; not empty.
    pub arguments: Vec<String>,
    /// In which it runs.
    pub folder: PathBuf,
    /// The folder for all commands of the environment, which names it.
    pub work: PathBuf,
    /// Variables for it beside those of this process.
    pub environment: Vec<(&'static str, String)>,
    /// A text that a line of its output is to have, for [`Running::has_said`].
    pub sought: Option<String>,
}

/// A program that was started. It ends with the thread that started it.
#[derive(Debug)]
pub struct Running {
    pid: Pid,
    streams: [Receiver<Kept>; 2],
    said: Arc<AtomicBool>,
}

/// How a program ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// With this exit code.
    Exited(i32),
    /// By this signal.
    Signal(i32),
}

/// What a command used, with all that it started and waited for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// Processors' time.
    pub cpu_ns: u64,
    /// Of one process, the most at once.
    pub peak_memory_bytes: u64,
}

/// What a program printed.
#[derive(Debug, Clone, Default)]
pub struct Printed {
    /// On standard output.
    pub stdout: Kept,
    /// On standard error.
    pub stderr: Kept,
}

impl Printed {
    /// The end of it, on standard error unless there is nothing.
    #[must_use]
    pub fn last_words(&self) -> String {
        let on_stderr = self.stderr.last_words(LAST_WORDS);
        match on_stderr.is_empty() {
            true => self.stdout.last_words(LAST_WORDS),
            false => on_stderr,
        }
    }

    /// The same as a sentence, if it printed anything.
    #[must_use]
    pub fn said_last(&self) -> Option<String> {
        let words = self.last_words();
        (!words.is_empty()).then(|| format!("it printed last: {words}"))
    }
}

impl Program {
    /// Starts it.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(&self) -> Result<Running, CommandError> {
        let (program, arguments) = self.arguments.split_first().ok_or(CommandError::NoWork)?;
        let mut command = Command::new(program);
        command
            .args(arguments)
            .current_dir(&self.folder)
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
        command.env(layout::WORK_VARIABLE, &self.work);
        command.envs(self.environment.iter().map(|(name, value)| (name, value)));
        let mut child = child_process::spawn(&mut command).map_err(|source| CommandError::Start {
            program: program.clone(),
            source,
        })?;
        let pid = child_process::pid(&child);
        limit(pid);
        let said = Arc::new(AtomicBool::new(false));
        let sought = || self.sought.as_ref().map(|text| Sought::new(text, &said));
        Ok(Running {
            pid,
            streams: [
                keep(child.stdout.take(), sought()),
                keep(child.stderr.take(), sought()),
            ],
            said,
        })
    }
}

impl Running {
    /// Its process.
    #[must_use]
    pub const fn pid(&self) -> Pid {
        self.pid
    }

    /// Whether a line of its output had the text.
    #[must_use]
    pub fn has_said(&self) -> bool {
        self.said.load(Ordering::Relaxed)
    }

    /// How it ended, if it has. It stays a zombie until [`Self::wait`].
    ///
    /// # Errors
    /// If the system refuses.
    pub fn ended(&self) -> Result<Option<End>, CommandError> {
        let Some(pid) = rustix::process::Pid::from_raw(self.pid.as_raw()) else {
            return Ok(None);
        };
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let status = waitid(WaitId::Pid(pid), options)
            .map_err(|error| CommandError::system("watch the command")(io::Error::from(error)))?;
        Ok(status.map(|status| match status.exit_status() {
            Some(code) => End::Exited(code),
            None => End::Signal(status.terminating_signal().unwrap_or_default()),
        }))
    }

    /// Processors' time that it has used, with those of its children that it has waited for (proc(5), `stat`); none if the system does
    /// not say.
    #[must_use]
    pub fn cpu_ns(&self) -> Option<u64> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.pid)).ok()?;
        // The name, in parentheses, may hold anything; utime is the 14th field.
        let (_, fields) = stat.rsplit_once(')')?;
        let ticks = fields.split_whitespace().skip(11).take(4);
        let ticks: u64 = ticks.map(|ticks| ticks.parse::<u64>().unwrap_or(0)).sum();
        let per_second = sysconf(SysconfVar::CLK_TCK).ok()??;
        Some(ticks * 1_000_000_000 / u64::try_from(per_second).ok()?.max(1))
    }

    /// The most memory that it has had at once; none once it has ended.
    #[must_use]
    pub fn peak_memory_bytes(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.pid)).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
        let kibibytes: u64 = line.split_whitespace().next()?.parse().ok()?;
        Some(kibibytes * 1024)
    }

    /// Asks its process group to end.
    fn ask_to_end(&self) {
        let _ = killpg(self.pid, Signal::SIGTERM);
    }

    /// Ends its process group, and itself: its group may be another one by now.
    fn kill(&self) {
        let _ = killpg(self.pid, Signal::SIGKILL);
        let _ = kill(self.pid, Signal::SIGKILL);
    }

    /// Waits for the end of one that was killed or has ended, and says how it came and what it used.
    fn wait(&self) -> Result<(End, Usage), CommandError> {
        // A program of another user's, such as `sudo`, takes no signal from this one.
        if !any_ends_within(&[self], STREAMS)? {
            return Err(CommandError::Stubborn { count: 1 });
        }
        let (status, usage) = wait4(self.pid).map_err(CommandError::system("wait for the command"))?;
        let end = match status.code() {
            Some(code) => End::Exited(code),
            None => End::Signal(status.signal().unwrap_or_default()),
        };
        Ok((end, usage))
    }

    /// What it printed, once all that it started has ended.
    #[must_use]
    pub fn printed(&self) -> Printed {
        let [stdout, stderr] = self
            .streams
            .each_ref()
            .map(|stream| stream.recv_timeout(STREAMS).unwrap_or_default());
        Printed { stdout, stderr }
    }
}

/// Asks those programs that still run to end, the last one first, and kills those that have not ended when the grace is over, which is
/// for all together. How each ended, and what it used.
///
/// # Errors
/// If one does not end, or the system refuses.
pub fn end(programs: &[&Running], grace: Duration) -> Result<Vec<(End, Usage)>, CommandError> {
    let deadline = Instant::now() + grace;
    let mut asked = Vec::new();
    for program in programs.iter().rev() {
        // What one left behind that has ended by itself is not the business of a signal to its group.
        if program.ended()?.is_none() {
            program.ask_to_end();
            asked.push(program);
        }
    }
    for program in asked {
        let left = deadline.saturating_duration_since(Instant::now());
        if !any_ends_within(&[program], left)? {
            program.kill();
        }
    }
    programs.iter().map(|program| program.wait()).collect()
}

/// It may have ended already, and then needs no limit.
fn limit(pid: Pid) {
    let pid = rustix::process::Pid::from_raw(pid.as_raw());
    for (resource, limit) in [(Resource::Fsize, LONGEST_FILE), (Resource::Core, 0)] {
        let limit = Rlimit {
            current: Some(limit),
            maximum: Some(limit),
        };
        let _ = prlimit(pid, resource, limit);
    }
}

/// Whether one of them ends within that time, or has.
///
/// # Errors
/// If the system refuses.
pub fn any_ends_within(running: &[&Running], longest: Duration) -> Result<bool, CommandError> {
    let watch = || CommandError::system("watch the command");
    let pidfds = running
        .iter()
        .filter_map(|it| rustix::process::Pid::from_raw(it.pid.as_raw()));
    let pidfds = pidfds.map(|pid| pidfd_open(pid, PidfdFlags::empty()));
    let pidfds = pidfds
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| watch()(io::Error::from(error)))?;
    let deadline = Instant::now() + longest;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let timeout = Timespec::try_from(left).ok();
        let mut fds: Vec<_> = pidfds
            .iter()
            .map(|pidfd| PollFd::new(pidfd, PollFlags::IN))
            .collect();
        match poll(&mut fds, timeout.as_ref()) {
            Ok(ended) => return Ok(ended > 0),
            Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(watch()(error.into())),
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
fn keep(stream: Option<impl Read + Send + 'static>, sought: Option<Sought>) -> Receiver<Kept> {
    let (sender, receiver) = channel();
    // Without the thread the stream is closed, and nothing of it is kept.
    let _ = thread::Builder::new().name("output".into()).spawn(move || {
        let kept = stream
            .map(|stream| Kept::read(stream, sought))
            .unwrap_or_default();
        let _ = sender.send(kept);
    });
    receiver
}
