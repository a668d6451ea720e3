//! All pairs of windows compared, within each scenario and between each two: the counts that the paper tables. The main
//! types are [`Comparison`] and [`Tally`].

use crate::{
    ks::{self, KsTest},
    sample::Sample,
};

/// One test of one window against another.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Letter of the first scenario.
    pub a: String,
    /// Its window.
    pub a_window: u32,
    /// Letter of the second scenario; the same one within a scenario.
    pub b: String,
    /// Its window.
    pub b_window: u32,
    /// The test's result.
    pub test: KsTest,
    /// Whether p is below α.
    pub rejected: bool,
}

/// How many window pairs of two scenarios, or of one, were rejected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tally {
    /// Letter of the first scenario.
    pub a: String,
    /// Letter of the second.
    pub b: String,
    /// Window pairs compared; never 0.
    pub pairs: usize,
    /// Those of them that were rejected.
    pub rejected: usize,
}

/// Compares every sample with every later one.
#[must_use]
pub fn compare_all(samples: &[Sample], alpha: f64) -> Vec<Comparison> {
    let pairs = samples
        .iter()
        .enumerate()
        .flat_map(|(at, first)| samples.iter().skip(at + 1).map(move |second| (first, second)));
    pairs
        .filter_map(|(first, second)| {
            // Never an error: `sample::samples` leaves out what is empty, and logs have finite positions only.
            let test = ks::test(&first.errors_m, &second.errors_m).ok()?;
            Some(Comparison {
                a: first.scenario.clone(),
                a_window: first.window,
                b: second.scenario.clone(),
                b_window: second.window,
                rejected: test.p < alpha,
                test,
            })
        })
        .collect()
}

/// Counts the comparisons of each scenario with itself and with each other, in the order they first appear.
#[must_use]
pub fn tally(comparisons: &[Comparison]) -> Vec<Tally> {
    let mut tallies: Vec<Tally> = Vec::new();
    for comparison in comparisons {
        let same = |tally: &&mut Tally| tally.a == comparison.a && tally.b == comparison.b;
        let rejected = usize::from(comparison.rejected);
        match tallies.iter_mut().find(same) {
            Some(tally) => {
                tally.pairs += 1;
                tally.rejected += rejected;
            }
            None => tallies.push(Tally {
                a: comparison.a.clone(),
                b: comparison.b.clone(),
                pairs: 1,
                rejected,
            }),
        }
    }
    tallies
}
