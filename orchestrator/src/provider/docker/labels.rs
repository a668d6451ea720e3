//! The labels that everything of ours carries on an engine: how it is found again, and how it is told from what others
//! have there. The main type is [`Labels`].
//!
//! A container inherits the labels of its image, and an image those of the container it was committed from. So images
//! have an owner's label of their own, and what somebody else makes of our image is not taken for ours.

use std::{collections::HashMap, path::PathBuf};

use crate::provider::EnvironmentRequest;

const RUN: &str = "matrix.run";
const RUN_DIRECTORY: &str = "matrix.run-directory";
const SCENARIO: &str = "matrix.scenario";
const ENVIRONMENT: &str = "matrix.environment";
const OWNER: &str = "matrix.owner";
const WORKLOAD: &str = "matrix.workload";
const IMAGE_OWNER: &str = "matrix.image-owner";

/// What a thing's labels say.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Labels(HashMap<String, String>);

impl Labels {
    /// Of a container or a volume.
    #[must_use]
    pub fn of_environment(request: &EnvironmentRequest) -> Self {
        Self::with([
            (RUN, request.run.clone()),
            (RUN_DIRECTORY, request.run_directory.display().to_string()),
            (SCENARIO, request.scenario.clone()),
            (ENVIRONMENT, request.environment.clone()),
            (OWNER, owner()),
        ])
    }

    /// The same, of what the workload of this hash writes to: a container has it of its image, a volume has no image.
    #[must_use]
    pub fn with_workload(mut self, sha256: &str) -> Self {
        self.0.insert(WORKLOAD.to_owned(), sha256.to_owned());
        self
    }

    /// Of a container that belongs to no run.
    #[must_use]
    pub fn of_check() -> Self {
        Self::with([(OWNER, owner())])
    }

    /// Of an image with the workload of this hash.
    #[must_use]
    pub fn of_image(workload_sha256: &str) -> Self {
        Self::with([(WORKLOAD, workload_sha256.to_owned()), (IMAGE_OWNER, owner())])
    }

    fn with<const N: usize>(pairs: [(&str, String); N]) -> Self {
        Self(
            pairs
                .into_iter()
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
        )
    }

    /// As an engine has them.
    #[must_use]
    pub fn read(labels: Option<HashMap<String, String>>) -> Self {
        Self(labels.unwrap_or_default())
    }

    /// As an engine takes them.
    #[must_use]
    pub fn write(&self) -> HashMap<String, String> {
        self.0.clone()
    }

    /// Whether this user on this machine made the container or volume that carries them.
    #[must_use]
    pub fn are_ours(&self) -> bool {
        self.0.get(OWNER).is_some_and(|known| *known == owner())
    }

    /// Whether this user on this machine made the image that carries them.
    #[must_use]
    pub fn are_of_our_image(&self) -> bool {
        self.0.get(IMAGE_OWNER).is_some_and(|known| *known == owner())
    }

    /// Whether they are those of this environment.
    #[must_use]
    pub fn name_environment(&self, environment: &str) -> bool {
        self.0.get(ENVIRONMENT).is_some_and(|known| known == environment)
    }

    /// The hash of the workload that is in the image, and so in what was made of it.
    #[must_use]
    pub fn workload(&self) -> Option<String> {
        self.0.get(WORKLOAD).cloned()
    }

    /// The run.
    #[must_use]
    pub fn run(&self) -> Option<String> {
        self.0.get(RUN).cloned()
    }

    /// The run directory.
    #[must_use]
    pub fn run_directory(&self) -> Option<PathBuf> {
        self.0.get(RUN_DIRECTORY).map(PathBuf::from)
    }

    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> Option<String> {
        self.0.get(SCENARIO).cloned()
    }
}

/// What makes an engine list only containers and volumes that are ours.
#[must_use]
pub fn only_ours() -> HashMap<String, Vec<String>> {
    HashMap::from([("label".to_owned(), vec![format!("{OWNER}={}", owner())])])
}

/// What makes an engine list only images that are ours, or were made from ours.
#[must_use]
pub fn only_our_images() -> HashMap<String, Vec<String>> {
    HashMap::from([("label".to_owned(), vec![format!("{IMAGE_OWNER}={}", owner())])])
}

/// Who we are: an engine may be shared by users, and by machines.
fn owner() -> String {
    let name = rustix::system::uname();
    format!(
        "{}@{}",
        rustix::process::getuid().as_raw(),
        name.nodename().to_string_lossy()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_another_made_is_not_ours() {
        let ours = Labels::of_image("abc");
        assert!(ours.are_of_our_image());
        assert!(!ours.are_ours(), "a container of our image, made by another");
        let mut others = ours.write();
        others.insert(IMAGE_OWNER.to_owned(), "1@elsewhere".to_owned());
        assert!(!Labels::read(Some(others)).are_of_our_image());
        assert!(!Labels::read(None).are_ours());
    }
}
