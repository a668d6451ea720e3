//! All pairs of windows compared, within each scenario and between each two. The comparisons are one polars frame, a row
//! for each, and what the paper tables are sums of its rows by keys. The main type is [`Comparisons`], made by
//! [`compare`].

mod frame;

use std::{borrow::Cow, sync::Arc};

pub(crate) use frame::sums;
pub use frame::{Comparisons, compare, tallies};

use record::report_settings::Method;

use crate::analysis::{pairs::OfPair, sample::Sample};

/// How many comparisons are listed: those of a thousand windows, in some 200 MB. Of more the counts are kept.
pub const LISTED: usize = 500_000;

/// One test of one window against another: a row of the frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison<'a> {
    /// Letter of the first scenario.
    pub a: &'a str,
    /// Its window.
    pub a_window: u32,
    /// Letter of the second scenario; the same one within a scenario.
    pub b: &'a str,
    /// Its window.
    pub b_window: u32,
    /// The test's result.
    pub test: TestResult,
    /// Whether p is below α.
    pub rejected: bool,
}

/// What [`statistics::ks::KsTest`] found, as far as it is listed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TestResult {
    /// Size of the first sample.
    pub n: u64,
    /// Size of the second sample.
    pub m: u64,
    /// The distance: `h / lcm`.
    pub d: f64,
    /// Its numerator.
    pub h: u64,
    /// Its denominator.
    pub lcm: u64,
    /// The p-value; 0 when it is below what a double can hold.
    pub p: f64,
    /// Its decimal logarithm.
    pub log10_p: f64,
    /// The distance with its sign: negative where the first's distribution function lies below the second's.
    pub signed_d: f64,
    /// The value at which it is reached; none where it is 0.
    pub at: Option<f64>,
    /// How p was computed.
    pub method: Method,
}

/// How many window pairs of two scenarios, or of one, were rejected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tally {
    /// Letter of the first scenario. Of a thousand scenarios there are half a million pairs, which share their letters.
    pub a: Arc<str>,
    /// Letter of the second.
    pub b: Arc<str>,
    /// Window pairs compared; never 0.
    pub pairs: usize,
    /// Those of them that were rejected.
    pub rejected: usize,
    /// Those of them whose p-value is not of the method that was asked for, since the samples are large.
    pub in_the_limit: usize,
}

impl OfPair for Tally {
    fn letters(&self) -> (&str, &str) {
        (&self.a, &self.b)
    }
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

impl<'a> From<&'a Sample> for WindowValues<'a> {
    fn from(sample: &'a Sample) -> Self {
        Self {
            scenario: &sample.scenario,
            window: sample.window,
            values: Cow::Borrowed(&sample.values),
        }
    }
}

/// The comparisons could not be counted.
#[derive(Debug, thiserror::Error)]
#[error("the comparisons cannot be counted: {0}")]
pub struct FrameError(String);

impl From<polars::error::PolarsError> for FrameError {
    fn from(error: polars::error::PolarsError) -> Self {
        Self(error.to_string())
    }
}

/// How many pairs so many samples have.
#[must_use]
pub const fn pairs_of(samples: usize) -> usize {
    samples * samples.saturating_sub(1) / 2
}
