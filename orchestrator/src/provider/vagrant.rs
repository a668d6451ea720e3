//! Virtual machines through Vagrant: `virtualbox`, `libvirt` and the other providers that Vagrant knows. The main type is
//! [`Vagrant`].
//!
//! This version does not drive virtual machines. It says so, and says what the host lacks besides, so that the plan
//! shows these scenarios as infeasible with a reason and nobody takes them for measured.

use async_trait::async_trait;
use reports::run_directory::Resource;

use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError, executable::Executable,
};

/// The providers that Vagrant itself or its usual plugins know, by the names that Vagrant gives them.
pub const PROVIDERS: [&str; 6] = [
    "virtualbox",
    "libvirt",
    "vmware_desktop",
    "parallels",
    "hyperv",
    "qemu",
];

/// Virtual machines of one of Vagrant's providers.
#[derive(Debug, Clone)]
pub struct Vagrant {
    provider: &'static str,
}

impl Vagrant {
    /// Of the provider that Vagrant knows by this name, if this version does.
    #[must_use]
    pub fn with_provider(name: &str) -> Option<Self> {
        PROVIDERS
            .into_iter()
            .find(|known| *known == name)
            .map(|provider| Self { provider })
    }

    fn unsupported(&self) -> ProviderError {
        ProviderError::Unsupported {
            provider: self.provider.to_owned(),
            reason: NOT_DRIVEN.to_owned(),
            hint: Some(INSTEAD.to_owned()),
        }
    }
}

const NOT_DRIVEN: &str = "this version of matrix does not drive virtual machines yet";
const INSTEAD: &str = "run the scenario's machine yourself and start matrix in it, or exclude it in the matrix file with a reason";

/// What to say of a host on which Vagrant is or is not.
fn judge(provider: &str, vagrant: Option<&Executable>) -> Availability {
    match vagrant {
        Some(vagrant) => Availability::Unavailable {
            reason: format!(
                "{NOT_DRIVEN} (Vagrant is at {} but is not used)",
                vagrant.path().display()
            ),
            fix: Some(INSTEAD.to_owned()),
        },
        None => Availability::Unavailable {
            reason: format!("{NOT_DRIVEN}, and Vagrant, which {provider} would need, is not installed"),
            fix: Some(INSTEAD.to_owned()),
        },
    }
}

#[async_trait]
impl Provider for Vagrant {
    fn name(&self) -> &'static str {
        self.provider
    }

    async fn survey(&self) -> Availability {
        judge(self.provider, Executable::find("vagrant").as_ref())
    }

    fn resources(&self, _request: &EnvironmentRequest) -> Vec<Resource> {
        Vec::new()
    }

    async fn create(&self, _request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        Err(self.unsupported())
    }

    async fn find(
        &self,
        _request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        Ok(None)
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        Ok(Vec::new())
    }

    async fn remove(&self, _leftover: &Leftover) -> Result<(), ProviderError> {
        Err(self.unsupported())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_machines_are_never_said_to_be_available() {
        let here = Executable::find("sh").unwrap();
        for vagrant in [None, Some(&here)] {
            let Availability::Unavailable { reason, fix } = judge("virtualbox", vagrant) else {
                panic!("available");
            };
            assert!(reason.contains("does not drive virtual machines"), "{reason}");
            assert_eq!(reason.contains("not installed"), vagrant.is_none(), "{reason}");
            assert!(fix.is_some());
        }
    }

    #[test]
    fn a_provider_that_vagrant_does_not_know_is_none() {
        assert!(Vagrant::with_provider("virtualbox").is_some());
        assert!(Vagrant::with_provider("VirtualBox").is_none());
    }
}
