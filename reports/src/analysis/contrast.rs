//! Two scenarios compared with the window as the unit: whether their windows differ in level, by how much, and what may
//! be said of it after all pairs of the family are counted. It stands beside the paper's counts. The main type is
//! [`Contrasts`].

use record::{family::Family, report_settings::ReportSettings};
use statistics::{
    block_permutation::BlockCount,
    effect::{self, Effect, Interval},
    mean_shift::MeanShift,
    multiplicity::{benjamini_yekutieli, holm},
    permutation::{self, MaxT},
    relabelling::{Coverage, Effort, PermutationTest},
    serial::SerialDependence,
    shape::ShapeTests,
};

use crate::analysis::sample::Sample;

/// A declared family of pairs, compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Contrasts {
    /// What was declared.
    pub family: Family,
    /// One for each pair with a window on each side that counts.
    pub pairs: Vec<Contrast>,
    /// Letters of the pairs without.
    pub without_data: Vec<(String, String)>,
    /// The draws that each pair's test of the shift has, if the family is so large that so few cannot reach α.
    pub too_few_draws: Option<u64>,
    /// How the family's windows were dealt; none without a pair.
    pub max_t: Option<MaxT>,
    /// How the windows of a scenario depend on their neighbours in time; none where no scenario has three.
    pub serial: Option<SerialDependence>,
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
    /// p of equal mean levels, whatever the spreads: the larger one of the studentised permutation test's and Welch's. None where
    /// a scenario has a single window.
    pub p_shift: Option<f64>,
    /// The same, adjusted by Holm's method.
    pub p_shift_holm: Option<f64>,
    /// How large the difference is, from the first to the second.
    pub effect: Effect,
    /// The shifts of the mean level that are not rejected, m: an interval that holds for all pairs of the family at once, with
    /// [`Contrasts::simultaneous_confidence`] in each. None where so few windows cannot have it.
    pub simultaneous: Option<Interval>,
    /// p adjusted by Holm's method.
    pub p_holm: f64,
    /// p adjusted by Benjamini and Yekutieli's method.
    pub p_benjamini_yekutieli: f64,
    /// p adjusted by the largest statistic of the family.
    pub p_max_t: f64,
    /// What may be said.
    pub verdict: Verdict,
}

/// What may be said of a pair at the level α and with the equivalence margin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// So few windows in such a family cannot reach α, whatever they are.
    CannotTell,
    /// α could have been reached, and was not. Not the same as no difference.
    NotToldApart,
    /// The simultaneous interval of the shift lies within the equivalence margin, whatever p is.
    Immaterial,
    /// Their mean levels differ; no equivalence margin was declared.
    Differ,
    /// Their levels differ, and the whole simultaneous interval of the shift lies beyond the margin.
    DifferMaterially,
    /// Their mean levels differ, and it is open whether by as much as the margin.
    DifferByUnknown,
    /// Their levels differ, and it is open whether in the mean or in how they spread.
    DifferLevelOpen,
}

/// What a verdict is made of.
#[derive(Debug, Clone, Copy)]
struct Evidence {
    /// Of equal distributions, by Holm's method.
    p_holm: f64,
    /// The smallest that it can be with these numbers of windows in the family.
    smallest_p_holm: f64,
    /// Of equal means, by Holm's method; none where it cannot be tested.
    p_shift_holm: Option<f64>,
    /// An interval of the shift that holds for all pairs at once.
    simultaneous: Option<Interval>,
}

impl Verdict {
    /// Statements that two scenarios differ are by Holm's p, and those on the margin by the simultaneous interval: in a family with
    /// any number of pairs the chance of an untrue statement of either kind is at most α.
    fn of(evidence: &Evidence, alpha: f64, limit: Option<f64>) -> Self {
        let interval = evidence.simultaneous;
        let within = |limit: f64| interval.is_some_and(|i| i.low > -limit && i.high < limit);
        let beyond = |limit: f64| interval.is_some_and(|i| i.low > limit || i.high < -limit);
        let differ = evidence.p_holm < alpha;
        let in_the_mean = evidence.p_shift_holm.is_some_and(|p| p < alpha);
        match limit {
            Some(limit) if within(limit) => Self::Immaterial,
            Some(limit) if differ && beyond(limit) => Self::DifferMaterially,
            _ if differ && !in_the_mean => Self::DifferLevelOpen,
            Some(_) if differ => Self::DifferByUnknown,
            None if differ => Self::Differ,
            _ if evidence.smallest_p_holm >= alpha => Self::CannotTell,
            _ => Self::NotToldApart,
        }
    }

    /// Whether the two are told apart, by whatever it is.
    #[must_use]
    pub const fn is_difference(self) -> bool {
        match self {
            Self::CannotTell | Self::NotToldApart | Self::Immaterial => false,
            Self::Differ | Self::DifferMaterially | Self::DifferByUnknown | Self::DifferLevelOpen => true,
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
            Self::DifferLevelOpen => "differ, level open",
        }
    }
}

/// Resamples and relabellings of all pairs together are bounded: some seconds.
const LABELLINGS: u64 = 100_000_000;
/// The same of the tests of shifts, each of which is looked for some hundred times.
const SHIFT_LABELLINGS: u64 = 20_000_000;
/// Those of one pair, which are held in memory: a hundred megabytes.
const MOST_SHIFT_DRAWS: u64 = 2_000_000;
/// The same of the tests that walk along all values, in values.
const VALUES_WALKED: u64 = 1_000_000_000;
/// Window pairs up to which blocks are permuted.
const MOST_BLOCK_PAIRS: usize = 2_000;

impl Contrasts {
    /// Compares the pairs of letters that belong to the family. The margin is in the unit of the samples.
    #[must_use]
    pub fn of(
        pairs: &[(impl AsRef<str>, impl AsRef<str>)],
        samples: &[Sample],
        settings: &ReportSettings,
        equivalence_margin: Option<f64>,
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
        let too_few_draws = tested.iter().filter_map(|pair| pair.too_few_draws(&work)).min();
        let levels: Vec<&[f64]> = scenarios.iter().map(|it| it.levels.as_slice()).collect();
        Self {
            family: settings.family.clone(),
            pairs: adjusted(
                tested,
                max_t.as_ref(),
                &work,
                (settings.alpha, equivalence_margin),
            ),
            without_data,
            too_few_draws,
            max_t,
            serial: SerialDependence::of(&levels, settings.seed),
        }
    }

    /// The confidence of each simultaneous interval: by Bonferroni, so that all hold with 1 − α.
    #[must_use]
    pub fn simultaneous_confidence(&self, settings: &ReportSettings) -> f64 {
        simultaneous_confidence(self.pairs.len(), settings.alpha)
    }

    /// The contrast of two scenarios, in either order.
    #[must_use]
    pub fn find(&self, a: &str, b: &str) -> Option<&Contrast> {
        self.pairs
            .iter()
            .find(|pair| (pair.a == a && pair.b == b) || (pair.a == b && pair.b == a))
    }
}

fn simultaneous_confidence(pairs: usize, alpha: f64) -> f64 {
    1.0 - alpha / pairs.max(1) as f64
}

/// A scenario with a window that counts and has values.
struct Scenario<'a> {
    letter: &'a str,
    /// The values of each such window.
    windows: Vec<&'a [f64]>,
    /// One for each of `windows`.
    levels: Vec<f64>,
}

impl<'a> Scenario<'a> {
    /// In the order of the samples.
    fn all(samples: &'a [Sample]) -> Vec<Self> {
        let mut all: Vec<Self> = Vec::new();
        for sample in samples {
            let Some(level) = effect::level(&sample.values) else {
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
                scenario.windows.push(&sample.values);
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
    /// Whether blocks are permuted.
    with_blocks: bool,
    /// The level that the smallest p of the family must reach.
    alpha: f64,
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
            alpha: settings.alpha,
        }
    }

    /// With draws enough for Holm's first step, as long as there are not too many pairs for it.
    fn of_levels(&self) -> Effort {
        let pairs = self.pairs.max(1);
        self.effort
            .reaching(self.alpha / pairs as f64)
            .at_most(LABELLINGS / pairs as u64)
    }

    /// With draws enough for Holm's first step where those of levels are, or no pair of a large family could be told to differ.
    fn of_shifts(&self) -> Effort {
        let pairs = self.pairs.max(1);
        let needed = (2.0 * pairs as f64 / self.alpha).min(MOST_SHIFT_DRAWS as f64) as u64;
        let affordable = (SHIFT_LABELLINGS / pairs as u64).min(MOST_SHIFT_DRAWS);
        self.of_levels().at_most(needed.max(affordable))
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
    p_shift: Option<f64>,
    /// The draws of that test; none if all its labellings were looked at.
    shift_draws: Option<u64>,
    simultaneous: Option<Interval>,
    effect: Effect,
}

impl<'a> Tested<'a> {
    /// None if a side has nothing to test.
    fn of(a: &'a Scenario<'a>, b: &'a Scenario<'a>, work: &Work, settings: &ReportSettings) -> Option<Self> {
        let windows = a.windows.len() + b.windows.len();
        let shift = MeanShift::of(&a.levels, &b.levels, work.of_shifts());
        let confidence = simultaneous_confidence(work.pairs, settings.alpha);
        Some(Self {
            level: permutation::mean_difference(&a.levels, &b.levels, work.of_levels())?,
            shape: ShapeTests::of(&a.windows, &b.windows, work.of_values(windows))?,
            blocks: work
                .with_blocks
                .then(|| BlockCount::of(&a.windows, &b.windows, settings.alpha, settings.seed)),
            p_shift: shift.as_ref().map(|shift| shift.p(0.0)),
            shift_draws: shift
                .as_ref()
                .filter(|shift| shift.coverage == Coverage::MonteCarlo)
                .map(MeanShift::looked_at),
            simultaneous: shift.as_ref().and_then(|shift| shift.interval(confidence)),
            effect: Effect::of(&a.windows, &b.windows, shift.as_ref())?,
            a,
            b,
        })
    }

    /// The draws of the test of the shift, if so few cannot reach α by Holm, however far apart the pair is.
    fn too_few_draws(&self, work: &Work) -> Option<u64> {
        self.shift_draws
            .filter(|draws| work.pairs as f64 / *draws as f64 >= work.alpha)
    }

    /// What its p can be at the least.
    fn smallest_p(&self, work: &Work) -> f64 {
        permutation::reachable_p(self.a.levels.len(), self.b.levels.len(), work.of_levels())
    }
}

/// The maximum-statistic adjustment of the pairs that were tested. Only what takes part in one is permuted.
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

/// The p-values of a pair as adjusted in the family of all.
struct Adjusted {
    p_holm: f64,
    p_benjamini_yekutieli: f64,
    p_max_t: f64,
    /// Of no meaning for a pair without a test of the shift.
    p_shift_holm: f64,
    smallest_p_holm: f64,
}

/// Each pair with its p-values as adjusted in the family of all: every list here has one entry a pair.
fn adjusted(
    tested: Vec<Tested<'_>>,
    max_t: Option<&MaxT>,
    work: &Work,
    (alpha, equivalence_margin): (f64, Option<f64>),
) -> Vec<Contrast> {
    let of_each = |p: &dyn Fn(&Tested<'_>) -> f64| Vec::from_iter(tested.iter().map(p));
    let raw = of_each(&|pair| pair.level.p);
    let (by_holm, by_yekutieli) = (holm(&raw), benjamini_yekutieli(&raw));
    let by_max_t = max_t.map(|max_t| max_t.p.as_slice()).unwrap_or_default();
    let shifts = holm(&of_each(&|pair| pair.p_shift.unwrap_or(1.0)));
    // Holm's p is smallest where every p is.
    let smallest = holm(&of_each(&|pair| pair.smallest_p(work)));
    let adjusted = by_holm
        .into_iter()
        .zip(by_yekutieli)
        .zip(by_max_t)
        .zip(shifts)
        .zip(smallest)
        .map(
            |((((p_holm, p_benjamini_yekutieli), p_max_t), p_shift_holm), smallest_p_holm)| Adjusted {
                p_holm,
                p_benjamini_yekutieli,
                p_max_t: *p_max_t,
                p_shift_holm,
                smallest_p_holm,
            },
        );
    let pair = |(pair, adjusted): (Tested<'_>, Adjusted)| {
        let p_shift_holm = pair.p_shift.map(|_| adjusted.p_shift_holm);
        let evidence = Evidence {
            p_holm: adjusted.p_holm,
            smallest_p_holm: adjusted.smallest_p_holm,
            p_shift_holm,
            simultaneous: pair.simultaneous,
        };
        Contrast {
            a: pair.a.letter.to_owned(),
            b: pair.b.letter.to_owned(),
            n: pair.a.levels.len(),
            m: pair.b.levels.len(),
            p_holm: adjusted.p_holm,
            p_benjamini_yekutieli: adjusted.p_benjamini_yekutieli,
            p_max_t: adjusted.p_max_t,
            verdict: Verdict::of(&evidence, alpha, equivalence_margin),
            level: pair.level,
            shape: pair.shape,
            blocks: pair.blocks,
            p_shift: pair.p_shift,
            p_shift_holm,
            effect: pair.effect,
            simultaneous: pair.simultaneous,
        }
    };
    tested.into_iter().zip(adjusted).map(pair).collect()
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use record::quantity::Length;

    use super::*;

    fn margin(settings: &ReportSettings) -> Option<f64> {
        settings.equivalence_margin.map(Length::metres)
    }

    fn sample(scenario: &str, window: u32, values: &[f64]) -> Sample {
        Sample {
            scenario: scenario.to_owned(),
            window,
            first_value: 1,
            values: values.to_vec(),
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
        Contrasts::of(pairs, &samples, settings, margin(settings))
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

    /// Windows of one value each, at these levels.
    fn levels(scenario: &str, levels: &[f64]) -> Vec<Sample> {
        let windows = (1..).zip(levels);
        windows
            .map(|(window, level)| sample(scenario, window, &[*level]))
            .collect()
    }

    // a/b with 4 : 4 windows can reach 2/70 and a/c with 4 : 8 1/495. Holm asks the larger of them for no more than α once the smaller
    // one is rejected. Until version 0.1 a/b "differ" where they are wholly apart, and else "cannot" be told.
    #[rstest]
    #[case::apart(0.5, Verdict::Differ)]
    #[case::one_place_off(0.25, Verdict::NotToldApart)]
    fn what_holms_procedure_can_reach_is_not_out_of_reach(
        #[case] lowest_of_b: f64,
        #[case] verdict: Verdict,
    ) {
        let settings = ReportSettings {
            alpha: 0.05,
            ..ReportSettings::default()
        };
        let samples = [
            levels("a", &[0.10, 0.11, 0.12, 0.30]),
            levels("b", &[lowest_of_b, 0.61, 0.72, 0.83]),
            levels("c", &[0.90, 0.91, 0.92, 0.93, 0.94, 0.95, 0.96, 0.97]),
        ]
        .concat();
        let contrasts = Contrasts::of(&[("a", "b"), ("a", "c")], &samples, &settings, margin(&settings));
        assert_eq!(contrasts.pairs[0].verdict, verdict, "{:?}", contrasts.pairs[0]);
        assert_eq!(contrasts.pairs[1].verdict, Verdict::Differ);
    }

    // Three windows that vary by 0.3 are all above ten that vary by 0.005: that is no rare chance where the means are equal, and until
    // version 0.1 was "differ".
    #[test]
    fn a_spread_is_not_taken_for_a_shift() {
        let settings = ReportSettings {
            alpha: 0.05,
            ..ReportSettings::default()
        };
        let samples = [
            levels("a", &[0.60, 0.90, 1.20]),
            levels(
                "b",
                &[0.50, 0.51, 0.49, 0.505, 0.495, 0.50, 0.502, 0.498, 0.507, 0.493],
            ),
        ]
        .concat();
        let contrasts = Contrasts::of(&[("a", "b")], &samples, &settings, margin(&settings));
        let pair = &contrasts.pairs[0];
        assert!(
            pair.p_holm < 0.01 && pair.p_shift_holm.unwrap() > 0.05,
            "{pair:?}"
        );
        assert_eq!(pair.verdict, Verdict::DifferLevelOpen);
    }

    // One pair of eight windows with an interval of 95 % just within the margin is immaterial by itself at 0.05; as one of 8 pairs it is
    // not, since one of 8 such intervals may well be wrong. Until version 0.1 both were.
    #[test]
    fn a_larger_family_has_longer_intervals() {
        let near: Vec<f64> = (0..8).map(|it| 0.2 + f64::from(it) * 1e-4).collect();
        let mut samples = Vec::new();
        for letter in ["a", "b", "c", "d", "e"] {
            samples.extend(levels(letter, &near));
        }
        let settings = ReportSettings {
            alpha: 0.05,
            equivalence_margin: Some(Length::from_millimetres(0.3)),
            ..ReportSettings::default()
        };
        let pairs = [
            ("a", "b"),
            ("a", "c"),
            ("a", "d"),
            ("a", "e"),
            ("b", "c"),
            ("b", "d"),
            ("b", "e"),
            ("c", "d"),
        ];
        let alone = Contrasts::of(&pairs[..1], &samples, &settings, margin(&settings));
        let together = Contrasts::of(&pairs, &samples, &settings, margin(&settings));
        assert_eq!(
            alone.pairs[0].verdict,
            Verdict::Immaterial,
            "{:?}",
            alone.pairs[0].simultaneous
        );
        assert_eq!(
            together.pairs[0].verdict,
            Verdict::NotToldApart,
            "{:?}",
            together.pairs[0].simultaneous
        );
        assert_eq!(alone.pairs[0].effect.shift, together.pairs[0].effect.shift);
        assert_eq!(together.simultaneous_confidence(&settings), 1.0 - 0.05 / 8.0);
        let strict = ReportSettings {
            alpha: 0.001,
            ..settings
        };
        assert_eq!(
            Contrasts::of(&pairs[..1], &samples, &strict, margin(&strict)).pairs[0].verdict,
            Verdict::NotToldApart
        );
    }

    #[test]
    fn windows_too_many_to_enumerate_are_drawn_often_enough_for_the_family() {
        let many = |from: f64| Vec::from_iter((0..12).map(|it| from + f64::from(it) * 1e-3));
        let samples = [
            levels("a", &many(0.1)),
            levels("b", &many(0.5)),
            levels("c", &many(0.9)),
        ]
        .concat();
        let contrasts = Contrasts::of(
            &[("a", "b"), ("a", "c"), ("b", "c")],
            &samples,
            &ReportSettings {
                alpha: 0.0001,
                ..ReportSettings::default()
            },
            None,
        );
        for pair in &contrasts.pairs {
            assert_eq!(pair.verdict, Verdict::Differ, "{pair:?}");
        }
    }

    #[rstest]
    #[case::more_than_nine_scenarios(45, 0.0001)]
    #[case::eighteen_scenarios(153, 0.001)]
    fn no_pair_of_a_large_family_is_left_open_for_want_of_draws(#[case] pairs: usize, #[case] alpha: f64) {
        let many = |from: f64| Vec::from_iter((0..12).map(|it| from + f64::from(it) * 1e-3));
        let work = Work {
            effort: Effort::of_a_report(0),
            pairs,
            longest: 60,
            with_blocks: false,
            alpha,
        };
        let shift = MeanShift::of(&many(0.1), &many(0.5), work.of_shifts()).unwrap();
        assert_eq!(shift.coverage, Coverage::MonteCarlo);
        assert!(shift.p(0.0) * (pairs as f64) < alpha, "{}", shift.p(0.0));
    }

    #[test]
    fn a_family_too_large_for_its_draws_is_known() {
        let few = |from: f64| Vec::from_iter((0..12).map(|it| from + f64::from(it) * 1e-3));
        let samples = [levels("a", &few(0.1)), levels("b", &few(0.5))].concat();
        let of = |alpha: f64| {
            let settings = ReportSettings {
                alpha,
                ..ReportSettings::default()
            };
            Contrasts::of(&[("a", "b")], &samples, &settings, margin(&settings)).too_few_draws
        };
        assert_eq!(of(0.001), None);
        // So few labellings there are not, but so few are drawn.
        assert!(of(1e-8).is_some());
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
        let alone = Contrasts::of(&[("a", "b")], &samples, &settings, margin(&settings));
        let beside = Contrasts::of(&[("x", "a"), ("a", "b")], &samples, &settings, margin(&settings));
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
    fn a_verdict_passes_both_the_level_and_the_equivalence_margin(
        #[case] p: f64,
        #[case] smallest: f64,
        #[case] shift: Interval,
        #[case] margin: Option<f64>,
        #[case] verdict: Verdict,
    ) {
        let margin = margin.map(|margin_mm| margin_mm / 1e3);
        let evidence = Evidence {
            p_holm: p,
            smallest_p_holm: smallest,
            p_shift_holm: Some(p),
            simultaneous: Some(shift),
        };
        assert_eq!(Verdict::of(&evidence, 0.001, margin), verdict);
    }

    #[test]
    fn without_an_interval_for_all_pairs_nothing_is_said_of_the_margin() {
        let contrasts = of(
            &[("a", "b")],
            &ReportSettings {
                equivalence_margin: Some(Length::from_millimetres(1000.0)),
                ..ReportSettings::default()
            },
        );
        let pair = &contrasts.pairs[0];
        assert!(pair.effect.shift.interval.is_some());
        assert_eq!((pair.simultaneous, pair.verdict), (None, Verdict::CannotTell));
    }
}
