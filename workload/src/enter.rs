//! Running a tool inside a virtual host of a workload that runs already, such as `rostopic` or a node of one's own. The
//! main function is [`exec`].
//!
//! The hosts' network namespaces have no name. A running workload keeps an idle thread in each ([`entry_name`]), and
//! /proc gives that thread's namespace to whoever may have it: the same user, or root. See setns(2), proc(5).

use std::{
    ffi::OsString,
    fs::{self, File},
    io,
    net::Ipv4Addr,
    os::unix::process::CommandExt,
    path::PathBuf,
    process::Command,
};

use nix::{
    errno::Errno,
    ifaddrs::getifaddrs,
    sched::{CloneFlags, setns},
};
use record::virtual_host::VirtualHost;

/// Why a host could not be entered.
#[derive(Debug, thiserror::Error)]
pub enum EnterError {
    /// There is no such process.
    #[error("there is no process {pid}")]
    NoProcess {
        /// The number that was given.
        pid: u32,
    },
    /// It has no such host, now.
    #[error("process {pid} has no virtual host {host}")]
    NoHost {
        /// The process.
        pid: u32,
        /// The host.
        host: VirtualHost,
    },
    /// The kernel does not let us in.
    #[error("the network of {host} could not be entered")]
    Refused {
        /// The host.
        host: VirtualHost,
        /// What the kernel said.
        source: io::Error,
    },
    /// The tool could not be started.
    #[error("{} could not be started", program.display())]
    Program {
        /// The tool.
        program: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
}

impl EnterError {
    /// What to do about it.
    #[must_use]
    pub const fn hint(&self) -> &'static str {
        match self {
            Self::NoProcess { .. } => "`pidof workload` says which there are",
            Self::NoHost { .. } => {
                "name a `workload run` or `workload rehearse` that has said `network-up` and has not ended"
            }
            Self::Refused { .. } => "enter as the user who runs that workload, or as root",
            Self::Program { .. } => {
                "the tool is looked for on this machine, not inside a container: is it installed here?"
            }
        }
    }
}

/// The name of the thread that the workload keeps in a host.
#[must_use]
pub fn entry_name(host: VirtualHost) -> String {
    format!("netns-{host}")
}

/// Replaces this process by the program, inside the host, with `ROS_MASTER_URI` and `ROS_IP` set for it. Returns only
/// to say why it could not. The calling process must have one thread.
pub fn exec(
    pid: u32,
    host: VirtualHost,
    master_uri: &str,
    program: &OsString,
    arguments: &[OsString],
) -> EnterError {
    if let Err(error) = enter(pid, host) {
        return error;
    }
    let source = Command::new(program)
        .args(arguments)
        .env("ROS_MASTER_URI", master_uri)
        .envs(address(host).map(|address| ("ROS_IP", address.to_string())))
        .env_remove("ROS_HOSTNAME")
        .exec();
    EnterError::Program {
        program: program.into(),
        source,
    }
}

/// The address that the host has, which this process is in.
fn address(host: VirtualHost) -> Option<Ipv4Addr> {
    let interface = host.interface();
    let mut found = getifaddrs().ok()?.filter(|it| it.interface_name == interface);
    found.find_map(|it| Some(it.address?.as_sockaddr_in()?.ip()))
}

/// Moves this process into the host's network.
fn enter(pid: u32, host: VirtualHost) -> Result<(), EnterError> {
    let refused = |source: io::Error| EnterError::Refused { host, source };
    let network = find(pid, host)?;
    let open = || File::open(&network).map_err(refused);
    match setns(open()?, CloneFlags::CLONE_NEWNET) {
        Ok(()) => return Ok(()),
        // It belongs to a user namespace that an ordinary user's workload has made.
        Err(Errno::EPERM) => {}
        Err(errno) => return Err(refused(errno.into())),
    }
    let user = File::open(format!("/proc/{pid}/ns/user")).map_err(refused)?;
    setns(user, CloneFlags::CLONE_NEWUSER).map_err(|errno| refused(errno.into()))?;
    setns(open()?, CloneFlags::CLONE_NEWNET).map_err(|errno| refused(errno.into()))
}

/// The namespace of the thread that is in that host.
fn find(pid: u32, host: VirtualHost) -> Result<PathBuf, EnterError> {
    let tasks = fs::read_dir(format!("/proc/{pid}/task")).map_err(|_| EnterError::NoProcess { pid })?;
    let entry = entry_name(host);
    tasks
        .flatten()
        .map(|task| task.path())
        .find(|task| fs::read_to_string(task.join("comm")).is_ok_and(|name| name.trim_end() == entry))
        .map(|task| task.join("ns/net"))
        .ok_or(EnterError::NoHost { pid, host })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_without_hosts_has_none() {
        let error = enter(std::process::id(), VirtualHost::STA1).unwrap_err();
        assert!(matches!(error, EnterError::NoHost { .. }), "{error}");
    }

    #[test]
    fn no_process_has_none_either() {
        // Above the largest process number that Linux gives.
        let error = enter(u32::MAX, VirtualHost::H1).unwrap_err();
        assert!(matches!(error, EnterError::NoProcess { .. }), "{error}");
    }
}
