//! `list` and `remove-bridge`: what of ours is on the host. The main function is [`list`].

use std::path::Path;

use record::detached::{Listed, ListedEnvironment, Removed};

use super::{DetachedError, EnvironmentFolder, process};
use crate::network::mininet::leftovers;

/// Every environment below the root, and the bridges that no living workload has.
///
/// # Errors
/// When something cannot be read.
pub fn list(root: &Path) -> Result<Listed, DetachedError> {
    let environment = |folder: EnvironmentFolder| {
        Ok(ListedEnvironment {
            environment: folder.environment().to_owned(),
            owner: folder.owner(),
            started: folder.lines().exists(),
            running: !process::find(&folder)?.is_empty(),
        })
    };
    Ok(Listed {
        environments: EnvironmentFolder::all(root)?
            .into_iter()
            .map(environment)
            .collect::<Result<_, DetachedError>>()?,
        bridges: bridges()?,
    })
}

/// Removes a bridge that [`list`] names. One that is gone already is fine, and one that a workload has stays.
///
/// # Errors
/// When Open vSwitch refuses.
pub fn remove_bridge(name: &str) -> Result<Removed, DetachedError> {
    let removed = bridges()?.iter().any(|bridge| bridge == name);
    if removed {
        leftovers::remove(name).map_err(|source| DetachedError::Bridge {
            action: "remove a bridge from Open vSwitch",
            source,
        })?;
    }
    Ok(Removed { removed })
}

fn bridges() -> Result<Vec<String>, DetachedError> {
    leftovers::find().map_err(|source| DetachedError::Bridge {
        action: "look for bridges of ours in Open vSwitch",
        source,
    })
}
