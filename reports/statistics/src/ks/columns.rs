//! The tests of many pairs as columns, for tables with millions of rows: a number takes its own eight bytes and no more. The type is
//! [`PairColumns`].

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
    /// The group of the first samples, shifted by 32 bits, and that of the second.
    pub key: Vec<u64>,
    /// How many tests there are.
    pub tests: Vec<u32>,
    /// How many reject.
    pub rejected: Vec<u32>,
    /// How many were computed by another method than the one that was asked for.
    pub of_another_method: Vec<u32>,
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

    /// The tests counted by the groups of their samples: `group` has that of each sample, ascending from 0 without a gap, and `asked` is the
    /// method that was asked for. A row is of a pair of groups.
    #[must_use]
    pub fn counts(&self, group: &[u32], alpha: f64, asked: Method) -> PairCounts {
        let mut counts = PairCounts::default();
        // The first group whose rows are being filled, its first row, and the second group of that.
        let mut filled = None;
        for (at, (first, second)) in self.first.iter().zip(&self.second).enumerate() {
            let [first, second] = [*first, *second].map(|sample| group[sample as usize]);
            let (begin, lowest) = match filled {
                Some((of, begin, lowest)) if of == first => (begin, lowest),
                _ => {
                    filled = Some((first, counts.key.len(), second));
                    (counts.key.len(), second)
                }
            };
            let row = begin + (second - lowest) as usize;
            if row == counts.key.len() {
                counts.key.push(u64::from(first) << 32 | u64::from(second));
                for sums in [
                    &mut counts.tests,
                    &mut counts.rejected,
                    &mut counts.of_another_method,
                ] {
                    sums.push(0);
                }
            }
            counts.tests[row] += 1;
            counts.rejected[row] += u32::from(self.p[at] < alpha);
            counts.of_another_method[row] += u32::from(self.method[at] != asked);
        }
        counts
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
        let counts = pool
            .columns(0..4, procedure, &Arc::default())
            .counts(&[0, 0, 1, 1], 0.5, Method::Exact);
        assert_eq!(counts.key, [0, 1, (1 << 32) | 1]);
        assert_eq!(counts.tests, [1, 4, 1]);
        // With three values each, those of the last sample are all larger.
        assert_eq!(counts.rejected, [0, 2, 1]);
        assert_eq!(counts.of_another_method, [0; 3]);
    }
}
