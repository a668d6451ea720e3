//! All pairs of many samples. The values are sorted once, over all samples; after that a value is its rank, and a test
//! is counting. For each first sample a table says how many of its values lie below each rank; the distance to any
//! other sample is then two look-ups for each value of that one, which takes less time than merging the two would.
//! A single test is a pool of two, so that one result does not depend on the company that it is computed in. The main
//! type is [`Pool`].

use std::{ops::Range, sync::Arc};

use rayon::prelude::*;

use super::{
    Alternative, Gap, KsError, KsTest, Ordinal, Procedure,
    distance::{Farthest, Steps},
    tails::{KnownTails, SharedTails, Tail},
};

/// Samples, ranked together.
#[derive(Debug, Clone)]
pub struct Pool {
    /// The distinct values of all samples, ascending: what a rank stands for.
    values: Vec<f64>,
    samples: Vec<Ranked>,
}

/// One sample of a pool.
#[derive(Debug, Clone, Default)]
struct Ranked {
    /// The rank of each value, ascending.
    ranks: Vec<u32>,
    /// Whether some of its values are equal.
    has_ties: bool,
}

impl Pool {
    /// Ranks the samples.
    ///
    /// # Errors
    /// When a sample is empty or has a value that is NaN or infinite.
    pub fn of<S: AsRef<[f64]>>(samples: &[S]) -> Result<Self, KsError> {
        let size: usize = samples.iter().map(|sample| sample.as_ref().len()).sum();
        if u32::try_from(size).is_err() {
            return Err(KsError::TooMany { values: size });
        }
        let mut all: Vec<(f64, usize)> = Vec::with_capacity(size);
        for (which, sample) in samples.iter().enumerate() {
            let sample = sample.as_ref();
            see_that_it_has_an_order(sample, Ordinal(which))?;
            all.extend(sample.iter().map(|value| (*value, which)));
        }
        all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut pool = Self {
            values: Vec::with_capacity(size),
            samples: samples.iter().map(Ranked::with_room_for).collect(),
        };
        for (value, which) in all {
            // −0 and 0 are the same value.
            if pool.values.last() != Some(&value) {
                pool.values.push(value);
            }
            pool.samples[which].push(pool.values.len() as u32 - 1);
        }
        Ok(pool)
    }

    /// How many samples there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Compares sample `a` with sample `b`.
    ///
    /// # Panics
    /// When the pool has no sample of that number.
    #[must_use]
    pub fn pair(&self, a: usize, b: usize, procedure: Procedure) -> KsTest {
        let mut below = Vec::new();
        let first = FirstSample::of(self, a, &mut below);
        first.test(b, procedure, &mut KnownTails::default())
    }

    /// Compares every sample with every later one, on all processors. `take` gets each sample with its tests against
    /// the later ones, in order, and makes of them what is kept; nothing else is, so that the memory is that of what
    /// it returns. The results are in the order of the samples, and each test is to the bit that of [`Self::pair`].
    pub fn pairs<T: Send>(
        &self,
        procedure: Procedure,
        take: impl Fn(usize, Partners<'_>) -> T + Sync,
    ) -> Vec<T> {
        self.pairs_of(0..self.len(), procedure, &Arc::default(), take)
    }

    /// The part of [`Self::pairs`] whose first samples are `firsts`. Parts of one procedure share the p-values that are
    /// known.
    pub fn pairs_of<T: Send>(
        &self,
        firsts: Range<usize>,
        procedure: Procedure,
        known: &Arc<SharedTails>,
        take: impl Fn(usize, Partners<'_>) -> T + Sync,
    ) -> Vec<T> {
        firsts
            .into_par_iter()
            .map_init(
                || (Vec::new(), KnownTails::beside(known.clone())),
                |(below, tails), a| {
                    let partners = Partners {
                        first: FirstSample::of(self, a, below),
                        next: a + 1,
                        procedure,
                        tails,
                    };
                    take(a, partners)
                },
            )
            .collect()
    }
}

impl Ranked {
    fn with_room_for(sample: &impl AsRef<[f64]>) -> Self {
        Self {
            ranks: Vec::with_capacity(sample.as_ref().len()),
            has_ties: false,
        }
    }

    fn push(&mut self, rank: u32) {
        self.has_ties |= self.ranks.last() == Some(&rank);
        self.ranks.push(rank);
    }
}

fn see_that_it_has_an_order(sample: &[f64], which: Ordinal) -> Result<(), KsError> {
    if sample.is_empty() {
        return Err(KsError::Empty { which });
    }
    match sample.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(at) => Err(KsError::NotFinite {
            which,
            position: at + 1,
            value: sample[at],
        }),
    }
}

/// The tests of one sample against each later one: the later one's number, and the test.
pub struct Partners<'a> {
    first: FirstSample<'a>,
    next: usize,
    procedure: Procedure,
    tails: &'a mut KnownTails,
}

impl Iterator for Partners<'_> {
    type Item = (usize, KsTest);

    fn next(&mut self) -> Option<Self::Item> {
        let b = self.next;
        if b >= self.first.pool.len() {
            return None;
        }
        self.next += 1;
        Some((b, self.first.test(b, self.procedure, self.tails)))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.first.pool.len().saturating_sub(self.next);
        (left, Some(left))
    }
}

/// The first sample of a test.
struct FirstSample<'a> {
    pool: &'a Pool,
    sample: &'a Ranked,
    /// How many of its values lie below each rank; one more than there are ranks.
    below: &'a [u32],
}

impl<'a> FirstSample<'a> {
    fn of(pool: &'a Pool, which: usize, below: &'a mut Vec<u32>) -> Self {
        let sample = &pool.samples[which];
        below.clear();
        for (count, rank) in sample.ranks.iter().enumerate() {
            below.resize(*rank as usize + 1, count as u32);
        }
        below.resize(pool.values.len() + 1, sample.ranks.len() as u32);
        Self { pool, sample, below }
    }

    fn test(&self, second: usize, procedure: Procedure, tails: &mut KnownTails) -> KsTest {
        let second = &self.pool.samples[second];
        let (n, m) = (self.sample.ranks.len(), second.ranks.len());
        let steps = Steps::of(n as u64, m as u64);
        let farthest = Farthest::of(n, self.below, &second.ranks, steps);
        let above = self.gap(farthest.above, &self.sample.ranks, farthest.above_after);
        let below = self.gap(farthest.below, &second.ranks, farthest.below_after);
        let h = match procedure.alternative {
            Alternative::TwoSided => above.h.max(below.h),
            Alternative::Greater => above.h,
            Alternative::Less => below.h,
        };
        let tail = if farthest.has_shared || self.sample.has_ties || second.has_ties {
            Tail::given_ties(procedure, n, m, h, &ends(&self.sample.ranks, &second.ranks))
        } else {
            tails.without_ties(procedure, n, m, h)
        };
        let lcm = steps.of_x * n as u64;
        KsTest {
            n,
            m,
            d: h as f64 / lcm as f64,
            h,
            lcm,
            above,
            below,
            p: tail.p,
            log10_p: tail.log10_p,
            alternative: procedure.alternative,
            method: tail.method,
        }
    }

    /// A distance to the one side, which is reached after so many of `ranks`.
    fn gap(&self, h: u64, ranks: &[u32], after: usize) -> Gap {
        let last = after.checked_sub(1).and_then(|at| ranks.get(at));
        Gap {
            h,
            at: last
                .and_then(|rank| self.pool.values.get(*rank as usize))
                .copied(),
        }
    }
}

/// How many pooled values there are up to and including each distinct one: where the distance exists.
fn ends(x: &[u32], y: &[u32]) -> Vec<usize> {
    let (mut i, mut j) = (0, 0);
    let mut ends = Vec::with_capacity(x.len() + y.len());
    while let Some(rank) = x.get(i).into_iter().chain(y.get(j)).min().copied() {
        i += x[i..].iter().take_while(|other| **other == rank).count();
        j += y[j..].iter().take_while(|other| **other == rank).count();
        ends.push(i + j);
    }
    ends
}
