//! Three permutation tests of whole distributions with the window as the unit: what a shift of the level does not show,
//! spread and tails, shows here. Each deals the windows anew, whole, so that dependence within them does no harm. The main
//! type is [`ShapeTests`].

use crate::statistics::{
    anderson_darling,
    energy::WindowDistances,
    pooled_ranks::PooledRanks,
    relabelling::{Effort, PermutationTest, Relabellings},
};

/// The tests of one pair of scenarios, on the pooled values of each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeTests {
    /// Of the Kolmogorov-Smirnov distance.
    pub kolmogorov_smirnov: PermutationTest,
    /// Of the standardised Anderson-Darling statistic.
    pub anderson_darling: PermutationTest,
    /// Of the energy distance, in metres.
    pub energy: PermutationTest,
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
        let merged = PooledRanks::of(&windows);
        let distances = WindowDistances::of(&windows);
        let mut weights = vec![0.0; windows.len()];
        let kolmogorov_smirnov = Relabellings::of(&sizes, effort, |labels| {
            let mut counts = [0.0; 2];
            for (label, size) in labels.iter().zip(merged.sizes()) {
                counts[usize::from(*label == 1)] += *size as f64;
            }
            let shares = [1.0 / counts[0], -1.0 / counts[1]];
            for (weight, label) in weights.iter_mut().zip(labels) {
                *weight = shares[usize::from(*label == 1)];
            }
            merged.distances(&weights).kolmogorov
        });
        // Without anything to weigh every labelling is alike.
        let anderson_darling = Relabellings::of(&sizes, effort, |labels| {
            anderson_darling::standardised(&merged, labels, 2).unwrap_or(0.0)
        });
        let energy = Relabellings::of(&sizes, effort, |labels| distances.energy(labels));
        Some(Self {
            kolmogorov_smirnov: kolmogorov_smirnov.test(),
            anderson_darling: anderson_darling.test(),
            energy: energy.test(),
        })
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
        for test in [found.kolmogorov_smirnov, found.anderson_darling, found.energy] {
            assert!((test.p - 2.0 / 70.0).abs() < 1e-12, "{test:?}");
        }
    }

    #[test]
    fn identical_scenarios_have_a_p_of_one() {
        let windows: [&[f64]; 2] = [&[0.1, 0.2, 0.3], &[0.1, 0.2, 0.3]];
        let found = ShapeTests::of(&windows, &windows, EFFORT).unwrap();
        for test in [found.kolmogorov_smirnov, found.anderson_darling, found.energy] {
            assert_eq!(test.p, 1.0, "{test:?}");
        }
        let constant: [&[f64]; 2] = [&[1.0, 1.0], &[1.0, 1.0]];
        assert_eq!(
            ShapeTests::of(&constant, &constant, EFFORT)
                .unwrap()
                .anderson_darling
                .p,
            1.0
        );
        assert_eq!(ShapeTests::of(&[], &windows, EFFORT), None);
    }
}
