//! Where a run finds its hosts and providers. The trait is [`Fleet`].

use std::sync::Arc;

use record::run_directory::PlannedScenario;

use super::{Provider, ProviderError};
use crate::host::Host;

/// The machines of a run: the production ones, or a test's.
pub trait Fleet: Sync {
    /// The host of that name in the matrix file.
    ///
    /// # Errors
    /// When there is none.
    fn host(&self, name: &str) -> Result<Arc<dyn Host>, ProviderError>;

    /// What makes a scenario's environments on one of its hosts.
    ///
    /// # Errors
    /// When there is no such provider or host.
    fn provider(&self, planned: &PlannedScenario, host: &str) -> Result<Arc<dyn Provider>, ProviderError>;
}
