//! Changes that somebody knows of, so that each is told once. The main type is [`Acknowledgements`].
//!
//! ```yaml
//! acknowledged:
//!   - scenario: x86-64-debian-12-docker   # or "*"
//!     metric: error                       # or "*"
//!     since: 2026-11-20T02-00-00          # the first run with it, by its name
//!     reason: the kernel is 6.12 now
//!     person: Ada
//!     expires: 2027-03-01                 # from that day on it is told again
//!     baseline: reset                     # nights before it are no longer held against those since; or `keep`
//! ```

use std::{collections::BTreeSet, fmt};

use serde::{Deserialize, Serialize};

use super::{Metric, Night};

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
    /// The metric's name, such as `error` or `provisioning`, or one of the experiment's own; or `*` for all.
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

impl Acknowledgement {
    fn is_of(&self, scenario: &str, metric: &Metric) -> bool {
        let is = |wanted: &str, name: &str| wanted == "*" || wanted == name;
        is(&self.scenario, scenario) && is(&self.metric, metric.name())
    }

    /// Whether it still holds on the day of a night: both are written with the year first.
    fn holds_on(&self, created: &str) -> bool {
        created.get(..10).is_some_and(|day| day < self.expires.as_str())
    }

    fn problem(&self) -> Option<String> {
        // It knows how many days months have.
        let is_day = humantime::parse_rfc3339(&format!("{}T00:00:00Z", self.expires)).is_ok();
        let what = if !is_day {
            format!("`expires: {}` is no day: write it as 2027-03-01", self.expires)
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

    /// Those of runs and scenarios that the history does not have (any more), in words.
    pub(super) fn of_no_night(&self, nights: &[Night]) -> Vec<String> {
        let has_run = |run: &str| nights.iter().any(|night| night.run == run);
        let has_scenario = |slug: &str| {
            let mut all = nights.iter();
            slug == "*" || all.any(|night| night.scenarios.contains_key(slug))
        };
        let metrics: BTreeSet<&str> = nights
            .iter()
            .flat_map(|night| night.scenarios.values())
            .flat_map(|measured| {
                let contents = measured.contents.keys().map(String::as_str);
                measured.values.keys().map(Metric::name).chain(contents)
            })
            .collect();
        let what = |it: &Acknowledgement| {
            if !metrics.is_empty() && it.metric != "*" && !metrics.contains(it.metric.as_str()) {
                let known: Vec<&str> = metrics.iter().copied().collect();
                Some(format!(
                    "the history follows no `{}`, but {}",
                    it.metric,
                    known.join(", ")
                ))
            } else if !has_scenario(&it.scenario) {
                Some("there is no such scenario in the history".to_owned())
            } else if !has_run(&it.since) {
                Some(format!("`since: {}` is no run of the history", it.since))
            } else {
                None
            }
        };
        let each = self.acknowledged.iter();
        each.filter_map(|it| Some(format!("{it}: {}", what(it)?)))
            .collect()
    }

    /// That of exactly that run, if it has not expired by the newest of the nights.
    pub(super) fn of_run(
        &self,
        nights: &[Night],
        scenario: &str,
        metric: &Metric,
        run: &str,
    ) -> Option<&Acknowledgement> {
        self.holding(nights, scenario, metric).find(|it| it.since == run)
    }

    /// Those of changes whose earlier nights stay in the history, with the place of the night that each begins with.
    pub(super) fn steps(
        &self,
        nights: &[Night],
        scenario: &str,
        metric: &Metric,
    ) -> impl Iterator<Item = (usize, &Acknowledgement)> {
        let all = self.holding(nights, scenario, metric);
        all.filter(|it| it.baseline == Baseline::Keep)
            .filter_map(|it| Some((nights.iter().position(|night| night.run == it.since)?, it)))
    }

    /// Whether somebody knows that a scenario is not measured any more: a run without it is acknowledged.
    pub(super) fn is_left_out(&self, nights: &[Night], scenario: &str) -> bool {
        let lacks = |night: &Night| !night.scenarios.contains_key(scenario);
        let metric = nights
            .last()
            .map(|night| night.metric.clone())
            .unwrap_or_default();
        self.holding(nights, scenario, &metric)
            .any(|it| nights.iter().any(|night| night.run == it.since && lacks(night)))
    }

    /// The first run that counts, where a change was accepted as what is usual now.
    pub(super) fn begins(&self, nights: &[Night], scenario: &str, metric: &Metric) -> Option<&str> {
        let all = self
            .holding(nights, scenario, metric)
            .filter(|it| it.baseline == Baseline::Reset);
        let place = |it: &&Acknowledgement| nights.iter().position(|night| night.run == it.since);
        all.max_by_key(place).map(|it| it.since.as_str())
    }

    fn holding(
        &self,
        nights: &[Night],
        scenario: &str,
        metric: &Metric,
    ) -> impl Iterator<Item = &Acknowledgement> {
        let day = nights
            .last()
            .map(|night| night.created.as_str())
            .unwrap_or_default();
        self.acknowledged
            .iter()
            .filter(move |it| it.is_of(scenario, metric) && it.holds_on(day))
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
                metric: Metric::TrackingError,
                equivalence_margin_m: None,
                equivalence_margins: BTreeMap::new(),
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

    fn known_steps(all: &Acknowledgements, nights: &[Night], scenario: &str, metric: &Metric) -> Vec<usize> {
        all.steps(nights, scenario, metric)
            .map(|(night, _)| night)
            .collect()
    }

    #[rstest]
    #[case::itself("a", Metric::TrackingError, &[10])]
    #[case::another_scenario("b", Metric::TrackingError, &[])]
    #[case::another_metric("a", Metric::Lateness, &[])]
    fn one_is_of_its_series_alone(
        #[case] scenario: &str,
        #[case] metric: Metric,
        #[case] known_at: &[usize],
    ) {
        let all = Acknowledgements {
            acknowledged: vec![known()],
        };
        assert_eq!(known_steps(&all, &nights(), scenario, &metric), known_at);
    }

    #[test]
    fn one_that_has_expired_says_nothing_any_more() {
        let expired = |baseline| Acknowledgements {
            acknowledged: vec![Acknowledgement {
                expires: "2026-11-29".to_owned(),
                baseline,
                ..known()
            }],
        };
        let metric = &Metric::TrackingError;
        let nights = nights();
        let the_day_before = &nights[..19];
        let kept = expired(Baseline::Keep);
        assert!(known_steps(&kept, &nights, "a", metric).is_empty());
        assert_eq!(known_steps(&kept, the_day_before, "a", metric), [10]);
        let reset = expired(Baseline::Reset);
        assert_eq!(reset.begins(&nights, "a", metric), None);
        assert_eq!(reset.begins(the_day_before, "a", metric), Some("night-20"));
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
            all.begins(&nights(), "b", &Metric::TrackingError),
            Some("night-18")
        );
        assert_eq!(all.begins(&nights(), "b", &Metric::Lateness), None);
    }

    #[rstest]
    #[case(Acknowledgement { expires: "soon".to_owned(), ..known() }, "write it as 2027-03-01")]
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
    fn one_of_a_run_or_a_scenario_that_is_not_there_is_told() {
        let everywhere = Acknowledgement {
            scenario: "*".to_owned(),
            ..known()
        };
        let stranger = Acknowledgement {
            since: "night-99".to_owned(),
            ..everywhere.clone()
        };
        let all = Acknowledgements {
            acknowledged: vec![everywhere, stranger, known()],
        };
        assert_eq!(
            all.of_no_night(&nights()),
            [
                "the acknowledgement of * error: `since: night-99` is no run of the history",
                "the acknowledgement of a error: there is no such scenario in the history"
            ]
        );
    }

    #[rstest]
    #[case::a_day("2027-02-28", true)]
    #[case::no_day_of_that_month("2027-02-29", false)]
    #[case::no_month("2027-99-99", false)]
    #[case::another_way("28.02.2027", false)]
    fn it_expires_on_a_day_that_there_is(#[case] expires: &str, #[case] is_one: bool) {
        let all = Acknowledgements {
            acknowledged: vec![Acknowledgement {
                expires: expires.to_owned(),
                ..known()
            }],
        };
        assert_eq!(all.problems().is_empty(), is_one, "{:?}", all.problems());
    }
}
