//! Two scenarios compared with the window as the unit: whether their windows differ in level, by how much, and what may
//! be said of it after all pairs of the family are counted. It stands beside the paper's counts. The main type is
//! [`Contrasts`].

use record::{family::Family, quantity::Length, report_settings::ReportSettings};

use crate::{
    analysis::sample::Sample,
    statistics::{
        block_permutation::BlockCount,
        effect::{self, Effect, Interval},
        multiplicity::{benjamini_yekutieli, holm},
        permutation::{self, MaxT},
        relabelling::{Effort, PermutationTest},
        shape::ShapeTests,
    },
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
        let scenarios = Scenario::all(samples);
        let find = |letter: &str| scenarios.iter().find(|scenario| scenario.letter == letter);
        let (mut found, mut without_data) = (Vec::new(), Vec::new());
        for (a, b) in pairs {
            let (a, b) = (a.as_ref(), b.as_ref());
            match find(a).zip(find(b)) {
                Some(pair) => found.push(pair),
                None => without_data.push((a.to_owned(), b.to_owned())),
            }
        }
        let work = Work::of(&found, settings);
        let mut tested = Vec::new();
        for (a, b) in found {
            match Tested::of(a, b, &work, settings) {
                Some(pair) => tested.push(pair),
                None => without_data.push((a.letter.to_owned(), b.letter.to_owned())),
            }
        }
        let max_t = max_t(&scenarios, &tested, work.effort);
        Self {
            family: settings.family.clone(),
            pairs: adjusted(tested, max_t.as_ref(), settings),
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

/// A scenario with a window that counts and has values.
struct Scenario<'a> {
    letter: &'a str,
    /// The errors of each such window, in metres.
    windows: Vec<&'a [f64]>,
    /// One for each of `windows`.
    levels: Vec<f64>,
}

impl<'a> Scenario<'a> {
    /// In the order of the samples.
    fn all(samples: &'a [Sample]) -> Vec<Self> {
        let mut all: Vec<Self> = Vec::new();
        for sample in samples {
            let Some(level) = effect::level(&sample.errors_m) else {
                continue;
            };
            let at = all.iter().position(|scenario| scenario.letter == sample.scenario);
            let at = at.unwrap_or_else(|| {
                all.push(Self {
                    letter: &sample.scenario,
                    windows: Vec::new(),
                    levels: Vec::new(),
                });
                all.len() - 1
            });
            if let Some(scenario) = all.get_mut(at) {
                scenario.windows.push(&sample.errors_m);
                scenario.levels.push(level);
            }
        }
        all
    }
}

/// How much work each pair of a family may take.
struct Work {
    effort: Effort,
    /// Pairs in the family.
    pairs: usize,
    /// Values of the longest window.
    longest: usize,
    /// Whether blocks are dealt anew.
    with_blocks: bool,
}

impl Work {
    fn of(pairs: &[(&Scenario<'_>, &Scenario<'_>)], settings: &ReportSettings) -> Self {
        let windows = pairs.iter().flat_map(|(a, b)| a.windows.iter().chain(&b.windows));
        let window_pairs: usize = pairs.iter().map(|(a, b)| a.windows.len() * b.windows.len()).sum();
        Self {
            effort: Effort::of_a_report(settings.seed),
            pairs: pairs.len(),
            longest: windows.map(|window| window.len()).max().unwrap_or(0),
            with_blocks: window_pairs <= MOST_BLOCK_PAIRS,
        }
    }

    fn of_levels(&self) -> Effort {
        self.effort.at_most(LABELLINGS / self.pairs.max(1) as u64)
    }

    /// Of tests that walk along all values of that many windows.
    fn of_values(&self, windows: usize) -> Effort {
        let values = (self.longest * windows * self.pairs).max(1);
        self.effort.at_most(VALUES_WALKED / values as u64)
    }
}

/// A pair by itself, before the family is counted.
struct Tested<'a> {
    a: &'a Scenario<'a>,
    b: &'a Scenario<'a>,
    level: PermutationTest,
    shape: ShapeTests,
    blocks: Option<BlockCount>,
    effect: Effect,
}

impl<'a> Tested<'a> {
    /// None if a side has nothing to test.
    fn of(a: &'a Scenario<'a>, b: &'a Scenario<'a>, work: &Work, settings: &ReportSettings) -> Option<Self> {
        let windows = a.windows.len() + b.windows.len();
        Some(Self {
            level: permutation::mean_difference(&a.levels, &b.levels, work.of_levels())?,
            shape: ShapeTests::of(&a.windows, &b.windows, work.of_values(windows))?,
            blocks: work
                .with_blocks
                .then(|| BlockCount::of(&a.windows, &b.windows, settings.alpha, settings.seed)),
            effect: Effect::of(&a.windows, &b.windows, work.pairs, settings.seed)?,
            a,
            b,
        })
    }

    /// What its p could be at the least, after Holm's adjustment in a family of that many.
    fn smallest_p_holm(&self, pairs: usize) -> f64 {
        let smallest = permutation::smallest_p(self.a.levels.len(), self.b.levels.len());
        (smallest * pairs as f64).min(1.0)
    }
}

/// The maximum-statistic adjustment of the pairs that were tested. Only what takes part in one is dealt anew.
fn max_t(scenarios: &[Scenario<'_>], tested: &[Tested<'_>], effort: Effort) -> Option<MaxT> {
    let is_member = |letter: &str| {
        tested
            .iter()
            .any(|pair| pair.a.letter == letter || pair.b.letter == letter)
    };
    let members: Vec<&Scenario<'_>> = scenarios
        .iter()
        .filter(|scenario| is_member(scenario.letter))
        .collect();
    let place = |of: &Scenario<'_>| members.iter().position(|member| member.letter == of.letter);
    let places: Option<Vec<_>> = tested
        .iter()
        .map(|pair| place(pair.a).zip(place(pair.b)))
        .collect();
    let levels: Vec<&[f64]> = members.iter().map(|member| member.levels.as_slice()).collect();
    permutation::max_t(&levels, &places?, effort)
}

/// Each pair with its p-values as adjusted in the family of all: every list here has one entry a pair.
fn adjusted(tested: Vec<Tested<'_>>, max_t: Option<&MaxT>, settings: &ReportSettings) -> Vec<Contrast> {
    let raw: Vec<f64> = tested.iter().map(|pair| pair.level.p).collect();
    let (by_holm, by_yekutieli) = (holm(&raw), benjamini_yekutieli(&raw));
    let by_max_t = max_t.map(|max_t| max_t.p.as_slice()).unwrap_or_default();
    let adjusted = by_holm.into_iter().zip(by_yekutieli).zip(by_max_t);
    let pair =
        |(pair, ((p_holm, p_benjamini_yekutieli), p_max_t)): (Tested<'_>, ((f64, f64), &f64))| Contrast {
            a: pair.a.letter.to_owned(),
            b: pair.b.letter.to_owned(),
            n: pair.a.levels.len(),
            m: pair.b.levels.len(),
            p_holm,
            p_benjamini_yekutieli,
            p_max_t: *p_max_t,
            verdict: Verdict::of(
                p_holm,
                pair.smallest_p_holm(raw.len()),
                pair.effect.shift_m.interval,
                settings.alpha,
                settings.matters,
            ),
            level: pair.level,
            shape: pair.shape,
            blocks: pair.blocks,
            effect: pair.effect,
        };
    tested.into_iter().zip(adjusted).map(pair).collect()
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

    #[test]
    fn windows_without_values_cost_their_own_pair_and_no_other() {
        let mut samples = vec![sample("x", 1, &[])];
        for window in 1..=4 {
            let noise = f64::from(window) * 1e-4;
            samples.push(sample("a", window, &[0.2 + noise, 0.21]));
            samples.push(sample("b", window, &[0.25 + noise, 0.26]));
        }
        let settings = ReportSettings::default();
        let alone = Contrasts::of(&[("a", "b")], &samples, &settings);
        let beside = Contrasts::of(&[("x", "a"), ("a", "b")], &samples, &settings);
        assert_eq!(alone.pairs.len(), 1);
        assert_eq!(beside.pairs, alone.pairs);
        assert_eq!(beside.max_t, alone.max_t);
        assert_eq!(beside.without_data, [("x".to_owned(), "a".to_owned())]);
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
