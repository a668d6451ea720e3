//! Network namespaces without a name, and the user namespace that lets an ordinary user have them. The main type is
//! [`Namespace`]. See network_namespaces(7) and user_namespaces(7).

use std::{
    fmt,
    fs::{self, File},
    io,
    os::fd::OwnedFd,
    panic,
    sync::mpsc::{Receiver, Sender, channel},
    thread::{self, JoinHandle},
};

use nix::{
    errno::Errno,
    sched::{CloneFlags, setns, unshare},
    unistd::{Pid, getgid, gettid, getuid},
};

use record::{topology::Topology, virtual_host::VirtualHost};

use super::error::NetworkError;
use crate::capabilities::drop_unneeded;

/// CAP_SYS_ADMIN's place in a capability set (`linux/capability.h`).
const CAP_SYS_ADMIN: u32 = 21;

/// What a namespace's own thread is given to do: starting a thread, which takes no time.
pub type Work = Box<dyn FnOnce() + Send>;

/// Its own thread does nothing but wait and start threads and programs.
const STACK_BYTES: usize = 256 * 1024;

/// A network namespace, with a thread that stays in it and starts those that are to be there: a thread begins where the one is
/// that starts it. So nobody needs the right to enter it, and the experiment gives that right up. The namespace is gone with
/// its last thread, socket and handle.
pub struct Namespace {
    handle: OwnedFd,
    /// Its own thread's number.
    tid: Pid,
    /// None once it is dropped.
    work: Option<Sender<Work>>,
    thread: Option<JoinHandle<()>>,
}

impl fmt::Debug for Namespace {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Namespace")
            .field("handle", &self.handle)
            .finish_non_exhaustive()
    }
}

/// Those of a network's hosts.
#[derive(Debug)]
pub struct Namespaces(Vec<(VirtualHost, Namespace)>);

impl Namespaces {
    /// One for each host, in the topology's order.
    #[must_use]
    pub fn of(topology: &Topology, namespaces: Vec<Namespace>) -> Self {
        Self(topology.names().zip(namespaces).collect())
    }

    /// Of a network without hosts.
    #[cfg(test)]
    pub const NONE: Self = Self(Vec::new());

    /// All of them, in the topology's order.
    pub fn iter(&self) -> impl Iterator<Item = &Namespace> {
        self.0.iter().map(|(_, namespace)| namespace)
    }

    /// That of a host.
    ///
    /// # Errors
    /// If there is none.
    pub fn at(&self, host: VirtualHost) -> Result<&Namespace, NetworkError> {
        let found = self.0.iter().find(|(name, _)| *name == host);
        found
            .map(|(_, namespace)| namespace)
            .ok_or_else(|| NetworkError::NoHost {
                host: host.to_string(),
            })
    }
}

impl Namespace {
    /// A new one, with a loopback interface that is down and nothing else.
    ///
    /// # Errors
    /// If the kernel refuses, most often for lack of CAP_SYS_ADMIN.
    pub fn create() -> Result<Self, NetworkError> {
        Self::begin(|| {
            unshare(CloneFlags::CLONE_NEWNET).map_err(|source| NetworkError::Namespace { source })?;
            let handle = File::open("/proc/thread-self/ns/net").map_err(|error| NetworkError::Namespace {
                source: errno(&error),
            })?;
            Ok(handle.into())
        })
    }

    /// That of another process.
    ///
    /// # Errors
    /// If the process has ended or the kernel refuses.
    pub fn of_process(pid: u32) -> Result<Self, NetworkError> {
        Self::begin(move || {
            let handle = File::open(format!("/proc/{pid}/ns/net")).map_err(|error| NetworkError::Enter {
                source: errno(&error),
            })?;
            let handle = handle.into();
            enter(&handle)?;
            Ok(handle)
        })
    }

    /// Starts its thread, which gets there by itself and says with what handle.
    fn begin(
        get_there: impl FnOnce() -> Result<OwnedFd, NetworkError> + Send + 'static,
    ) -> Result<Self, NetworkError> {
        let no_thread = |error: io::Error| NetworkError::Thread {
            source: errno(&error),
        };
        let (there, is_there) = channel();
        let (work, to_do) = channel();
        let thread = thread::Builder::new()
            .name("namespace".into())
            .stack_size(STACK_BYTES)
            .spawn(move || {
                let handle = get_there();
                drop_unneeded();
                if there.send(handle.map(|handle| (handle, gettid()))).is_ok() {
                    do_all(&to_do);
                }
            })
            .map_err(no_thread)?;
        let (handle, tid) = is_there
            .recv()
            .unwrap_or_else(|_| Err(no_thread(io::ErrorKind::BrokenPipe.into())))?;
        Ok(Self {
            handle,
            tid,
            work: Some(work),
            thread: Some(thread),
        })
    }

    /// Where other processes find it, as long as this process has it: with its own thread, since the kernel shows nobody what
    /// belongs to a thread with more rights (ptrace(2), "access mode checking").
    #[must_use]
    pub fn path(&self) -> String {
        format!("/proc/{}/task/{}/ns/net", std::process::id(), self.tid)
    }

    /// Moves the calling thread into it, for which that must have CAP_SYS_ADMIN.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn enter(&self) -> Result<(), NetworkError> {
        enter(&self.handle)
    }

    /// Has its own thread do something short, sometime.
    ///
    /// # Errors
    /// If the thread has ended.
    pub fn give(&self, work: Work) -> io::Result<()> {
        let given = self.work.as_ref().map(|to| to.send(work));
        match given {
            Some(Ok(())) => Ok(()),
            _ => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    /// Does something inside it, on a thread that lives as long as the work.
    ///
    /// # Errors
    /// If there is no thread for it, or what the work says.
    pub fn within<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, NetworkError> + Send + 'static,
    ) -> Result<T, NetworkError> {
        let thread = spawn_by(|starting| self.give(starting), "namespace".to_owned(), work);
        let thread = thread.map_err(|error| NetworkError::Thread {
            source: errno(&error),
        })?;
        thread
            .join()
            .unwrap_or_else(|payload| panic::resume_unwind(payload))
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        // Without anything more to come it ends.
        self.work = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn enter(handle: &OwnedFd) -> Result<(), NetworkError> {
    setns(handle, CloneFlags::CLONE_NEWNET).map_err(|source| NetworkError::Enter { source })
}

fn do_all(to_do: &Receiver<Work>) {
    for work in to_do {
        work();
    }
}

/// Has a thread started by who is given the work of starting it.
///
/// # Errors
/// If it cannot be started.
pub fn spawn_by<T: Send + 'static>(
    give: impl FnOnce(Work) -> io::Result<()>,
    name: String,
    work: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    let (tell, started) = channel();
    give(Box::new(move || {
        // Who asked waits for the answer.
        let _ = tell.send(thread::Builder::new().name(name).spawn(work));
    }))?;
    started
        .recv()
        .unwrap_or_else(|_| Err(io::ErrorKind::BrokenPipe.into()))
}

/// Lets an ordinary user build networks: moves the process into a user namespace of its own, in which it is root, if
/// it lacks the right to make network namespaces. Files that it writes still belong to the user. Call it first thing,
/// while the process has one thread.
///
/// # Errors
/// If the kernel does not let this user have a user namespace, or the process has more threads.
pub fn become_namespace_root() -> Result<(), NetworkError> {
    if may_administer()? {
        return Ok(());
    }
    let refused = |source| NetworkError::UserNamespace { source };
    let (user, group) = (getuid(), getgid());
    unshare(CloneFlags::CLONE_NEWUSER).map_err(refused)?;
    // The order matters: without setgroups denied an ordinary user may not map a group.
    for (file, text) in [
        ("/proc/self/setgroups", "deny".to_owned()),
        ("/proc/self/uid_map", format!("0 {user} 1\n")),
        ("/proc/self/gid_map", format!("0 {group} 1\n")),
    ] {
        fs::write(file, text).map_err(|error| refused(errno(&error)))?;
    }
    Ok(())
}

/// Whether CAP_SYS_ADMIN is effective.
fn may_administer() -> Result<bool, NetworkError> {
    let status = fs::read_to_string("/proc/self/status").map_err(|error| NetworkError::UserNamespace {
        source: errno(&error),
    })?;
    let effective = effective_capabilities(&status).unwrap_or(0);
    Ok(effective & (1 << CAP_SYS_ADMIN) != 0)
}

/// The effective set in the text of `/proc/self/status`.
fn effective_capabilities(status: &str) -> Option<u64> {
    let set = status.lines().find_map(|line| line.strip_prefix("CapEff:"))?;
    u64::from_str_radix(set.trim(), 16).ok()
}

/// The error number of an I/O error that came from the kernel.
pub(crate) fn errno(error: &io::Error) -> Errno {
    error.raw_os_error().map_or(Errno::UnknownErrno, Errno::from_raw)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("Name:\tx\nCapEff:\t000001ffffffffff\nCapBnd:\t0\n", Some(0x1ff_ffff_ffff))]
    #[case("CapEff:\t0000000000000000\n", Some(0))]
    #[case("CapBnd:\t000001ffffffffff\n", None)]
    #[case("CapEff:\tnonsense\n", None)]
    fn the_effective_capabilities_are_read_from_the_status(#[case] status: &str, #[case] set: Option<u64>) {
        assert_eq!(effective_capabilities(status), set);
    }
}
