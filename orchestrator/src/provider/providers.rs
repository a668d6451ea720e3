//! The hosts and providers that one call of `matrix` works with, each made once, so that a host is logged in to and an
//! engine is asked who it is once. The main type is [`Providers`].

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use record::run_directory::PlannedScenario;

use super::{Catalogue, Fleet, Provider, ProviderError, ProviderSettings};
use crate::{batch::Clusters, host::Host};

/// Providers by virtualization and host, made when they are first asked for.
pub struct Providers {
    catalogue: Catalogue,
    settings: ProviderSettings,
    hosts: BTreeMap<String, Arc<dyn Host>>,
    clusters: Clusters,
    made: Mutex<BTreeMap<(String, String), Arc<dyn Provider>>>,
}

impl Providers {
    /// One with these hosts, in which no provider was asked for yet.
    #[must_use]
    pub fn new(
        catalogue: Catalogue,
        settings: ProviderSettings,
        hosts: impl IntoIterator<Item = Arc<dyn Host>>,
    ) -> Self {
        Self {
            catalogue,
            settings,
            hosts: hosts
                .into_iter()
                .map(|host| (host.name().to_owned(), host))
                .collect(),
            clusters: Clusters::default(),
            made: Mutex::default(),
        }
    }

    /// The providers that there are.
    #[must_use]
    pub const fn catalogue(&self) -> Catalogue {
        self.catalogue
    }

    /// Its hosts, by name.
    pub fn hosts(&self) -> impl Iterator<Item = &Arc<dyn Host>> {
        self.hosts.values()
    }

    /// The provider of a `virtualization` on the host of that name in the matrix file.
    ///
    /// # Errors
    /// When there is none of that name, or no such host, or it cannot be made with its settings.
    pub fn of(&self, virtualization: &str, host: &str) -> Result<Arc<dyn Provider>, ProviderError> {
        // The map is whole whenever the lock is free, also after a panic.
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (virtualization.to_owned(), host.to_owned());
        if let Some(provider) = made.get(&key) {
            return Ok(Arc::clone(provider));
        }
        let provider =
            self.catalogue
                .choose(virtualization, &self.settings, &self.host(host)?, &self.clusters)?;
        let provider: Arc<dyn Provider> = provider.into();
        made.insert(key, Arc::clone(&provider));
        Ok(provider)
    }
}

impl Fleet for Providers {
    fn host(&self, name: &str) -> Result<Arc<dyn Host>, ProviderError> {
        self.hosts
            .get(name)
            .cloned()
            .ok_or_else(|| ProviderError::UnknownHost {
                name: name.to_owned(),
            })
    }

    fn provider(&self, planned: &PlannedScenario, host: &str) -> Result<Arc<dyn Provider>, ProviderError> {
        self.of(&planned.provider(), host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{host::Here, state_directory::StateDirectory};

    fn host(name: &str) -> Arc<dyn Host> {
        Arc::new(Here::new(name, StateDirectory::of_this_user()))
    }

    #[test]
    fn a_provider_is_made_once_for_each_host() {
        let providers = Providers::new(
            Catalogue::default(),
            ProviderSettings::default(),
            ["here", "there"].map(host),
        );
        let here = providers.of("docker", "here").unwrap();
        assert!(Arc::ptr_eq(&here, &providers.of("docker", "here").unwrap()));
        assert!(!Arc::ptr_eq(&here, &providers.of("docker", "there").unwrap()));
        assert!(providers.of("dokcer", "here").is_err());
        assert!(providers.of("docker", "nowhere").is_err());
    }
}
