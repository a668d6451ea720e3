//! The labels that everything of ours carries on an engine: how it is found again, and how it is told from what others
//! have there. The main type is [`Labels`].
//!
//! A container inherits the labels of its image, and an image those of the container it was committed from. So images
//! have an owner's label of their own, and what somebody else makes of our image is not taken for ours.

use std::{collections::HashMap, fs, path::PathBuf};

use sha2::{Digest as _, Sha256};

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

    /// Of an image without a workload: one of packages, or one without a file.
    #[must_use]
    pub fn of_image_without_workload() -> Self {
        Self::with([(IMAGE_OWNER, owner())])
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
        self.0.get(OWNER).is_some_and(|known| owners().contains(known))
    }

    /// Whether this user on this machine made the image that carries them.
    #[must_use]
    pub fn are_of_our_image(&self) -> bool {
        self.0
            .get(IMAGE_OWNER)
            .is_some_and(|known| owners().contains(known))
    }

    /// Whether they are those of this environment of this run, made by us. A name alone may be another's: it is read from a
    /// run directory.
    #[must_use]
    pub fn are_of(&self, request: &EnvironmentRequest) -> bool {
        let is = |label, value: &String| self.0.get(label) == Some(value);
        self.are_ours() && is(ENVIRONMENT, &request.environment) && is(RUN, &request.run)
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

/// What makes an engine list only containers and volumes that some user of `matrix` made.
#[must_use]
pub fn of_any_owner() -> HashMap<String, Vec<String>> {
    HashMap::from([("label".to_owned(), vec![OWNER.to_owned()])])
}

/// What makes an engine list only images that some user of `matrix` made, or that were made from such.
#[must_use]
pub fn images_of_any_owner() -> HashMap<String, Vec<String>> {
    HashMap::from([("label".to_owned(), vec![IMAGE_OWNER.to_owned()])])
}

/// Who we are: an engine may be shared by users, and by machines.
fn owner() -> String {
    let machine = machine(&fs::read_to_string("/etc/machine-id").unwrap_or_default());
    of_machine(&machine.unwrap_or_else(hostname))
}

/// Everything that we call ourselves, or called ourselves in earlier versions.
fn owners() -> [String; 2] {
    [owner(), of_machine(&hostname())]
}

fn of_machine(machine: &str) -> String {
    format!("{}@{machine}", rustix::process::getuid().as_raw())
}

/// A machine keeps its identity where its name changes with its network. Hashed, since it is not to be told elsewhere
/// (machine-id(5)). A container's is empty.
fn machine(machine_id: &str) -> Option<String> {
    let id = machine_id.trim();
    (!id.is_empty()).then(|| {
        let digest = Sha256::digest(format!("matrix owner {id}"));
        digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    })
}

fn hostname() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
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

    #[rstest::rstest]
    #[case::its_own(&[], true)]
    #[case::another_users(&[(OWNER, "1000@elsewhere")], false)]
    #[case::another_runs(&[(RUN, "r2")], false)]
    #[case::another_environments(&[(ENVIRONMENT, "matrix-r1-b-1")], false)]
    fn an_environment_is_found_by_its_owner_and_run_and_not_by_its_name(
        #[case] changed: &[(&str, &str)],
        #[case] is: bool,
    ) {
        let request = EnvironmentRequest {
            environment: "matrix-r1-a-1".to_owned(),
            run: "r1".to_owned(),
            run_directory: "/runs/r1".into(),
            scenario: "a".to_owned(),
            host: "here".to_owned(),
            settings: record::settings::Settings::default(),
            windows: vec![1],
            files: None,
        };
        let mut labels = Labels::of_environment(&request).write();
        for (label, value) in changed {
            labels.insert((*label).to_owned(), (*value).to_owned());
        }
        assert_eq!(Labels::read(Some(labels)).are_of(&request), is);
    }

    #[test]
    fn a_machine_is_known_by_its_identity_which_is_not_told() {
        let id = "0123456789abcdef0123456789abcdef";
        let known = machine(&format!("{id}\n")).unwrap();
        assert_eq!(machine(id).unwrap(), known);
        assert!(!known.contains("0123"));
        assert_eq!(machine("\n"), None);
    }
}
