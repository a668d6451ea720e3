//! The share of lattice paths that leave a band: Viehmann's recursion (arXiv 2102.08037), one anti-diagonal at a time.
//!
//! Dealing the pooled values in order into the two samples is a path from (0, 0) to (n, m), and all paths are equally
//! likely. Of the paths to (i, j), a share i/(i+j) comes from (i−1, j) and the rest from (i, j−1), so the share that
//! has left the band by (i, j) is the mean of the two shares there; where the distance itself is out of the band, it
//! is 1. Every step is a mean of numbers from 0 to 1, so each result is exact to some (n + m) roundings, however small.
//!
//! With ties the distance exists only after the last of a run of equal values: at the other anti-diagonals nothing is
//! checked (Schröer and Trenkler 1995). The main type is [`Band`].

use super::scaled::{Scaled, Share};

/// Below this the plain doubles of the recursion may have underflowed on the way.
const UNDERFLOW_NEAR: f64 = 1e-280;

/// The paths to (n, m), and the band |i · step_x − j · step_y| < h.
#[derive(Debug, Clone, Copy)]
pub(super) struct Band {
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) step_x: u64,
    pub(super) step_y: u64,
    pub(super) h: u64,
}

impl Band {
    /// About how many cells the recursion visits when there are no ties.
    pub(super) fn cells(&self) -> u64 {
        let width = (2 * self.h / (self.step_x + self.step_y)).min(self.n.min(self.m) as u64) + 1;
        width.saturating_mul((self.n + self.m) as u64)
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
        // left[i] is the share for (i, k − i). Only low..=high is in the band; what is outside has left.
        let mut left = vec![S::ALL; self.n + 1];
        left[0] = S::NONE;
        let (mut low, mut high) = (0, 0);
        let mut ends = ends.iter().copied().peekable();
        for k in 1..=self.n + self.m {
            // The band widens by the one step, within what n and m allow.
            let reach = (high + 1).min(self.n);
            low = low.max(k.saturating_sub(self.m));
            if high + 1 == k && reach == k {
                // (k, 0) has one way to arrive, and it is from within.
                left[k] = left[k - 1];
            }
            let total = k as f64;
            // Downwards, since left[i − 1] is still that of k − 1.
            for i in (low.max(1)..=reach.min(k - 1)).rev() {
                left[i] = S::mean(i as f64, left[i - 1], (k - i) as f64, left[i], total);
            }
            high = reach;
            if ends.next_if_eq(&k).is_some() {
                let (first, last) = self.inside(k);
                let (first, last) = (first.max(low), last.min(high));
                if first > last {
                    return S::ALL;
                }
                left[low..first].fill(S::ALL);
                left[last + 1..=high].fill(S::ALL);
                (low, high) = (first, last);
            }
        }
        left[self.n]
    }
}

impl Band {
    /// The first and the last i of anti-diagonal k that are in the band: k·b − h < i·(a + b) < k·b + h.
    fn inside(&self, k: usize) -> (usize, usize) {
        let middle = k as u64 * self.step_y;
        let both = self.step_x + self.step_y;
        let first = middle.checked_sub(self.h).map_or(0, |below| below / both + 1);
        let last = (middle + self.h - 1) / both;
        (first as usize, last as usize)
    }
}
