//! What tells one of Vagrant's providers from another. The main type is [`VagrantKind`].

use super::{options::Allowed, settings::VagrantSettings};
use crate::provider::settings::ProviderSettings;

/// What only the providers that Vagrant drives have.
#[derive(Debug, Clone, Copy)]
pub struct VagrantKind {
    /// Which of the settings are its own.
    pub(crate) settings: fn(&ProviderSettings) -> &VagrantSettings,
    /// What it needs beside Vagrant.
    pub(crate) requirement: Requirement,
    /// What a matrix file may set under its `options`.
    pub(crate) options: Allowed,
}

/// A program and its arguments.
pub type Probe = (&'static str, &'static [&'static str]);

/// What a provider needs beside Vagrant.
#[derive(Debug, Clone, Copy, Default)]
pub struct Requirement {
    /// The plugin without which Vagrant does not know it.
    pub plugin: Option<&'static str>,
    /// A command that succeeds where the provider can work.
    pub probe: Option<Probe>,
    /// What makes it work, on Debian.
    pub fix: &'static str,
}

impl Requirement {
    /// A plugin and no more.
    pub const fn plugin(plugin: &'static str, fix: &'static str) -> Self {
        Self {
            plugin: Some(plugin),
            probe: None,
            fix,
        }
    }
}
