//! The `mininet` network, which is the paper's: hosts, Open vSwitch switches, an OpenFlow controller and links
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
//! of Mininet's hosts. The bridges and their ports have names of their own in each network, so that several can be on one
//! machine, beside Mininets of others.
//!
//! Nothing is left behind: the program takes the network down when this process has ended, however it did; what is left
//! of it when both were killed is found by [`leftovers`].

pub mod error;
pub mod leftovers;
mod owner;
mod script;

use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use record::{settings::NetworkSettings, topology::Topology, virtual_host::VirtualHost, window::LinkRecord};

pub use self::error::MininetError;
use self::script::{Datapath, Done, Request, Script, Transcript, Up, bridge};
use super::{
    backend::Network,
    error::NetworkError,
    kernel::{counts, tools},
    namespace::{Namespace, Namespaces},
    seed::random_seed,
};

/// What the names of our bridges begin with. Six digits of the network, one of the switch, and `-eth64` make them 15 bytes, the most
/// that a name has.
const PREFIX: &str = "mx";

/// Mininet takes about a second, about fifteen on an emulated processor, and over 120 where that one is starved as well.
const TIMEOUT: Duration = Duration::from_secs(300);

/// A network that is up until it is dropped.
#[derive(Debug)]
pub struct Mininet {
    // Before the namespaces, so that they still exist while Mininet takes the network down.
    script: Mutex<Script>,
    hosts: Namespaces,
    /// The interfaces of both ends of each link, the lower one first.
    ports: Vec<[String; 2]>,
    name: String,
    topology: Topology,
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
        // Any 24 of the bits will do.
        let name = format!("{PREFIX}{:06x}", random_seed() & 0x00ff_ffff);
        let datapath = datapath()?;
        let topology = settings.topology();
        let mut script = Script::start()?;
        let request = Request::up(&name, datapath, &topology, settings.offloads);
        let Up { pids, links } = script.ask(&request, TIMEOUT)?;
        let namespaces = pids
            .into_iter()
            .map(Namespace::of_process)
            .collect::<Result<_, _>>()?;
        Ok(Self {
            script: Mutex::new(script),
            hosts: Namespaces::of(&topology, namespaces),
            ports: links,
            name,
            topology,
        })
    }

    fn script(&self) -> MutexGuard<'_, Script> {
        self.script.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Network for Mininet {
    fn topology(&self) -> &Topology {
        &self.topology
    }

    fn namespaces(&self) -> &Namespaces {
        &self.hosts
    }

    fn impair(&self) -> Result<(), NetworkError> {
        let Done {} = self.script().ask(&Request::impair(&self.topology), TIMEOUT)?;
        Ok(())
    }

    /// None where the counters cannot be read: that is no reason to stop measuring.
    fn links(&self) -> Vec<LinkRecord> {
        let link = |(host, [lower, upper]): (VirtualHost, &[String; 2])| {
            let lower = match self.hosts.at(host) {
                Ok(namespace) => tools::run(namespace, "tc", &show(lower)),
                // A switch, which is on the machine.
                Err(_) => tools::run_here("tc", &show(lower)),
            };
            let upper = tools::run_here("tc", &show(upper)).ok()?;
            Some(LinkRecord {
                host,
                up: counts::of_netem(&lower.ok()?)?,
                down: counts::of_netem(&upper)?,
            })
        };
        let names = self.topology.links().map(|(name, _)| name);
        names.zip(&self.ports).filter_map(link).collect()
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
        for position in 0..self.topology.switches.len() {
            let _ = leftovers::remove(&bridge(&self.name, position));
        }
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
    use record::topology::{MOST_HOSTS, MOST_SWITCHES};

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
        let bridge = bridge(&format!("{PREFIX}{:06x}", 0xff_ffff), MOST_SWITCHES - 1);
        assert_eq!(
            format!("{bridge}-eth{}", MOST_HOSTS + MOST_SWITCHES).len(),
            libc::IFNAMSIZ - 1
        );
    }
}
