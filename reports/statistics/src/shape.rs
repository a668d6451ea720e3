//! Permutation tests of whole distributions with the window as the unit: what a shift of the level does not show, spread
//! and tails, shows here. Each permutes whole windows between the scenarios, so that dependence within them does no harm.
//! [`DISTANCES`] has a row for each; the main type is [`ShapeTests`].

use crate::{
    anderson_darling,
    energy::WindowDistances,
    pooled_ranks::PooledRanks,
    relabelling::{Coverage, Effort, PermutationTest, Relabellings},
};

/// A distance of two distributions, whose permutation test is a column of the contrasts.
#[derive(Debug)]
pub struct Distance {
    /// The column of its p-value in `contrasts.csv`, `contrasts.parquet` and `report.json`.
    pub column: &'static str,
    /// Its heading in tables.
    pub heading: &'static str,
    /// Its name in a sentence.
    pub name: &'static str,
    /// Prepares it for the windows of a pair.
    prepare: for<'a> fn(&'a Pooled<'a>) -> Measure<'a>,
}

/// How far apart the windows with the label 0 and those with the label 1 are. The distance gets the label of each window.
type Measure<'a> = Box<dyn FnMut(&[usize]) -> f64 + 'a>;

/// The windows of both scenarios, those of the first before those of the second.
struct Pooled<'a> {
    windows: Vec<&'a [f64]>,
    ranks: PooledRanks,
}

/// Every distance that is tested, in the order of the columns.
pub static DISTANCES: &[Distance] = &[
    Distance {
        column: "p_kolmogorov_smirnov",
        heading: "KS",
        name: "the Kolmogorov-Smirnov distance",
        prepare: |pooled| Box::new(kolmogorov_smirnov(&pooled.ranks)),
    },
    Distance {
        column: "p_anderson_darling",
        heading: "A-D",
        name: "the Anderson-Darling statistic",
        // Where there is nothing to weigh, every labelling is alike.
        prepare: |pooled| {
            Box::new(|labels| anderson_darling::standardised(&pooled.ranks, labels, 2).unwrap_or(0.0))
        },
    },
    Distance {
        column: "p_energy",
        heading: "energy",
        name: "the energy distance",
        prepare: |pooled| {
            let distances = WindowDistances::of(&pooled.windows);
            Box::new(move |labels| distances.energy(labels))
        },
    },
];

fn kolmogorov_smirnov(ranks: &PooledRanks) -> impl FnMut(&[usize]) -> f64 {
    let mut weights = vec![0.0; ranks.sizes().len()];
    move |labels| {
        let mut counts = [0.0; 2];
        for (label, size) in labels.iter().zip(ranks.sizes()) {
            counts[usize::from(*label == 1)] += *size as f64;
        }
        let shares = [1.0 / counts[0], -1.0 / counts[1]];
        for (weight, label) in weights.iter_mut().zip(labels) {
            *weight = shares[usize::from(*label == 1)];
        }
        ranks.distances(&weights).kolmogorov
    }
}

/// The tests of one pair of scenarios, on the pooled values of each.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeTests {
    /// One for each of [`DISTANCES`].
    tests: Vec<PermutationTest>,
}

impl ShapeTests {
    /// Those of two scenarios, given the values of each of their windows; none if one of them has none.
    #[must_use]
    pub fn of(a: &[&[f64]], b: &[&[f64]], effort: Effort) -> Option<Self> {
        if a.is_empty() || b.is_empty() {
            return None;
        }
        let windows: Vec<&[f64]> = a.iter().chain(b).copied().collect();
        let sizes = [a.len(), b.len()];
        let ranks = PooledRanks::of(&windows);
        let pooled = Pooled { windows, ranks };
        let test = |distance: &Distance| Relabellings::of(&sizes, effort, (distance.prepare)(&pooled)).test();
        Some(Self {
            tests: DISTANCES.iter().map(test).collect(),
        })
    }

    /// Each distance with its test.
    pub fn each(&self) -> impl Iterator<Item = (&'static Distance, &PermutationTest)> {
        DISTANCES.iter().zip(&self.tests)
    }

    /// Labellings looked at by each of the tests, the observed one included.
    #[must_use]
    pub fn labellings(&self) -> u64 {
        self.tests.first().map_or(0, |test| test.labellings)
    }

    /// How each of the tests went through them.
    #[must_use]
    pub fn coverage(&self) -> Coverage {
        self.tests.first().map_or(Coverage::Exact, |test| test.coverage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EFFORT: Effort = Effort::of_a_report(0);

    #[test]
    fn a_spread_is_found_where_the_levels_are_alike() {
        let narrow: Vec<Vec<f64>> = (0..4)
            .map(|w| (-10..=10).map(|i| f64::from(i + w) / 100.0).collect())
            .collect();
        let wide: Vec<Vec<f64>> = (0..4)
            .map(|w| {
                (-10..=10)
                    .map(|i| f64::from(i) / 10.0 + f64::from(w) / 100.0)
                    .collect()
            })
            .collect();
        let narrow: Vec<&[f64]> = narrow.iter().map(Vec::as_slice).collect();
        let wide: Vec<&[f64]> = wide.iter().map(Vec::as_slice).collect();
        let found = ShapeTests::of(&narrow, &wide, EFFORT).unwrap();
        for (_, test) in found.each() {
            assert!((test.p - 2.0 / 70.0).abs() < 1e-12, "{test:?}");
        }
    }

    #[test]
    fn identical_scenarios_have_a_p_of_one() {
        let windows: [&[f64]; 2] = [&[0.1, 0.2, 0.3], &[0.1, 0.2, 0.3]];
        let found = ShapeTests::of(&windows, &windows, EFFORT).unwrap();
        for (_, test) in found.each() {
            assert_eq!(test.p, 1.0, "{test:?}");
        }
        let constant: [&[f64]; 2] = [&[1.0, 1.0], &[1.0, 1.0]];
        for (_, test) in ShapeTests::of(&constant, &constant, EFFORT).unwrap().each() {
            assert_eq!(test.p, 1.0, "{test:?}");
        }
        assert_eq!(ShapeTests::of(&[], &windows, EFFORT), None);
    }
}
