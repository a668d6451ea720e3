//! Without polars no window is compared with another; what reads and tells of a run is there all the same, for fuzzing.

use super::{Comparison, FrameError, Tally, WindowValues};
use crate::{sample::Sample, settings::ReportSettings};

/// Always empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Comparisons;

impl Comparisons {
    /// Never one.
    pub fn rows(&self) -> impl Iterator<Item = Comparison<'_>> {
        std::iter::empty()
    }

    /// Never one.
    #[must_use]
    pub const fn between(&self, _: &str, _: &str) -> Vec<Comparison<'_>> {
        Vec::new()
    }

    /// Always.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        true
    }
}

/// Compares nothing.
///
/// # Errors
/// Never.
pub fn compare(_: &[Sample], _: &ReportSettings) -> Result<(Comparisons, Vec<Tally>), FrameError> {
    Ok(<_>::default())
}

/// Counts nothing.
///
/// # Errors
/// Never.
pub const fn tallies(_: &[WindowValues<'_>], _: &ReportSettings) -> Result<Vec<Tally>, FrameError> {
    Ok(Vec::new())
}
