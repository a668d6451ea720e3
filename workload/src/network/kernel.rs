//! The `kernel` network: a namespace for each host and one for the switch, veth pairs, a bridge, and at both ends of
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
    io,
    sync::{Mutex, PoisonError},
};

use nix::net::if_::if_nametoindex;
use record::{
    quantity::TimeSpan,
    settings::{NetworkSettings, Offloads},
    virtual_host::VirtualHost,
    window::{LinkRecord, PassRecord},
};

use self::tools::Transcript;
use super::{
    backend::Network,
    device::{self, Interface},
    error::NetworkError,
    ipv6,
    namespace::{Namespace, Work},
};

/// The bridge, named as Mininet names its first switch.
const BRIDGE: &str = "s1";

/// A network that is up until it is dropped.
#[derive(Debug)]
pub struct Kernel {
    hosts: [Namespace; 3],
    switch: Namespace,
    settings: NetworkSettings,
    transcript: Mutex<Transcript>,
}

impl Kernel {
    /// Makes the namespaces, the veth pairs and the bridge. The links are not impaired yet.
    ///
    /// # Errors
    /// If the platform does not offer what it needs.
    pub fn open(settings: &NetworkSettings) -> Result<Self, NetworkError> {
        let mut transcript = Transcript::default();
        let switch = Namespace::create()?;
        make_bridge(&switch, &mut transcript)?;
        let mut connect = |host| connect(host, &switch, settings.offloads, &mut transcript);
        let hosts = [
            connect(VirtualHost::H1)?,
            connect(VirtualHost::Sta1)?,
            connect(VirtualHost::Sta2)?,
        ];
        Ok(Self {
            hosts,
            switch,
            settings: settings.clone(),
            transcript: Mutex::new(transcript),
        })
    }

    /// Both ends of a host's link: the host's and the switch's.
    fn ends(&self, host: VirtualHost) -> [(&Namespace, String); 2] {
        [
            (&self.hosts[host.index()], host.interface()),
            (&self.switch, port(host)),
        ]
    }
}

impl Network for Kernel {
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
        let mut transcript = self.transcript.lock().unwrap_or_else(PoisonError::into_inner);
        for (namespace, interface) in VirtualHost::ALL.into_iter().flat_map(|host| self.ends(host)) {
            impair(namespace, &interface, &self.settings, &mut transcript)?;
        }
        Ok(())
    }

    /// None where the counters cannot be read: that is no reason to stop measuring.
    fn links(&self) -> Vec<LinkRecord> {
        let pass = |(namespace, interface): (&Namespace, String)| -> Option<PassRecord> {
            let words = ["-s", "-j", "qdisc", "show", "dev", &interface];
            counts::of_netem(&tools::run(namespace, "tc", &words).ok()?)
        };
        let link = |host| {
            let [up, down] = self.ends(host).map(pass);
            Some(LinkRecord {
                host,
                up: up?,
                down: down?,
            })
        };
        VirtualHost::ALL.into_iter().filter_map(link).collect()
    }

    /// netem draws from the kernel's own source of randomness.
    fn seed(&self) -> Option<u64> {
        None
    }

    fn transcript(&self) -> Option<String> {
        let mut transcript = self.transcript.lock().unwrap_or_else(PoisonError::into_inner);
        // A failure is in the transcript, where it belongs.
        for (namespace, interface) in VirtualHost::ALL.into_iter().flat_map(|host| self.ends(host)) {
            let _ = transcript.run(namespace, "tc", &["-s", "qdisc", "show", "dev", &interface]);
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
    let switch = Namespace::create()?;
    make_bridge(&switch, &mut transcript)?;
    let host = connect(VirtualHost::H1, &switch, settings.offloads, &mut transcript)?;
    impair(&host, &VirtualHost::H1.interface(), settings, &mut transcript)
}

/// A switch that forwards at once and says nothing itself.
fn make_bridge(switch: &Namespace, transcript: &mut Transcript) -> Result<(), NetworkError> {
    transcript.run(
        switch,
        "ip",
        &[
            "link",
            "add",
            BRIDGE,
            "type",
            "bridge",
            "stp_state",
            "0",
            "mcast_snooping",
            "0",
        ],
    )?;
    silence_ipv6(switch, BRIDGE)?;
    transcript.run(switch, "ip", &["link", "set", BRIDGE, "up"])
}

/// Makes a host's namespace and the link from it to the switch.
fn connect(
    host: VirtualHost,
    switch: &Namespace,
    offloads: Offloads,
    transcript: &mut Transcript,
) -> Result<Namespace, NetworkError> {
    let namespace = Namespace::create()?;
    let (interface, port) = (host.interface(), port(host));
    transcript.run(
        &namespace,
        "ip",
        &[
            "link",
            "add",
            &interface,
            "type",
            "veth",
            "peer",
            "name",
            &port,
            "netns",
            &switch.path(),
        ],
    )?;
    if offloads == Offloads::None {
        for (namespace, device) in [(&namespace, &interface), (switch, &port)] {
            let words = [
                "-K", device, "tso", "off", "gso", "off", "gro", "off", "tx", "off",
            ];
            transcript.run(namespace, "ethtool", &words)?;
        }
    }
    silence_ipv6(switch, &port)?;
    transcript.run(switch, "ip", &["link", "set", &port, "master", BRIDGE, "up"])?;
    let neighbours: Vec<_> = VirtualHost::ALL
        .into_iter()
        .filter(|other| *other != host)
        .map(Interface::of)
        .collect();
    namespace.within(move || device::configure(&Interface::of(host), &neighbours))?;
    Ok(namespace)
}

/// Has an interface delay, lose and limit what leaves through it, by the commands of Mininet 2.3.0's `TCIntf`
/// (`mininet/link.py`), but for the `limit`, which Mininet leaves at netem's own 1000.
fn impair(
    namespace: &Namespace,
    interface: &str,
    settings: &NetworkSettings,
    transcript: &mut Transcript,
) -> Result<(), NetworkError> {
    for command in commands(interface, settings) {
        let words: Vec<&str> = command.split(' ').collect();
        transcript.run(namespace, "tc", &words)?;
    }
    Ok(())
}

/// What `tc` is told for one interface.
fn commands(interface: &str, settings: &NetworkSettings) -> [String; 3] {
    let loss_percent = settings.loss.probability() * 100.0;
    let loss = if loss_percent > 0.0 {
        format!(" loss {loss_percent:.5}%")
    } else {
        String::new()
    };
    let rate_mbit = settings.bandwidth.bits_per_second() as f64 / 1e6;
    [
        format!("qdisc add dev {interface} root handle 5:0 htb default 1"),
        format!("class add dev {interface} parent 5:0 classid 5:1 htb rate {rate_mbit:.6}Mbit burst 15k"),
        format!(
            "qdisc add dev {interface} parent 5:1 handle 10: netem delay {} {}{loss} limit {}",
            tc_time(settings.delay),
            tc_time(settings.jitter),
            settings.limit_packets
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

/// The switch's end of a host's link, named as Mininet names it.
fn port(host: VirtualHost) -> String {
    format!("{BRIDGE}-eth{}", host.index() + 1)
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
            commands("h1-eth0", &NetworkSettings::default()),
            [
                "qdisc add dev h1-eth0 root handle 5:0 htb default 1",
                "class add dev h1-eth0 parent 5:0 classid 5:1 htb rate 10.000000Mbit burst 15k",
                "qdisc add dev h1-eth0 parent 5:1 handle 10: netem delay 10ms 1ms loss 1.00000% limit 1000",
            ]
        );
    }

    #[test]
    fn nothing_is_said_of_a_loss_of_nothing() {
        let settings = NetworkSettings {
            delay: "1500us".parse().unwrap(),
            jitter: "0ms".parse().unwrap(),
            loss: Fraction::from_percent(0.0),
            bandwidth: BitRate::from_mbit(100),
            limit_packets: 50,
            ..NetworkSettings::default()
        };
        let [_, class, netem] = commands("s1-eth2", &settings);
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
        assert_eq!(VirtualHost::ALL.map(port), ["s1-eth1", "s1-eth2", "s1-eth3"]);
    }
}
