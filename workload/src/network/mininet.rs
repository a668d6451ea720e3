//! The `mininet` network, which is the paper's: three hosts, an Open vSwitch switch, an OpenFlow controller and links
//! with HTB and netem, all made by Mininet's own API. The main type is [`Mininet`].
//!
//! ```text
//! h1's namespace         this machine's namespace          sta1's namespace
//! h1-eth0 ──veth── mx…-eth1 ── Open vSwitch mx… ── mx…-eth2 ──veth── sta1-eth0
//! HTB+netem       HTB+netem          │             HTB+netem        HTB+netem
//!                          ovs-testcontroller, on a free port of 127.0.0.1
//! ```
//!
//! Open vSwitch forwards in the kernel where that has the module, and in its daemon otherwise; the transcript says which.
//!
//! A Python program ([`script`]) holds the network, since Mininet's is Python's; the nodes run here, in the namespaces
//! of Mininet's hosts. The bridge and its ports have a name of their own in each network, so that several can be on one
//! machine, beside Mininets of others.
//!
//! Nothing is left behind: the program takes the network down when this process has ended, however it did; what is left
//! of it when both were killed is found by [`leftovers`].

pub mod error;
pub mod leftovers;
mod owner;
mod script;

use std::{
    io,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use record::{settings::NetworkSettings, virtual_host::VirtualHost, window::LinkRecord};

pub use self::error::MininetError;
use self::script::{Datapath, Done, Impair, Request, Script, Transcript, Up};
use super::{
    backend::Network,
    error::NetworkError,
    kernel::{counts, tools},
    namespace::{Namespace, Work},
    seed::random_seed,
};

/// What the names of our bridges begin with. Eight digits and `-eth3` make them 15 bytes, the most that a name has.
const PREFIX: &str = "mx";

/// Mininet takes about a second, about fifteen on an emulated processor, and over 120 where that one is starved as well.
const TIMEOUT: Duration = Duration::from_secs(300);

/// A network that is up until it is dropped.
#[derive(Debug)]
pub struct Mininet {
    // Before the namespaces, so that they still exist while Mininet takes the network down.
    script: Mutex<Script>,
    hosts: [Namespace; 3],
    /// The switch's ends of the links.
    ports: [String; 3],
    name: String,
    settings: NetworkSettings,
}

impl Mininet {
    /// Removes what killed ones left and has Mininet build the network. The links are not impaired yet.
    ///
    /// # Errors
    /// If the platform does not offer what it needs.
    pub fn open(settings: &NetworkSettings) -> Result<Self, NetworkError> {
        look_for_root()?;
        for bridge in leftovers::find()? {
            leftovers::remove(&bridge)?;
        }
        // Any 32 of the bits will do.
        let name = format!("{PREFIX}{:08x}", random_seed() as u32);
        let datapath = datapath()?;
        let mut script = Script::start()?;
        let Up { pids, ports } = script.ask(&Request::up(&name, datapath, settings), TIMEOUT)?;
        let [h1, sta1, sta2] = pids.map(Namespace::of_process);
        Ok(Self {
            script: Mutex::new(script),
            hosts: [h1?, sta1?, sta2?],
            ports,
            name,
            settings: settings.clone(),
        })
    }

    fn script(&self) -> MutexGuard<'_, Script> {
        self.script.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Network for Mininet {
    fn enter(&self, host: VirtualHost) -> Result<(), NetworkError> {
        self.hosts[host.index()].enter()
    }

    fn give(&self, host: VirtualHost, work: Work) -> io::Result<()> {
        self.hosts[host.index()].give(work)
    }

    fn interface(&self, host: VirtualHost) -> String {
        host.interface()
    }

    fn impair(&self) -> Result<(), NetworkError> {
        let request = Request::Impair(Impair::from(&self.settings));
        let Done {} = self.script().ask(&request, TIMEOUT)?;
        Ok(())
    }

    /// None where the counters cannot be read: that is no reason to stop measuring.
    fn links(&self) -> Vec<LinkRecord> {
        let link = |host: VirtualHost| {
            let own = host.interface();
            let own = tools::run(&self.hosts[host.index()], "tc", &show(&own)).ok()?;
            let port = tools::run_here("tc", &show(&self.ports[host.index()])).ok()?;
            Some(LinkRecord {
                host,
                up: counts::of_netem(&own)?,
                down: counts::of_netem(&port)?,
            })
        };
        VirtualHost::ALL.into_iter().filter_map(link).collect()
    }

    /// netem draws from the kernel's own source of randomness.
    fn seed(&self) -> Option<u64> {
        None
    }

    fn transcript(&self) -> Option<String> {
        match self.script().ask(&Request::Inspect, TIMEOUT) {
            Ok(Transcript { transcript }) => Some(transcript),
            Err(error) => Some(format!("# {error}\n")),
        }
    }

    fn failure(&self) -> Option<NetworkError> {
        self.script().has_ended().then(|| MininetError::Ended.into())
    }
}

impl Drop for Mininet {
    fn drop(&mut self) {
        self.script().end();
        // The program was killed, perhaps. What cannot be removed now is found again by the next one.
        let _ = leftovers::remove(&self.name);
    }
}

/// Whether Mininet can build a network here. Makes nothing but a queue in a namespace that is dropped.
///
/// # Errors
/// What is missing.
pub fn survey() -> Result<(), NetworkError> {
    look_for_root()?;
    let Done {} = Script::start()?.ask(&Request::Survey, TIMEOUT)?;
    for (program, words) in [
        (
            "ovs-vsctl",
            [
                "--timeout=5",
                "--no-wait",
                "get",
                "Open_vSwitch",
                ".",
                "ovs_version",
            ]
            .as_slice(),
        ),
        ("ovs-appctl", &["--timeout=5", "--target=ovs-vswitchd", "version"]),
    ] {
        tools::run_here(program, words).map_err(|error| match error {
            NetworkError::Command { said, .. } => MininetError::Service { said }.into(),
            other => other,
        })?;
    }
    datapath()?;
    let namespace = Namespace::create()?;
    for command in [
        "qdisc add dev lo root handle 5:0 htb default 1",
        "class add dev lo parent 5:0 classid 5:1 htb rate 10Mbit",
        "qdisc add dev lo parent 5:1 handle 10: netem delay 10ms",
    ] {
        let words: Vec<&str> = command.split(' ').collect();
        tools::run(&namespace, "tc", &words)?;
    }
    Ok(())
}

/// What `tc` is told to print the counts of an interface's queues.
fn show(interface: &str) -> [&str; 6] {
    ["-s", "-j", "qdisc", "show", "dev", interface]
}

/// Open vSwitch belongs to the machine: being root of a user namespace does not do.
fn look_for_root() -> Result<(), NetworkError> {
    let map = std::fs::read_to_string("/proc/self/uid_map").unwrap_or_default();
    if nix::unistd::geteuid().is_root() && !maps_one_user(&map) {
        Ok(())
    } else {
        Err(MininetError::NotRoot.into())
    }
}

/// Whether a `/proc/self/uid_map` (user_namespaces(7)) is that of a user namespace with nobody in it but its maker.
fn maps_one_user(uid_map: &str) -> bool {
    uid_map.split_whitespace().nth(2) == Some("1")
}

/// The kernel's datapath where the kernel has it, or loads it when it is asked for; the daemon's own otherwise. One is made in
/// a namespace that is dropped.
fn datapath() -> Result<Datapath, NetworkError> {
    match tools::run(&Namespace::create()?, "ovs-dpctl", &["add-dp", "probe"]) {
        Ok(_) => Ok(Datapath::Kernel),
        Err(NetworkError::Command { .. }) => Ok(Datapath::User),
        Err(other) => Err(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case::of_the_machine("         0          0 4294967295\n", false)]
    #[case::of_a_container("         0     100000      65536\n", false)]
    #[case::of_an_ordinary_user("         0       1000          1\n", true)]
    #[case::unreadable("", false)]
    fn the_root_of_an_ordinary_users_namespace_is_not_the_machines(#[case] uid_map: &str, #[case] one: bool) {
        assert_eq!(maps_one_user(uid_map), one);
    }

    #[test]
    fn the_longest_name_is_as_long_as_the_kernel_takes() {
        assert_eq!(format!("{PREFIX}{:08x}-eth3", u32::MAX).len(), libc::IFNAMSIZ - 1);
    }
}
