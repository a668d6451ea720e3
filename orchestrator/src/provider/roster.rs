//! The providers that one call of `matrix` works with, each made once, so that an engine is asked once who it is. The
//! main type is [`Roster`].

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use super::{Provider, ProviderError, ProviderSettings, choose};

/// Providers by virtualization and host, made when they are first asked for.
pub struct Roster {
    settings: ProviderSettings,
    made: Mutex<BTreeMap<(String, String), Arc<dyn Provider>>>,
}

impl Roster {
    /// An empty one.
    #[must_use]
    pub fn new(settings: ProviderSettings) -> Self {
        Self {
            settings,
            made: Mutex::default(),
        }
    }

    /// The provider of a `virtualization` on the host of that name in the matrix file.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn provider(&self, virtualization: &str, host: &str) -> Result<Arc<dyn Provider>, ProviderError> {
        // The map is whole whenever the lock is free, also after a panic.
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (virtualization.to_owned(), host.to_owned());
        if let Some(provider) = made.get(&key) {
            return Ok(Arc::clone(provider));
        }
        let provider: Arc<dyn Provider> = choose(virtualization, &self.settings, host)?.into();
        made.insert(key, Arc::clone(&provider));
        Ok(provider)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_provider_is_made_once_for_each_host() {
        let roster = Roster::new(ProviderSettings::default());
        let here = roster.provider("docker", "here").unwrap();
        assert!(Arc::ptr_eq(&here, &roster.provider("docker", "here").unwrap()));
        assert!(!Arc::ptr_eq(&here, &roster.provider("docker", "there").unwrap()));
        assert!(roster.provider("dokcer", "here").is_err());
    }
}
