//! The windows that are in a scene's folders, read from the files themselves. The main type is [`Windows`].

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
};

use serde_json::Value;
use sha2::{Digest as _, Sha256};

use super::scene::{Platform, Scene, children};

/// A scenario's slug, and a window's number.
pub type Name = (String, u32);

/// What makes a window that very one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// The environment that measured it.
    pub environment: String,
    /// The checksum of its control log; none of one that is only told of.
    control: Option<String>,
    /// The checksum of its record; the same.
    record: Option<String>,
}

impl Window {
    /// Whether the two are one and the same, as far as is known.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        let (one, another) = (&self.control, &other.control);
        self.environment == other.environment && (one.is_none() || another.is_none() || one == another)
    }

    /// The window in a folder, if it is whole: its record says so, and each file beside it is as the record says.
    #[must_use]
    pub fn whole(folder: &Path) -> Option<Self> {
        let text = fs::read(folder.join("window.json")).ok()?;
        let record: Value = serde_json::from_slice(&text).ok()?;
        let mut control = None;
        for file in record["files"].as_array()? {
            let (name, sha256) = (file["name"].as_str()?, file["sha256"].as_str()?);
            let (bytes, found) = digest(&folder.join(name)).ok()?;
            if Some(bytes) != file["bytes"].as_u64() || found != sha256 {
                return None;
            }
            if name == "control.csv" {
                control = Some(found);
            }
        }
        (record["complete"] == true && control.is_some()).then(|| Self {
            environment: record["environment"].as_str().unwrap_or_default().to_owned(),
            control,
            record: Some(format!("{:x}", Sha256::digest(&text))),
        })
    }

    /// Whether its record is one that the journal has of a window of this name, if it has any: a digit may be another one since.
    fn is_as_journaled(&self, name: &Name, journaled: &Journaled) -> bool {
        match (journaled.get(name), &self.record) {
            (Some(sums), Some(record)) => sums.contains(record),
            _ => true,
        }
    }
}

fn digest(file: &Path) -> io::Result<(u64, String)> {
    let mut hasher = Sha256::new();
    let bytes = io::copy(&mut fs::File::open(file)?, &mut hasher)?;
    Ok((bytes, format!("{:x}", hasher.finalize())))
}

/// Windows that are whole, by name.
#[derive(Debug, Clone, Default)]
pub struct Windows(pub BTreeMap<Name, Window>);

impl Windows {
    /// Those that are in their place in the run directory.
    #[must_use]
    pub fn in_place(scene: &Scene) -> Self {
        let mut windows = Self::default();
        for scenario in scenarios(scene) {
            windows.add_below(&scenario, &name_of(&scenario));
        }
        let journaled = journaled(scene);
        windows
            .0
            .retain(|name, window| window.is_as_journaled(name, &journaled));
        windows
    }

    /// The folders of those that were put aside as broken and are whole.
    #[must_use]
    pub fn put_aside(scene: &Scene) -> Vec<PathBuf> {
        let journaled = journaled(scene);
        let mut found = Vec::new();
        for scenario in scenarios(scene) {
            for environment in children(&scenario.join("broken")) {
                for folder in children(&environment) {
                    let number = number_of(&folder).unwrap_or_default();
                    let name = (name_of(&scenario), number);
                    if Window::whole(&folder).is_some_and(|window| window.is_as_journaled(&name, &journaled))
                    {
                        found.push(folder);
                    }
                }
            }
        }
        found
    }

    /// Those that are anywhere: in their place, on the way to it, in an environment of this machine, or, elsewhere, told to
    /// be complete.
    #[must_use]
    pub fn anywhere(scene: &Scene) -> Self {
        let mut windows = Self::in_place(scene);
        for scenario in scenarios(scene) {
            for folder in children(&scenario) {
                if name_of(&folder).starts_with("collecting-") {
                    windows.add_below(&folder, &name_of(&scenario));
                }
            }
        }
        let run = scene.run_directory().map(|run| name_of(&run)).unwrap_or_default();
        for environment in scene
            .state_folders()
            .iter()
            .flat_map(|state| children(&state.join("environments")))
        {
            let name = name_of(&environment);
            let slug = name
                .strip_prefix(&format!("matrix-{run}-"))
                .and_then(|name| Some(name.rsplit_once('-')?.0));
            if let Some(slug) = slug {
                windows.add_below(&environment.join("data"), slug);
            }
        }
        if matches!(scene.platform, Platform::Docker | Platform::Machine) {
            windows.add(Self::told(scene, &["window-collected", "window-complete"]));
        }
        windows
    }

    /// Those that must outlive a loss of power at this moment: the journal says so.
    #[must_use]
    pub fn promised(scene: &Scene) -> Self {
        match scene.platform.syncs_its_windows() {
            true => Self::told(scene, &["window-collected", "window-complete"]),
            false => Self::told(scene, &["window-collected"]),
        }
    }

    /// Those that the journal has one of these events of.
    fn told(scene: &Scene, events: &[&str]) -> Self {
        let mut windows = Self::default();
        let mut open = BTreeMap::new();
        for entry in scene.journal() {
            let slug = entry["scenario"].as_str().unwrap_or_default().to_owned();
            let event = entry["event"].as_str().unwrap_or_default();
            if event == "environment-creating" {
                open.insert(slug.clone(), entry["environment"].clone());
            }
            let (said, window, environment) = match event {
                "workload" => (
                    entry["progress"]["event"].as_str().unwrap_or_default(),
                    &entry["progress"]["window"],
                    open.get(&slug),
                ),
                event => (event, &entry["window"], entry.get("environment")),
            };
            let number = window.as_u64().and_then(|window| u32::try_from(window).ok());
            if let (true, Some(number), Some(environment)) = (events.contains(&said), number, environment) {
                let environment = environment.as_str().unwrap_or_default().to_owned();
                let window = Window {
                    environment,
                    control: None,
                    record: None,
                };
                windows.0.insert((slug, number), window);
            }
        }
        windows
    }

    /// Adds those of another that are not among these.
    pub fn add(&mut self, other: Self) {
        for (name, window) in other.0 {
            self.0.entry(name).or_insert(window);
        }
    }

    fn add_below(&mut self, folder: &Path, slug: &str) {
        for place in children(folder) {
            if let (Some(number), Some(window)) = (number_of(&place), Window::whole(&place)) {
                self.0.entry((slug.to_owned(), number)).or_insert(window);
            }
        }
    }
}

/// A window's number, by its folder's name.
fn number_of(folder: &Path) -> Option<u32> {
    name_of(folder).strip_prefix("window-")?.parse().ok()
}

/// The checksums of the records of windows, of each as often as it was collected.
type Journaled = BTreeMap<Name, BTreeSet<String>>;

fn journaled(scene: &Scene) -> Journaled {
    let mut sums = Journaled::new();
    for entry in scene.journal() {
        let (Some(slug), Some(number)) = (entry["scenario"].as_str(), entry["window"].as_u64()) else {
            continue;
        };
        let name = (slug.to_owned(), u32::try_from(number).unwrap_or_default());
        if let (Some("window-collected"), Some(sha256)) = (entry["event"].as_str(), entry["sha256"].as_str())
        {
            sums.entry(name).or_default().insert(sha256.to_owned());
        }
    }
    sums
}

/// The folders of scenarios in the run directory.
#[must_use]
pub fn scenarios(scene: &Scene) -> Vec<PathBuf> {
    let run = scene.run_directory();
    run.map(|run| children(&run.join("scenarios")))
        .unwrap_or_default()
}

/// A path's last part.
#[must_use]
pub fn name_of(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}
