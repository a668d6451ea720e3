//! Whether an environment stays when it has done its work. The main type is [`Keep`].

use clap::ValueEnum;
use record::run_directory::Outcome;

/// Which environments stay, for `matrix shell`, until `matrix clean`. Their data is collected all the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Keep {
    /// None.
    #[default]
    Never,
    /// Those of scenarios that end as failed or errored.
    OnFailure,
    /// All.
    Always,
}

impl Keep {
    /// Whether the environment of a scenario that ended so stays.
    #[must_use]
    pub fn keeps(self, outcome: Outcome) -> bool {
        match self {
            Self::Never => false,
            Self::OnFailure => matches!(outcome, Outcome::Failed | Outcome::Errored),
            Self::Always => true,
        }
    }
}
