//! Which host runs a scenario, and whether it can. The main function is [`place`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use workload::settings::NetworkBackend;

use super::expansion::Combination;
use crate::{
    matrix_file::{Connection, HARDWARE, Host, OS, VIRTUALIZATION, did_you_mean, list},
    provider::Availability,
};

/// What a survey found out about a host.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HostFacts {
    /// As `uname -m` says it, such as `x86_64`.
    pub hardware: String,
    /// `ID` and `VERSION_ID` of os-release, such as `debian-12`.
    pub os: String,
    /// For each provider by name, whether it can work there. One that is not in it was not asked.
    pub providers: BTreeMap<String, Availability>,
    /// For each provider by name, what it says of the networks. One that is not in it is known in the environment only.
    pub networks: BTreeMap<String, BTreeMap<NetworkBackend, Availability>>,
}

/// What a host offers: what the matrix file says, completed by what the survey found.
#[derive(Debug, Clone, PartialEq)]
pub struct Offer {
    /// The host's name.
    pub host: String,
    /// Its hardware.
    pub hardware: String,
    /// Its operating system.
    pub os: String,
    connection: Connection,
    facts: Option<HostFacts>,
}

impl Offer {
    /// Of a host, with what is known of it.
    #[must_use]
    pub fn of(host: &Host, facts: Option<&HostFacts>) -> Self {
        let or_found = |said: &Option<String>, found: Option<&String>| {
            let known = said.as_ref().or(found.filter(|found| !found.is_empty()));
            known.cloned().unwrap_or_else(|| "unknown".to_owned())
        };
        Self {
            host: host.name.value.clone(),
            hardware: or_found(&host.hardware, facts.map(|facts| &facts.hardware)),
            os: or_found(&host.os, facts.map(|facts| &facts.os)),
            connection: host.connection.clone(),
            facts: facts.cloned(),
        }
    }

    /// The value of one of the two axes that hosts have.
    #[must_use]
    pub fn get(&self, axis: &str) -> Option<&str> {
        match axis {
            HARDWARE => Some(&self.hardware),
            OS => Some(&self.os),
            _ => None,
        }
    }

    /// Why it cannot make environments of a kind with a network, if it cannot.
    fn obstacle(&self, virtualization: &str, backend: NetworkBackend) -> Option<Obstacle> {
        if let Connection::Ssh(ssh) = &self.connection {
            return Some(Obstacle {
                reason: format!(
                    "host `{}` is reached over SSH ({}), which this version cannot do yet",
                    self.host, ssh.address
                ),
                fix: Some(format!(
                    "run `matrix` on `{}` itself, with `connect: local`",
                    self.host
                )),
            });
        }
        let Some(facts) = &self.facts else {
            return Some(Obstacle {
                reason: format!("host `{}` was not asked what it can do", self.host),
                fix: None,
            });
        };
        let Some(availability) = facts.providers.get(virtualization) else {
            return Some(Obstacle {
                reason: format!("this version cannot make environments with `{virtualization}` yet"),
                fix: None,
            });
        };
        let network = || facts.networks.get(virtualization)?.get(&backend);
        unavailable(availability).or_else(|| unavailable(network()?))
    }
}

/// Why a scenario cannot run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Obstacle {
    /// Why.
    pub reason: String,
    /// What would make it possible.
    pub fix: Option<String>,
}

fn unavailable(availability: &Availability) -> Option<Obstacle> {
    match availability {
        Availability::Available { .. } => None,
        Availability::Unavailable { reason, fix } => Some(Obstacle {
            reason: reason.clone(),
            fix: fix.clone(),
        }),
    }
}

/// Where a scenario runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placement {
    /// The host that offers what it needs.
    pub host: Option<String>,
    /// Why it cannot run there.
    pub obstacle: Option<Obstacle>,
}

/// The first host that offers a combination's hardware and OS and can make its environment with its network; if none
/// can, the first that offers them, with what stands in the way.
#[must_use]
pub fn place(combination: &Combination, backend: NetworkBackend, offers: &[Offer]) -> Placement {
    let virtualization = combination.value(VIRTUALIZATION).unwrap_or("native");
    let fits = |offer: &&Offer| {
        [HARDWARE, OS]
            .iter()
            .all(|axis| combination.value(axis) == offer.get(axis))
    };
    let mut fitting: Vec<_> = offers
        .iter()
        .filter(fits)
        .map(|offer| (offer.obstacle(virtualization, backend), offer))
        .collect();
    // A stable sort: among equals the file's order decides.
    fitting.sort_by_key(|(obstacle, _)| obstacle.is_some());
    match fitting.into_iter().next() {
        Some((obstacle, offer)) => Placement {
            host: Some(offer.host.clone()),
            obstacle,
        },
        None => Placement {
            host: None,
            obstacle: Some(no_host(combination, offers)),
        },
    }
}

fn no_host(combination: &Combination, offers: &[Offer]) -> Obstacle {
    let wanted: Vec<_> = [HARDWARE, OS]
        .iter()
        .filter_map(|axis| Some(format!("{axis} `{}`", combination.value(axis)?)))
        .collect();
    let mut reason = format!("no host offers {}", wanted.join(" with "));
    let meant = [HARDWARE, OS].iter().find_map(|axis| {
        let value = combination.value(axis)?;
        let offered: Vec<_> = offers.iter().filter_map(|offer| offer.get(axis)).collect();
        let meant = did_you_mean(value, offered.iter().copied())?;
        (!offered.contains(&value)).then_some(meant)
    });
    if let Some(meant) = meant {
        reason += &format!("; did you mean `{meant}`?");
    }
    let pairs: Vec<_> = offers
        .iter()
        .map(|offer| format!("{} {} ({})", offer.hardware, offer.os, offer.host))
        .collect();
    Obstacle {
        reason,
        fix: Some(format!(
            "add a host that offers it under `hosts:`, or exclude it; there are {}",
            list(pairs.iter().map(String::as_str))
        )),
    }
}
