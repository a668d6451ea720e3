//! Whatever a command started and left behind. The main type is [`Descendants`].
//!
//! This process is the subreaper of its descendants (prctl(2)): one whose parent has ended becomes its child, whichever session,
//! group or terminal it chose. So all that a command started is found below this process, and nothing else is.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, thread,
    time::{Duration, Instant},
};

use nix::{
    sys::{
        prctl,
        signal::{Signal, kill},
        wait::{WaitPidFlag, waitpid},
    },
    unistd::{Pid, getpid},
};

use crate::command_error::CommandError;

/// How long the kernel may take to end what was killed.
const KILLED: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(2);

/// The descendants of this process that it has from now on.
#[derive(Debug)]
pub struct Descendants {
    /// Those that it had before, such as the daemons that a container's entry point started, with all that they start.
    earlier: BTreeSet<Pid>,
}

impl Descendants {
    /// From now on descendants without a parent are children of this process.
    ///
    /// # Errors
    /// When the kernel refuses.
    pub fn begin() -> Result<Self, CommandError> {
        prctl::set_child_subreaper(true).map_err(CommandError::system(
            "become the parent of what the command starts",
        ))?;
        Ok(Self {
            earlier: descendants(getpid(), &BTreeSet::new()),
        })
    }

    /// Waits for those that have ended and whose parents have, too, but for some that somebody else waits for. Otherwise a command that
    /// starts and leaves many fills the table of processes.
    pub fn reap(&self, but_for: impl IntoIterator<Item = Pid>) {
        let but_for: BTreeSet<Pid> = but_for.into_iter().collect();
        for pid in adopted() {
            if !self.earlier.contains(&pid) && !but_for.contains(&pid) {
                let _ = waitpid(pid, Some(WaitPidFlag::WNOHANG));
            }
        }
    }

    /// Ends each of them, and waits for them. How many there were, those that have ended and nobody has waited for among them.
    ///
    /// # Errors
    /// When some do not end.
    pub fn end_all(&self) -> Result<u64, CommandError> {
        end_all_but(&self.earlier)
    }
}

/// They are stopped first, so that none can start another while the others are ended.
fn end_all_but(earlier: &BTreeSet<Pid>) -> Result<u64, CommandError> {
    let begun = Instant::now();
    let mut ended = BTreeSet::new();
    let mut stopped = BTreeSet::new();
    loop {
        let found = descendants(getpid(), earlier);
        if found.is_empty() {
            return Ok(ended.len() as u64);
        }
        let is_new = !found.is_subset(&stopped);
        let signal = if is_new { Signal::SIGSTOP } else { Signal::SIGKILL };
        for pid in &found {
            // One that has ended meanwhile is a zombie until it is waited for, and takes any signal.
            let _ = kill(*pid, signal);
        }
        for pid in &found {
            // Of those that are not our children their own parents are killed, too, and then they are ours.
            let _ = waitpid(*pid, Some(WaitPidFlag::WNOHANG));
        }
        if begun.elapsed() > KILLED {
            return Err(CommandError::Stubborn { count: found.len() });
        }
        ended.extend(found.iter().copied());
        stopped = found;
        if !is_new {
            thread::sleep(LOOK);
        }
    }
}

/// Every process below that one, zombies too, but for those and all below them.
fn descendants(of: Pid, but_for: &BTreeSet<Pid>) -> BTreeSet<Pid> {
    let mut children: BTreeMap<Pid, Vec<Pid>> = BTreeMap::new();
    for (pid, parent) in processes() {
        children.entry(parent).or_default().push(pid);
    }
    let mut found = BTreeSet::new();
    let mut to_look_at = vec![of];
    while let Some(pid) = to_look_at.pop() {
        for child in children.get(&pid).into_iter().flatten() {
            if !but_for.contains(child) && found.insert(*child) {
                to_look_at.push(*child);
            }
        }
    }
    found
}

/// The children of this process's first thread, among which those are that have lost their parents; a short file, unlike all of `/proc`.
fn adopted() -> Vec<Pid> {
    let pid = getpid();
    let children = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap_or_default();
    let pids = children.split_whitespace().filter_map(|pid| pid.parse().ok());
    pids.map(Pid::from_raw).collect()
}

/// All processes with their parents.
fn processes() -> impl Iterator<Item = (Pid, Pid)> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| {
        let pid: i32 = entry.file_name().to_str()?.parse().ok()?;
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        // The name, in parentheses, may hold anything; the parent is the second field behind it.
        let (_, fields) = stat.rsplit_once(')')?;
        let parent: i32 = fields.split_whitespace().nth(1)?.parse().ok()?;
        Some((Pid::from_raw(pid), Pid::from_raw(parent)))
    })
}
