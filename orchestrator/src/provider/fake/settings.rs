//! What a matrix file can say of the fake platform: `providers.fake`. The main type is [`FakeSettings`].

use std::collections::BTreeMap;

use record::quantity::TimeSpan;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the fake platform behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FakeSettings {
    /// Seed of the noise; the same seed, scenario and window give the same control log.
    pub seed: u64,
    /// Standard deviation of what is added to the mean error of each period, on each axis, in metres.
    pub noise_m: f64,
    /// How long a window takes, so that there is time to interrupt it.
    pub window_takes: TimeSpan,
    /// What is special about one scenario, by its slug.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub scenarios: BTreeMap<String, FakeScenario>,
}

impl Default for FakeSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            noise_m: 0.002,
            window_takes: TimeSpan::default(),
            scenarios: BTreeMap::new(),
        }
    }
}

/// What is special about one scenario on the fake platform.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FakeScenario {
    /// Added to the mean error of every period, on each axis, in metres: an effect to be found.
    pub shift_m: f64,
    /// A fault to play.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fail: Option<Fault>,
}

/// A fault, and when it happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// During what.
    pub at: FaultPoint,
    /// During which window's measuring; the first of the environment's when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<u32>,
    /// In how many of the scenario's attempts; in all of them when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attempts: Option<u32>,
}

/// What can go wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FaultPoint {
    /// The environment cannot be created.
    Create,
    /// The workload says, in a window, that the experiment failed.
    Measure,
    /// The workload is killed in a window.
    Kill,
    /// The platform stops answering in a window, once; found again, the environment has gone on.
    Disconnect,
    /// The data cannot be copied.
    Collect,
    /// The environment cannot be discarded.
    Discard,
}

impl FaultPoint {
    /// Its name in a matrix file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Create => "create",
            Self::Measure => "measure",
            Self::Kill => "kill",
            Self::Disconnect => "disconnect",
            Self::Collect => "collect",
            Self::Discard => "discard",
        }
    }
}

impl FakeSettings {
    /// What is added to a scenario's errors.
    #[must_use]
    pub fn shift_m(&self, scenario: &str) -> f64 {
        self.scenarios
            .get(scenario)
            .map_or(0.0, |special| special.shift_m)
    }

    /// The fault that an environment of this name, `…-<attempt>`, plays.
    #[must_use]
    pub fn fault(&self, scenario: &str, environment: &str) -> Option<Fault> {
        let attempt = environment
            .rsplit('-')
            .next()
            .and_then(|number| number.parse().ok())
            .unwrap_or(1);
        self.scenarios
            .get(scenario)
            .and_then(|special| special.fail)
            .filter(|fault| fault.attempts.is_none_or(|attempts| attempt <= attempts))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_played_in_as_many_attempts_as_were_asked_for() {
        let fault = Fault {
            at: FaultPoint::Kill,
            window: None,
            attempts: Some(1),
        };
        let special = FakeScenario {
            fail: Some(fault),
            ..FakeScenario::default()
        };
        let settings = FakeSettings {
            scenarios: BTreeMap::from([("a".to_owned(), special)]),
            ..FakeSettings::default()
        };
        assert_eq!(settings.fault("a", "matrix-r-a-1"), Some(fault));
        assert_eq!(settings.fault("a", "matrix-r-a-2"), None);
        assert_eq!(settings.fault("b", "matrix-r-b-1"), None);
    }
}
