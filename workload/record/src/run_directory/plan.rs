//! `plan.json`: every scenario, feasible or not, and the order they run in. The main type is [`PlanRecord`].

use std::collections::BTreeSet;

use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

use crate::{
    axis::{NATIVE, SIMULATED, VIRTUALIZATION, axis_text},
    name::{is_name, name, name_if_any, names},
    settings::{Settings, recorded},
    window::Impossible,
};

/// The plan of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanRecord {
    /// [`super::FORMAT`] at the time of writing.
    pub format: u32,
    /// Every scenario, in letter order.
    pub scenarios: Vec<PlannedScenario>,
    /// Letters of the feasible ones that were selected, in the order they run: in the first round, if there are several.
    pub order: Vec<String>,
    /// The order of each further round, in which every scenario of it has a new environment. Runs of one round have none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub later_rounds: Vec<Vec<String>>,
    /// Time that measuring takes, in seconds: windows only, without setting up, on the host that has most of them.
    pub measuring_s: f64,
}

/// One combination of axis values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedScenario {
    /// Its letter: a, b, … z, aa, ab, …
    #[serde(deserialize_with = "letters")]
    pub id: String,
    /// Its name in files, containers and logs, such as `i686-ubuntu-native`.
    #[serde(deserialize_with = "name")]
    pub slug: String,
    /// Axis to value, in the matrix's order.
    pub axes: serde_json::Map<String, serde_json::Value>,
    /// Name of the host that runs it, when one offers what it needs.
    #[serde(default, deserialize_with = "name_if_any")]
    pub host: Option<String>,
    /// The hosts that share its rounds, if several do: round N is the turn of number N, and after the last it is the first one's again.
    #[serde(default, skip_serializing_if = "Vec::is_empty", deserialize_with = "names")]
    pub pool: Vec<String>,
    /// Whether it can run.
    pub feasible: bool,
    /// Why not, when it cannot.
    pub reason: Option<String>,
    /// What would make it feasible, where something would.
    pub fix: Option<String>,
    /// Why it is left out of this run although it may be feasible, such as "not selected by `--only b`". It is in no
    /// order then, and has no outcome.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_selected: Option<String>,
    /// Whether its numbers are computed and not measured, and say nothing about any platform. Runs of earlier versions do not
    /// say so: ask `reports::input::run::ScenarioRun::is_simulated`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub simulated: bool,
    /// The workload's settings, the axes' sweeps applied.
    #[serde(deserialize_with = "recorded")]
    pub settings: Settings,
}

impl PlanRecord {
    /// More scenarios no matrix has.
    pub const MOST_SCENARIOS: usize = 1000;
    /// More windows no matrix has, of all scenarios.
    pub const MOST_WINDOWS: u64 = 200_000;

    /// The rounds, numbered from 1, each with the letters of its scenarios in the order they run.
    pub fn rounds(&self) -> impl Iterator<Item = (u32, &[String])> {
        let orders = std::iter::once(&self.order).chain(&self.later_rounds);
        std::iter::zip(1.., orders.map(Vec::as_slice))
    }

    /// Looks whether it is one that could have been planned: it comes from a run directory.
    ///
    /// # Errors
    /// What is not.
    pub fn check(&self) -> Result<(), Impossible> {
        let wrong = |field, value: String| Err(Impossible { field, value });
        if self.scenarios.len() > Self::MOST_SCENARIOS {
            return wrong("scenarios", format!("a list of {}", self.scenarios.len()));
        }
        if self.later_rounds.len() >= Settings::MOST_ENVIRONMENTS as usize {
            return wrong("later_rounds", format!("a list of {}", self.later_rounds.len()));
        }
        // Each of them is one environment of a scenario. A letter that no scenario has is left to those that look for it.
        let mut letters = self.rounds().flat_map(|(_, order)| order);
        if let Some(letter) = letters.find(|letter| !is_name(letter)) {
            return wrong(
                "order",
                format!("a letter of {} bytes that is no name", letter.len()),
            );
        }
        let letters: usize = self.rounds().map(|(_, order)| order.len()).sum();
        if letters as u64 > Self::MOST_WINDOWS {
            return wrong("order", format!("{letters} letters in all"));
        }
        let windows: u64 = self
            .scenarios
            .iter()
            .map(|it| u64::from(it.settings.all_windows()))
            .sum();
        if windows > Self::MOST_WINDOWS {
            return wrong("windows", format!("{windows} in all"));
        }
        let environments = self.scenarios.iter().map(|it| it.settings.environments).max();
        if let Some(many) = environments.filter(|many| *many > Settings::MOST_ENVIRONMENTS) {
            return wrong("environments", many.to_string());
        }
        let twice = |field, of: fn(&PlannedScenario) -> &String| {
            let mut seen = BTreeSet::new();
            let again = self.scenarios.iter().map(of).find(|name| !seen.insert(*name));
            again.map_or(Ok(()), |name| wrong(field, format!("`{name}` twice")))
        };
        twice("id", |it| &it.id).and_then(|()| twice("slug", |it| &it.slug))
    }
}

impl PlannedScenario {
    /// Whether this run measures it.
    #[must_use]
    pub const fn runs(&self) -> bool {
        self.feasible && self.not_selected.is_none()
    }

    /// What makes its environments: the provider that its axis `virtualization` names, unless it is computed.
    #[must_use]
    pub fn provider(&self) -> String {
        match &self.settings.simulation {
            Some(_) => SIMULATED.to_owned(),
            None => self.axis(VIRTUALIZATION).unwrap_or_else(|| NATIVE.to_owned()),
        }
    }

    /// Whether that is its letter or its slug.
    #[must_use]
    pub fn is_called(&self, name: &str) -> bool {
        self.id == name || self.slug == name
    }

    /// The rounds in which it has an environment, from 1.
    pub fn rounds(&self) -> impl Iterator<Item = u32> + use<> {
        1..=self.settings.environments
    }

    /// The host that runs a round; empty if none does.
    #[must_use]
    pub fn host_in(&self, round: u32) -> &str {
        let turn = usize::try_from(round.saturating_sub(1)).unwrap_or(0);
        let pooled = turn.checked_rem(self.pool.len()).and_then(|at| self.pool.get(at));
        pooled.or(self.host.as_ref()).map_or("", String::as_str)
    }

    /// All hosts that it runs on.
    pub fn hosts(&self) -> impl Iterator<Item = &str> {
        let alone = self.host.iter().filter(|_| self.pool.is_empty());
        self.pool.iter().chain(alone).map(String::as_str)
    }

    /// The number of a round for the journal: none where there is but one.
    #[must_use]
    pub fn round(&self, round: u32) -> Option<u32> {
        (self.settings.environments > 1).then_some(round)
    }

    /// The value of an axis as text, if the scenario has that axis.
    #[must_use]
    pub fn axis(&self, name: &str) -> Option<String> {
        self.axes.get(name).map(axis_text)
    }
}

/// Reads the letter of a scenario, of which each pair of scenarios has two.
fn letters<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    const LONGEST: usize = 6;
    let text = String::deserialize(from)?;
    match (1..=LONGEST).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_lowercase()) {
        true => Ok(text),
        false => {
            let shown: String = text.chars().take(60).collect();
            Err(D::Error::custom(format!(
                "`{}` is no name of a scenario, whose `id` is its letter: a, b, … z, aa, ab, …",
                shown.escape_debug()
            )))
        }
    }
}

/// The letter of the scenario at an index from 0: a, b, … z, aa, ab, …
#[must_use]
pub fn letter(index: usize) -> String {
    let mut letters = Vec::new();
    let mut rest = index + 1;
    while rest > 0 {
        rest -= 1;
        letters.push(char::from(b'a' + (rest % 26) as u8));
        rest /= 26;
    }
    letters.iter().rev().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(order: Vec<String>, later_rounds: Vec<Vec<String>>) -> PlanRecord {
        PlanRecord {
            format: super::super::FORMAT,
            scenarios: Vec::new(),
            order,
            later_rounds,
            measuring_s: 0.0,
        }
    }

    #[test]
    fn an_order_has_names_and_no_more_of_them_than_there_can_be_environments() {
        let letters = |count: usize| vec!["a".to_owned(); count];
        assert_eq!(plan(letters(1000), vec![letters(1000); 99]).check(), Ok(()));
        assert!(plan(letters(200_001), Vec::new()).check().is_err());
        assert!(plan(letters(1), vec![letters(1000); 200]).check().is_err());
        assert!(plan(vec!["a".repeat(1000)], Vec::new()).check().is_err());
        assert!(plan(letters(1), vec![vec![String::new()]]).check().is_err());
    }
}
