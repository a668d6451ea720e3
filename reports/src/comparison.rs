//! All pairs of windows compared, within each scenario and between each two: the counts that the paper tables. The main
//! types are [`Comparison`] and [`Tally`], made by [`compare`].

use std::{borrow::Cow, collections::BTreeMap, sync::Arc};

use crate::{
    ks::{KsTest, Pool, Procedure},
    sample::Sample,
    settings::ReportSettings,
};

/// How many comparisons are listed: those of a thousand windows, in some 200 MB. Of more the counts are kept.
pub const LISTED: usize = 500_000;

/// One test of one window against another.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Letter of the first scenario. Half a million comparisons share the letters of a thousand.
    pub a: Arc<str>,
    /// Its window.
    pub a_window: u32,
    /// Letter of the second scenario; the same one within a scenario.
    pub b: Arc<str>,
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
    /// Those of them whose p-value is not of the method that was asked for, since the samples are large.
    pub in_the_limit: usize,
}

/// Every two samples compared.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Compared {
    /// Every comparison; empty if there are more than [`LISTED`].
    pub comparisons: Vec<Comparison>,
    /// The counts, of each scenario with itself and with each other, in the order they first appear.
    pub tallies: Vec<Tally>,
}

/// The values of one window, whatever they are of.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowValues<'a> {
    /// Letter of its scenario.
    pub scenario: &'a str,
    /// Its number.
    pub window: u32,
    /// Its values; not empty, and finite.
    pub values: Cow<'a, [f64]>,
}

/// Compares every sample with every later one, on all processors. The samples of a scenario stand together.
#[must_use]
pub fn compare(samples: &[Sample], settings: &ReportSettings) -> Compared {
    let windows: Vec<WindowValues<'_>> = samples
        .iter()
        .map(|sample| WindowValues {
            scenario: &sample.scenario,
            window: sample.window,
            values: Cow::Borrowed(&sample.errors_m),
        })
        .collect();
    compare_windows(&windows, settings, LISTED)
}

/// Counts the rejections of every window against every later one. The windows of a scenario stand together.
#[must_use]
pub fn tallies(windows: &[WindowValues<'_>], settings: &ReportSettings) -> Vec<Tally> {
    compare_windows(windows, settings, 0).tallies
}

/// No more comparisons than so many are `listed`: else none of them.
fn compare_windows(windows: &[WindowValues<'_>], settings: &ReportSettings, listed: usize) -> Compared {
    let values: Vec<&[f64]> = windows.iter().map(|window| &*window.values).collect();
    // Never an error: what is empty was left out, logs have finite positions only, and as many values as cannot be ranked
    // would not have been held.
    let Ok(pool) = Pool::of(&values) else {
        return Compared::default();
    };
    let procedure = Procedure {
        method: settings.method,
        ..Procedure::default()
    };
    let scenarios: Vec<&[WindowValues<'_>]> = windows.chunk_by(|a, b| a.scenario == b.scenario).collect();
    // Which of them each sample is of.
    let number: Vec<usize> = (0..)
        .zip(&scenarios)
        .flat_map(|(number, windows)| windows.iter().map(move |_| number))
        .collect();
    let is_listed = pairs_of(windows.len()) <= listed;

    let rows = pool.pairs(procedure, |first, partners| {
        let mut row = Row::default();
        if is_listed {
            // No more than that: what is grown by doubling is half empty.
            row.tests.reserve_exact(windows.len() - first - 1);
        }
        for (second, test) in partners {
            let rejected = test.p < settings.alpha;
            row.count(number[second], rejected, test.method != settings.method);
            if is_listed {
                row.tests.push(test);
            }
        }
        row
    });

    let letters: Vec<Arc<str>> = scenarios
        .iter()
        .filter_map(|windows| Some(windows.first()?.scenario.into()))
        .collect();
    let mut comparisons = Vec::with_capacity(rows.iter().map(|row| row.tests.len()).sum());
    let mut counts: BTreeMap<(usize, usize), Count> = BTreeMap::new();
    for (first, row) in rows.into_iter().enumerate() {
        for (second, count) in row.counts {
            counts.entry((number[first], second)).or_default().add(&count);
        }
        for (second, test) in (first + 1..).zip(row.tests) {
            comparisons.push(Comparison {
                a: Arc::clone(&letters[number[first]]),
                a_window: windows[first].window,
                b: Arc::clone(&letters[number[second]]),
                b_window: windows[second].window,
                rejected: test.p < settings.alpha,
                test,
            });
        }
    }
    let tallies = counts.into_iter().map(|((a, b), count)| Tally {
        a: letters[a].to_string(),
        b: letters[b].to_string(),
        pairs: count.pairs,
        rejected: count.rejected,
        in_the_limit: count.in_the_limit,
    });
    Compared {
        comparisons,
        tallies: tallies.collect(),
    }
}

/// How many pairs so many samples have.
#[must_use]
pub const fn pairs_of(samples: usize) -> usize {
    samples * samples.saturating_sub(1) / 2
}

/// One sample's comparisons with the later ones.
#[derive(Default)]
struct Row {
    /// If they are listed.
    tests: Vec<KsTest>,
    /// By the number of the other scenario, ascending.
    counts: Vec<(usize, Count)>,
}

#[derive(Default)]
struct Count {
    pairs: usize,
    rejected: usize,
    in_the_limit: usize,
}

impl Row {
    fn count(&mut self, scenario: usize, rejected: bool, in_the_limit: bool) {
        let one = Count {
            pairs: 1,
            rejected: usize::from(rejected),
            in_the_limit: usize::from(in_the_limit),
        };
        match self.counts.last_mut() {
            Some((same, count)) if *same == scenario => count.add(&one),
            _ => self.counts.push((scenario, one)),
        }
    }
}

impl Count {
    fn add(&mut self, other: &Self) {
        self.pairs += other.pairs;
        self.rejected += other.rejected;
        self.in_the_limit += other.in_the_limit;
    }
}
