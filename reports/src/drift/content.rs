//! Metrics that are compared byte for byte, along the nights: there is no spread to hold a change against, and any other byte is one.
//!
//! Windows of the same number are compared, since a program may have the number as its seed. The main functions are [`of_history`] and
//! [`of_baseline`].

use std::collections::BTreeMap;

use super::{
    Acknowledgement, Cause, Change, ContentChange, Finding, Judgement, Kind, Metric, Night, Settings,
    Verdict,
    night::Measured,
    series::{lacks, never_asked},
};

/// A night that has the metric, with the SHA-256 of each window.
#[derive(Clone, Copy)]
struct Point<'a> {
    night: usize,
    run: &'a str,
    measured: &'a Measured,
    windows: &'a BTreeMap<u32, String>,
}

/// Each night against what the nights before it had. What has changed is told until somebody acknowledges it, or until a night has the
/// same as before again.
pub(super) fn of_history(nights: &[Night], settings: &Settings) -> Vec<Judgement> {
    let known = &settings.acknowledgements;
    let look = |points: &[Point<'_>], scenario: &str, metric: &Metric| {
        let begins = known.begins(nights, scenario, metric);
        let first = begins.and_then(|run| points.iter().position(|point| point.run == run));
        let points = points.get(first.unwrap_or(0)..).unwrap_or_default();
        changes(points, |run| known.of_run(nights, scenario, metric, run))
    };
    judgements(nights, look)
}

/// The newest night against the others: a window is the same if one of them had it so.
pub(super) fn of_baseline(nights: &[Night], settings: &Settings) -> Vec<Judgement> {
    let look = |points: &[Point<'_>], scenario: &str, metric: &Metric| {
        let Some((tonight, before)) = points.split_last() else {
            return Followed::default();
        };
        let Some(last) = before.last().filter(|_| tonight.night + 1 == nights.len()) else {
            return Followed::default();
        };
        let had = |window: u32, sha256: &String| {
            let mut all = before.iter().filter_map(|point| point.windows.get(&window));
            all.clone().next().map(|_| all.any(|known| known == sha256))
        };
        let compared = Compared::of(tonight.windows, had);
        let known = settings
            .acknowledgements
            .of_run(nights, scenario, metric, tonight.run);
        let found = compared
            .change()
            .map(|change| finding(Kind::FromBaseline, last, tonight, change, known));
        Followed {
            findings: found.into_iter().collect(),
            is_newest_compared: !compared.0.is_empty(),
        }
    };
    judgements(nights, look)
}

/// What one scenario and metric came to.
#[derive(Default)]
struct Followed {
    findings: Vec<Finding>,
    /// Whether the newest of its nights has a window that was there before.
    is_newest_compared: bool,
}

/// `look` follows one scenario and metric.
fn judgements(nights: &[Night], look: impl Fn(&[Point<'_>], &str, &Metric) -> Followed) -> Vec<Judgement> {
    let Some(newest) = nights.last() else {
        return Vec::new();
    };
    let mut all = Vec::new();
    for (scenario, tonight) in &newest.scenarios {
        for name in tonight.contents.keys() {
            let metric = Metric::Content { name: name.clone() };
            let points: Vec<Point<'_>> = points(nights, scenario, name).collect();
            let lacks = lacks(tonight, tonight.has(&metric));
            if points.is_empty() && never_asked(lacks.as_ref()) {
                continue;
            }
            let Followed {
                findings,
                is_newest_compared,
            } = look(&points, scenario, &metric);
            let verdict = match (findings.iter().any(Finding::is_news), lacks) {
                (true, _) => Verdict::Drift,
                (false, Some(lacks)) => lacks.into(),
                (false, None) if points.len() < 2 => Verdict::TooLittle {
                    reason: "no earlier run has it".to_owned(),
                },
                (false, None) if !is_newest_compared => Verdict::TooLittle {
                    reason: "the newest run has no window of a number that an earlier one has".to_owned(),
                },
                (false, None) => Verdict::NoDrift { detectable: None },
            };
            all.push(Judgement {
                scenario: scenario.clone(),
                metric,
                verdict,
                nights: points.len(),
                findings,
            });
        }
    }
    all
}

fn points<'a>(
    nights: &'a [Night],
    scenario: &'a str,
    name: &'a str,
) -> impl Iterator<Item = Point<'a>> + use<'a> {
    nights.iter().enumerate().filter_map(move |(place, night)| {
        let measured = night.scenarios.get(scenario)?;
        Some(Point {
            night: place,
            run: &night.run,
            measured,
            windows: measured
                .contents
                .get(name)
                .filter(|windows| !windows.is_empty())?,
        })
    })
}

fn changes<'k>(points: &[Point<'_>], known: impl Fn(&str) -> Option<&'k Acknowledgement>) -> Followed {
    let mut followed = Followed::default();
    let Some((first, later)) = points.split_first() else {
        return followed;
    };
    let findings = &mut followed.findings;
    // What each window had before the change that is told, or has now.
    let mut usual: BTreeMap<u32, &String> = first.windows.iter().map(|(window, it)| (*window, it)).collect();
    let mut last = first;
    // The finding that the nights are within, and how its windows compared.
    let mut told: Option<(usize, Compared)> = None;
    for point in later {
        let had = |window: u32, sha256: &String| usual.get(&window).map(|known| *known == sha256);
        let acknowledged = known(point.run);
        let compared = Compared::of(point.windows, had);
        followed.is_newest_compared = !compared.0.is_empty();
        match (compared.change(), &told) {
            (None, Some((open, changed))) if compared.has_any_that_changed_in(changed) => {
                if let Some(finding) = findings.get_mut(*open) {
                    finding.withdrawn = Some(point.run.to_owned());
                }
                told = None;
            }
            (None, _) => {}
            (Some(change), None) => {
                findings.push(finding(Kind::Jump, last, point, change, acknowledged));
                told = Some((findings.len() - 1, compared));
            }
            // A change upon a change is told by itself where somebody knows of it: it is what is usual from now on.
            (Some(change), Some(_)) if acknowledged.is_some() => {
                findings.push(finding(Kind::Jump, last, point, change, acknowledged));
            }
            (Some(_), Some(_)) => {}
        }
        if acknowledged.is_some() {
            usual.clear();
            told = None;
        }
        if told.is_none() {
            for (window, sha256) in point.windows {
                usual.entry(*window).or_insert(sha256);
            }
        }
        last = point;
    }
    followed
}

fn finding(
    kind: Kind,
    before: &Point<'_>,
    since: &Point<'_>,
    change: ContentChange,
    known: Option<&Acknowledgement>,
) -> Finding {
    Finding {
        kind,
        before: before.run.to_owned(),
        since: since.run.to_owned(),
        change: Change::Content(change),
        cause: Cause::between(before.measured, since.measured),
        acknowledged: known.cloned(),
        immaterial: false,
        withdrawn: None,
        explained: None,
        report: None,
    }
}

/// Windows of a night that were there before, each with whether it is the same.
struct Compared(BTreeMap<u32, bool>);

impl Compared {
    /// Of a night's windows, with `had` for whether a window was so before, if it was there.
    fn of(windows: &BTreeMap<u32, String>, had: impl Fn(u32, &String) -> Option<bool>) -> Self {
        let compared = windows
            .iter()
            .filter_map(|(window, sha256)| Some((*window, had(*window, sha256)?)));
        Self(compared.collect())
    }

    fn changed(&self) -> impl Iterator<Item = u32> + '_ {
        let changed = self.0.iter().filter(|(_, is_same)| !**is_same);
        changed.map(|(window, _)| *window)
    }

    /// None if nothing is other than it was, which says something of the windows that were compared and of no others.
    fn change(&self) -> Option<ContentChange> {
        Some(ContentChange {
            first_window: self.changed().next()?,
            changed: self.changed().count(),
            compared: self.0.len(),
        })
    }

    fn has_any_that_changed_in(&self, earlier: &Self) -> bool {
        earlier.changed().any(|window| self.0.contains_key(&window))
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;
    use crate::drift::{Acknowledgements, Baseline, Drift, baseline, history};

    /// Nights of one scenario, each with what its windows had, from the first on; `-` is a window that is not there.
    fn nights(each: &[&str]) -> Vec<Night> {
        let night = |(number, had): (usize, &&str)| {
            let windows = (1..).zip(had.chars()).filter(|(_, letter)| *letter != '-');
            let windows: BTreeMap<u32, String> = windows
                .map(|(window, letter)| (window, letter.to_string()))
                .collect();
            Night {
                run: format!("night-{number}"),
                created: format!("2026-11-{:02}T02:00:00.000Z", number + 1),
                is_simulated: false,
                metric: Metric::Content {
                    name: "state".to_owned(),
                },
                equivalence_margin_m: None,
                equivalence_margins: BTreeMap::new(),
                scenarios: BTreeMap::from([(
                    "a".to_owned(),
                    Measured {
                        configuration: crate::drift::Compact::of(&serde_json::json!({})),
                        environment: None,
                        values: BTreeMap::new(),
                        contents: BTreeMap::from([("state".to_owned(), windows)]),
                        lack: None,
                    },
                )]),
            }
        };
        each.iter().enumerate().map(night).collect()
    }

    fn known(since: &str, baseline: Baseline) -> Acknowledgement {
        Acknowledgement {
            scenario: "a".to_owned(),
            metric: "state".to_owned(),
            since: since.to_owned(),
            reason: "another compiler".to_owned(),
            person: "Ada".to_owned(),
            expires: "2027-03-01".to_owned(),
            baseline,
        }
    }

    fn assert_told(drift: &Drift, verdict: &str, findings: &[&str]) {
        let (found, said) = told(drift);
        assert_eq!(
            (found, said.iter().map(String::as_str).collect::<Vec<_>>()),
            (verdict, findings.to_vec())
        );
    }

    /// The verdict, and of each finding the run, the first window, how many changed of how many, and whether it is news.
    fn told(drift: &Drift) -> (&'static str, Vec<String>) {
        let [judgement] = drift.judgements.as_slice() else {
            panic!("{:?}", drift.judgements);
        };
        let finding = |finding: &Finding| match &finding.change {
            Change::Content(change) => format!(
                "{} window {} ({}/{}){}",
                finding.since,
                change.first_window,
                change.changed,
                change.compared,
                if finding.is_news() { "" } else { " silent" }
            ),
            Change::Level(_) => panic!("{finding:?}"),
        };
        (
            judgement.verdict.name(),
            judgement.findings.iter().map(finding).collect(),
        )
    }

    #[rstest]
    #[case::the_same(&["xy", "xy", "xy"], "no drift found", &[])]
    #[case::one_byte(&["xy", "xy", "xz"], "drift", &["night-2 window 2 (1/2)"])]
    #[case::told_until_known(&["xy", "zy", "zy", "zy"], "drift", &["night-1 window 1 (1/2)"])]
    #[case::as_before(&["xy", "zy", "xy"], "no drift found", &["night-1 window 1 (1/2) silent"])]
    #[case::again(&["x", "z", "x", "z"], "drift", &["night-1 window 1 (1/1) silent", "night-3 window 1 (1/1)"])]
    #[case::further_windows(&["x", "xy", "xyz", "xqz"], "drift", &["night-3 window 2 (1/3)"])]
    #[case::one_night(&["xy"], "too little data", &[])]
    #[case::none_tonight(&["xy", "xy", "-"], "too little data", &[])]
    #[case::a_night_between(&["xy", "-", "xz"], "drift", &["night-2 window 2 (1/2)"])]
    #[case::no_window_in_common(&["xy", "--z"], "too little data", &[])]
    #[case::told_while_nothing_is_compared(&["xy", "zy", "--x"], "drift", &["night-1 window 1 (1/2)"])]
    #[case::told_while_its_window_is_not_there(&["xy", "zy", "-y"], "drift", &["night-1 window 1 (1/2)"])]
    fn a_change_of_any_byte_is_told(#[case] each: &[&str], #[case] verdict: &str, #[case] findings: &[&str]) {
        let drift = history::judge(&nights(each), &Settings::default());
        assert_told(&drift, verdict, findings);
    }

    #[rstest]
    #[case::kept(Baseline::Keep, &["night-1 window 1 (1/2) silent"])]
    #[case::reset(Baseline::Reset, &[])]
    fn what_is_known_is_usual_from_then_on(#[case] baseline: Baseline, #[case] silent: &[&str]) {
        let settings = Settings {
            acknowledgements: Acknowledgements {
                acknowledged: vec![known("night-1", baseline)],
            },
            ..Settings::default()
        };
        let quiet = history::judge(&nights(&["xy", "zy", "zy"]), &settings);
        assert_told(&quiet, "no drift found", silent);
        let again = history::judge(&nights(&["xy", "zy", "zy", "zq"]), &settings);
        let (verdict, findings) = told(&again);
        assert_eq!(
            (verdict, findings.last().map(String::as_str)),
            ("drift", Some("night-3 window 2 (1/2)"))
        );
    }

    #[rstest]
    #[case(&["xy", "xz", "xz"], "no drift found", &[])]
    #[case(&["xy", "xz", "xq"], "drift", &["night-2 window 2 (1/2)"])]
    #[case(&["xy", "xz", "-"], "too little data", &[])]
    #[case(&["xy", "xz", "--z"], "too little data", &[])]
    fn against_a_baseline_what_one_of_its_nights_had_is_the_same(
        #[case] each: &[&str],
        #[case] verdict: &str,
        #[case] findings: &[&str],
    ) {
        let drift = baseline::judge(&nights(each), &Settings::default());
        assert_told(&drift, verdict, findings);
    }

    #[test]
    fn a_finding_says_which_windows_have_other_bytes() {
        let drift = history::judge(&nights(&["xyz", "xqq"]), &Settings::default());
        insta::assert_snapshot!(drift.text(), @r#"
        Drift in night-1, against 1 earlier runs (drift: 1). The state of a has other
        bytes than before in night-1.

        Changed
        - a state has other bytes than before in night-1 (2 of 3 windows, the first is
          2); nothing else that is recorded changed with it

        To acknowledge a change, write it into drift.yaml; the first of these is

            acknowledged:
              - scenario: "a"
                metric: "state"
                since: "night-1"
                reason: why it is as it is
                person: who says so
                expires: 2027-01-31
                baseline: keep

        Each scenario and metric
        - a state: drift
        "#);
    }
}
