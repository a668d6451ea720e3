//! What of the settings of scenarios is not as it is by default. The main type is [`ChangedSetting`].

use record::{axis::axis_text, run_directory::PlannedScenario, settings::Settings};
use serde_json::Value;

use super::fields::differing;

/// A setting that some scenarios have otherwise than it is by default.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChangedSetting {
    /// Its dotted path below `workload`, such as `network.delay`.
    pub path: String,
    /// What these scenarios have.
    pub value: String,
    /// What it is by default with their dynamics; none where that has nothing there.
    pub default: Option<String>,
    /// The letters of the scenarios that have it so.
    pub scenarios: Vec<String>,
}

impl ChangedSetting {
    /// Those of all scenarios, in the order of their paths.
    #[must_use]
    pub fn all<'a>(scenarios: impl Iterator<Item = &'a PlannedScenario>) -> Vec<Self> {
        let record = |settings: &Settings| serde_json::to_value(settings).unwrap_or_default();
        let text = |value: &Value| (!value.is_null()).then(|| axis_text(value));
        let mut found: Vec<Self> = Vec::new();
        for planned in scenarios {
            let settings = &planned.settings;
            let by_default = Settings {
                // Named where it is not the default itself.
                dynamics: Settings::default().dynamics,
                ..Settings::of(settings.dynamics)
            };
            for (path, default, value) in differing(&record(&by_default), &record(settings)) {
                let (default, value) = (text(&default), text(&value).unwrap_or_else(|| "none".to_owned()));
                let same = |it: &&mut Self| it.path == path && it.value == value && it.default == default;
                match found.iter_mut().find(same) {
                    Some(known) => known.scenarios.push(planned.id.clone()),
                    None => found.push(Self {
                        path,
                        value,
                        default,
                        scenarios: vec![planned.id.clone()],
                    }),
                }
            }
        }
        // Stable: values stay in the order of the scenarios.
        found.sort_by(|a, b| a.path.cmp(&b.path));
        found
    }
}
