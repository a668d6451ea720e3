//! Network namespaces without a name, and the user namespace that lets an ordinary user have them. The main type is
//! [`Namespace`]. See network_namespaces(7) and user_namespaces(7).

use std::{
    fs::{self, File},
    io,
    os::fd::{AsRawFd, OwnedFd},
    panic, thread,
};

use nix::{
    errno::Errno,
    sched::{CloneFlags, setns, unshare},
    unistd::{getgid, getuid},
};

use super::NetworkError;

/// CAP_SYS_ADMIN's place in a capability set (`linux/capability.h`).
const CAP_SYS_ADMIN: u32 = 21;

/// A network namespace. It is gone with its last thread, socket and handle.
#[derive(Debug)]
pub struct Namespace {
    handle: OwnedFd,
}

impl Namespace {
    /// A new one, with a loopback interface that is down and nothing else.
    ///
    /// # Errors
    /// If the kernel refuses, most often for lack of CAP_SYS_ADMIN.
    pub fn create() -> Result<Self, NetworkError> {
        // A thread of its own, since unshare() moves the calling one.
        on_own_thread(|| {
            unshare(CloneFlags::CLONE_NEWNET).map_err(|source| NetworkError::Namespace { source })?;
            let handle = File::open("/proc/thread-self/ns/net").map_err(|error| NetworkError::Namespace {
                source: errno(&error),
            })?;
            Ok(Self {
                handle: handle.into(),
            })
        })
    }

    /// That of another process.
    ///
    /// # Errors
    /// If the process has ended or the kernel refuses.
    pub fn of_process(pid: u32) -> Result<Self, NetworkError> {
        let handle = File::open(format!("/proc/{pid}/ns/net")).map_err(|error| NetworkError::Enter {
            source: errno(&error),
        })?;
        Ok(Self {
            handle: handle.into(),
        })
    }

    /// Where other processes find it, as long as this process has it.
    #[must_use]
    pub fn path(&self) -> String {
        format!("/proc/{}/fd/{}", std::process::id(), self.handle.as_raw_fd())
    }

    /// Moves the calling thread into it.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn enter(&self) -> Result<(), NetworkError> {
        setns(&self.handle, CloneFlags::CLONE_NEWNET).map_err(|source| NetworkError::Enter { source })
    }

    /// Does something inside it, on a thread of its own.
    ///
    /// # Errors
    /// If it cannot be entered, or what the work says.
    pub fn within<T: Send>(
        &self,
        work: impl FnOnce() -> Result<T, NetworkError> + Send,
    ) -> Result<T, NetworkError> {
        on_own_thread(|| {
            self.enter()?;
            work()
        })
    }
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

/// Runs the work on a thread that lives as long as the work.
fn on_own_thread<T: Send>(work: impl FnOnce() -> Result<T, NetworkError> + Send) -> Result<T, NetworkError> {
    thread::scope(|scope| {
        let thread = thread::Builder::new()
            .name("namespace".into())
            .spawn_scoped(scope, work)
            .map_err(|error| NetworkError::Thread {
                source: errno(&error),
            })?;
        thread
            .join()
            .unwrap_or_else(|payload| panic::resume_unwind(payload))
    })
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
