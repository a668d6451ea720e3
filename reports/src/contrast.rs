//! Two scenarios compared with the window as the unit: whether their windows differ in level, by how much, and what may
//! be said of it after all pairs of the family are counted. It stands beside the paper's counts. The main type is
//! [`Contrasts`].

use workload::quantity::Length;

use crate::{
    block_permutation::BlockCount,
    effect::{self, Effect, Interval},
    family::Family,
    multiplicity::{benjamini_yekutieli, holm},
    permutation::{self, MaxT},
    relabelling::{Effort, PermutationTest},
    sample::Sample,
    settings::ReportSettings,
    shape::ShapeTests,
};

/// A declared family of pairs, compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Contrasts {
    /// What was declared.
    pub family: Family,
    /// One for each pair with a window on each side that counts.
    pub pairs: Vec<Contrast>,
    /// Letters of the pairs without.
    pub without_data: Vec<(String, String)>,
    /// How the family's labels were dealt anew; none without a pair.
    pub max_t: Option<MaxT>,
}

/// One pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Contrast {
    /// Letter of the first scenario.
    pub a: String,
    /// Letter of the second.
    pub b: String,
    /// Windows of the first that count.
    pub n: usize,
    /// Windows of the second that count.
    pub m: usize,
    /// The permutation test of the windows' levels.
    pub level: PermutationTest,
    /// The permutation tests of the windows' distributions.
    pub shape: ShapeTests,
    /// The count of rejected window pairs with blocks of neighbours in place of values; none for more pairs than are
    /// looked at.
    pub blocks: Option<BlockCount>,
    /// How large the difference is, from the first to the second.
    pub effect: Effect,
    /// p adjusted by Holm's method.
    pub p_holm: f64,
    /// p adjusted by Benjamini and Yekutieli's method.
    pub p_benjamini_yekutieli: f64,
    /// p adjusted by the largest statistic of the family.
    pub p_max_t: f64,
    /// What may be said.
    pub verdict: Verdict,
}

/// What may be said of a pair at the level α and with the shift that matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// So few windows in so large a family cannot reach α, whatever they are.
    CannotTell,
    /// α could have been reached, and was not. Not the same as no difference.
    NotToldApart,
    /// The shift's interval lies within what does not matter, whatever p is.
    Immaterial,
    /// They differ; no shift that matters was declared.
    Differ,
    /// They differ, and the whole interval lies beyond what matters.
    DifferMaterially,
    /// They differ, and it is open whether by as much as matters.
    DifferByUnknown,
}

impl Verdict {
    /// It is by Holm's p, which needs nothing of the other scenarios.
    fn of(
        p_holm: f64,
        smallest_p_holm: f64,
        shift: Option<Interval>,
        alpha: f64,
        matters: Option<Length>,
    ) -> Self {
        let limit = matters.map(Length::metres);
        let within = |limit: f64| {
            shift.is_some_and(|i| i.confidence >= effect::CONFIDENCE && i.low > -limit && i.high < limit)
        };
        let beyond = |limit: f64| shift.is_some_and(|i| i.low > limit || i.high < -limit);
        match limit {
            Some(limit) if within(limit) => Self::Immaterial,
            Some(limit) if p_holm < alpha && beyond(limit) => Self::DifferMaterially,
            Some(_) if p_holm < alpha => Self::DifferByUnknown,
            None if p_holm < alpha => Self::Differ,
            _ if smallest_p_holm >= alpha => Self::CannotTell,
            _ => Self::NotToldApart,
        }
    }

    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::CannotTell => "cannot tell",
            Self::NotToldApart => "not told apart",
            Self::Immaterial => "immaterial",
            Self::Differ => "differ",
            Self::DifferMaterially => "differ, matters",
            Self::DifferByUnknown => "differ, size open",
        }
    }
}

/// Resamples and relabellings of all pairs together are bounded: some seconds.
const LABELLINGS: u64 = 100_000_000;
/// The same of the tests that walk along all values, in values.
const VALUES_WALKED: u64 = 1_000_000_000;
/// Window pairs up to which blocks are dealt anew.
const MOST_BLOCK_PAIRS: usize = 2_000;

impl Contrasts {
    /// Compares the pairs of letters that belong to the family.
    #[must_use]
    pub fn of(
        pairs: &[(impl AsRef<str>, impl AsRef<str>)],
        samples: &[Sample],
        settings: &ReportSettings,
    ) -> Self {
        let mut scenarios: Vec<&str> = Vec::new();
        for sample in samples {
            if !scenarios.contains(&sample.scenario.as_str()) {
                scenarios.push(&sample.scenario);
            }
        }
        let windows: Vec<Vec<&[f64]>> = scenarios
            .iter()
            .map(|id| {
                let of_it = samples.iter().filter(|sample| sample.scenario == *id);
                of_it.map(|sample| sample.errors_m.as_slice()).collect()
            })
            .collect();
        let levels: Vec<Vec<f64>> = windows.iter().map(|windows| effect::levels(windows)).collect();
        let place = |id: &str| scenarios.iter().position(|scenario| *scenario == id);
        let mut found = Vec::new();
        let mut without_data = Vec::new();
        for (a, b) in pairs {
            let (a, b) = (a.as_ref(), b.as_ref());
            match place(a).zip(place(b)) {
                Some(places) => found.push(places),
                None => without_data.push((a.to_owned(), b.to_owned())),
            }
        }
        let effort = Effort::of_a_report(settings.seed);
        // Only what takes part in the family is dealt anew.
        let members: Vec<&[f64]> = levels.iter().map(Vec::as_slice).collect();
        let (members, renamed) = taking_part(&members, &found);
        let max_t = permutation::max_t(&members, &renamed, effort);
        let each = effort.at_most(LABELLINGS / found.len().max(1) as u64);
        let values = samples
            .iter()
            .map(|sample| sample.errors_m.len())
            .max()
            .unwrap_or(0);
        let walk = |a: &[&[f64]], b: &[&[f64]]| {
            let values = (values * (a.len() + b.len()) * found.len()).max(1);
            effort.at_most(VALUES_WALKED / values as u64)
        };
        let block_pairs: usize = found
            .iter()
            .filter_map(|(a, b)| Some(windows.get(*a)?.len() * windows.get(*b)?.len()))
            .sum();
        let tested: Vec<(PermutationTest, ShapeTests, Option<BlockCount>, Effect)> = found
            .iter()
            .filter_map(|(a, b)| {
                let test = permutation::mean_difference(levels.get(*a)?, levels.get(*b)?, each)?;
                let (a, b) = (windows.get(*a)?, windows.get(*b)?);
                let shape = ShapeTests::of(a, b, walk(a, b))?;
                let blocks = (block_pairs <= MOST_BLOCK_PAIRS)
                    .then(|| BlockCount::of(a, b, settings.alpha, settings.seed));
                let effect = Effect::of(a, b, found.len(), settings.seed)?;
                Some((test, shape, blocks, effect))
            })
            .collect();
        let raw: Vec<f64> = tested.iter().map(|(test, ..)| test.p).collect();
        let adjusted = holm(&raw).into_iter().zip(benjamini_yekutieli(&raw));
        let by_max_t = max_t.iter().flat_map(|max_t| max_t.p.iter().copied());
        let pairs = found
            .iter()
            .zip(tested)
            .zip(adjusted.zip(by_max_t))
            .filter_map(
                |(((a, b), (level, shape, blocks, effect)), ((p_holm, p_benjamini_yekutieli), p_max_t))| {
                    let smallest = permutation::smallest_p(levels.get(*a)?.len(), levels.get(*b)?.len());
                    let verdict = Verdict::of(
                        p_holm,
                        (smallest * raw.len() as f64).min(1.0),
                        effect.shift_m.interval,
                        settings.alpha,
                        settings.matters,
                    );
                    Some(Contrast {
                        a: (*scenarios.get(*a)?).to_owned(),
                        b: (*scenarios.get(*b)?).to_owned(),
                        n: levels.get(*a)?.len(),
                        m: levels.get(*b)?.len(),
                        level,
                        shape,
                        blocks,
                        effect,
                        p_holm,
                        p_benjamini_yekutieli,
                        p_max_t,
                        verdict,
                    })
                },
            )
            .collect();
        Self {
            family: settings.family.clone(),
            pairs,
            without_data,
            max_t,
        }
    }

    /// The contrast of two scenarios, in either order.
    #[must_use]
    pub fn find(&self, a: &str, b: &str) -> Option<&Contrast> {
        self.pairs
            .iter()
            .find(|pair| (pair.a == a && pair.b == b) || (pair.a == b && pair.b == a))
    }
}

/// The scenarios that a pair names, and the pairs by their places among those.
fn taking_part<'a>(levels: &[&'a [f64]], pairs: &[(usize, usize)]) -> (Vec<&'a [f64]>, Vec<(usize, usize)>) {
    let mut places: Vec<usize> = pairs.iter().flat_map(|(a, b)| [*a, *b]).collect();
    places.sort_unstable();
    places.dedup();
    let renamed = |at: usize| places.partition_point(|place| *place < at);
    (
        places
            .iter()
            .filter_map(|place| levels.get(*place).copied())
            .collect(),
        pairs.iter().map(|(a, b)| (renamed(*a), renamed(*b))).collect(),
    )
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn sample(scenario: &str, window: u32, errors_m: &[f64]) -> Sample {
        Sample {
            scenario: scenario.to_owned(),
            window,
            first_period: 1,
            errors_m: errors_m.to_vec(),
        }
    }

    fn of(pairs: &[(&str, &str)], settings: &ReportSettings) -> Contrasts {
        let mut samples = Vec::new();
        for window in 1..=4 {
            let noise = f64::from(window) * 1e-4;
            samples.push(sample("a", window, &[0.2 + noise, 0.21]));
            samples.push(sample("b", window, &[0.25 + noise, 0.26]));
            samples.push(sample("c", window, &[0.2 + noise, 0.2101]));
        }
        Contrasts::of(pairs, &samples, settings)
    }

    #[test]
    fn four_windows_cannot_reach_a_thousandth_and_the_verdict_says_so() {
        let contrasts = of(&[("a", "b")], &ReportSettings::default());
        let pair = contrasts.find("b", "a").unwrap();
        assert_eq!((pair.n, pair.m, pair.level.p), (4, 4, 2.0 / 70.0));
        assert_eq!(pair.verdict, Verdict::CannotTell);
        let lenient = ReportSettings {
            alpha: 0.05,
            ..ReportSettings::default()
        };
        assert_eq!(of(&[("a", "b")], &lenient).pairs[0].verdict, Verdict::Differ);
    }

    #[test]
    fn a_larger_family_asks_for_more() {
        let settings = ReportSettings {
            alpha: 0.05,
            ..ReportSettings::default()
        };
        let contrasts = of(&[("a", "b"), ("a", "c"), ("b", "c")], &settings);
        let pair = contrasts.find("a", "b").unwrap();
        assert!((pair.p_holm - 6.0 / 70.0).abs() < 1e-12, "{}", pair.p_holm);
        assert_eq!(pair.verdict, Verdict::CannotTell);
        assert!(pair.p_max_t < pair.p_holm && pair.p_max_t >= contrasts.max_t.unwrap().smallest_p);
    }

    #[test]
    fn a_pair_without_data_is_no_pair_without_change() {
        let contrasts = of(&[("a", "b"), ("a", "x")], &ReportSettings::default());
        assert_eq!(contrasts.pairs.len(), 1);
        assert_eq!(contrasts.without_data, [("a".to_owned(), "x".to_owned())]);
        let none = of(&[], &ReportSettings::default());
        assert!(none.pairs.is_empty() && none.max_t.is_none());
    }

    const NARROW: Interval = Interval {
        low: 0.0001,
        high: 0.0015,
        confidence: 0.97,
    };
    const WIDE: Interval = Interval {
        low: 0.0015,
        high: 0.004,
        confidence: 0.97,
    };
    const FAR: Interval = Interval {
        low: -0.009,
        high: -0.004,
        confidence: 0.97,
    };

    #[rstest]
    #[case::reached(0.0001, 1e-5, NARROW, None, Verdict::Differ)]
    #[case::missed(0.01, 1e-5, NARROW, None, Verdict::NotToldApart)]
    #[case::hopeless(0.01, 0.01, NARROW, None, Verdict::CannotTell)]
    #[case::small(0.0001, 1e-5, NARROW, Some(2.0), Verdict::Immaterial)]
    #[case::small_and_missed(0.01, 0.01, NARROW, Some(2.0), Verdict::Immaterial)]
    #[case::open(0.0001, 1e-5, WIDE, Some(2.0), Verdict::DifferByUnknown)]
    #[case::large(0.0001, 1e-5, FAR, Some(2.0), Verdict::DifferMaterially)]
    #[case::large_and_missed(0.01, 1e-5, FAR, Some(2.0), Verdict::NotToldApart)]
    fn a_verdict_passes_both_the_level_and_what_matters(
        #[case] p: f64,
        #[case] smallest: f64,
        #[case] shift: Interval,
        #[case] matters_mm: Option<f64>,
        #[case] verdict: Verdict,
    ) {
        let matters = matters_mm.map(Length::from_millimetres);
        assert_eq!(Verdict::of(p, smallest, Some(shift), 0.001, matters), verdict);
    }

    #[test]
    fn an_interval_of_less_confidence_never_makes_a_difference_immaterial() {
        let shift = Interval {
            confidence: 0.667,
            ..NARROW
        };
        let verdict = Verdict::of(0.3, 0.3, Some(shift), 0.001, Some(Length::from_millimetres(2.0)));
        assert_eq!(verdict, Verdict::CannotTell);
    }
}
