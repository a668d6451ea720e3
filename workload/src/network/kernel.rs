//! The `kernel` network: a namespace for each host and one for the switches, veth pairs, bridges, and at both ends of
//! every link HTB with a netem child, as Mininet's `TCLink` sets them. The main type is [`Kernel`].
//!
//! ```text
//! h1's namespace          the switch's namespace            sta1's namespace
//! h1-eth0 ──veth── s1-eth1 ── bridge s1 ── s1-eth2 ──veth── sta1-eth0
//! HTB+netem       HTB+netem                HTB+netem        HTB+netem
//! ```
//!
//! `ip` and `tc` do it, since they are what Mininet uses and their words say exactly what was done: they are kept in
//! [`Network::transcript`]. The namespaces have no name, and devices go with them.
//!
//! A host's packets pass its queue before a capture on its interface sees them (Linux, `dev_hard_start_xmit`), as in
//! Mininet. In the `userspace` network the interface comes before the link.

pub mod counts;
pub mod tools;

use std::{
    iter,
    sync::{Mutex, PoisonError},
};

use nix::net::if_::if_nametoindex;
use record::{
    quantity::TimeSpan,
    settings::{NetworkSettings, Offloads},
    topology::{Link, Topology},
    virtual_host::VirtualHost,
    window::{LinkRecord, PassRecord},
};

use self::tools::Transcript;
use super::{
    backend::Network,
    device::{self, Interface},
    error::NetworkError,
    ipv6,
    namespace::{Namespace, Namespaces},
};

/// A network that is up until it is dropped.
#[derive(Debug)]
pub struct Kernel {
    hosts: Namespaces,
    /// All of them are in one.
    switches: Namespace,
    topology: Topology,
    ports: Ports,
    transcript: Mutex<Transcript>,
}

impl Kernel {
    /// Makes the namespaces, the veth pairs and the bridges. The links are not impaired yet.
    ///
    /// # Errors
    /// If the platform does not offer what it needs.
    pub fn open(settings: &NetworkSettings) -> Result<Self, NetworkError> {
        let mut transcript = Transcript::default();
        let topology = settings.topology();
        let ports = Ports::of(&topology);
        let switches = Namespace::create()?;
        for switch in &topology.switches {
            make_bridge(&switches, switch.name, &mut transcript)?;
        }
        let mut maker = Maker {
            topology: &topology,
            ports: &ports,
            switches: &switches,
            offloads: settings.offloads,
            transcript: &mut transcript,
        };
        let hosts = (0..topology.hosts.len()).map(|position| maker.connect(position));
        let hosts = hosts.collect::<Result<_, _>>()?;
        maker.connect_switches()?;
        Ok(Self {
            hosts: Namespaces::of(&topology, hosts),
            switches,
            topology,
            ports,
            transcript: Mutex::new(transcript),
        })
    }

    /// The namespaces and the interfaces of both ends of every link, the lower one first, in the topology's order.
    fn ends(&self) -> impl Iterator<Item = (VirtualHost, Link, [(&Namespace, &str); 2])> {
        // Switches are in one namespace, and their links are the last.
        let lower = self.hosts.iter().chain(iter::repeat(&self.switches));
        let links = self.topology.links().zip(lower).zip(&self.ports.of_links);
        links.map(|(((name, link), namespace), [lower, upper])| {
            let ends = [(namespace, lower.as_str()), (&self.switches, upper.as_str())];
            (name, link, ends)
        })
    }
}

/// The names of the interfaces at both ends of each link, as Mininet names them: `h1-eth0` and `s1-eth1`.
#[derive(Debug)]
struct Ports {
    /// The lower end, which is the host's, and the upper one, in the order of [`Topology::links`].
    of_links: Vec<[String; 2]>,
}

impl Ports {
    fn of(topology: &Topology) -> Self {
        let mut taken = vec![0; topology.switches.len()];
        let mut next = |switch: usize| {
            let name = topology.switches.get(switch).map(|switch| switch.name);
            let number = taken.get_mut(switch).map_or(0, |number| {
                *number += 1;
                *number
            });
            format!(
                "{}-eth{number}",
                name.map(|name| name.to_string()).unwrap_or_default()
            )
        };
        let mut of_links: Vec<_> = topology
            .hosts
            .iter()
            .map(|host| [host.name.interface(), next(host.switch)])
            .collect();
        for (lower, switch) in topology.switches.iter().enumerate() {
            if let Some((upper, _)) = switch.uplink {
                of_links.push([next(lower), next(upper)]);
            }
        }
        Self { of_links }
    }
}

impl Network for Kernel {
    fn topology(&self) -> &Topology {
        &self.topology
    }

    fn namespaces(&self) -> &Namespaces {
        &self.hosts
    }

    fn impair(&self) -> Result<(), NetworkError> {
        let mut transcript = self.transcript.lock().unwrap_or_else(PoisonError::into_inner);
        for (_, link, ends) in self.ends() {
            for (namespace, interface) in ends {
                impair(namespace, interface, &link, &mut transcript)?;
            }
        }
        Ok(())
    }

    /// None where the counters cannot be read: that is no reason to stop measuring.
    fn links(&self) -> Vec<LinkRecord> {
        let pass = |(namespace, interface): (&Namespace, &str)| -> Option<PassRecord> {
            let words = ["-s", "-j", "qdisc", "show", "dev", interface];
            counts::of_netem(&tools::run(namespace, "tc", &words).ok()?)
        };
        let link = |(host, _, ends): (VirtualHost, Link, [_; 2])| {
            let [up, down] = ends.map(pass);
            Some(LinkRecord {
                host,
                up: up?,
                down: down?,
            })
        };
        self.ends().filter_map(link).collect()
    }

    /// netem draws from the kernel's own source of randomness.
    fn seed(&self) -> Option<u64> {
        None
    }

    fn transcript(&self) -> Option<String> {
        let mut transcript = self.transcript.lock().unwrap_or_else(PoisonError::into_inner);
        // A failure is in the transcript, where it belongs.
        for (namespace, interface) in self.ends().flat_map(|(_, _, ends)| ends) {
            let _ = transcript.run(namespace, "tc", &["-s", "qdisc", "show", "dev", interface]);
        }
        Some(transcript.to_string())
    }

    fn failure(&self) -> Option<NetworkError> {
        None
    }
}

/// Makes one link with both its ends in one namespace, impairs it as the settings say, and drops it.
///
/// # Errors
/// What is missing.
pub fn survey(settings: &NetworkSettings) -> Result<(), NetworkError> {
    let mut transcript = Transcript::default();
    let topology = settings.topology();
    let switches = Namespace::create()?;
    let first = topology
        .hosts
        .first()
        .and_then(|host| Some((host, topology.switches.get(host.switch)?)));
    if let Some((host, switch)) = first {
        make_bridge(&switches, switch.name, &mut transcript)?;
        let namespace = Maker {
            topology: &topology,
            ports: &Ports::of(&topology),
            switches: &switches,
            offloads: settings.offloads,
            transcript: &mut transcript,
        }
        .connect(0)?;
        impair(&namespace, &host.name.interface(), &host.link, &mut transcript)?;
    }
    Ok(())
}

/// A switch that forwards at once and says nothing itself.
fn make_bridge(
    switch: &Namespace,
    bridge: VirtualHost,
    transcript: &mut Transcript,
) -> Result<(), NetworkError> {
    let bridge = bridge.name();
    transcript.run(
        switch,
        "ip",
        &[
            "link",
            "add",
            bridge,
            "type",
            "bridge",
            "stp_state",
            "0",
            "mcast_snooping",
            "0",
        ],
    )?;
    silence_ipv6(switch, bridge)?;
    transcript.run(switch, "ip", &["link", "set", bridge, "up"])
}

/// Makes the links of a network, one by one.
struct Maker<'a> {
    topology: &'a Topology,
    ports: &'a Ports,
    switches: &'a Namespace,
    offloads: Offloads,
    transcript: &'a mut Transcript,
}

impl Maker<'_> {
    /// Makes the namespace of the host in that position and the link from it to its switch.
    fn connect(&mut self, position: usize) -> Result<Namespace, NetworkError> {
        let namespace = Namespace::create()?;
        let (interface, neighbours) = Interface::and_neighbours(self.topology, position)?;
        let switch = self.topology.hosts.get(position).map_or(0, |host| host.switch);
        if let Some(ends) = self.ports.of_links.get(position) {
            self.link(&namespace, ends)?;
            self.attach(&ends[1], switch)?;
        }
        namespace.within(move || device::configure(&interface, &neighbours))?;
        Ok(namespace)
    }

    /// Makes the links between the switches, whose ends come after those of the hosts.
    fn connect_switches(&mut self) -> Result<(), NetworkError> {
        let uplinks = self.topology.switches.iter().enumerate();
        let uplinks = uplinks.filter_map(|(lower, switch)| Some((lower, switch.uplink?.0)));
        let ends = self.ports.of_links.iter().skip(self.topology.hosts.len());
        for ((lower, upper), ends) in uplinks.zip(ends) {
            self.link(self.switches, ends)?;
            self.attach(&ends[0], lower)?;
            self.attach(&ends[1], upper)?;
        }
        Ok(())
    }

    /// Makes a pair of interfaces, the first in `namespace` and the second at the switches.
    fn link(&mut self, namespace: &Namespace, [lower, upper]: &[String; 2]) -> Result<(), NetworkError> {
        let path = self.switches.path();
        let words = [
            "link", "add", lower, "type", "veth", "peer", "name", upper, "netns", &path,
        ];
        self.transcript.run(namespace, "ip", &words)?;
        if self.offloads == Offloads::None {
            for (namespace, device) in [(namespace, lower), (self.switches, upper)] {
                let words = [
                    "-K", device, "tso", "off", "gso", "off", "gro", "off", "tx", "off",
                ];
                self.transcript.run(namespace, "ethtool", &words)?;
            }
        }
        Ok(())
    }

    /// Connects an end of a link to the bridge of the switch in that position.
    fn attach(&mut self, port: &str, switch: usize) -> Result<(), NetworkError> {
        let Some(bridge) = self.topology.switches.get(switch) else {
            return Ok(());
        };
        silence_ipv6(self.switches, port)?;
        let words = ["link", "set", port, "master", bridge.name.name(), "up"];
        self.transcript.run(self.switches, "ip", &words)
    }
}

/// Has an interface delay, lose and limit what leaves through it, by the commands of Mininet 2.3.0's `TCIntf`
/// (`mininet/link.py`), but for the `limit`, which Mininet leaves at netem's own 1000.
fn impair(
    namespace: &Namespace,
    interface: &str,
    link: &Link,
    transcript: &mut Transcript,
) -> Result<(), NetworkError> {
    for command in commands(interface, link) {
        let words: Vec<&str> = command.split(' ').collect();
        transcript.run(namespace, "tc", &words)?;
    }
    Ok(())
}

/// What `tc` is told for one interface.
fn commands(interface: &str, link: &Link) -> [String; 3] {
    let loss_percent = link.loss.probability() * 100.0;
    let loss = if loss_percent > 0.0 {
        format!(" loss {loss_percent:.5}%")
    } else {
        String::new()
    };
    let rate_mbit = link.bandwidth.bits_per_second() as f64 / 1e6;
    [
        format!("qdisc add dev {interface} root handle 5:0 htb default 1"),
        format!("class add dev {interface} parent 5:0 classid 5:1 htb rate {rate_mbit:.6}Mbit burst 15k"),
        format!(
            "qdisc add dev {interface} parent 5:1 handle 10: netem delay {} {}{loss} limit {}",
            tc_time(link.delay),
            tc_time(link.jitter),
            link.limit_packets
        ),
    ]
}

/// A time in `tc`'s words, exact to the nanosecond.
pub fn tc_time(span: TimeSpan) -> String {
    match span.as_nanos() {
        nanoseconds if nanoseconds % 1_000_000 == 0 => format!("{}ms", nanoseconds / 1_000_000),
        nanoseconds if nanoseconds % 1_000 == 0 => format!("{}us", nanoseconds / 1_000),
        nanoseconds => format!("{nanoseconds}ns"),
    }
}

fn silence_ipv6(namespace: &Namespace, interface: &str) -> Result<(), NetworkError> {
    let interface = interface.to_owned();
    namespace.within(move || {
        if_nametoindex(interface.as_str())
            .and_then(ipv6::silence)
            .map_err(|source| NetworkError::Interface {
                interface,
                action: "silencing IPv6 on it",
                source,
            })
    })
}

#[cfg(test)]
mod tests {
    use record::quantity::{BitRate, Fraction};

    use super::*;

    #[test]
    fn the_papers_link_is_made_by_mininets_commands() {
        assert_eq!(
            commands("h1-eth0", &NetworkSettings::default().link()),
            [
                "qdisc add dev h1-eth0 root handle 5:0 htb default 1",
                "class add dev h1-eth0 parent 5:0 classid 5:1 htb rate 10.000000Mbit burst 15k",
                "qdisc add dev h1-eth0 parent 5:1 handle 10: netem delay 10ms 1ms loss 1.00000% limit 1000",
            ]
        );
    }

    #[test]
    fn nothing_is_said_of_a_loss_of_nothing() {
        let link = Link {
            delay: "1500us".parse().unwrap(),
            jitter: "0ms".parse().unwrap(),
            loss: Fraction::from_percent(0.0),
            bandwidth: BitRate::from_mbit(100),
            limit_packets: 50,
        };
        let [_, class, netem] = commands("s1-eth2", &link);
        assert!(class.contains("rate 100.000000Mbit"), "{class}");
        assert!(netem.ends_with("netem delay 1500us 0ms limit 50"), "{netem}");
    }

    #[rstest::rstest]
    #[case("10ms", "10ms")]
    #[case("2s", "2000ms")]
    #[case("1500us", "1500us")]
    #[case("1234ns", "1234ns")]
    fn a_time_keeps_its_nanoseconds(#[case] span: &str, #[case] words: &str) {
        assert_eq!(tc_time(span.parse().unwrap()), words);
    }

    #[test]
    fn ports_are_numbered_as_mininet_numbers_them() {
        let network: NetworkSettings = serde_json::from_value(serde_json::json!({
            "hosts": {"a": {}, "b": {"switch": "s2"}, "c": {}},
            "switches": {"s1": {}, "s2": {}},
        }))
        .unwrap();
        let ports = Ports::of(&network.topology());
        let expected = [
            ["a-eth0", "s1-eth1"],
            ["b-eth0", "s2-eth1"],
            ["c-eth0", "s1-eth2"],
            ["s2-eth2", "s1-eth3"],
        ];
        assert_eq!(ports.of_links, expected);
    }
}
