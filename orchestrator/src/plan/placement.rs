//! Which host runs a scenario, and whether it can. The main function is [`place`].

use std::collections::{BTreeMap, btree_map::Entry};

use record::{
    axis::{HARDWARE, NODE, OS},
    identity::{HostIdentity, IdentityMismatch},
    run_directory::PlannedScenario,
    settings::{Need, Settings},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::expansion::Combination;
use crate::{
    matrix_file::{Host, OneNode, did_you_mean, list},
    provider::{
        Availability,
        time_limit::{TimeLimit, WindowTooLong},
    },
};

/// What a survey found out about a host.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HostFacts {
    /// As `uname -m` says it, such as `x86_64`.
    pub hardware: String,
    /// `ID` and `VERSION_ID` of os-release, such as `debian-12`.
    pub os: String,
    /// As `uname -r` says it.
    pub kernel: String,
    /// Why it could not be asked what it is, if it could not; then no more is known.
    pub obstacle: Option<Obstacle>,
    /// Whether it was not to be asked, which is no obstacle.
    pub left_alone: bool,
    /// What its providers say, by their names. One that is not in it was not asked.
    pub providers: BTreeMap<String, ProviderFacts>,
}

/// What a survey found out about a provider on a host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProviderFacts {
    /// Whether it can work there at all.
    pub availability: Availability,
    /// Whether its environments meet what settings need. A need that is not in it is known in the environment only.
    pub needs: BTreeMap<Need, Availability>,
    /// How long one of its environments may take; none where as long as it needs.
    pub time_limit: Option<TimeLimit>,
}

/// What a host offers: what the matrix file says, completed by what the survey found.
#[derive(Debug, Clone, PartialEq)]
pub struct HostCapabilities {
    /// The host's name.
    pub host: String,
    /// Its hardware.
    pub hardware: String,
    /// Its operating system.
    pub os: String,
    /// The pool that it is in, if it is in one.
    pub pool: Option<String>,
    /// The node that it is, where each of a cluster's nodes is a host.
    pub node: Option<OneNode>,
    /// What is wrong with what the file says that it is.
    pub contradiction: Option<IdentityMismatch>,
    facts: Option<HostFacts>,
}

impl HostCapabilities {
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
            pool: host.pool.clone(),
            node: host.node.clone(),
            contradiction: facts.and_then(|facts| {
                let claim = HostIdentity {
                    host: &host.name.value,
                    hardware: host.hardware.as_deref(),
                    os: host.os.as_deref(),
                };
                claim.contradiction(&facts.hardware, &facts.os)
            }),
            facts: facts.cloned(),
        }
    }

    /// The value of one of the axes that hosts have.
    #[must_use]
    pub fn get(&self, axis: &str) -> Option<&str> {
        match axis {
            HARDWARE => Some(&self.hardware),
            OS => Some(&self.os),
            NODE => Some(&self.node.as_ref()?.name),
            _ => None,
        }
    }

    /// Why it could not be asked what it can do, if it could not.
    #[must_use]
    pub fn silence(&self) -> Option<&Obstacle> {
        self.facts.as_ref()?.obstacle.as_ref()
    }

    /// Why it cannot make environments of a kind that meet a need, if it cannot. A host that is out of reach may be back
    /// when its turn comes: that a machine is broken says nothing of what it can do.
    fn obstacle(&self, virtualization: &str, need: Option<&Need>, settings: &Settings) -> Option<Obstacle> {
        let Some(facts) = &self.facts else {
            return Some(Obstacle {
                reason: format!("host `{}` was not asked what it can do", self.host),
                fix: None,
            });
        };
        if facts.left_alone || facts.obstacle.is_some() {
            return None;
        }
        let Some(provider) = facts.providers.get(virtualization) else {
            return Some(Obstacle {
                reason: format!("this version cannot make environments with `{virtualization}` yet"),
                fix: None,
            });
        };
        let too_long = || provider.time_limit?.most_windows(settings).err();
        unavailable(&provider.availability)
            .or_else(|| unavailable(provider.needs.get(need?)?))
            .or_else(|| {
                Some(Obstacle {
                    reason: too_long()?.to_string(),
                    fix: Some(WindowTooLong::HINT.to_owned()),
                })
            })
    }
}

/// Why a scenario cannot run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Obstacle {
    /// The reason, as the plan and the report print it.
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
    /// All hosts of its pool that do, in the file's order; empty if it is in none, or alone in it.
    pub pool: Vec<String>,
    /// Why it cannot run there.
    pub obstacle: Option<Obstacle>,
}

/// The hosts that offer a combination's hardware and OS, and its node if it has one.
pub fn fitting<'a>(
    combination: &Combination,
    offers: &'a [HostCapabilities],
) -> impl Iterator<Item = &'a HostCapabilities> {
    offers.iter().filter(|offer| {
        [HARDWARE, OS]
            .iter()
            .all(|axis| combination.value(axis) == offer.get(axis))
            && combination
                .value(NODE)
                .is_none_or(|node| offer.get(NODE) == Some(node))
    })
}

/// The first host that offers a combination's hardware and OS and can make an environment that meets its settings' need, or, after
/// all those, may be able to when it is back; if none can, the first that offers them, with what stands in the way.
#[must_use]
pub fn place(
    combination: &Combination,
    provider: &str,
    settings: &Settings,
    offers: &[HostCapabilities],
) -> Placement {
    let need = Need::of(settings);
    let mut fitting: Vec<_> = fitting(combination, offers)
        .map(|offer| (offer.obstacle(provider, need.as_ref(), settings), offer))
        .collect();
    // A stable sort: among equals the file's order decides.
    fitting.sort_by_key(|(obstacle, offer)| (obstacle.is_some(), offer.silence().is_some()));
    match fitting.first() {
        Some((obstacle, first)) => Placement {
            host: Some(first.host.clone()),
            pool: pool(&fitting),
            obstacle: obstacle.clone(),
        },
        None => Placement {
            host: None,
            pool: Vec::new(),
            obstacle: Some(no_host(combination, offers)),
        },
    }
}

impl Placement {
    /// All hosts are this machine, and one is enough: it computes one scenario after the other, also where none offers what the
    /// scenario is to be measured on.
    pub fn compute_on(&mut self, offers: &[HostCapabilities]) {
        self.host = offers.first().map(|offer| offer.host.clone());
        self.pool.clear();
    }
}

/// Those that share the rounds of the first.
fn pool(fitting: &[(Option<Obstacle>, &HostCapabilities)]) -> Vec<String> {
    let of_first = fitting.first().and_then(|(_, first)| first.pool.as_ref());
    // Those that do not answer come last, and are waited for only if none answers.
    let shares = |(obstacle, offer): &&(Option<Obstacle>, &HostCapabilities)| {
        of_first.is_some()
            && offer.pool.as_ref() == of_first
            && obstacle.is_none()
            && offer.silence().is_none()
    };
    let hosts: Vec<String> = fitting
        .iter()
        .filter(shares)
        .map(|(_, offer)| offer.host.clone())
        .collect();
    match hosts.len() {
        0 | 1 => Vec::new(),
        _ => hosts,
    }
}

/// Has all scenarios of a pool share the hosts that can run each of them: a round is then measured on one host, whichever scenario,
/// and a difference between two scenarios of a round is none between hosts.
pub fn share(scenarios: &mut [PlannedScenario], offers: &[HostCapabilities]) {
    let place = |scenario: &PlannedScenario| {
        let host = scenario.host.as_ref().filter(|_| scenario.feasible)?;
        let offer = offers.iter().find(|offer| offer.host == *host)?;
        Some((offer.pool.clone()?, offer.hardware.clone(), offer.os.clone()))
    };
    let mut shared: BTreeMap<_, Vec<String>> = BTreeMap::new();
    for scenario in scenarios.iter() {
        let Some(place) = place(scenario) else { continue };
        let hosts: Vec<String> = scenario.hosts().map(str::to_owned).collect();
        match shared.entry(place) {
            Entry::Vacant(entry) => drop(entry.insert(hosts)),
            Entry::Occupied(mut entry) => entry.get_mut().retain(|host| hosts.contains(host)),
        }
    }
    for scenario in scenarios {
        let Some(hosts) = place(scenario).and_then(|place| shared.get(&place)) else {
            continue;
        };
        // Where no host can run them all, each runs where it can.
        scenario.pool = match hosts.len() {
            0 | 1 => Vec::new(),
            _ => hosts.clone(),
        };
        if let Some(first) = hosts.first() {
            scenario.host = Some(first.clone());
        }
    }
}

fn no_host(combination: &Combination, offers: &[HostCapabilities]) -> Obstacle {
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
    // A host that did not answer may be the one that was meant.
    if let Some(silent) = offers.iter().find_map(HostCapabilities::silence) {
        return Obstacle {
            reason: format!("{reason}; {}", silent.reason),
            fix: silent.fix.clone(),
        };
    }
    Obstacle {
        reason,
        fix: Some(format!(
            "add a host that offers it under `hosts:`, or exclude it; there are {}",
            list(pairs.iter().map(String::as_str))
        )),
    }
}
