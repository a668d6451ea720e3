//! One call of a command, from its start to the end of all that it started. The main type is [`Call`].

use std::{
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use nix::sys::signal::Signal;
use record::window::CommandRecord;
use rustix::fs::statvfs;

use super::{
    CommandError,
    program::{self, End, Printed, Program, Running, Usage, any_ends_within},
};
use crate::descendants::Descendants;

/// How often the workload looks whether it is to stop and whether the disk is full. The command's end is noticed at once.
pub const LOOK: Duration = Duration::from_secs(1);
/// How long a command may take to end once it was asked to.
pub const GRACE: Duration = Duration::from_secs(5);
/// What must stay free on the disk of the command's folder: 512 MiB.
const RESERVE: u64 = 512 << 20;

/// A command to be called.
pub struct Call<'a> {
    /// What is started.
    pub program: Program,
    /// How far it may go.
    pub bounds: Bounds<'a>,
    /// Those of this process, of which the command's are.
    pub descendants: &'a Descendants,
}

/// How far what runs in a window may go.
#[derive(Clone, Copy)]
pub struct Bounds<'a> {
    /// When it began.
    pub began: Instant,
    /// For how long at most.
    pub timeout: Duration,
    /// Ends it once it is set.
    pub stop: &'a AtomicBool,
    /// On whose disk some room must stay.
    pub folder: &'a Path,
}

/// What came of it.
#[derive(Debug)]
pub struct Ended {
    /// How it ended.
    pub outcome: Outcome,
    /// What it used.
    pub usage: Usage,
    /// What it printed.
    pub printed: Printed,
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
    /// By a signal that it brought upon itself.
    Crashed {
        /// Which.
        signal: i32,
    },
    /// It took longer than it may.
    TimedOut,
    /// It left too little room on the disk.
    DiskFull,
    /// The workload was asked to stop.
    Stopped,
    /// A node ended that was not to end, or not so.
    NodeEnded,
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
            Self::Crashed { signal } => format!("crashed with signal {signal}"),
            Self::TimedOut => format!("was ended since it took longer than {} s", timeout.as_secs_f64()),
            Self::DiskFull => format!(
                "was ended since the disk had less than {} MiB left",
                RESERVE >> 20
            ),
            Self::Stopped => "was interrupted".to_owned(),
            Self::NodeEnded => "was ended by a node".to_owned(),
        }
    }
}

impl From<End> for Outcome {
    fn from(end: End) -> Self {
        match end {
            End::Exited(code) => Self::Exited(code),
            End::Signal(signal) if is_a_crash(signal) => Self::Crashed { signal },
            End::Signal(signal) => Self::Killed { signal },
        }
    }
}

/// Whether it is a signal that a program brings upon itself (signal(7)): a crash is a result, and the window is not measured until it
/// succeeds. Nobody else sends these.
#[must_use]
pub fn is_a_crash(signal: i32) -> bool {
    [
        Signal::SIGSEGV,
        Signal::SIGBUS,
        Signal::SIGILL,
        Signal::SIGFPE,
        Signal::SIGABRT,
        Signal::SIGTRAP,
        Signal::SIGSYS,
        Signal::SIGXFSZ,
        Signal::SIGXCPU,
        Signal::SIGPIPE,
    ]
    .iter()
    .any(|crash| *crash as i32 == signal)
}

impl Bounds<'_> {
    /// Why it is not to go on, if so.
    #[must_use]
    pub fn exceeded(&self) -> Option<Outcome> {
        if self.stop.load(Ordering::Relaxed) {
            return Some(Outcome::Stopped);
        }
        if self.began.elapsed() >= self.timeout {
            return Some(Outcome::TimedOut);
        }
        let free = statvfs(self.folder).map(|disk| disk.f_bavail.saturating_mul(disk.f_frsize));
        free.is_ok_and(|free| free < RESERVE).then_some(Outcome::DiskFull)
    }

    /// How long to wait at most before the next look.
    #[must_use]
    pub fn until_next_look(&self) -> Duration {
        self.timeout.saturating_sub(self.began.elapsed()).min(LOOK)
    }

    /// Waits for the end of a program, and tells `watch` about once a second for how long that has been; why it is not to go on, if it
    /// did not end by itself.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn wait(
        &self,
        running: &Running,
        descendants: &Descendants,
        mut watch: impl FnMut(Duration),
    ) -> Result<Option<Outcome>, CommandError> {
        loop {
            if any_ends_within(&[running], self.until_next_look())? {
                return Ok(None);
            }
            if let Some(outcome) = self.exceeded() {
                return Ok(Some(outcome));
            }
            descendants.reap([running.pid()]);
            watch(self.began.elapsed());
        }
    }
}

impl Call<'_> {
    /// Calls it, tells `watch` about once a second for how long it has been running, and ends all that it left behind.
    ///
    /// # Errors
    /// When it cannot be started or what it left behind does not end.
    pub fn run(&self, watch: impl FnMut(Duration)) -> Result<Ended, CommandError> {
        let running = self.program.start()?;
        let cut = self.bounds.wait(&running, self.descendants, watch)?;
        Ended::of(&running, cut, self.descendants)
    }
}

impl Ended {
    /// Ends a program that may have ended by itself, and all that it started. `cut` is why, if it did not.
    ///
    /// # Errors
    /// When something of it does not end.
    pub fn of(
        running: &Running,
        cut: Option<Outcome>,
        descendants: &Descendants,
    ) -> Result<Self, CommandError> {
        // What has ended by itself is not left behind.
        descendants.reap([running.pid()]);
        let ends = program::end(&[running], GRACE)?;
        let left_behind = descendants.end_all()?;
        let (end, usage) = ends.first().copied().ok_or(CommandError::NoWork)?;
        Ok(Self {
            outcome: cut.unwrap_or(end.into()),
            usage,
            printed: running.printed(),
            left_behind,
        })
    }

    /// What the window's record has of it.
    #[must_use]
    pub fn record(&self) -> CommandRecord {
        CommandRecord {
            exit_code: self.outcome.exit_code(),
            cpu_ns: self.usage.cpu_ns,
            peak_memory_bytes: self.usage.peak_memory_bytes,
            stdout_bytes: self.printed.stdout.bytes,
            stderr_bytes: self.printed.stderr.bytes,
            left_behind: self.left_behind,
            nodes: Vec::new(),
        }
    }

    /// That nothing killed the command of this window.
    ///
    /// # Errors
    /// If something did.
    pub fn check_not_killed(&self, window: u32) -> Result<(), CommandError> {
        match self.outcome {
            Outcome::Killed { signal } => Err(CommandError::Killed {
                who: "the command".to_owned(),
                window,
                signal,
                last_words: self.printed.last_words(),
            }),
            _ => Ok(()),
        }
    }
}
