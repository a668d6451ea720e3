//! The Kolmogorov-Smirnov distance of two windows with blocks of values permuted in place of single values: for values
//! that depend on their neighbours (Politis, Romano and Wolf, *Subsampling*, 1999, on blocks; Good, *Permutation Tests*,
//! on permuting them). A block is about independent of the next; what shifts a window as a whole is still taken for a
//! difference, so that this stands between the paper's counts and the window as the unit. The main function is [`test`].

use crate::{
    dependence::Dependence,
    permutation,
    pooled_ranks::PooledRanks,
    relabelling::{Effort, PermutationTest, Relabellings},
};

/// How many window pairs of two scenarios are rejected when blocks of neighbouring values are permuted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BlockCount {
    /// Values in a block.
    pub block: usize,
    /// Window pairs that have a block on each side.
    pub pairs: usize,
    /// Those of them whose p is below the level.
    pub rejected: usize,
    /// Those of them that have blocks enough for a p below the level.
    pub possible: usize,
}

/// Draws of each window pair: p to 5e-4.
pub const DRAWS: u32 = 1_999;

impl BlockCount {
    /// That of two scenarios, given the values of each of their windows, in blocks of twice the autocorrelation time of
    /// the one that has the longer.
    #[must_use]
    pub fn of(a: &[&[f64]], b: &[&[f64]], alpha: f64, seed: u64) -> Self {
        let block = Dependence::block_of(a).max(Dependence::block_of(b));
        let effort = effort(seed);
        let pairs = a.iter().flat_map(|x| b.iter().map(move |y| (*x, *y)));
        let possible = pairs
            .clone()
            .filter(|(x, y)| smallest_p(x, y, block, effort) < alpha);
        let possible = possible.count();
        let tests: Vec<PermutationTest> = pairs.filter_map(|(x, y)| test(x, y, block, effort)).collect();
        Self {
            block,
            pairs: tests.len(),
            rejected: tests.iter().filter(|test| test.p < alpha).count(),
            possible,
        }
    }
}

/// That of each window pair.
const fn effort(seed: u64) -> Effort {
    Effort {
        enumerate: 10_000,
        draws: DRAWS,
        seed,
    }
}

/// How many blocks a window has.
fn blocks(values: &[f64], block: usize) -> usize {
    values.len() / block.max(1)
}

/// The smallest p that [`test`] can reach with so many blocks and so much effort, whatever is measured.
#[must_use]
pub fn smallest_p(x: &[f64], y: &[f64], block: usize, effort: Effort) -> f64 {
    permutation::attainable_p(blocks(x, block), blocks(y, block), effort)
}

/// Deals the blocks of two windows anew. Blocks have `block` values; the first values, up to a block, are left out, so
/// that all are equally long. None where a window has no block.
#[must_use]
pub fn test(x: &[f64], y: &[f64], block: usize, effort: Effort) -> Option<PermutationTest> {
    let (n, m) = (blocks(x, block), blocks(y, block));
    if n == 0 || m == 0 {
        return None;
    }
    let of = |values: &[f64], count: usize| -> Vec<Vec<f64>> {
        let rest = values.len() - count * block.max(1);
        let values = values.iter().skip(rest).copied().collect::<Vec<f64>>();
        values.chunks(block.max(1)).map(<[f64]>::to_vec).collect()
    };
    let mut all = of(x, n);
    all.extend(of(y, m));
    let all: Vec<&[f64]> = all.iter().map(Vec::as_slice).collect();
    let merged = PooledRanks::of(&all);
    let shares = [1.0 / (n * block.max(1)) as f64, -1.0 / (m * block.max(1)) as f64];
    let mut weights = vec![0.0; n + m];
    let permuted = Relabellings::of(&[n, m], effort, |labels| {
        for (weight, label) in weights.iter_mut().zip(labels) {
            *weight = shares[usize::from(*label == 1)];
        }
        merged.distances(&weights).kolmogorov
    });
    Some(permuted.test())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise_model::Noise;

    const EFFORT: Effort = Effort {
        enumerate: 200_000,
        draws: 499,
        seed: 1,
    };

    #[test]
    fn blocks_of_one_value_are_the_exact_test() {
        // P(D ≥ 3/4) of 4 and 4 without ties is 16/70 (Kim and Jennrich 1973).
        let (x, y) = ([1.0, 2.0, 3.0, 7.0], [4.0, 5.0, 6.0, 8.0]);
        let found = test(&x, &y, 1, EFFORT).unwrap();
        assert!((found.statistic - 0.75).abs() < 1e-12);
        assert!((found.p - 16.0 / 70.0).abs() < 1e-12, "{}", found.p);
    }

    #[test]
    fn neighbours_that_stay_together_say_less() {
        let (x, y) = ([1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]);
        for (block, p) in [(1, 2.0 / 70.0), (2, 2.0 / 6.0)] {
            let found = test(&x, &y, block, EFFORT).unwrap();
            assert!(found.statistic == 1.0 && (found.p - p).abs() < 1e-12, "{found:?}");
        }
    }

    #[test]
    fn windows_of_few_blocks_cannot_be_rejected_however_far_they_are_apart() {
        // Levels that go far up and down, so that a block is half of a window or so.
        let slow = |level: f64| -> Vec<f64> {
            (0..60)
                .map(|i| level + (f64::from(i) * std::f64::consts::TAU / 60.0).sin())
                .collect()
        };
        let (x, y) = (slow(0.0), slow(100.0));
        let found = BlockCount::of(&[&x, &x], &[&y, &y], 0.001, 1);
        assert!((15..=60).contains(&found.block), "{found:?}");
        assert_eq!((found.pairs, found.rejected, found.possible), (4, 0, 0));
        let mut random = Noise::new(6);
        let (x, mut y) = (random.ar1(60, 0.0), random.ar1(60, 0.0));
        for value in &mut y {
            *value += 100.0;
        }
        let found = BlockCount::of(&[&x], &[&y], 0.001, 1);
        assert_eq!((found.pairs, found.rejected, found.possible), (1, 1, 1));
        // 1 999 draws reach no p below 0.0005.
        assert_eq!(BlockCount::of(&[&x], &[&y], 0.0005, 1).possible, 0);
    }

    #[test]
    fn the_smallest_p_is_that_of_the_blocks() {
        let values = [0.0; 60];
        for (block, p) in [(20, 2.0 / 20.0), (30, 2.0 / 6.0), (60, 1.0), (61, 1.0)] {
            assert_eq!(smallest_p(&values, &values, block, EFFORT), p);
        }
        assert_eq!(smallest_p(&values, &values, 1, EFFORT), 1.0 / 500.0);
    }

    #[test]
    fn what_does_not_fill_a_block_is_left_out_at_the_start() {
        let found = test(&[99.0, 1.0, 2.0], &[3.0, 4.0], 2, EFFORT).unwrap();
        assert_eq!((found.statistic, found.labellings), (1.0, 2));
        assert_eq!(test(&[1.0], &[3.0, 4.0], 2, EFFORT), None);
    }

    #[test]
    fn correlated_windows_alike_are_rejected_about_as_often_as_they_should_be() {
        let mut random = Noise::new(5);
        let mut rejected = [0; 2];
        for _ in 0..100 {
            let (x, y) = (random.ar1(60, 0.5), random.ar1(60, 0.5));
            for (count, block) in rejected.iter_mut().zip([1, 6]) {
                *count += usize::from(test(&x, &y, block, effort(1)).is_some_and(|found| found.p < 0.05));
            }
        }
        let [values, blocks] = rejected;
        assert!(values > 15, "single values: {values} of 100 at a nominal 5");
        assert!(
            (1..13).contains(&blocks),
            "blocks: {blocks} of 100 at a nominal 5"
        );
    }
}
