//! The tests of each pair of a family, and how much work they may take.

use record::report_settings::ReportSettings;
use statistics::{
    block_permutation::BlockCount,
    effect::{self, Effect, Interval},
    mean_shift::MeanShift,
    permutation::{self, MaxT},
    relabelling::{Coverage, Effort, PermutationTest},
    shape::ShapeTests,
};

use crate::analysis::sample::Sample;

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

pub(super) fn simultaneous_confidence(pairs: usize, alpha: f64) -> f64 {
    1.0 - alpha / pairs.max(1) as f64
}

/// A scenario with a window that counts and has values.
pub(super) struct Scenario<'a> {
    pub(super) letter: &'a str,
    /// The values of each such window.
    pub(super) windows: Vec<&'a [f64]>,
    /// One for each of `windows`.
    pub(super) levels: Vec<f64>,
}

impl<'a> Scenario<'a> {
    /// In the order of the samples.
    pub(super) fn all(samples: &'a [Sample]) -> Vec<Self> {
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
pub(super) struct Work {
    pub(super) effort: Effort,
    /// Pairs in the family.
    pub(super) pairs: usize,
    /// Values of the longest window.
    pub(super) longest: usize,
    /// Whether blocks are permuted.
    pub(super) with_blocks: bool,
    /// The level that the smallest p of the family must reach.
    pub(super) alpha: f64,
}

impl Work {
    pub(super) fn of(pairs: &[(&Scenario<'_>, &Scenario<'_>)], settings: &ReportSettings) -> Self {
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
    pub(super) fn of_shifts(&self) -> Effort {
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
pub(super) struct Tested<'a> {
    pub(super) a: &'a Scenario<'a>,
    pub(super) b: &'a Scenario<'a>,
    pub(super) level: PermutationTest,
    pub(super) shape: ShapeTests,
    pub(super) blocks: Option<BlockCount>,
    pub(super) p_shift: Option<f64>,
    /// The draws of that test; none if all its labellings were looked at.
    pub(super) shift_draws: Option<u64>,
    pub(super) simultaneous: Option<Interval>,
    pub(super) effect: Effect,
}

impl<'a> Tested<'a> {
    /// None if a side has nothing to test.
    pub(super) fn of(
        a: &'a Scenario<'a>,
        b: &'a Scenario<'a>,
        work: &Work,
        settings: &ReportSettings,
    ) -> Option<Self> {
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
    pub(super) fn too_few_draws(&self, work: &Work) -> Option<u64> {
        self.shift_draws
            .filter(|draws| work.pairs as f64 / *draws as f64 >= work.alpha)
    }

    /// What its p can be at the least.
    pub(super) fn smallest_p(&self, work: &Work) -> f64 {
        permutation::reachable_p(self.a.levels.len(), self.b.levels.len(), work.of_levels())
    }
}

/// The maximum-statistic adjustment of the pairs that were tested. Only what takes part in one is permuted.
pub(super) fn max_t(scenarios: &[Scenario<'_>], tested: &[Tested<'_>], effort: Effort) -> Option<MaxT> {
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
