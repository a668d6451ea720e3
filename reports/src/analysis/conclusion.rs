//! What the paper concludes, as tests: that Docker differs from VirtualBox, and OSX from Ubuntu. Two values of an axis are
//! compared over all platforms that have both: within each stratum the windows are permuted between the two values, and all strata
//! together give one p-value and one shift. The main type is [`Conclusion`].
//!
//! The statistic is the weighted mean over strata of the differences of the mean window levels,
//!
//! ```text
//! shift = Σ w_s (mean_s(second) − mean_s(first)) / Σ w_s,    w_s = n_s m_s / (n_s + m_s)
//! ```
//!
//! with the weights that have the least variance where windows spread alike, and p is the share of labellings with a shift at
//! least as large in size (Good, *Permutation, Parametric and Bootstrap Tests of Hypotheses*, 2005, 3.4: a permutation test in
//! blocks). The interval is of all shifts that the same test does not reject at 0.05 when the second's windows are moved back by
//! them. It needs no search: under a labelling with the shift A of the levels and B of what was moved, moving back by δ gives
//! A − δB, so that each labelling has one interval of δ within which it is as extreme as the observed one.

use record::axis::{HARDWARE, NODE, OS, VIRTUALIZATION};
use serde::Serialize;
use statistics::{
    effect::{CONFIDENCE, Estimate, Interval},
    multiplicity::holm,
    relabelling::{Coverage, Effort, PermutationTest, Relabellings, labellings},
};

use crate::analysis::{
    sample::{Sample, levels},
    scenario::ScenarioReport,
    setup::SetupDifference,
};

/// Two values of an axis, compared within strata.
#[derive(Debug, Clone, PartialEq)]
pub struct Conclusion {
    /// `virtualization`, `os` or `node`.
    pub axis: &'static str,
    /// The first value; of a node, [`OTHER_NODES`] where there are several.
    pub first: String,
    /// The second.
    pub second: String,
    /// Whether scenarios of a stratum differ in hardware, too: no hardware has both values.
    pub hardware_differs: bool,
    /// Where both values have windows that count; never empty.
    pub strata: Vec<Stratum>,
    /// The test.
    pub test: PermutationTest,
    /// The smallest p that so many windows in such strata can reach.
    pub smallest_p: f64,
    /// p adjusted by Holm's method for all conclusions of the report.
    pub p_holm: f64,
    /// By how much the second's window means are larger, m.
    pub shift: Estimate,
}

/// The windows that are alike in all that is held fixed.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Stratum {
    /// The values held fixed.
    pub name: String,
    /// Letters of the scenarios with the first value.
    pub a: Vec<String>,
    /// Letters of those with the second.
    pub b: Vec<String>,
    /// Windows of the first value.
    pub n: usize,
    /// Windows of the second value.
    pub m: usize,
    /// By how much the second's window means are larger, m.
    pub shift: f64,
}

/// A stratum with the levels of its windows, those of the first value before those of the second.
#[derive(Debug, Clone)]
struct Levels {
    stratum: Stratum,
    levels: Vec<f64>,
}

/// What stands in a conclusion for all nodes but one.
pub const OTHER_NODES: &str = "the other nodes";

/// Compares every two values of `virtualization`, and of `os`, that have windows in a stratum in common, and each `node` with all
/// others. Strata with scenarios that did not run the same experiment are left out.
#[must_use]
pub fn conclusions(
    scenarios: &[ScenarioReport],
    samples: &[Sample],
    unlike: &[SetupDifference],
    seed: u64,
) -> Vec<Conclusion> {
    let with_data: Vec<(&ScenarioReport, Vec<f64>)> = scenarios
        .iter()
        .map(|scenario| (scenario, levels(samples, &scenario.id)))
        .filter(|(_, levels)| !levels.is_empty())
        .collect();
    let mut found = Vec::new();
    for axis in [VIRTUALIZATION, OS, NODE] {
        let mut values: Vec<String> = Vec::new();
        for value in with_data.iter().filter_map(|(scenario, _)| value(scenario, axis)) {
            if !values.contains(&value) {
                values.push(value);
            }
        }
        for sides in Side::pairs(axis, &values) {
            found.extend(Conclusion::of(axis, sides, &with_data, unlike, seed));
        }
    }
    let adjusted = holm(&found.iter().map(|one| one.test.p).collect::<Vec<_>>());
    for (conclusion, p_holm) in found.iter_mut().zip(adjusted) {
        conclusion.p_holm = p_holm;
    }
    found
}

fn value(scenario: &ScenarioReport, axis: &str) -> Option<String> {
    match axis {
        VIRTUALIZATION => Some(scenario.virtualization()),
        _ => scenario.axis(axis),
    }
}

/// One side of a conclusion.
#[derive(Debug, Clone, Copy)]
enum Side<'a> {
    /// One value of the axis.
    Value(&'a str),
    /// All values but this one.
    AllBut(&'a str),
}

impl<'a> Side<'a> {
    /// What is compared of the values of an axis: nodes are alike until one is odd, so that each is compared with all others.
    fn pairs(axis: &str, values: &'a [String]) -> Vec<[Self; 2]> {
        if axis == NODE && values.len() > 2 {
            let against_others = values
                .iter()
                .map(|value| [Self::AllBut(value), Self::Value(value)]);
            return against_others.collect();
        }
        let pairs = values.iter().enumerate().flat_map(|(at, first)| {
            let later = values.iter().skip(at + 1);
            later.map(move |second| [Self::Value(first), Self::Value(second)])
        });
        pairs.collect()
    }

    fn holds(self, value: &str) -> bool {
        match self {
            Self::Value(own) => value == own,
            Self::AllBut(other) => value != other,
        }
    }

    fn name(self) -> &'a str {
        match self {
            Self::Value(own) => own,
            Self::AllBut(_) => OTHER_NODES,
        }
    }
}

impl Conclusion {
    fn of(
        axis: &'static str,
        sides: [Side<'_>; 2],
        scenarios: &[(&ScenarioReport, Vec<f64>)],
        unlike: &[SetupDifference],
        seed: u64,
    ) -> Option<Self> {
        let strata = |free: &[&str]| strata(axis, sides, free, scenarios, unlike);
        let (found, hardware_differs) = match axis {
            // A machine has one operating system: no hardware may have both, and no node has.
            OS => match strata(&[NODE]) {
                none if none.is_empty() => (strata(&[NODE, HARDWARE]), true),
                found => (found, false),
            },
            _ => (strata(&[]), false),
        };
        let (test, shift) = stratified(&found, Effort::of_a_report(seed))?;
        let strata: Vec<Stratum> = found.into_iter().map(|it| it.stratum).collect();
        Some(Self {
            axis,
            first: sides[0].name().to_owned(),
            second: sides[1].name().to_owned(),
            hardware_differs,
            smallest_p: smallest_p(&strata, &test),
            strata,
            p_holm: test.p,
            test,
            shift,
        })
    }
}

/// The strata in which both sides have windows: scenarios alike in all axes but this one and those that are left `free`.
fn strata(
    axis: &str,
    sides: [Side<'_>; 2],
    free: &[&str],
    scenarios: &[(&ScenarioReport, Vec<f64>)],
    unlike: &[SetupDifference],
) -> Vec<Levels> {
    let fixed = |scenario: &ScenarioReport| -> String {
        let others = scenario
            .axes
            .keys()
            .filter(|other| *other != axis && !free.contains(&other.as_str()));
        let values: Vec<String> = others.filter_map(|other| scenario.axis(other)).collect();
        values.join(" ")
    };
    let mut names: Vec<String> = Vec::new();
    for name in scenarios.iter().map(|(scenario, _)| fixed(scenario)) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let stratum = |name: String| {
        let [a, b] = sides.map(|side| {
            let own = scenarios.iter().filter(|(scenario, _)| {
                fixed(scenario) == name && value(scenario, axis).is_some_and(|value| side.holds(&value))
            });
            own.collect::<Vec<_>>()
        });
        let ids =
            |side: &[&(&ScenarioReport, Vec<f64>)]| Vec::from_iter(side.iter().map(|it| it.0.id.clone()));
        let levels = |side: &[&(&ScenarioReport, Vec<f64>)]| {
            Vec::from_iter(side.iter().flat_map(|it| it.1.iter().copied()))
        };
        let all = [ids(&a), ids(&b)].concat();
        let has = |letter: &str| all.iter().any(|id| id == letter);
        let is_one_experiment = !unlike.iter().any(|it| has(&it.a) && has(&it.b));
        let (of_a, of_b) = (levels(&a), levels(&b));
        let has_both = !of_a.is_empty() && !of_b.is_empty();
        (has_both && is_one_experiment).then(|| Levels {
            stratum: Stratum {
                name,
                a: ids(&a),
                b: ids(&b),
                n: of_a.len(),
                m: of_b.len(),
                shift: mean(&of_b) - mean(&of_a),
            },
            levels: [of_a, of_b].concat(),
        })
    };
    names.into_iter().filter_map(stratum).collect()
}

/// The test of no shift in any stratum, and the shift; none without a stratum.
fn stratified(strata: &[Levels], effort: Effort) -> Option<(PermutationTest, Estimate)> {
    let sizes: Vec<[usize; 2]> = strata.iter().map(|it| [it.stratum.n, it.stratum.m]).collect();
    let weight = |[n, m]: &[usize; 2]| (n * m) as f64 / (n + m) as f64;
    let total: f64 = sizes.iter().map(weight).sum();
    // Around each stratum's mean: the strata's own levels are no part of the shift, and sums of small numbers lose least.
    let centred: Vec<f64> = strata
        .iter()
        .flat_map(|it| {
            let centre = mean(&it.levels);
            it.levels.iter().map(move |level| level - centre)
        })
        .collect();
    let moved: Vec<f64> = sizes
        .iter()
        .flat_map(|[n, m]| std::iter::repeat_n(0.0, *n).chain(std::iter::repeat_n(1.0, *m)))
        .collect();
    if strata.is_empty() {
        return None;
    }
    let shift = |labels: &[usize], values: &[f64]| -> f64 {
        let mut begin = 0;
        let mut sum = 0.0;
        for size @ [n, m] in &sizes {
            let place = begin..begin + n + m;
            begin = place.end;
            let (mut first, mut second) = (0.0, 0.0);
            for (label, value) in labels[place.clone()].iter().zip(&values[place]) {
                if *label == 0 {
                    first += value;
                } else {
                    second += value;
                }
            }
            sum += weight(size) * (second / *m as f64 - first / *n as f64);
        }
        sum / total
    };
    let mut lines = Vec::new();
    let all = Relabellings::within(&sizes, effort, |labels| {
        let of_levels = shift(labels, &centred);
        lines.push((of_levels, shift(labels, &moved)));
        of_levels.abs()
    });
    let (observed, _) = *lines.first()?;
    let estimate = Estimate {
        value: observed,
        interval: not_rejected(observed, &lines),
    };
    Some((all.test(), estimate))
}

/// The shifts that the test does not reject, from the shift A of the levels and B of what is moved under each labelling; none
/// where the most extreme labellings are too large a share to reject any.
fn not_rejected(observed: f64, lines: &[(f64, f64)]) -> Option<Interval> {
    let largest = lines.iter().map(|(a, _)| a.abs()).fold(0.0, f64::max);
    // How far the shift may be from the observed one until this labelling is less extreme: the δ > 0 at which |c − δb| = δ.
    let reach = |c: f64, b: f64| {
        let (size, slope) = if c >= 0.0 { (c, 1.0 + b) } else { (-c, 1.0 - b) };
        // As large as the observed one at every δ: the observed labelling itself, and its mirror image.
        if (1.0 - b.abs()) < EQUAL && size <= EQUAL * largest {
            return f64::INFINITY;
        }
        size / slope
    };
    let beyond = ((1.0 - CONFIDENCE) * lines.len() as f64 + EQUAL).floor() as usize;
    let limit = |side: f64| {
        let mut reaches: Vec<f64> = lines
            .iter()
            .map(|(a, b)| reach(a - observed * b, side * b))
            .collect();
        reaches.sort_by(|a, b| b.total_cmp(a));
        let limit = *reaches.get(beyond)?;
        limit.is_finite().then_some(observed + side * limit)
    };
    Some(Interval {
        low: limit(-1.0)?,
        high: limit(1.0)?,
        confidence: CONFIDENCE,
    })
}

/// Numbers around one that differ by less are equal but for rounding.
const EQUAL: f64 = 1e-9;

/// Twice one labelling where the mirror image of the most extreme one is as extreme, else once; of those that are drawn, the
/// observed one.
fn smallest_p(strata: &[Stratum], test: &PermutationTest) -> f64 {
    let is_even = strata.iter().all(|stratum| stratum.n == stratum.m);
    let all: f64 = strata.iter().map(|it| labellings(&[it.n, it.m])).product();
    let of_all = (if is_even { 2.0 } else { 1.0 } / all).min(1.0);
    match test.coverage {
        Coverage::Exact => of_all,
        Coverage::MonteCarlo => of_all.max(1.0 / test.labellings as f64),
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const EFFORT: Effort = Effort::of_a_report(1);

    fn stratum(name: &str, a: &[f64], b: &[f64]) -> Levels {
        Levels {
            stratum: Stratum {
                name: name.to_owned(),
                a: vec!["a".to_owned()],
                b: vec!["b".to_owned()],
                n: a.len(),
                m: b.len(),
                shift: mean(b) - mean(a),
            },
            levels: [a, b].concat(),
        }
    }

    fn close(left: f64, right: f64) {
        assert!((left - right).abs() < 1e-8, "{left} {right}");
    }

    // Expected: reports/statistics/tests/data/strata.py, by enumeration of all 700 labellings and a search for the limits.
    #[test]
    fn two_strata_are_one_test_and_its_interval_is_what_it_does_not_reject() {
        let strata = [
            stratum(
                "i7 osx",
                &[0.120, 0.121, 0.1225, 0.124],
                &[0.118, 0.1195, 0.121, 0.1205],
            ),
            stratum("arm64 ubuntu", &[0.110, 0.112], &[0.1085, 0.1105, 0.109]),
        ];
        let (test, shift) = stratified(&strata, EFFORT).unwrap();
        assert_eq!((test.coverage, test.labellings), (Coverage::Exact, 700));
        close(test.p, 27.0 / 700.0);
        close(shift.value, -1.953_125e-3);
        let interval = shift.interval.unwrap();
        close(interval.low, -3.75e-3);
        close(interval.high, -0.208_333_33e-3);
        let strata = strata.map(|it| it.stratum);
        assert_eq!(smallest_p(&strata, &test), 1.0 / 700.0);
        close(strata[0].shift, -2.125e-3);
    }

    #[test]
    fn one_stratum_is_the_test_of_two_scenarios() {
        let (a, b) = ([0.236, 0.241, 0.239, 0.240], [0.238, 0.2405, 0.2425, 0.244]);
        let (test, _) = stratified(&[stratum("", &a, &b)], EFFORT).unwrap();
        let own = statistics::permutation::mean_difference(&a, &b, EFFORT).unwrap();
        close(test.p, own.p);
        let even = [stratum("", &a, &b).stratum];
        assert_eq!(smallest_p(&even, &test), 2.0 / 70.0);
    }

    #[test]
    fn what_the_strata_differ_by_is_no_part_of_the_shift() {
        let near = [
            stratum("x", &[1.0, 2.0], &[2.0, 3.0]),
            stratum("y", &[1.5, 2.5], &[2.0, 4.0]),
        ];
        let far = [
            stratum("x", &[1.0, 2.0], &[2.0, 3.0]),
            stratum("y", &[91.5, 92.5], &[92.0, 94.0]),
        ];
        let [near, far] = [near, far].map(|strata| stratified(&strata, EFFORT).unwrap());
        close(near.0.p, far.0.p);
        close(near.1.value, far.1.value);
    }

    #[test]
    fn a_shift_of_nothing_and_too_few_windows_have_no_interval() {
        let (test, shift) = stratified(&[stratum("", &[1.0; 3], &[1.0; 3])], EFFORT).unwrap();
        assert_eq!((test.p, shift.value, shift.interval), (1.0, 0.0, None));
        let (test, shift) = stratified(&[stratum("", &[1.0, 2.0], &[8.0, 9.0])], EFFORT).unwrap();
        close(test.p, 2.0 / 6.0);
        assert_eq!(shift.interval, None);
        assert_eq!(stratified(&[], EFFORT), None);
    }

    #[test]
    fn many_labellings_are_drawn_and_say_so() {
        let levels = |from: f64| Vec::from_iter((0..12).map(|it| from + f64::from(it)));
        let strata = [
            stratum("", &levels(0.0), &levels(9.0)),
            stratum("", &levels(1.0), &levels(10.0)),
        ];
        let (test, shift) = stratified(&strata, EFFORT).unwrap();
        assert_eq!((test.coverage, test.labellings), (Coverage::MonteCarlo, 10_000));
        assert!(test.p < 0.001, "{}", test.p);
        let interval = shift.interval.unwrap();
        assert!(interval.low > 6.0 && interval.low < 9.0 && interval.high > 9.0 && interval.high < 12.0);
        assert_eq!(smallest_p(&strata.map(|it| it.stratum), &test), 1e-4);
    }
}
