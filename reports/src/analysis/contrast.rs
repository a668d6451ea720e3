//! Two scenarios compared with the window as the unit: whether their windows differ in level, by how much, and what may
//! be said of it after all pairs of the family are counted. It stands beside the paper's counts. The main type is
//! [`Contrasts`].

mod tested;
mod verdict;

use record::{family::Family, report_settings::ReportSettings};
use statistics::{
    block_permutation::BlockCount,
    effect::{Effect, Interval},
    multiplicity::{benjamini_yekutieli, holm},
    permutation::MaxT,
    relabelling::PermutationTest,
    serial::SerialDependence,
    shape::ShapeTests,
};

pub use self::verdict::Verdict;
use self::{
    tested::{Scenario, Tested, Work, max_t, simultaneous_confidence},
    verdict::Evidence,
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
mod tests;
