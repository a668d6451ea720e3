//! Takes what an environment measured into the run directory: each window to its place, and the facts about the environment beside
//! them.

use std::{collections::BTreeSet, io, ops::RangeInclusive};

use record::{
    layout,
    run_directory::{EnvironmentRecord, Event, Place},
    window::WindowRecord,
};
use serde::de::DeserializeOwned;
use sha2::{Digest as _, Sha256};
use tokio::task::spawn_blocking;

use super::{ScenarioError, following::Heard};
use crate::{
    provider::{Environment, EnvironmentRequest, Provider, facts},
    run::{
        Run,
        collection::{self, Sorted},
    },
};

/// What the workload says of its network is no longer.
const LONGEST_TEXT: u64 = 4 << 20;

/// All windows of the round that an environment is of, whether or not it is to measure them.
fn windows_of(request: &EnvironmentRequest) -> RangeInclusive<u32> {
    let settings = &request.settings;
    let round = request
        .windows
        .first()
        .map_or(1, |first| settings.round_of(*first));
    settings.windows_of_round(round)
}

/// What a file of JSON says, if it is there and says it: facts that are missing must not cost any windows.
fn read_json<T: DeserializeOwned>(place: &Place) -> Option<T> {
    serde_json::from_slice(&place.read(WindowRecord::MOST_BYTES).ok()?).ok()
}

impl Run<'_> {
    /// Copies the data into the run directory's own file system, then gives each window its place.
    pub(super) async fn collect(
        &self,
        provider: &dyn Provider,
        environment: &mut dyn Environment,
        request: &EnvironmentRequest,
        heard: &Heard,
    ) -> Result<(), ScenarioError> {
        let _nothing_is_measured_here = self.this_machine.read().await;
        let folder = self
            .directory
            .scenario(&request.scenario)
            .join(format!("collecting-{}", request.environment));
        // What an interrupted collection left is only a copy: the originals are still in the environment.
        folder.remove_folder()?;
        folder.make_folder()?;
        environment.collect(&folder.path()).await?;
        self.keep_platform(provider, environment, request, &folder)?;
        // What was collected before is looked at once more: the originals are here, and go afterwards.
        self.inspect(&request.scenario, windows_of(request)).await?;
        let state = self.events.scenario(&request.scenario);
        let windows: Vec<u32> = request
            .windows
            .iter()
            .copied()
            .filter(|window| !state.collected.contains_key(window))
            .collect();
        let mut missing: BTreeSet<u32> = windows.iter().copied().collect();
        missing.retain(|window| heard.completed.contains(window));
        let (scenario, environment) = (&request.scenario, &request.environment);
        let sorting = {
            let (directory, folder) = (self.directory.clone(), folder.clone());
            let (scenario, environment) = (scenario.clone(), environment.clone());
            move || collection::sort_windows(&directory, &scenario, &environment, &windows, &folder)
        };
        // Captures are compressed: other hosts are not to wait for that.
        let sorted = spawn_blocking(sorting).await.map_err(io::Error::other)??;
        for sorted in sorted {
            missing.remove(&sorted.window());
            let (scenario, environment) = (scenario.clone(), environment.clone());
            self.events.emit(match sorted {
                Sorted::Whole {
                    window,
                    verdict,
                    sha256,
                } => Event::WindowCollected {
                    scenario,
                    environment,
                    window,
                    verdict,
                    sha256: Some(sha256),
                },
                Sorted::Broken { window, reason } => Event::WindowBroken {
                    scenario,
                    environment,
                    window,
                    reason,
                },
            })?;
        }
        // The environment goes after this: it must not go with windows in it.
        if !missing.is_empty() {
            return Err(ScenarioError::NotGivenOut {
                windows: missing.into_iter().collect(),
            });
        }
        Ok(folder.remove_folder()?)
    }

    /// Writes the scenario's `environment.json`: what the provider knows and what the workload saw from inside, and
    /// puts the workload's `network.txt` and what the commands around the windows printed beside it. That of
    /// an earlier environment, whose windows may count, stays under its own name.
    fn keep_platform(
        &self,
        provider: &dyn Provider,
        environment: &dyn Environment,
        request: &EnvironmentRequest,
        folder: &Place,
    ) -> Result<(), ScenarioError> {
        let record = EnvironmentRecord {
            environment: request.environment.clone(),
            provider: provider.name().to_owned(),
            host: request.host.clone(),
            facts: facts::of(environment),
            platform: read_json(&folder.join(layout::ENVIRONMENT)),
        };
        let place = self.directory.environment(&request.scenario);
        if let Some(EnvironmentRecord {
            environment: earlier, ..
        }) = read_json(&place)
            && earlier != request.environment
        {
            place.rename(&place.beside(format!("environment-{earlier}.json")))?;
            let network = place.beside(layout::NETWORK);
            if network.exists() {
                network.rename(&place.beside(format!("network-{earlier}.txt")))?;
            }
        }
        let network = folder.join(layout::NETWORK);
        if network.exists() {
            place
                .beside(layout::NETWORK)
                .write(&network.read(LONGEST_TEXT)?)?;
        }
        for hook in [layout::PREPARE, layout::RESTORE] {
            for name in [layout::STDOUT, layout::STDERR] {
                let printed = folder.join(hook).join(name);
                if printed.exists() {
                    let kept = place.beside(format!("{hook}-{}-{name}", request.environment));
                    kept.write(&printed.read(LONGEST_TEXT)?)?;
                }
            }
        }
        let mut text = serde_json::to_vec_pretty(&record).map_err(io::Error::from)?;
        text.push(b'\n');
        self.events.emit(Event::EnvironmentRecorded {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
            sha256: format!("{:x}", Sha256::digest(&text)),
        })?;
        Ok(place.write(&text)?)
    }
}
