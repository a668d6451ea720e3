//! The networks that there are: one row each, with its name, its needs, what it refuses and what reports say of it. The main
//! type is [`NetworkBackend`]; the workload's module `network` opens what it names.

use serde::{Deserialize, Serialize};

use super::NetworkSettings;

/// What holds of a network whatever its settings are.
#[derive(Debug)]
pub struct BackendFacts {
    /// As a matrix file names it: the variant in lower case.
    pub name: &'static str,
    /// The programs that it needs beside the workload itself, as a person names them.
    pub programs: &'static [&'static str],
    /// Those that `network.offloads: none` needs besides; none where that setting changes nothing about the need.
    pub programs_without_offloads: Option<&'static [&'static str]>,
    /// The settings that it does not take.
    pub refusals: &'static [Refusal],
    /// What its switch is, in the drawing of the network.
    pub switch: &'static str,
    /// Whether a controller is connected to the switch.
    pub has_controller: bool,
    /// Whether a host's capture records a packet before its link delays or loses it, so that captures see the whole way.
    pub captures_see_the_whole_way: bool,
}

/// A setting that a network does not take.
#[derive(Debug)]
pub struct Refusal {
    /// Dotted path of the setting.
    pub path: &'static str,
    /// What is wrong, if it is.
    pub problem: fn(&NetworkSettings) -> Option<String>,
    /// What to write instead.
    pub hint: &'static str,
}

const SEED_OF_NETEM: Refusal = Refusal {
    path: "network.seed",
    problem: |network| {
        let words = "netem draws its losses and delays from the kernel and takes no seed";
        network.seed.map(|_| words.to_owned())
    },
    hint: "remove it, or use `backend: userspace`",
};

const BANDWIDTH_OF_MININET: Refusal = Refusal {
    path: "network.bandwidth",
    problem: |network| {
        let topology = network.topology();
        let mut bandwidths = topology.links().map(|(_, link)| link.bandwidth);
        bandwidths
            .find(|bandwidth| bandwidth.bits_per_second() > MININET_MOST_BITS_PER_SECOND)
            .map(|bandwidth| format!("Mininet ignores a bandwidth of {bandwidth}"))
    },
    hint: "write at most `1000Mbit`, or use another `backend`",
};

/// `TCIntf.bwParamMax` of `mininet/link.py`; it has no limit for what is above.
const MININET_MOST_BITS_PER_SECOND: u64 = 1_000_000_000;

/// Makes [`NetworkBackend`] of the rows. A row's comment is its text in the schema.
macro_rules! backends {
    ($($(#[$comment:meta])* $backend:ident = $facts:expr;)+) => {
        /// What carries the packets between the virtual hosts.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        #[serde(rename_all = "lowercase")]
        pub enum NetworkBackend {
            $($(#[$comment])* $backend,)+
        }

        impl NetworkBackend {
            /// All of them, the default first.
            pub const ALL: [Self; [$(Self::$backend),+].len()] = [$(Self::$backend),+];

            /// Its row.
            #[must_use]
            pub const fn facts(self) -> &'static BackendFacts {
                const ROWS: &[BackendFacts] = &[$($facts),+];
                &ROWS[self as usize]
            }
        }
    };
}

backends! {
    /// Namespaces with TAP devices, and a switch and link emulator in the workload's own process.
    Userspace = BackendFacts {
        name: "userspace",
        programs: &[],
        // TAP devices have no offloads.
        programs_without_offloads: None,
        refusals: &[],
        switch: "emulated",
        has_controller: false,
        captures_see_the_whole_way: true,
    };

    /// Namespaces, veth pairs and a bridge, with HTB and netem as Mininet's `TCLink` sets them. Needs netem in the
    /// kernel, `ip` and `tc`.
    Kernel = BackendFacts {
        name: "kernel",
        programs: &["ip", "tc"],
        programs_without_offloads: Some(&["ethtool"]),
        refusals: &[SEED_OF_NETEM],
        switch: "Linux bridge",
        has_controller: false,
        captures_see_the_whole_way: false,
    };

    /// The paper's: Mininet's own hosts, links, Open vSwitch switch and OpenFlow controller. Needs them installed, root of
    /// the machine, and netem and openvswitch in the kernel.
    Mininet = BackendFacts {
        name: "mininet",
        programs: &["Mininet", "a running Open vSwitch"],
        // It needs ethtool either way.
        programs_without_offloads: None,
        refusals: &[SEED_OF_NETEM, BANDWIDTH_OF_MININET],
        switch: "Open vSwitch",
        has_controller: true,
        captures_see_the_whole_way: false,
    };
}

impl NetworkBackend {
    /// As a matrix file names it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.facts().name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_backend_is_written_by_its_name() {
        for backend in NetworkBackend::ALL {
            assert_eq!(serde_json::to_value(backend).unwrap(), backend.name());
        }
    }

    #[test]
    fn the_first_backend_is_the_default() {
        assert_eq!(NetworkSettings::default().backend, NetworkBackend::ALL[0]);
    }

    #[test]
    fn the_docs_have_a_row_for_each_backend_and_for_nothing_else() {
        let lines = include_str!("../../../../docs/network.md").lines();
        let table = lines.skip_while(|line| !line.starts_with("| `network.backend` |"));
        let rows = table.skip(2).take_while(|line| line.starts_with('|'));
        let named: Vec<_> = rows.map(|row| row.split('`').nth(1).unwrap_or(row)).collect();
        assert_eq!(named, NetworkBackend::ALL.map(NetworkBackend::name));
    }
}
