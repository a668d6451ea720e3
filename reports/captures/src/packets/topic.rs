//! The experiment's two topics, and between which hosts their messages travel. The main type is [`Topic`].

use record::virtual_host::VirtualHost;

/// The two topics of the experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Topic {
    /// From plant to controller.
    State,
    /// From controller to plant.
    Command,
}

impl Topic {
    /// Both.
    pub const ALL: [Self; 2] = [Self::State, Self::Command];

    /// Its name in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::State => "state",
            Self::Command => "command",
        }
    }

    /// Who publishes it.
    #[must_use]
    pub const fn sender(self) -> VirtualHost {
        match self {
            Self::State => VirtualHost::STA2,
            Self::Command => VirtualHost::STA1,
        }
    }

    /// Who it is for.
    #[must_use]
    pub const fn receiver(self) -> VirtualHost {
        match self {
            Self::State => VirtualHost::STA1,
            Self::Command => VirtualHost::STA2,
        }
    }

    /// The topic of the other direction.
    #[must_use]
    pub const fn back(self) -> Self {
        match self {
            Self::State => Self::Command,
            Self::Command => Self::State,
        }
    }
}
