//! What settings demand of the place in which the workload runs. The main type is [`Need`].
//!
//! Most settings demand nothing: what they name is in the workload itself. Those that do are asked for before a run, once
//! for each distinct need, so that what is missing is known before anything is measured.

use std::fmt;

use super::{CaptureTool, NetworkBackend, Offloads, RosMaster, Settings};

/// What the workload must find where it runs. Settings with the same need can run in the same places.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Need {
    network: NetworkNeed,
    master: RosMaster,
    capture: Option<CaptureNeed>,
}

/// What carries the packets, with what its interfaces are to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct NetworkNeed {
    backend: NetworkBackend,
    offloads: Offloads,
}

/// What captures, and what is left out.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct CaptureNeed {
    tool: CaptureTool,
    filter: Option<String>,
}

impl Need {
    /// Of settings; none of a command on no network, which finds what it needs in the user's image or on the machine, or says so, and
    /// none of what is computed.
    #[must_use]
    pub fn of(settings: &Settings) -> Option<Self> {
        let network = settings
            .network_in_use()
            .filter(|_| settings.simulation.is_none());
        network.map(|_| Self::of_the_network(settings))
    }

    /// Of settings, as far as they are of an emulated network and what is on it.
    #[must_use]
    pub fn of_the_network(settings: &Settings) -> Self {
        let offloads = match settings.network.backend.facts().programs_without_offloads {
            Some(_) => settings.network.offloads,
            None => Settings::default().network.offloads,
        };
        Self {
            network: NetworkNeed {
                backend: settings.network.backend,
                offloads,
            },
            master: settings.master_in_use().unwrap_or(RosMaster::Embedded),
            capture: settings.capture.enabled.then(|| CaptureNeed {
                tool: settings.capture.tool,
                filter: settings.capture.filter.clone(),
            }),
        }
    }

    /// The default settings but for those that make this need.
    #[must_use]
    pub fn settings(&self) -> Settings {
        let mut settings = Settings::default();
        settings.network.backend = self.network.backend;
        settings.network.offloads = self.network.offloads;
        settings.ros.master = self.master;
        settings.capture.enabled = self.capture.is_some();
        if let Some(capture) = &self.capture {
            settings.capture.tool = capture.tool;
            settings.capture.filter.clone_from(&capture.filter);
        }
        settings
    }

    /// The needs that one setting makes, each for itself: what there is to ask of a place. The first is of the defaults.
    #[must_use]
    pub fn each() -> Vec<Self> {
        let networks = NetworkBackend::ALL.map(|backend| with(|it| it.network.backend = backend));
        let others = [
            with(|it| it.ros.master = RosMaster::Rosmaster),
            with(|it| it.capture.tool = CaptureTool::Tcpdump),
        ];
        networks.into_iter().chain(others).collect()
    }

    /// The programs that must be there beside the workload itself, as a person names them.
    #[must_use]
    pub fn programs(&self) -> Vec<&'static str> {
        let network = self.network.backend.facts();
        let without_offloads: &[_] = match self.network.offloads {
            Offloads::Mininet => &[],
            Offloads::None => network.programs_without_offloads.unwrap_or_default(),
        };
        let master: &[_] = match self.master {
            RosMaster::Embedded => &[],
            RosMaster::Rosmaster => &["rosmaster"],
        };
        let capture: &[_] = match &self.capture {
            // tcpdump makes the kernel's program of a filter.
            Some(capture) if capture.tool == CaptureTool::Tcpdump || capture.filter.is_some() => &["tcpdump"],
            _ => &[],
        };
        [network.programs, without_offloads, master, capture].concat()
    }
}

/// Of the default settings with one change.
fn with(change: impl FnOnce(&mut Settings)) -> Need {
    let mut settings = Settings::default();
    change(&mut settings);
    Need::of_the_network(&settings)
}

/// The settings that make it, as a matrix file names them; of the defaults, the network.
impl fmt::Display for Need {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut words = Vec::new();
        if self.network.backend != NetworkBackend::Userspace || self.programs().is_empty() {
            words.push(format!("network.backend: {}", self.network.backend.name()));
        }
        if self.network.offloads == Offloads::None {
            words.push("network.offloads: none".to_owned());
        }
        if self.master == RosMaster::Rosmaster {
            words.push("ros.master: rosmaster".to_owned());
        }
        if let Some(capture) = &self.capture {
            if capture.tool == CaptureTool::Tcpdump {
                words.push("capture.tool: tcpdump".to_owned());
            }
            if let Some(filter) = &capture.filter {
                words.push(format!("capture.filter: {filter}"));
            }
        }
        f.write_str(&words.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{quantity::TimeSpan, settings::RealtimeSettings};

    fn settings(json: serde_json::Value) -> Settings {
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn settings_that_differ_in_what_the_workload_has_itself_have_the_same_need() {
        let other = Settings {
            windows: 1,
            window: TimeSpan::from_secs(100),
            realtime: RealtimeSettings {
                priority: 0,
                lock_memory: false,
            },
            ..settings(serde_json::json!({"network": {"loss": "5%", "offloads": "none", "seed": 7}}))
        };
        assert_eq!(
            Need::of_the_network(&other),
            Need::of_the_network(&Settings::default())
        );
    }

    #[rstest::rstest]
    #[case::defaults(serde_json::json!({}), &[], "network.backend: userspace")]
    #[case::kernel(
        serde_json::json!({"network": {"backend": "kernel"}}),
        &["ip", "tc"],
        "network.backend: kernel"
    )]
    #[case::kernel_without_offloads(
        serde_json::json!({"network": {"backend": "kernel", "offloads": "none"}}),
        &["ip", "tc", "ethtool"],
        "network.backend: kernel, network.offloads: none"
    )]
    #[case::mininet(
        serde_json::json!({"network": {"backend": "mininet", "offloads": "none"}}),
        &["Mininet", "a running Open vSwitch"],
        "network.backend: mininet"
    )]
    #[case::rosmaster(
        serde_json::json!({"ros": {"master": "rosmaster"}}),
        &["rosmaster"],
        "ros.master: rosmaster"
    )]
    #[case::filter(
        serde_json::json!({"capture": {"filter": "tcp"}}),
        &["tcpdump"],
        "capture.filter: tcp"
    )]
    #[case::no_capture(
        serde_json::json!({"capture": {"enabled": false, "tool": "tcpdump", "filter": "tcp"}}),
        &[],
        "network.backend: userspace"
    )]
    #[case::all(
        serde_json::json!({
            "network": {"backend": "kernel"}, "ros": {"master": "rosmaster"}, "capture": {"tool": "tcpdump"}
        }),
        &["ip", "tc", "rosmaster", "tcpdump"],
        "network.backend: kernel, ros.master: rosmaster, capture.tool: tcpdump"
    )]
    fn a_need_names_its_programs_and_its_settings(
        #[case] json: serde_json::Value,
        #[case] programs: &[&str],
        #[case] words: &str,
    ) {
        let need = Need::of_the_network(&settings(json));
        assert_eq!(need.programs(), programs);
        assert_eq!(need.to_string(), words);
        assert_eq!(
            Need::of_the_network(&need.settings()),
            need,
            "the settings it stands for"
        );
        assert_eq!(need.settings().problems(), []);
    }

    #[test]
    fn no_two_of_what_there_is_to_ask_are_the_same() {
        let each = Need::each();
        let distinct: std::collections::BTreeSet<_> = each.iter().collect();
        assert_eq!(distinct.len(), each.len());
    }
}
