//! The comparisons as one polars frame, and their counts as another. Comparisons that are listed are made in pieces of some hundred thousand rows,
//! each of which is counted by a group-by. Of more than are listed there is no row: ten million are counted as they are made.

use std::{collections::HashMap, ops::Range, sync::Arc};

use polars::{
    df,
    error::PolarsResult,
    frame::DataFrame,
    prelude::{BooleanChunked, Float64Chunked, StringChunked, UInt32Chunked, UInt64Chunked},
};
use record::report_settings::{Method, ReportSettings};
use statistics::ks::{Counting, PairColumns, PairCounts, Pool, Procedure, SharedTails, key};

use super::{Comparison, FrameError, LISTED, Tally, TestResult, WindowValues, pairs_of};
use crate::analysis::sample::Sample;

/// Comparisons from which on a piece is whole.
const PIECE: usize = 1 << 17;

/// What the counts are summed by, the names that it stands for, and the sums.
const KEY: &str = "scenarios";
const PAIR: [&str; 2] = ["a", "b"];
const SUMS: [&str; 3] = ["pairs", "rejected", "in_the_limit"];

/// Every two windows compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparisons {
    frame: DataFrame,
    counts: DataFrame,
}

impl Comparisons {
    /// A row for each comparison, in the order of the windows; none if there are more than [`LISTED`]. Columns: `a`,
    /// `a_window`, `b`, `b_window`, `n`, `m`, `d`, `h`, `lcm`, `p`, `log10_p`, `signed_d`, `at`, `method`, `rejected`.
    #[must_use]
    pub const fn frame(&self) -> &DataFrame {
        &self.frame
    }

    /// A row for each scenario with itself and for each two scenarios: `a`, `b`, and of all their comparisons the number of
    /// `pairs`, of the `rejected` and of those `in_the_limit`.
    #[must_use]
    pub const fn counts(&self) -> &DataFrame {
        &self.counts
    }

    /// Whether no comparison is listed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frame.height() == 0
    }

    /// The comparisons one by one.
    pub fn rows(&self) -> impl Iterator<Item = Comparison<'_>> {
        rows(&self.frame)
    }

    /// Of those that are wanted, the one of the median D: the later one of the two in the middle. There may be half a million, so
    /// that of each no more is held than its D.
    pub fn of_median_d(&self, is_wanted: impl Fn(&Comparison<'_>) -> bool) -> Option<Comparison<'_>> {
        let rows = self.rows().enumerate();
        let mut wanted: Vec<(f64, usize)> = rows
            .filter(|(_, row)| is_wanted(row))
            .map(|(at, row)| (row.test.d, at))
            .collect();
        wanted.sort_unstable_by(|(d, at), (other_d, other_at)| d.total_cmp(other_d).then(at.cmp(other_at)));
        let (_, at) = wanted.get(wanted.len() / 2)?;
        self.rows().nth(*at)
    }
}

impl Default for Comparisons {
    fn default() -> Self {
        Self {
            frame: DataFrame::empty(),
            counts: DataFrame::empty(),
        }
    }
}

/// Compares every sample with every later one, on all processors. The samples of a scenario stand together.
///
/// # Errors
/// When polars refuses, which would be a fault of ours.
pub fn compare(
    samples: &[Sample],
    settings: &ReportSettings,
) -> Result<(Comparisons, Vec<Tally>), FrameError> {
    let windows: Vec<WindowValues<'_>> = samples.iter().map(WindowValues::from).collect();
    let comparisons = compare_windows(&windows, settings, LISTED)?;
    let tallies = as_tallies(&comparisons.counts)?;
    Ok((comparisons, tallies))
}

/// Counts the rejections of every window against every later one. The windows of a scenario stand together.
///
/// # Errors
/// As [`compare`].
pub fn tallies(windows: &[WindowValues<'_>], settings: &ReportSettings) -> Result<Vec<Tally>, FrameError> {
    Ok(as_tallies(&compare_windows(windows, settings, 0)?.counts)?)
}

/// No more comparisons than so many are `listed`: else none of them.
fn compare_windows(
    windows: &[WindowValues<'_>],
    settings: &ReportSettings,
    listed: usize,
) -> PolarsResult<Comparisons> {
    let values: Vec<&[f64]> = windows.iter().map(|window| &*window.values).collect();
    // Never an error: what is empty was left out, logs have finite positions only, and as many values as cannot be ranked
    // would not have been held.
    let pool = Pool::of(&values).ok();
    let procedure = Procedure {
        method: settings.method,
        ..Procedure::default()
    };
    let scenarios = Scenarios::of(windows);
    // Without a row they have their columns all the same.
    let none = PairColumns::default();
    let mut frame = piece(windows, &none, settings)?;
    let mut counts = counted(&none, &scenarios, settings)?;
    match &pool {
        Some(pool) if pairs_of(windows.len()) > listed => {
            let by = Counting {
                groups: &scenarios.of,
                alpha: settings.alpha,
                procedure,
            };
            counts = in_columns(pool.counts(by))?;
        }
        Some(pool) => {
            let known = Arc::new(SharedTails::default());
            for firsts in pieces(windows.len()) {
                let tests = pool.columns(firsts, procedure, &known);
                counts.vstack_mut_owned(counted(&tests, &scenarios, settings)?)?;
                frame.vstack_mut_owned(piece(windows, &tests, settings)?)?;
            }
            counts = sums(&counts, &[KEY], &SUMS)?;
        }
        None => {}
    }
    Ok(Comparisons {
        frame,
        counts: scenarios.named(&counts)?,
    })
}

/// The scenarios by number, so that two of them are one number to count by.
struct Scenarios<'a> {
    names: Vec<&'a str>,
    /// That of each window.
    of: Vec<u32>,
}

impl<'a> Scenarios<'a> {
    /// The windows of a scenario stand together.
    fn of(windows: &'a [WindowValues<'_>]) -> Self {
        let mut names: Vec<&str> = Vec::new();
        let mut of = Vec::with_capacity(windows.len());
        for window in windows {
            if names.last() != Some(&window.scenario) {
                names.push(window.scenario);
            }
            of.push(names.len() as u32 - 1);
        }
        Self { names, of }
    }

    /// The counts with the scenarios' names in place of their key.
    fn named(&self, counts: &DataFrame) -> PolarsResult<DataFrame> {
        let keys: Vec<u64> = counts.column(KEY)?.u64()?.iter().flatten().collect();
        let names =
            |number: fn(u64) -> u64| Vec::from_iter(keys.iter().map(|key| self.names[number(*key) as usize]));
        let mut named = df![
            PAIR[0] => names(|key| key >> 32),
            PAIR[1] => names(|key| key & u64::from(u32::MAX)),
        ]?;
        named.hstack_mut(counts.select(SUMS)?.columns())?;
        Ok(named)
    }
}

/// The first samples of each piece.
fn pieces(windows: usize) -> Vec<Range<usize>> {
    let mut pieces = Vec::new();
    let (mut begin, mut size) = (0, 0);
    for first in 0..windows {
        size += windows - first - 1;
        if size >= PIECE || first + 1 == windows {
            pieces.push(begin..first + 1);
            (begin, size) = (first + 1, 0);
        }
    }
    pieces
}

/// The tests as rows.
fn piece(
    windows: &[WindowValues<'_>],
    tests: &PairColumns,
    settings: &ReportSettings,
) -> PolarsResult<DataFrame> {
    let letters = |side: &[u32]| Vec::from_iter(side.iter().map(|it| windows[*it as usize].scenario));
    let numbers = |side: &[u32]| Vec::from_iter(side.iter().map(|it| windows[*it as usize].window));
    df![
        "a" => letters(&tests.first),
        "a_window" => numbers(&tests.first),
        "b" => letters(&tests.second),
        "b_window" => numbers(&tests.second),
        "n" => &tests.n,
        "m" => &tests.m,
        "d" => &tests.d,
        "h" => &tests.h,
        "lcm" => &tests.lcm,
        "p" => &tests.p,
        "log10_p" => &tests.log10_p,
        "signed_d" => &tests.signed_d,
        "at" => &tests.at,
        "method" => Vec::from_iter(tests.method.iter().map(|method| method.name())),
        "rejected" => Vec::from_iter(tests.p.iter().map(|p| *p < settings.alpha)),
    ]
}

/// The tests that are listed, counted by the pair of scenarios.
fn counted(
    tests: &PairColumns,
    scenarios: &Scenarios<'_>,
    settings: &ReportSettings,
) -> PolarsResult<DataFrame> {
    let of = |sample: &u32| scenarios.of[*sample as usize];
    let pairs = tests.first.iter().zip(&tests.second);
    let each = in_columns(PairCounts {
        key: pairs
            .map(|(first, second)| key([of(first), of(second)]))
            .collect(),
        tests: vec![1; tests.len()],
        rejected: tests.p.iter().map(|p| u32::from(*p < settings.alpha)).collect(),
        of_another_method: tests
            .method
            .iter()
            .map(|it| u32::from(*it != settings.method))
            .collect(),
    })?;
    sums(&each, &[KEY], &SUMS)
}

fn in_columns(counts: PairCounts) -> PolarsResult<DataFrame> {
    df![
        KEY => counts.key,
        SUMS[0] => counts.tests,
        SUMS[1] => counts.rejected,
        SUMS[2] => counts.of_another_method,
    ]
}

/// The sums of some columns by keys, in the order in which the keys first appear.
pub(crate) fn sums(frame: &DataFrame, by: &[&str], columns: &[&str]) -> PolarsResult<DataFrame> {
    #[expect(
        deprecated,
        reason = "what is to be used in its place doubles the build of polars"
    )]
    let mut sums = frame
        .group_by_stable(by.iter().copied())?
        .select(columns.iter().copied())
        .sum()?;
    let names: Vec<&str> = by.iter().chain(columns).copied().collect();
    sums.set_column_names(&names)?;
    Ok(sums)
}

fn as_tallies(counts: &DataFrame) -> PolarsResult<Vec<Tally>> {
    let (a, b) = (counts.column("a")?.str()?, counts.column("b")?.str()?);
    let [pairs, rejected, in_the_limit] = SUMS.map(|name| counts.column(name).and_then(|it| it.u32()));
    let (pairs, rejected, in_the_limit) = (pairs?, rejected?, in_the_limit?);
    let mut known: HashMap<&str, Arc<str>> = HashMap::new();
    let mut letter = |text| Arc::clone(known.entry(text).or_insert_with(|| text.into()));
    let tally = |at: usize| {
        Some(Tally {
            a: letter(a.get(at)?),
            b: letter(b.get(at)?),
            pairs: pairs.get(at)? as usize,
            rejected: rejected.get(at)? as usize,
            in_the_limit: in_the_limit.get(at)? as usize,
        })
    };
    Ok((0..counts.height()).filter_map(tally).collect())
}

/// The columns of a frame of comparisons, each by its type.
struct Columns<'a> {
    texts: [&'a StringChunked; 3],
    windows: [&'a UInt32Chunked; 2],
    counts: [&'a UInt64Chunked; 4],
    numbers: [&'a Float64Chunked; 5],
    rejected: &'a BooleanChunked,
}

fn rows(frame: &DataFrame) -> impl Iterator<Item = Comparison<'_>> {
    // A frame without rows may be without columns.
    let columns = Columns::of(frame).ok();
    columns
        .into_iter()
        .flat_map(|columns| (0..frame.height()).filter_map(move |at| columns.row(at)))
}

impl<'a> Columns<'a> {
    fn of(frame: &'a DataFrame) -> PolarsResult<Self> {
        let text = |name: &str| frame.column(name)?.str();
        let window = |name: &str| frame.column(name)?.u32();
        let count = |name: &str| frame.column(name)?.u64();
        let number = |name: &str| frame.column(name)?.f64();
        Ok(Self {
            texts: [text("a")?, text("b")?, text("method")?],
            windows: [window("a_window")?, window("b_window")?],
            counts: [count("n")?, count("m")?, count("h")?, count("lcm")?],
            numbers: [
                number("d")?,
                number("p")?,
                number("log10_p")?,
                number("signed_d")?,
                number("at")?,
            ],
            rejected: frame.column("rejected")?.bool()?,
        })
    }

    fn row(&self, at: usize) -> Option<Comparison<'a>> {
        let [a, b, method] = self.texts;
        let [a_window, b_window] = self.windows;
        let [n, m, h, lcm] = self.counts;
        let [d, p, log10_p, signed_d, place] = self.numbers;
        let method = method.get(at)?;
        Some(Comparison {
            a: a.get(at)?,
            a_window: a_window.get(at)?,
            b: b.get(at)?,
            b_window: b_window.get(at)?,
            test: TestResult {
                n: n.get(at)?,
                m: m.get(at)?,
                d: d.get(at)?,
                h: h.get(at)?,
                lcm: lcm.get(at)?,
                p: p.get(at)?,
                log10_p: log10_p.get(at)?,
                signed_d: signed_d.get(at)?,
                at: place.get(at),
                method: Method::ALL.into_iter().find(|it| it.name() == method)?,
            },
            rejected: self.rejected.get(at)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use super::*;

    fn windows(count: u32) -> Vec<WindowValues<'static>> {
        let value =
            |window: u32, at: u32| f64::from((window * 7919 + at * 104_729) % 1009 + window % 5 * 200);
        (0..count)
            .map(|window| WindowValues {
                scenario: ["a", "b", "c"][(window * 3 / count) as usize],
                window,
                values: Cow::Owned((0..12).map(|at| value(window, at)).collect()),
            })
            .collect()
    }

    #[test]
    fn every_pair_of_windows_is_in_one_piece_and_pieces_are_not_larger_than_they_need_be() {
        for windows in [0, 1, 2, 3, 700, 1200] {
            let pieces = pieces(windows);
            let firsts: Vec<usize> = pieces.iter().cloned().flatten().collect();
            assert_eq!(firsts, Vec::from_iter(0..windows));
            let size = |firsts: &Range<usize>| firsts.clone().map(|first| windows - first - 1).sum::<usize>();
            assert!(
                pieces.iter().all(|firsts| size(firsts) < PIECE + windows),
                "{pieces:?}"
            );
        }
        assert!(pieces(1200).len() > 1);
    }

    #[test]
    fn the_counts_are_those_of_the_rows_whether_or_not_these_are_listed() {
        let windows = windows(600);
        let settings = ReportSettings {
            alpha: 0.2,
            method: Method::Asymptotic,
            ..ReportSettings::default()
        };
        let listed = compare_windows(&windows, &settings, LISTED).unwrap();
        let counted = compare_windows(&windows, &settings, 0).unwrap();
        assert_eq!(
            (listed.frame.height(), counted.frame.height()),
            (pairs_of(600), 0)
        );
        assert_eq!(listed.counts, counted.counts);
        let tallies = as_tallies(&listed.counts).unwrap();
        let letters: Vec<_> = tallies.iter().map(|tally| (&*tally.a, &*tally.b)).collect();
        assert_eq!(
            letters,
            [
                ("a", "a"),
                ("a", "b"),
                ("a", "c"),
                ("b", "b"),
                ("b", "c"),
                ("c", "c")
            ]
        );
        for tally in &tallies {
            let of_both = [&*tally.a, &*tally.b];
            let is_own = |it: &Comparison<'_>| [[it.a, it.b], [it.b, it.a]].contains(&of_both);
            let own: Vec<Comparison<'_>> = listed.rows().filter(is_own).collect();
            let rejected = own.iter().filter(|row| row.rejected).count();
            assert_eq!(
                (tally.pairs, tally.rejected, tally.in_the_limit),
                (own.len(), rejected, 0)
            );
            assert!(rejected > 0 && rejected < own.len());
        }
    }

    #[test]
    fn a_row_is_the_test_of_its_two_windows() {
        let windows = windows(9);
        let comparisons = compare_windows(&windows, &ReportSettings::default(), LISTED).unwrap();
        let pool = Pool::of(&windows.iter().map(|it| &*it.values).collect::<Vec<_>>()).unwrap();
        let rows: Vec<Comparison<'_>> = comparisons.rows().collect();
        assert_eq!(rows.len(), 36);
        for row in rows {
            let test = pool.pair(row.a_window as usize, row.b_window as usize, Procedure::default());
            assert_eq!((row.test.d, row.test.p, row.test.h), (test.d, test.p, test.h));
            assert_eq!((row.test.signed_d, row.test.at), test.signed_d());
            assert_eq!(row.a, windows[row.a_window as usize].scenario);
        }
    }

    #[test]
    fn nothing_to_compare_is_no_row_and_no_count() {
        for windows in [windows(0), windows(1)] {
            let comparisons = compare_windows(&windows, &ReportSettings::default(), LISTED).unwrap();
            assert_eq!((comparisons.rows().count(), comparisons.counts.height()), (0, 0));
            assert_eq!(comparisons.frame.width(), 15);
        }
    }
}
