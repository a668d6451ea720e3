//! Which experiment a scenario ran. The main type is [`MeasuredExperiment`].

use record::{
    experiment::Argument,
    settings::{Dynamics, NetworkBackend, Settings},
};

/// The experiment of a scenario.
#[derive(Debug, Clone, PartialEq)]
pub enum MeasuredExperiment {
    /// The ball on the plate.
    Ball {
        /// How its network was to be made.
        network: NetworkBackend,
        /// Which rules plant, controller and messages followed.
        dynamics: Dynamics,
        /// The settings that were not as the dynamics has them, as dotted paths.
        overridden: Vec<String>,
    },
    /// A user's command.
    Command {
        /// The experiment's name.
        name: String,
        /// The command, as the matrix file has it, or its nodes.
        run: String,
        /// How the network of its nodes was to be made, if it has some.
        network: Option<NetworkBackend>,
    },
}

impl MeasuredExperiment {
    /// The one that settings ask for.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        match &settings.experiment {
            None => Self::Ball {
                network: settings.network.backend,
                dynamics: settings.dynamics,
                overridden: settings.overridden(),
            },
            Some(experiment) => {
                let words = |command: &[Argument]| {
                    let arguments = command.iter().map(Argument::to_string);
                    arguments.collect::<Vec<_>>().join(" ")
                };
                let nodes = experiment.nodes.iter();
                let nodes = nodes.map(|node| format!("{} on {}: {}", node.name, node.host, words(&node.run)));
                Self::Command {
                    network: settings.network_in_use().map(|network| network.backend),
                    name: experiment.name.clone(),
                    run: match experiment.nodes.is_empty() {
                        true => words(&experiment.run),
                        false => nodes.collect::<Vec<_>>().join("; "),
                    },
                }
            }
        }
    }

    /// How its network was to be made; none without a network of ours.
    #[must_use]
    pub const fn network(&self) -> Option<NetworkBackend> {
        match self {
            Self::Ball { network, .. } => Some(*network),
            Self::Command { network, .. } => *network,
        }
    }

    /// Whether it is the ball on the plate.
    #[must_use]
    pub const fn is_ball(&self) -> bool {
        matches!(self, Self::Ball { .. })
    }

    /// What it is, as a row of Table I has it.
    #[must_use]
    pub fn layer(&self) -> &str {
        match self {
            Self::Ball { .. } => "ball on plate, over ROS",
            Self::Command { name, .. } => name,
        }
    }

    /// What it is, in a sentence's words, after [`Self::topic`].
    #[must_use]
    pub fn description(&self) -> String {
        match self {
            Self::Ball {
                dynamics, overridden, ..
            } => match overridden.as_slice() {
                [] => dynamics.name().to_owned(),
                _ => format!("{} but for {}", dynamics.name(), overridden.join(", ")),
            },
            Self::Command { name, run, .. } => format!("{name}, `{run}`"),
        }
    }

    /// What of it is described.
    #[must_use]
    pub const fn topic(&self) -> &'static str {
        match self {
            Self::Ball { .. } => "Dynamics",
            Self::Command { .. } => "Experiment",
        }
    }
}
