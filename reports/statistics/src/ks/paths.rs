//! The share of lattice paths that leave a band: Viehmann's recursion (arXiv 2102.08037), one anti-diagonal at a time.
//!
//! Dealing the pooled values in order into the two samples is a path from (0, 0) to (n, m), and all paths are equally
//! likely. Of the paths to (i, j), a share i/(i+j) comes from (i−1, j) and the rest from (i, j−1), so the share that
//! has left the band by (i, j) is the mean of the two shares there; where the distance itself is out of the band, it
//! is 1. Every step is a mean of numbers from 0 to 1, so each result is exact to some (n + m) roundings, however small.
//!
//! With ties the distance exists only after the last of a run of equal values: at the other anti-diagonals nothing is
//! checked (Schröer and Trenkler 1995). The main type is [`Band`].

use super::{
    Alternative,
    distance::Steps,
    scaled::{Scaled, Share},
};

/// Below this the plain doubles of the recursion may have underflowed on the way.
const UNDERFLOW_NEAR: f64 = 1e-280;

/// The paths to (n, m), and the band |i · step_x − j · step_y| < h, or one side of it: i · step_x − j · step_y < h for
/// D⁺ and > −h for D⁻.
#[derive(Debug, Clone, Copy)]
pub(super) struct Band {
    n: usize,
    m: usize,
    steps: Steps,
    h: u64,
    alternative: Alternative,
}

impl Band {
    /// The band that a distance of h / lcm(n, m) is the first to be out of.
    pub(super) fn of(n: usize, m: usize, h: u64, alternative: Alternative) -> Self {
        Self {
            n,
            m,
            steps: Steps::of(n as u64, m as u64),
            h,
            alternative,
        }
    }

    /// The distance.
    pub(super) fn d(&self) -> f64 {
        self.h as f64 / (self.steps.of_x * self.n as u64) as f64
    }

    /// About how many cells the recursion visits at most.
    pub(super) fn cells(&self) -> u64 {
        let within = self.n.min(self.m) as u64;
        let width = match self.alternative {
            Alternative::TwoSided => (2 * self.h / (self.steps.of_x + self.steps.of_y)).min(within),
            Alternative::Less | Alternative::Greater => within,
        };
        (width + 1).saturating_mul((self.n + self.m) as u64)
    }

    /// The share of paths that are out of the band at one of the anti-diagonals `ends` (ascending), and its decimal
    /// logarithm.
    pub(super) fn share_leaving(&self, ends: &[usize]) -> (f64, f64) {
        if self.h == 0 {
            return (1.0, 0.0);
        }
        let share: f64 = self.recursion(ends);
        if share > UNDERFLOW_NEAR {
            let share = share.min(1.0);
            return (share, share.log10());
        }
        let share: Scaled = self.recursion(ends);
        (share.to_f64(), share.log10())
    }

    fn recursion<S: Share>(&self, ends: &[usize]) -> S {
        // left[i] is the share for (i, k − i), and next[i] will be that of the anti-diagonal after it. Only low..=high
        // is in the band; what is outside has left.
        let (mut left, mut next) = (vec![S::NONE; self.n + 1], vec![S::NONE; self.n + 1]);
        let whole: Vec<f64> = (0..=self.n).map(|i| i as f64).collect();
        let (mut low, mut high) = (0, 0);
        let mut ends = ends.iter().copied().peekable();
        for k in 1..=self.n + self.m {
            // The band widens by the one step, within what n and m allow.
            let reach = (high + 1).min(self.n);
            low = low.max(k.saturating_sub(self.m));
            // (0, k) and (k, 0) have one way to arrive, and it is from within.
            if low == 0 {
                next[0] = left[0];
            }
            if reach == k {
                next[k] = left[k - 1];
            }
            let (from, to) = (low.max(1), reach.min(k - 1));
            let total = k as f64;
            let ways = whole[from..=to].iter().zip(left[from - 1..=to].windows(2));
            for (share, (i, left)) in next[from..=to].iter_mut().zip(ways) {
                *share = S::mean(*i, left[0], total - i, left[1], total);
            }
            (left, next) = (next, left);
            high = reach;
            if ends.next_if_eq(&k).is_some() {
                let (first, last) = self.inside(k);
                (low, high) = (first.max(low), last.min(high));
                if low > high {
                    return S::ALL;
                }
            }
            if low > 0 {
                left[low - 1] = S::ALL;
            }
            if high < self.n {
                left[high + 1] = S::ALL;
            }
        }
        left[self.n]
    }
}

impl Band {
    /// The first and the last i of anti-diagonal k that are in the band: k·b − h < i·(a + b) < k·b + h, for steps a, b.
    fn inside(&self, k: usize) -> (usize, usize) {
        let middle = k as u64 * self.steps.of_y;
        let both = self.steps.of_x + self.steps.of_y;
        let first = match self.alternative {
            Alternative::Greater => 0,
            _ => middle.checked_sub(self.h).map_or(0, |below| below / both + 1),
        };
        let last = match self.alternative {
            Alternative::Less => k as u64,
            _ => (middle + self.h - 1) / both,
        };
        (first as usize, last as usize)
    }
}
