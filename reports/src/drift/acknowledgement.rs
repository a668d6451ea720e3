//! Changes that somebody knows of, so that each is told once. The main type is [`Acknowledgements`].
//!
//! ```yaml
//! acknowledged:
//!   - scenario: x86_64-debian-12-docker   # or "*"
//!     metric: error                       # or "*"
//!     since: 2026-11-20T02-00-00          # the first run with it, by its name
//!     reason: the kernel is 6.12 now
//!     person: Ada
//!     expires: 2027-03-01                 # from that day on it is told again
//!     baseline: reset                     # nights before it are no longer held against those since; or `keep`
//! ```

use std::fmt;

use serde::{Deserialize, Serialize};

use super::{Metric, Night};

/// Where the change that was found may be, in nights from where it was acknowledged: another night more moves it by some.
const NEAR: usize = 2;

/// All that is known.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Acknowledgements {
    /// One for each change.
    #[serde(default)]
    pub acknowledged: Vec<Acknowledgement>,
}

/// What is known of one change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Acknowledgement {
    /// The scenario's slug, or `*` for all.
    pub scenario: String,
    /// The metric's name, or `*` for all.
    #[cfg_attr(feature = "schema", schemars(schema_with = "metrics"))]
    pub metric: String,
    /// The name of the first run with it.
    pub since: String,
    /// Why it is as it is.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"\S")))]
    pub reason: String,
    /// Who says so.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"\S")))]
    pub person: String,
    /// The day from which on it is told again, `YYYY-MM-DD`.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^\d{4}-\d{2}-\d{2}$")))]
    pub expires: String,
    /// What becomes of the nights before it.
    #[serde(default)]
    pub baseline: Baseline,
}

/// What becomes of the nights before an acknowledged change.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Baseline {
    /// They stay in the history.
    #[default]
    Keep,
    /// The history begins with the change: it is what is usual from now on.
    Reset,
}

/// The JSON Schema (draft 2020-12) of a file of what is known.
#[cfg(feature = "schema")]
#[must_use]
pub fn schema() -> serde_json::Value {
    let settings = schemars::generate::SchemaSettings::draft2020_12();
    let mut schema = settings
        .into_generator()
        .into_root_schema_for::<Acknowledgements>();
    schema.insert("title".to_owned(), "Drift that is known".into());
    schema.insert(
        "description".to_owned(),
        "`drift.yaml` of `matrix drift`: changes that somebody knows of.".into(),
    );
    schema.to_value()
}

#[cfg(feature = "schema")]
fn metrics(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    let names: Vec<&str> = Metric::ALL
        .iter()
        .map(|metric| metric.name())
        .chain(["*"])
        .collect();
    schemars::json_schema!({ "enum": names })
}

impl Acknowledgement {
    fn is_of(&self, scenario: &str, metric: Metric) -> bool {
        let is = |wanted: &str, name: &str| wanted == "*" || wanted == name;
        is(&self.scenario, scenario) && is(&self.metric, metric.name())
    }

    /// Whether it still holds on the day of a night: both are written with the year first.
    fn holds_on(&self, created: &str) -> bool {
        created.get(..10).is_some_and(|day| day < self.expires.as_str())
    }

    fn problem(&self) -> Option<String> {
        let day = self.expires.as_bytes();
        let is_day = day.len() == 10
            && day.iter().enumerate().all(|(at, byte)| match at {
                4 | 7 => *byte == b'-',
                _ => byte.is_ascii_digit(),
            });
        let is_metric = self.metric == "*" || Metric::ALL.iter().any(|it| it.name() == self.metric);
        let what = if !is_day {
            format!("`expires: {}` is no day: write it as 2027-03-01", self.expires)
        } else if !is_metric {
            let names: Vec<&str> = Metric::ALL.iter().map(|metric| metric.name()).collect();
            format!(
                "`metric: {}` is none of {}, or `*`",
                self.metric,
                names.join(", ")
            )
        } else if self.reason.trim().is_empty() || self.person.trim().is_empty() {
            "it has no reason or no person".to_owned()
        } else {
            return None;
        };
        Some(format!("{self}: {what}"))
    }
}

impl fmt::Display for Acknowledgement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the acknowledgement of {} {}", self.scenario, self.metric)
    }
}

impl Acknowledgements {
    /// What is wrong with them, in words; empty when nothing is.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        let each = self.acknowledged.iter();
        each.filter_map(Acknowledgement::problem).collect()
    }

    /// Those of runs that the history does not have (any more), in words.
    pub(super) fn of_no_night(&self, nights: &[Night]) -> Vec<String> {
        let has = |run: &str| nights.iter().any(|night| night.run == run);
        self.acknowledged
            .iter()
            .filter(|it| !has(&it.since))
            .map(|it| format!("{it}: `since: {}` is no run of the history", it.since))
            .collect()
    }

    /// That of a change, if somebody knows of it and it has not expired by the newest of the nights.
    pub(super) fn of(
        &self,
        nights: &[Night],
        scenario: &str,
        metric: Metric,
        since: &str,
    ) -> Option<&Acknowledgement> {
        let place = |run: &str| nights.iter().position(|night| night.run == run);
        let newest = nights.last()?;
        self.holding(newest, scenario, metric)
            .find(|it| match (place(&it.since), place(since)) {
                (Some(known), Some(found)) => known.abs_diff(found) <= NEAR,
                _ => it.since == since,
            })
    }

    /// The first run that counts, where a change was accepted as what is usual now.
    pub(super) fn begins(&self, nights: &[Night], scenario: &str, metric: Metric) -> Option<&str> {
        let newest = nights.last()?;
        let resets = self
            .holding(newest, scenario, metric)
            .filter(|it| it.baseline == Baseline::Reset);
        let place = |it: &&Acknowledgement| nights.iter().position(|night| night.run == it.since);
        resets.max_by_key(place).map(|it| it.since.as_str())
    }

    fn holding(
        &self,
        newest: &Night,
        scenario: &str,
        metric: Metric,
    ) -> impl Iterator<Item = &Acknowledgement> {
        self.acknowledged
            .iter()
            .filter(move |it| it.is_of(scenario, metric) && it.holds_on(&newest.created))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rstest::rstest;

    use super::*;

    fn nights() -> Vec<Night> {
        (10..30)
            .map(|day| Night {
                run: format!("night-{day}"),
                created: format!("2026-11-{day}T02:00:00.000Z"),
                is_simulated: false,
                matters_m: None,
                scenarios: BTreeMap::new(),
            })
            .collect()
    }

    fn known() -> Acknowledgement {
        Acknowledgement {
            scenario: "a".to_owned(),
            metric: "error".to_owned(),
            since: "night-20".to_owned(),
            reason: "new kernel".to_owned(),
            person: "Ada".to_owned(),
            expires: "2026-12-24".to_owned(),
            baseline: Baseline::Keep,
        }
    }

    #[rstest]
    #[case::itself("a", Metric::TrackingError, "night-20", true)]
    #[case::moved_by_another_night("a", Metric::TrackingError, "night-22", true)]
    #[case::another_change("a", Metric::TrackingError, "night-23", false)]
    #[case::another_scenario("b", Metric::TrackingError, "night-20", false)]
    #[case::another_metric("a", Metric::Lateness, "night-20", false)]
    fn one_is_of_its_change_alone(
        #[case] scenario: &str,
        #[case] metric: Metric,
        #[case] since: &str,
        #[case] is_known: bool,
    ) {
        let all = Acknowledgements {
            acknowledged: vec![known()],
        };
        assert_eq!(all.of(&nights(), scenario, metric, since).is_some(), is_known);
    }

    #[test]
    fn one_that_has_expired_says_nothing_any_more() {
        let expired = Acknowledgement {
            expires: "2026-11-29".to_owned(),
            baseline: Baseline::Reset,
            ..known()
        };
        let all = Acknowledgements {
            acknowledged: vec![expired],
        };
        let metric = Metric::TrackingError;
        assert_eq!(all.of(&nights(), "a", metric, "night-20"), None);
        assert_eq!(all.begins(&nights(), "a", metric), None);
        assert!(
            all.of(&nights()[..19], "a", metric, "night-20").is_some(),
            "the day before"
        );
    }

    #[test]
    fn the_history_begins_with_the_last_change_that_was_accepted() {
        let reset = |since: &str| Acknowledgement {
            since: since.to_owned(),
            scenario: "*".to_owned(),
            baseline: Baseline::Reset,
            ..known()
        };
        let all = Acknowledgements {
            acknowledged: vec![reset("night-18"), reset("night-12"), known()],
        };
        assert_eq!(
            all.begins(&nights(), "b", Metric::TrackingError),
            Some("night-18")
        );
        assert_eq!(all.begins(&nights(), "b", Metric::Lateness), None);
    }

    #[rstest]
    #[case(Acknowledgement { expires: "soon".to_owned(), ..known() }, "write it as 2027-03-01")]
    #[case(Acknowledgement { metric: "speed".to_owned(), ..known() }, "none of error, state-age, packet-delay, lateness, provisioning")]
    #[case(Acknowledgement { person: " ".to_owned(), ..known() }, "no reason or no person")]
    fn a_wrong_one_is_told(#[case] wrong: Acknowledgement, #[case] says: &str) {
        let all = Acknowledgements {
            acknowledged: vec![known(), wrong],
        };
        let problems = all.problems();
        assert_eq!(problems.len(), 1, "{problems:?}");
        assert!(problems[0].contains(says), "{problems:?}");
    }

    #[test]
    fn one_of_a_run_that_is_not_there_is_told() {
        let stranger = Acknowledgement {
            since: "night-99".to_owned(),
            ..known()
        };
        let all = Acknowledgements {
            acknowledged: vec![known(), stranger],
        };
        assert_eq!(
            all.of_no_night(&nights()),
            ["the acknowledgement of a error: `since: night-99` is no run of the history"]
        );
    }
}
