//! What a journal says that the other files of its run directory are. The main type is [`Checksums`].

use std::collections::{BTreeMap, BTreeSet};

use super::{Event, Journal};

/// SHA-256 of files, in hexadecimal, as the journal has them. Runs of earlier versions have none.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Checksums {
    manifest: Option<String>,
    plan: Option<String>,
    /// By scenario.
    scenarios: BTreeMap<String, ScenarioChecksums>,
}

/// Those of a scenario's files.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ScenarioChecksums {
    /// Of each environment's `environment.json`, as often as it was written: a crash may have left either.
    environments: BTreeSet<String>,
    /// Of each window's `window.json`.
    windows: BTreeMap<u32, String>,
}

impl Checksums {
    /// Those that a journal has come to.
    #[must_use]
    pub fn of(journal: &Journal) -> Self {
        let mut sums = Self::default();
        for entry in &journal.entries {
            sums.apply(&entry.event);
        }
        sums
    }

    fn apply(&mut self, event: &Event) {
        match event {
            Event::RunStarted {
                manifest_sha256,
                plan_sha256,
                ..
            } => {
                self.manifest.clone_from(manifest_sha256);
                self.plan.clone_from(plan_sha256);
            }
            Event::EnvironmentRecorded { scenario, sha256, .. } => {
                self.entry(scenario).environments.insert(sha256.clone());
            }
            Event::WindowCollected {
                scenario,
                window,
                sha256,
                ..
            } => {
                let windows = &mut self.entry(scenario).windows;
                match sha256 {
                    Some(sha256) => drop(windows.insert(*window, sha256.clone())),
                    None => drop(windows.remove(window)),
                }
            }
            // Whatever is in its place now is another.
            Event::WindowBroken { scenario, window, .. } => {
                self.entry(scenario).windows.remove(window);
            }
            _ => {}
        }
    }

    fn entry(&mut self, slug: &str) -> &mut ScenarioChecksums {
        self.scenarios.entry(slug.to_owned()).or_default()
    }

    /// That of `manifest.json`.
    #[must_use]
    pub fn manifest(&self) -> Option<&str> {
        self.manifest.as_deref()
    }

    /// That of `plan.json`.
    #[must_use]
    pub fn plan(&self) -> Option<&str> {
        self.plan.as_deref()
    }

    /// Those of a scenario's files.
    #[must_use]
    pub fn scenario(&self, slug: &str) -> ScenarioChecksums {
        self.scenarios.get(slug).cloned().unwrap_or_default()
    }
}

impl ScenarioChecksums {
    /// Those that an `environment.json` may have; none if that is not known.
    pub fn environments(&self) -> impl Iterator<Item = &str> + Clone {
        self.environments.iter().map(String::as_str)
    }

    /// That of a window's `window.json`, if it is known.
    #[must_use]
    pub fn window(&self, window: u32) -> Option<&str> {
        self.windows.get(&window).map(String::as_str)
    }
}
