//! Who is connected to whom in an emulated network: hosts and switches in a tree, each link with what it does to packets. The main
//! type is [`Topology`]; a matrix file's `network.hosts` and `network.switches` make it.

use std::net::Ipv4Addr;

use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

use crate::{
    quantity::{BitRate, Fraction, TimeSpan},
    virtual_host::VirtualHost,
};

/// More hosts no machine carries: each has a namespace, a device and an address of the last byte.
pub const MOST_HOSTS: usize = 64;
/// More switches no machine carries, and their number is a hexadecimal digit of a bridge's name.
pub const MOST_SWITCHES: usize = 16;
/// A port's name, such as `s1-eth64`, has 15 characters at most.
const LONGEST_SWITCH: usize = 9;

/// What both ends of a link do to packets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Mean delay of one pass through an end.
    pub delay: TimeSpan,
    /// Uniform on [delay − jitter, delay + jitter).
    pub jitter: TimeSpan,
    /// Share of packets lost at one pass, each independently.
    pub loss: Fraction,
    /// Rate of one pass.
    pub bandwidth: BitRate,
    /// How many packets an end holds before it drops.
    pub limit_packets: u32,
}

/// The link of a host, or of a switch towards the first one: where it leads, and what it does that others do not.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct LinkSettings {
    /// The switch at its other end; the first one if it is left out. That of a switch is one of those before it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub switch: Option<VirtualHost>,
    /// Mean delay of one pass through an end of this link, in place of `network.delay`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay: Option<TimeSpan>,
    /// In place of `network.jitter`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jitter: Option<TimeSpan>,
    /// In place of `network.loss`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loss: Option<Fraction>,
    /// In place of `network.bandwidth`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bandwidth: Option<BitRate>,
    /// In place of `network.limit_packets`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit_packets: Option<u32>,
}

/// What a topology is made of.
#[derive(Debug, Clone, Copy)]
pub struct Wanted<'a> {
    /// The hosts; the three of the ball on the plate if there are none.
    pub hosts: &'a IndexMap<VirtualHost, LinkSettings>,
    /// The switches; one if there are none.
    pub switches: &'a IndexMap<VirtualHost, LinkSettings>,
    /// What each link does that says nothing of its own.
    pub link: &'a Link,
}

/// A tree of switches with hosts at them.
#[derive(Debug, Clone, PartialEq)]
pub struct Topology {
    /// In the order of their addresses.
    pub hosts: Vec<TopologyHost>,
    /// The first is the root of the tree, and every other one comes after the one that it is connected to.
    pub switches: Vec<TopologySwitch>,
}

/// A host with its link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TopologyHost {
    /// Its name.
    pub name: VirtualHost,
    /// The position of the switch at the other end of its link.
    pub switch: usize,
    /// What the link does.
    pub link: Link,
}

/// A switch with its link towards the root of the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TopologySwitch {
    /// Its name.
    pub name: VirtualHost,
    /// The position of the switch that it is connected to, and what that link does; none of the first.
    pub uplink: Option<(usize, Link)>,
}

/// What is wrong with a topology: the path below `network`, the message, what to write.
type Problem = (String, String, String);

impl Topology {
    /// That of the settings. What [`problems`] finds is left out.
    #[must_use]
    pub fn of(wanted: &Wanted<'_>) -> Self {
        let plain = LinkSettings::default();
        let named = wanted.switches.iter().map(|(name, switch)| (*name, switch));
        let default = wanted.switches.is_empty().then_some((VirtualHost::S1, &plain));
        let mut switches: Vec<TopologySwitch> = Vec::new();
        for (name, settings) in named.chain(default) {
            let uplink = settings
                .switch
                .unwrap_or_else(|| switches.first().map_or(name, |first| first.name));
            let at = switches.iter().position(|switch| switch.name == uplink);
            let uplink = at.map(|at| (at, settings.link(wanted.link)));
            switches.push(TopologySwitch { name, uplink });
        }
        let named = wanted.hosts.iter().map(|(name, host)| (*name, host));
        let of_the_ball = VirtualHost::OF_THE_BALL.map(|name| (name, &plain));
        let default = of_the_ball.into_iter().filter(|_| wanted.hosts.is_empty());
        let hosts = named.chain(default).map(|(name, settings)| TopologyHost {
            name,
            switch: settings
                .switch
                .and_then(|wanted| switches.iter().position(|switch| switch.name == wanted))
                .unwrap_or(0),
            link: settings.link(wanted.link),
        });
        Self {
            hosts: hosts.collect(),
            switches,
        }
    }

    /// The position of a host; none if it has no such host.
    #[must_use]
    pub fn position(&self, host: VirtualHost) -> Option<usize> {
        self.hosts.iter().position(|it| it.name == host)
    }

    /// The names of its hosts, in order.
    pub fn names(&self) -> impl Iterator<Item = VirtualHost> {
        self.hosts.iter().map(|host| host.name)
    }

    /// Every link, by the name of the host or the switch whose way towards the root it is: those of the hosts, in order, and then
    /// those of the switches.
    pub fn links(&self) -> impl Iterator<Item = (VirtualHost, Link)> {
        let hosts = self.hosts.iter().map(|host| (host.name, host.link));
        let uplinks = self.switches.iter();
        hosts.chain(uplinks.filter_map(|switch| Some((switch.name, switch.uplink?.1))))
    }
}

/// The address of the host at that position, numbered from 10.0.0.1 as Mininet does; the network is 10.0.0.0/8.
#[must_use]
pub const fn address(position: usize) -> Ipv4Addr {
    Ipv4Addr::new(10, 0, 0, position as u8 + 1)
}

/// The address of a host of the ball on the plate.
#[must_use]
pub fn address_in_the_ball(host: VirtualHost) -> Ipv4Addr {
    let position = VirtualHost::OF_THE_BALL.iter().position(|it| *it == host);
    address(position.unwrap_or(0))
}

/// The hardware address of the host at that position, as Mininet gives with `autoSetMacs`: 00:00:00:00:00:01 and up.
#[must_use]
pub const fn mac(position: usize) -> [u8; 6] {
    [0, 0, 0, 0, 0, position as u8 + 1]
}

impl LinkSettings {
    /// What it has.
    pub const FIELDS: [&str; 6] = ["switch", "delay", "jitter", "loss", "bandwidth", "limit_packets"];

    /// Whether that is the dotted path of a setting of one link, such as `network.hosts.sta1.delay`.
    #[must_use]
    pub fn is_path(path: &str) -> bool {
        match path.split('.').collect::<Vec<_>>().as_slice() {
            ["network", "hosts" | "switches", name, field] => {
                name.parse::<VirtualHost>().is_ok() && Self::FIELDS.contains(field)
            }
            _ => false,
        }
    }

    /// What it does, where it says nothing of its own as all others.
    fn link(&self, others: &Link) -> Link {
        Link {
            delay: self.delay.unwrap_or(others.delay),
            jitter: self.jitter.unwrap_or(others.jitter),
            loss: self.loss.unwrap_or(others.loss),
            bandwidth: self.bandwidth.unwrap_or(others.bandwidth),
            limit_packets: self.limit_packets.unwrap_or(others.limit_packets),
        }
    }
}

impl Link {
    /// What no link can be: the name of its setting, the message, what to write.
    fn problem(&self) -> Option<(&'static str, String, String)> {
        if self.jitter > self.delay {
            let message = format!(
                "jitter of {} about a delay of {} would be negative at times",
                self.jitter, self.delay
            );
            return Some(("jitter", message, format!("write at most `{}`", self.delay)));
        }
        (self.limit_packets == 0).then(|| {
            let message = "a queue of no packets passes none".to_owned();
            ("limit_packets", message, "write `1000`".to_owned())
        })
    }
}

/// What does not fit together, with paths below `network`.
#[must_use]
pub(crate) fn problems(network: &Wanted<'_>) -> Vec<Problem> {
    let mut found = Vec::new();
    let shared = network.link.problem();
    found.extend(
        shared
            .iter()
            .map(|(field, message, hint)| ((*field).to_owned(), message.clone(), hint.clone())),
    );
    for (path, count, most) in [
        ("hosts", network.hosts.len(), MOST_HOSTS),
        ("switches", network.switches.len(), MOST_SWITCHES),
    ] {
        if count > most {
            let message = format!("{count} are more than {most}");
            found.push((path.to_owned(), message, format!("write at most {most}")));
        }
    }
    let known = |switches: &IndexMap<VirtualHost, LinkSettings>| match switches.is_empty() {
        true => vec![VirtualHost::S1.to_string()],
        false => switches.keys().map(ToString::to_string).collect(),
    };
    for name in network
        .switches
        .keys()
        .filter(|name| name.name().len() > LONGEST_SWITCH)
    {
        let message = format!(
            "`{name}` is longer than {LONGEST_SWITCH} characters, which leaves no room for its ports' numbers"
        );
        found.push((
            format!("switches.{name}"),
            message,
            "write a shorter name".to_owned(),
        ));
    }
    for (at, (name, switch)) in network.switches.iter().enumerate() {
        let earlier: Vec<VirtualHost> = network.switches.keys().take(at).copied().collect();
        let path = format!("switches.{name}.switch");
        match switch.switch {
            Some(uplink) if earlier.is_empty() => {
                let message = format!(
                    "the first switch, `{name}`, is connected to no switch before it, such as `{uplink}`"
                );
                found.push((
                    path,
                    message,
                    "take it out, or write it after that switch".to_owned(),
                ));
            }
            Some(uplink) if !earlier.contains(&uplink) => {
                let names: Vec<String> = earlier.iter().map(ToString::to_string).collect();
                let message = format!("there is no switch `{uplink}` before `{name}`");
                found.push((
                    path,
                    message,
                    format!("write one of those before it: {}", names.join(", ")),
                ));
            }
            _ => {}
        }
        let differs = switch.link(network.link) != *network.link;
        if at > 0 || !differs {
            let problem = switch
                .link(network.link)
                .problem()
                .filter(|_| differs || shared.is_none());
            found.extend(
                problem.map(|(field, message, hint)| (format!("switches.{name}.{field}"), message, hint)),
            );
        } else {
            let message = format!("the first switch, `{name}`, has no link of its own");
            let hint = "write it with a host, or with a switch after the first".to_owned();
            found.push((format!("switches.{name}"), message, hint));
        }
    }
    for (name, host) in network.hosts {
        let switches = known(network.switches);
        if switches.contains(&name.to_string()) {
            let message = format!("`{name}` is the name of a switch, too");
            found.push((
                format!("hosts.{name}"),
                message,
                "give it another name".to_owned(),
            ));
        }
        if let Some(switch) = host
            .switch
            .filter(|switch| !switches.contains(&switch.to_string()))
        {
            let message = format!("there is no switch `{switch}`");
            let hint = format!(
                "write one of {}, or add it to `network.switches`",
                switches.join(", ")
            );
            found.push((format!("hosts.{name}.switch"), message, hint));
        }
        let link = host.link(network.link);
        let problem = link.problem().filter(|_| link != *network.link);
        found.extend(problem.map(|(field, message, hint)| (format!("hosts.{name}.{field}"), message, hint)));
    }
    found
}

#[cfg(test)]
mod tests {
    use rstest::rstest;
    use serde_json::json;

    use super::*;
    use crate::settings::NetworkSettings;

    fn network(section: serde_json::Value) -> NetworkSettings {
        serde_json::from_value(section).unwrap()
    }

    fn found(network: &NetworkSettings) -> Vec<Problem> {
        problems(&network.wanted(&network.link()))
    }

    #[test]
    fn the_fields_of_a_link_are_those_that_a_matrix_file_may_have() {
        let all: LinkSettings = serde_json::from_value(serde_json::json!({
            "switch": "s1", "delay": "1ms", "jitter": "1ms", "loss": "0%", "bandwidth": "1Mbit", "limit_packets": 1,
        }))
        .unwrap();
        let written = serde_json::to_value(all).unwrap();
        let mut fields: Vec<&str> = written.as_object().unwrap().keys().map(String::as_str).collect();
        let mut named = LinkSettings::FIELDS.to_vec();
        fields.sort_unstable();
        named.sort_unstable();
        assert_eq!(fields, named);
    }

    #[test]
    fn left_out_it_is_the_papers_three_hosts_at_one_switch() {
        let network = NetworkSettings::default();
        let topology = network.topology();
        assert!(topology.names().eq(VirtualHost::OF_THE_BALL));
        assert_eq!(topology.switches.len(), 1);
        assert!(topology.links().all(|(_, link)| link == network.link()));
        assert_eq!(address(2).to_string(), "10.0.0.3");
        assert_eq!(mac(2), [0, 0, 0, 0, 0, 3]);
        assert_eq!(found(&network), []);
        assert!(serde_json::to_value(&network).unwrap().get("hosts").is_none());
    }

    #[test]
    fn each_link_has_what_it_says_and_else_what_all_have() {
        let network = network(json!({
            "delay": "2ms",
            "hosts": {"robot": {"delay": "20ms", "loss": "5%", "switch": "s2"}, "base": {}},
            "switches": {"s1": {}, "s2": {"bandwidth": "1Mbit"}},
        }));
        assert_eq!(found(&network), []);
        let topology = network.topology();
        let [robot, base] = topology.hosts.as_slice() else {
            panic!("{topology:?}")
        };
        // The order is that of the file and not of the alphabet.
        assert_eq!((robot.name.name(), robot.switch, base.switch), ("robot", 1, 0));
        assert_eq!(robot.link.delay.to_string(), "20ms");
        assert_eq!(robot.link.jitter, network.jitter);
        assert_eq!(base.link, network.link());
        let (to, link) = topology.switches[1].uplink.unwrap();
        assert_eq!((to, link.bandwidth), (0, BitRate::from_mbit(1)));
        let names: Vec<String> = topology.links().map(|(name, _)| name.to_string()).collect();
        assert_eq!(names, ["robot", "base", "s2"]);
        let again: NetworkSettings = serde_json::from_str(&serde_json::to_string(&network).unwrap()).unwrap();
        assert!(again.hosts.keys().eq(network.hosts.keys()), "the order is kept");
    }

    #[rstest]
    #[case::jitter(json!({"hosts": {"a": {"jitter": "20ms"}}}), "hosts.a.jitter")]
    #[case::queue(json!({"hosts": {"a": {"limit_packets": 0}}}), "hosts.a.limit_packets")]
    #[case::once(json!({"limit_packets": 0, "hosts": {"a": {}}, "switches": {"x": {}, "y": {}}}), "limit_packets")]
    #[case::no_switch(json!({"hosts": {"a": {"switch": "s2"}}}), "hosts.a.switch")]
    #[case::two_kinds(json!({"hosts": {"s1": {}}}), "hosts.s1")]
    #[case::later(json!({"switches": {"x": {}, "y": {"switch": "z"}, "z": {}}}), "switches.y.switch")]
    #[case::itself(json!({"switches": {"x": {}, "y": {"switch": "y"}}}), "switches.y.switch")]
    #[case::root(json!({"switches": {"x": {"switch": "y"}, "y": {}}}), "switches.x.switch")]
    #[case::long(json!({"switches": {"upstairs-1": {}}}), "switches.upstairs-1")]
    #[case::no_link(json!({"switches": {"x": {"delay": "1ms", "jitter": "0ms"}, "y": {}}}), "switches.x")]
    fn what_is_no_network_is_told_at_its_place(#[case] section: serde_json::Value, #[case] path: &str) {
        let found = found(&network(section));
        let paths: Vec<&str> = found.iter().map(|(path, ..)| path.as_str()).collect();
        assert_eq!(paths, [path], "{found:?}");
    }

    #[rstest]
    #[case("network.hosts.sta1.delay", true)]
    #[case("network.switches.s2.limit_packets", true)]
    #[case("network.hosts.sta1", false)]
    #[case("network.hosts.sta1.delays", false)]
    #[case("network.hosts.STA1.delay", false)]
    #[case("network.delay", false)]
    fn a_setting_of_one_link_has_a_path(#[case] path: &str, #[case] is_one: bool) {
        assert_eq!(LinkSettings::is_path(path), is_one);
    }

    #[test]
    fn there_are_as_many_hosts_as_addresses() {
        let hosts: serde_json::Map<_, _> = (0..=MOST_HOSTS).map(|at| (format!("h{at}"), json!({}))).collect();
        assert_eq!(found(&network(json!({ "hosts": hosts })))[0].0, "hosts");
    }
}
