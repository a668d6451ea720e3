//! The tests of many pairs as columns, for tables with millions of rows: a number takes its own eight bytes and no more; and their
//! counts, which need no rows. The types are [`PairColumns`] and [`PairCounts`].

use std::{ops::Range, sync::Arc};

use record::report_settings::Method;

use super::{KsTest, Pool, Procedure, SharedTails};

/// Tests, of which row i of each column is the i-th. Each is a [`KsTest`] with the numbers of its two samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PairColumns {
    /// The number of the first sample.
    pub first: Vec<u32>,
    /// The number of the second sample.
    pub second: Vec<u32>,
    /// Size of the first sample.
    pub n: Vec<u64>,
    /// Size of the second sample.
    pub m: Vec<u64>,
    /// The distance that was tested.
    pub d: Vec<f64>,
    /// Its numerator.
    pub h: Vec<u64>,
    /// Its denominator.
    pub lcm: Vec<u64>,
    /// The p-value.
    pub p: Vec<f64>,
    /// Its decimal logarithm.
    pub log10_p: Vec<f64>,
    /// The distance with its sign, see [`KsTest::signed_d`].
    pub signed_d: Vec<f64>,
    /// Where it is reached.
    pub at: Vec<Option<f64>>,
    /// How p was computed.
    pub method: Vec<Method>,
}

/// Counts of tests, of which row i of each column is the i-th.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PairCounts {
    /// The groups of the first and the second samples, see [`key`].
    pub key: Vec<u64>,
    /// How many tests there are.
    pub tests: Vec<u32>,
    /// How many reject.
    pub rejected: Vec<u32>,
    /// How many were computed by another method than the one that was asked for.
    pub of_another_method: Vec<u32>,
}

/// Counts that are being made.
#[derive(Default)]
struct Unfinished {
    counts: PairCounts,
    /// Where the rows of the last key's first group begin.
    last_group: usize,
}

/// What [`Pool::counts`] counts by.
#[derive(Debug, Clone, Copy)]
pub struct Counting<'a> {
    /// The group of each sample, ascending from 0 without a gap.
    pub groups: &'a [u32],
    /// Below which p a test rejects.
    pub alpha: f64,
    /// How the tests are computed.
    pub procedure: Procedure,
}

impl Unfinished {
    /// Adds some tests of a group with another. Groups come in the order of the samples: the first ones ascend, and for each sample of one so do
    /// the second ones, without a gap.
    fn add(&mut self, groups: [u32; 2], [tests, rejected, of_another_method]: [u32; 3]) {
        let (key, counts) = (key(groups), &mut self.counts);
        if counts.key.last().is_none_or(|last| last >> 32 != key >> 32) {
            self.last_group = counts.key.len();
        }
        let lowest = counts.key.get(self.last_group).unwrap_or(&key);
        let row = self.last_group + (key - lowest) as usize;
        if row == counts.key.len() {
            counts.key.push(key);
            counts.tests.push(0);
            counts.rejected.push(0);
            counts.of_another_method.push(0);
        }
        counts.tests[row] += tests;
        counts.rejected[row] += rejected;
        counts.of_another_method[row] += of_another_method;
    }
}

/// A pair of groups as one number: the first one, shifted by 32 bits, and the second one.
#[must_use]
pub const fn key([first, second]: [u32; 2]) -> u64 {
    (first as u64) << 32 | second as u64
}

impl PairColumns {
    fn push(&mut self, first: u32, second: u32, test: &KsTest) {
        let (signed_d, at) = test.signed_d();
        self.first.push(first);
        self.second.push(second);
        self.n.push(test.n as u64);
        self.m.push(test.m as u64);
        self.d.push(test.d);
        self.h.push(test.h);
        self.lcm.push(test.lcm);
        self.p.push(test.p);
        self.log10_p.push(test.log10_p);
        self.signed_d.push(signed_d);
        self.at.push(at);
        self.method.push(test.method);
    }

    fn append(&mut self, mut other: Self) {
        self.first.append(&mut other.first);
        self.second.append(&mut other.second);
        self.n.append(&mut other.n);
        self.m.append(&mut other.m);
        self.d.append(&mut other.d);
        self.h.append(&mut other.h);
        self.lcm.append(&mut other.lcm);
        self.p.append(&mut other.p);
        self.log10_p.append(&mut other.log10_p);
        self.signed_d.append(&mut other.signed_d);
        self.at.append(&mut other.at);
        self.method.append(&mut other.method);
    }

    /// How many tests there are.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.first.len()
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.first.is_empty()
    }
}

/// Samples whose counts are held before they are summed.
const AT_ONCE: usize = 1024;

impl Pool {
    /// Compares each of these samples with every later one, on all processors, in the order of the samples. Calls of one procedure
    /// share the p-values that are known.
    #[must_use]
    pub fn columns(
        &self,
        firsts: Range<usize>,
        procedure: Procedure,
        known: &Arc<SharedTails>,
    ) -> PairColumns {
        // A pool has at most 2³² values, and a sample at least one.
        let parts = self.pairs_of(firsts, procedure, known, |first, partners| {
            let mut columns = PairColumns::default();
            for (second, test) in partners {
                columns.push(first as u32, second as u32, &test);
            }
            columns
        });
        let mut columns = PairColumns::default();
        for part in parts {
            columns.append(part);
        }
        columns
    }

    /// Counts the tests of every sample with every later one, on all processors, by the groups of the two. A row is of a pair of groups.
    #[must_use]
    pub fn counts(&self, by: Counting<'_>) -> PairCounts {
        let Counting {
            groups,
            alpha,
            procedure,
        } = by;
        let known = Arc::default();
        let mut counts = Unfinished::default();
        for begin in (0..self.len()).step_by(AT_ONCE) {
            let firsts = begin..self.len().min(begin + AT_ONCE);
            let parts = self.pairs_of(firsts, procedure, &known, |first, partners| {
                let mut counts = Unfinished::default();
                for (second, test) in partners {
                    let is = [true, test.p < alpha, test.method != procedure.method];
                    counts.add([groups[first], groups[second]], is.map(u32::from));
                }
                counts.counts
            });
            for part in parts {
                for (row, key) in part.key.iter().enumerate() {
                    let sums = [&part.tests, &part.rejected, &part.of_another_method];
                    counts.add([(key >> 32) as u32, *key as u32], sums.map(|sums| sums[row]));
                }
            }
        }
        counts.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_the_test_of_its_two_samples() {
        let samples = [[1.0, 2.0, 5.0], [2.0, 4.0, 6.0], [1.0, 2.0, 5.0], [7.0, 8.0, 9.0]];
        let pool = Pool::of(&samples).unwrap();
        let procedure = Procedure::default();
        let columns = pool.columns(1..3, procedure, &Arc::default());
        assert_eq!(
            (columns.first.as_slice(), columns.second.as_slice()),
            (&[1, 1, 2][..], &[2, 3, 3][..])
        );
        assert_eq!(columns.len(), 3);
        for at in 0..columns.len() {
            let test = pool.pair(columns.first[at] as usize, columns.second[at] as usize, procedure);
            assert_eq!((columns.n[at], columns.m[at]), (3, 3));
            assert_eq!(
                (columns.d[at], columns.h[at], columns.lcm[at]),
                (test.d, test.h, test.lcm)
            );
            assert_eq!((columns.p[at], columns.log10_p[at]), (test.p, test.log10_p));
            assert_eq!((columns.signed_d[at], columns.at[at]), test.signed_d());
            assert_eq!(columns.method[at], test.method);
        }
        let counts = pool.counts(Counting {
            groups: &[0, 0, 1, 1],
            alpha: 0.5,
            procedure,
        });
        assert_eq!(counts.key, [0, 1, (1 << 32) | 1]);
        assert_eq!(counts.tests, [1, 4, 1]);
        // With three values each, those of the last sample are all larger.
        assert_eq!(counts.rejected, [0, 2, 1]);
        assert_eq!(counts.of_another_method, [0; 3]);
    }
}
