//! Two scenarios compared with the environment as the unit, and what windows, environments and values add to the variance. Only of
//! runs that made a scenario's environment anew in several rounds (`workload.environments`). The main type is [`Replicates`].

use std::collections::BTreeMap;

use record::report_settings::ReportSettings;
use statistics::{
    dependence::Dependence,
    effect::{self, Interval, median},
    multiplicity::holm,
    permutation,
    power::Spread,
    relabelling::{Effort, PermutationTest},
    replicates::{self, Rounds},
    variance_components::{Components, Costs, Leaf, Nested, NextHour},
};

use crate::{
    analysis::{contrast::Verdict, sample::Sample},
    input::run::{Run, ScenarioRun},
};

/// What a run shows whose scenarios have several environments each.
#[derive(Debug, Clone, PartialEq)]
pub struct Replicates {
    /// The pairs of the family with two environments in common or more.
    pub pairs: Vec<EnvironmentContrast>,
    /// Letters of the pairs of the family without.
    pub without: Vec<(String, String)>,
    /// The variance of each scenario with windows that count, in the order of the plan.
    pub scenarios: Vec<ScenarioVariance>,
    /// That of all scenarios together, each around its own mean; none without one.
    pub together: Option<Components>,
    /// Where the next hour of measuring goes furthest; none where that is not known.
    pub next_hour: Option<Advice>,
}

/// A pair of scenarios.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentContrast {
    /// Letter of the first scenario.
    pub a: String,
    /// Letter of the second.
    pub b: String,
    /// Rounds in which both have a window that counts; of a pair that was not interleaved, those of the scenario that has fewer.
    pub rounds: usize,
    /// Whether their environments were made in the same rounds of one run, which is what makes p exact.
    pub is_interleaved: bool,
    /// The test of the environments' means.
    pub test: PermutationTest,
    /// The smallest p that so many environments can reach.
    pub smallest_p: f64,
    /// p adjusted by Holm's method.
    pub p_holm: f64,
    /// The mean shift from the first to the second.
    pub shift: f64,
    /// Its interval, for all pairs of the family together at 1 − α where so many rounds can, and else with what they can; none for
    /// pairs that were not interleaved.
    pub interval: Option<Interval>,
    /// Whether the interval has the confidence that was asked for.
    pub is_simultaneous: bool,
    /// What may be said.
    pub verdict: Verdict,
}

/// What adds to the variance of a scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioVariance {
    /// Its letter.
    pub id: String,
    /// Environments with a window that counts.
    pub environments: usize,
    /// Windows that count.
    pub windows: usize,
    /// In the square of the unit: values within windows, windows within environments, environments.
    pub components: Components,
}

/// Where the next hour of measuring goes furthest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Advice {
    /// How far.
    pub next: NextHour,
    /// What a window and an environment cost.
    pub costs: Costs,
    /// Windows in an environment, as planned.
    pub windows: u32,
}

/// The levels of a scenario's windows, by round.
type Levels = BTreeMap<u32, Vec<f64>>;

impl Replicates {
    /// Those of a run, for the pairs of letters that belong to the family; none where each scenario has one environment. The margin
    /// is in the unit of the samples.
    #[must_use]
    pub fn of(
        run: &Run,
        pairs: &[(impl AsRef<str>, impl AsRef<str>)],
        samples: &[Sample],
        settings: &ReportSettings,
        equivalence_margin: Option<f64>,
    ) -> Option<Self> {
        let is_replicated = |scenario: &ScenarioRun| scenario.planned.settings.environments > 1;
        if !run.scenarios.iter().any(is_replicated) {
            return None;
        }
        let levels = levels(run, samples);
        let (mut tested, mut without) = (Vec::new(), Vec::new());
        for (a, b) in pairs {
            let (a, b) = (a.as_ref(), b.as_ref());
            match Tested::of(run, &levels, a, b, settings) {
                Some(pair) => tested.push(pair),
                None => without.push((a.to_owned(), b.to_owned())),
            }
        }
        let trees: Vec<(ScenarioVariance, Nested)> = run
            .scenarios
            .iter()
            .filter_map(|scenario| variance(scenario, samples))
            .collect();
        let (scenarios, trees): (Vec<_>, Vec<_>) = trees.into_iter().unzip();
        let together = Components::of(&trees);
        Some(Self {
            pairs: judged(tested, settings, equivalence_margin),
            without,
            next_hour: together
                .as_ref()
                .and_then(|together| advice(run, &scenarios, together)),
            scenarios,
            together,
        })
    }

    /// The contrast of two scenarios, in either order.
    #[must_use]
    pub fn find(&self, a: &str, b: &str) -> Option<&EnvironmentContrast> {
        self.pairs
            .iter()
            .find(|pair| (pair.a == a && pair.b == b) || (pair.a == b && pair.b == a))
    }
}

/// The spread of environment means within a round, around what their scenario and their round add; none of a run without two
/// scenarios with environments in two rounds in common. Rounds in which a scenario has no window that counts are left out.
#[must_use]
pub fn spread_of_environments(run: &Run, samples: &[Sample]) -> Option<Spread> {
    let levels = levels(run, samples);
    let rounds = levels.values().next()?.keys();
    let is_whole = |round: &&u32| levels.values().all(|of_one| of_one.contains_key(round));
    let whole: Vec<&u32> = rounds.filter(is_whole).collect();
    let means = |of_one: &Levels| {
        whole
            .iter()
            .filter_map(|round| effect::level(&of_one[round]))
            .collect()
    };
    let table: Vec<Vec<f64>> = levels.values().map(means).collect();
    Spread::of_table(&table)
}

/// Of each scenario, by letter.
fn levels<'r>(run: &'r Run, samples: &[Sample]) -> BTreeMap<&'r str, Levels> {
    let mut all: BTreeMap<&str, Levels> = BTreeMap::new();
    for scenario in &run.scenarios {
        let planned = &scenario.planned;
        let of_it = samples.iter().filter(|sample| sample.scenario == planned.id);
        for (sample, level) in of_it.filter_map(|sample| Some((sample, effect::level(&sample.values)?))) {
            let rounds = all.entry(&planned.id).or_default();
            let round = planned.settings.round_of(sample.window);
            rounds.entry(round).or_default().push(level);
        }
    }
    all
}

/// Whether two scenarios were measured in one run, whose rounds they share.
fn are_interleaved(run: &Run, a: &str, b: &str) -> bool {
    let has = |letters: &[String], letter: &str| letters.iter().any(|it| it == letter);
    let mut parts = run.parts.iter();
    parts.any(|part| has(&part.scenarios, a) && has(&part.scenarios, b))
}

/// A pair by itself, before the family is counted.
struct Tested<'a> {
    a: &'a str,
    b: &'a str,
    rounds: usize,
    test: PermutationTest,
    smallest_p: f64,
    shift: f64,
    /// What an interval is made of.
    interleaved: Option<Rounds>,
}

impl<'a> Tested<'a> {
    /// None where either has no window that counts, or they have no round in common.
    fn of(
        run: &Run,
        levels: &BTreeMap<&'a str, Levels>,
        a: &str,
        b: &str,
        settings: &ReportSettings,
    ) -> Option<Self> {
        let effort = Effort::of_a_report(settings.seed);
        let ((&a, of_a), (&b, of_b)) = (levels.get_key_value(a)?, levels.get_key_value(b)?);
        if are_interleaved(run, a, b) {
            let both = of_a.iter().map(|(round, levels)| {
                (
                    effect::level(levels),
                    of_b.get(round).and_then(|levels| effect::level(levels)),
                )
            });
            let rounds = Rounds::of(both)?;
            return Some(Self {
                a,
                b,
                rounds: rounds.count(),
                test: rounds.test(effort),
                smallest_p: replicates::reachable_p(rounds.count(), effort),
                shift: rounds.shift(),
                interleaved: Some(rounds),
            });
        }
        let means = |levels: &Levels| -> Vec<f64> {
            levels
                .values()
                .filter_map(|levels| effect::level(levels))
                .collect()
        };
        let (of_a, of_b) = (means(of_a), means(of_b));
        Some(Self {
            a,
            b,
            rounds: of_a.len().min(of_b.len()),
            test: permutation::mean_difference(&of_a, &of_b, effort)?,
            smallest_p: permutation::reachable_p(of_a.len(), of_b.len(), effort),
            shift: effect::level(&of_b)? - effect::level(&of_a)?,
            interleaved: None,
        })
    }
}

fn judged(
    tested: Vec<Tested<'_>>,
    settings: &ReportSettings,
    equivalence_margin: Option<f64>,
) -> Vec<EnvironmentContrast> {
    let raw: Vec<f64> = tested.iter().map(|pair| pair.test.p).collect();
    let adjusted = holm(&raw);
    let effort = Effort::of_a_report(settings.seed);
    let asked = 1.0 - settings.alpha / tested.len().max(1) as f64;
    let judge = |(at, (pair, p_holm)): (usize, (Tested<'_>, f64))| {
        let interval = pair
            .interleaved
            .as_ref()
            .and_then(|rounds| rounds.interval(asked, effort));
        let is_simultaneous = interval.is_some_and(|interval| interval.confidence >= asked - 1e-12);
        // What the whole procedure could reach, had this pair been as far apart as can be and all others as they are.
        let mut at_best = raw.clone();
        if let Some(p) = at_best.get_mut(at) {
            *p = pair.smallest_p;
        }
        let can_reach = holm(&at_best).get(at).is_some_and(|p| *p < settings.alpha);
        EnvironmentContrast {
            verdict: verdict(
                p_holm,
                can_reach,
                interval.filter(|_| is_simultaneous),
                settings.alpha,
                equivalence_margin,
            ),
            a: pair.a.to_owned(),
            b: pair.b.to_owned(),
            rounds: pair.rounds,
            is_interleaved: pair.interleaved.is_some(),
            test: pair.test,
            smallest_p: pair.smallest_p,
            p_holm,
            shift: pair.shift,
            interval,
            is_simultaneous,
        }
    };
    let family = tested.into_iter().zip(adjusted).enumerate();
    family.map(judge).collect()
}

/// By Holm's p, and by an interval that holds for all pairs together: what is said of size has the level α in the family too.
fn verdict(
    p_holm: f64,
    can_reach: bool,
    shift: Option<Interval>,
    alpha: f64,
    margin: Option<f64>,
) -> Verdict {
    let within = |margin: f64| shift.is_some_and(|shift| shift.low > -margin && shift.high < margin);
    let beyond = |margin: f64| shift.is_some_and(|shift| shift.low > margin || shift.high < -margin);
    match margin {
        Some(margin) if within(margin) => Verdict::Immaterial,
        Some(margin) if p_holm < alpha && beyond(margin) => Verdict::DifferMaterially,
        Some(_) if p_holm < alpha => Verdict::DifferByUnknown,
        None if p_holm < alpha => Verdict::Differ,
        _ if can_reach => Verdict::NotToldApart,
        _ => Verdict::CannotTell,
    }
}

/// The variance of a scenario, and what it was made of; none without two values in a window that counts.
fn variance(scenario: &ScenarioRun, samples: &[Sample]) -> Option<(ScenarioVariance, Nested)> {
    let planned = &scenario.planned;
    let of_it = || samples.iter().filter(|sample| sample.scenario == planned.id);
    let windows: Vec<&[f64]> = of_it().map(|sample| sample.values.as_slice()).collect();
    // Values that follow each other in a window are worth fewer than they are.
    let time = Dependence::of(&windows).map_or(1.0, |dependence| dependence.time);
    let mut rounds: BTreeMap<u32, Vec<Nested>> = BTreeMap::new();
    for sample in of_it() {
        if let Some(leaf) = Leaf::of(&sample.values, time) {
            let round = planned.settings.round_of(sample.window);
            rounds.entry(round).or_default().push(Nested::Leaf(leaf));
        }
    }
    if rounds.is_empty() {
        return None;
    }
    let environments = rounds.len();
    let tree = Nested::Group(rounds.into_values().map(Nested::Group).collect());
    let found = ScenarioVariance {
        id: planned.id.clone(),
        environments,
        windows: windows.len(),
        components: Components::of(std::slice::from_ref(&tree))?,
    };
    Some((found, tree))
}

/// By the variance of all scenarios and what their environments took.
fn advice(run: &Run, scenarios: &[ScenarioVariance], together: &Components) -> Option<Advice> {
    let settings = &run.scenarios.first()?.planned.settings;
    let overheads: Vec<f64> = run
        .scenarios
        .iter()
        .flat_map(|it| it.overheads_s.iter().copied())
        .collect();
    let costs = Costs {
        window_s: settings.window.as_secs_f64(),
        environment_s: median(overheads)?,
    };
    let all: usize = scenarios.iter().map(|scenario| scenario.environments).sum();
    let environments = all as f64 / scenarios.len().max(1) as f64;
    let (windows, between_environments) = (together.level(2)?.of_means, together.level(3)?.variance);
    let per_environment = f64::from(settings.windows);
    Some(Advice {
        next: NextHour::of(
            windows,
            between_environments,
            environments,
            per_environment,
            costs,
        )?,
        costs,
        windows: settings.windows,
    })
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const fn interval(low: f64, high: f64) -> Option<Interval> {
        Some(Interval {
            low,
            high,
            confidence: 0.999,
        })
    }

    #[rstest]
    #[case::reached(1e-4, true, interval(0.001, 0.003), None, Verdict::Differ)]
    #[case::missed(0.2, true, interval(-0.001, 0.003), None, Verdict::NotToldApart)]
    #[case::hopeless(0.2, false, interval(-0.001, 0.003), None, Verdict::CannotTell)]
    #[case::matters(1e-4, true, interval(0.003, 0.005), Some(0.002), Verdict::DifferMaterially)]
    #[case::open(1e-4, true, interval(0.001, 0.005), Some(0.002), Verdict::DifferByUnknown)]
    #[case::small(0.2, true, interval(-0.001, 0.001), Some(0.002), Verdict::Immaterial)]
    #[case::of_less_confidence(0.2, false, None, Some(0.002), Verdict::CannotTell)]
    fn what_is_said_of_size_is_said_by_an_interval_for_the_whole_family(
        #[case] p_holm: f64,
        #[case] can_reach: bool,
        #[case] shift: Option<Interval>,
        #[case] margin: Option<f64>,
        #[case] expected: Verdict,
    ) {
        assert_eq!(verdict(p_holm, can_reach, shift, 0.001, margin), expected);
    }

    fn pair<'a>(a: &'a str, b: &'a str, differences: &[f64]) -> Tested<'a> {
        let rounds = Rounds::of(differences.iter().map(|it| (Some(0.0), Some(*it)))).unwrap();
        Tested {
            a,
            b,
            rounds: rounds.count(),
            test: rounds.test(Effort::of_a_report(1)),
            smallest_p: replicates::reachable_p(rounds.count(), Effort::of_a_report(1)),
            shift: rounds.shift(),
            interleaved: Some(rounds),
        }
    }

    #[test]
    fn a_pair_that_a_later_step_of_holms_could_reject_is_not_hopeless() {
        // Six rounds reach 1/32, which twice is above .05: only once the other pair is rejected.
        let clear: Vec<f64> = (1..=10).map(f64::from).collect();
        let near = [1.0, 2.0, 3.0, 4.0, 5.0, -0.5];
        let settings = ReportSettings {
            alpha: 0.05,
            ..ReportSettings::default()
        };
        let with_clear = judged(
            vec![pair("a", "b", &clear), pair("a", "c", &near)],
            &settings,
            None,
        );
        assert_eq!(with_clear[0].verdict, Verdict::Differ);
        assert_eq!(with_clear[1].verdict, Verdict::NotToldApart);
        let with_another = judged(
            vec![pair("a", "b", &near), pair("a", "c", &near)],
            &settings,
            None,
        );
        assert_eq!(with_another[0].verdict, Verdict::CannotTell);
    }
}
