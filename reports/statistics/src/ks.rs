//! The two-sample Kolmogorov-Smirnov test, exact and conditional on the observed ties.
//!
//! The distance is an integer: D = h / lcm(n, m), so that two distances compare without rounding. The p-value is the
//! share of all ways to deal the pooled values into samples of n and m whose distance is at least the observed one
//! (Schröer and Trenkler, *Exact and randomization distributions of Kolmogorov-Smirnov tests two or three samples*,
//! 1995), computed by the recursion of Viehmann (arXiv 2102.08037), which only ever adds positive terms: nothing
//! cancels, and p = 1e-233 is as exact as p = 0.1.
//!
//! One test is [`Procedure::test`], or [`test`] for what is usual; all pairs of many samples are a [`Pool`]. [`paths`]
//! has the recursion, [`scaled`] the numbers that do not underflow, [`limit`] the forms for large samples, [`tails`]
//! decides which of them gives the p-value.

mod columns;
mod distance;
mod limit;
mod numbers;
mod paths;
mod pool;
mod scaled;
mod tails;

use record::report_settings::Method;
use serde::{Deserialize, Serialize};

pub use columns::{Counting, PairColumns, PairCounts, key};
pub use numbers::{Numbers, NumbersError, read_numbers};
pub use pool::{Partners, Pool};
pub use tails::SharedTails;

/// What is asked of a test. By default the exact p-value, two-sided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Procedure {
    /// How p is computed.
    pub method: Method,
    /// Which distance counts.
    pub alternative: Alternative,
}

/// Which distance between the two distribution functions is tested.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Alternative {
    /// The larger one of both sides.
    #[default]
    TwoSided,
    /// That by which the first's lies below the second's: the first's values are larger.
    Less,
    /// That by which the first's lies above the second's: the first's values are smaller.
    Greater,
}

impl Alternative {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::TwoSided, Self::Less, Self::Greater];

    /// Its name in reports, as SciPy and R call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TwoSided => "two-sided",
            Self::Less => "less",
            Self::Greater => "greater",
        }
    }
}

/// The result of a test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct KsTest {
    /// Size of the first sample.
    pub n: usize,
    /// Size of the second sample.
    pub m: usize,
    /// The distance that was tested: `h / lcm`.
    pub d: f64,
    /// Its numerator.
    pub h: u64,
    /// Its denominator, the least common multiple of n and m.
    pub lcm: u64,
    /// D⁺: how far the first's distribution function comes to lie above the second's.
    pub above: Gap,
    /// D⁻: how far it comes to lie below.
    pub below: Gap,
    /// The p-value; 0 when it is below what a double can hold.
    pub p: f64,
    /// Its decimal logarithm, finite even then.
    pub log10_p: f64,
    /// What was tested.
    pub alternative: Alternative,
    /// How p was computed.
    pub method: Method,
}

/// The largest distance to one side.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Gap {
    /// In units of 1 / lcm.
    pub h: u64,
    /// The smallest value at which it is reached; none where the distance is 0.
    pub at: Option<f64>,
}

impl KsTest {
    /// The distance that was tested, negative where the first's distribution function lies below the second's, and the
    /// value at which it is reached. Where both sides are as far, it is the one above.
    #[must_use]
    pub fn signed_d(&self) -> (f64, Option<f64>) {
        let is_above = match self.alternative {
            Alternative::TwoSided => self.above.h >= self.below.h,
            Alternative::Greater => true,
            Alternative::Less => false,
        };
        match is_above {
            true => (self.d, self.above.at),
            // Not −0.
            false => (0.0 - self.d, self.below.at),
        }
    }
}

/// Which of the samples, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ordinal(pub usize);

impl std::fmt::Display for Ordinal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            0 => f.write_str("first"),
            1 => f.write_str("second"),
            later => write!(f, "{}.", later + 1),
        }
    }
}

/// Why samples cannot be compared.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum KsError {
    /// A sample without values.
    #[error("the {which} sample is empty")]
    Empty {
        /// The first sample or the second.
        which: Ordinal,
    },
    /// A value that is not a number or not finite.
    #[error("value {position} of the {which} sample is {value}, which has no place in an order")]
    NotFinite {
        /// The first sample or the second.
        which: Ordinal,
        /// Where, from 1.
        position: usize,
        /// The number.
        value: f64,
    },
    /// More values than are counted here.
    #[error("the samples have {values} values in all, and 4294967295 can be ranked")]
    TooMany {
        /// How many.
        values: usize,
    },
}

impl KsError {
    /// What to do about it.
    #[must_use]
    pub const fn hint(&self) -> &'static str {
        match self {
            Self::Empty { .. } => "a test needs at least one value on each side",
            Self::NotFinite { .. } => "remove the value, or find out what produced it",
            Self::TooMany { .. } => "compare fewer samples at a time",
        }
    }
}

/// Compares two samples: exactly, two-sided.
///
/// # Errors
/// When a sample is empty or has a value that is NaN or infinite.
pub fn test(x: &[f64], y: &[f64]) -> Result<KsTest, KsError> {
    Procedure::default().test(x, y)
}

impl Procedure {
    /// Compares two samples.
    ///
    /// # Errors
    /// When a sample is empty or has a value that is NaN or infinite.
    pub fn test(self, x: &[f64], y: &[f64]) -> Result<KsTest, KsError> {
        Ok(Pool::of(&[x, y])?.pair(0, 1, self))
    }

    /// The smallest p-value that samples of n and m can have, when all values of the one lie below all of the other. 1
    /// when a sample is empty, since nothing can then be rejected.
    #[must_use]
    pub fn smallest_p(self, n: usize, m: usize) -> f64 {
        let limit = match self.method {
            Method::Exact => {
                let two_sided = smallest_attainable_p(n, m);
                return match self.alternative {
                    Alternative::TwoSided => two_sided,
                    Alternative::Less | Alternative::Greater => two_sided / 2.0,
                };
            }
            Method::Asymptotic => limit::asymptotic,
            Method::Paper => limit::paper,
        };
        match n.min(m) {
            0 => 1.0,
            _ => limit(n, m, 1.0, self.alternative).0,
        }
    }
}

/// The smallest p-value that samples of n and m without ties can have, when all values of the one lie below all of the
/// other: `2 / C(n + m, n)`. 1 when a sample is empty, since nothing can then be rejected.
#[must_use]
pub fn smallest_attainable_p(n: usize, m: usize) -> f64 {
    if n == 0 || m == 0 {
        return 1.0;
    }
    let (few, many) = (n.min(m), n.max(m));
    // 1 / C(n+m, few) as a product, which never overflows; below the smallest double it is 0 and stays it.
    let mut p = 2.0;
    for k in 1..=few {
        p *= k as f64 / (many + k) as f64;
        if p == 0.0 {
            break;
        }
    }
    p.min(1.0)
}

#[cfg(test)]
mod tests;
