//! The two-sample Kolmogorov-Smirnov test, exact and conditional on the observed ties.
//!
//! The distance is an integer: D = h / lcm(n, m), so that two distances compare without rounding. The p-value is the
//! share of all ways to deal the pooled values into samples of n and m whose distance is at least the observed one
//! (Schröer and Trenkler, *Exact and randomization distributions of Kolmogorov-Smirnov tests two or three samples*,
//! 1995), computed by the recursion of Viehmann (arXiv 2102.08037), which only ever adds positive terms: nothing
//! cancels, and p = 1e-233 is as exact as p = 0.1. [`paths`] has the recursion, [`scaled`] the numbers that do not
//! underflow. The main type is [`KsTest`], made by [`test`].

mod numbers;
mod paths;
mod scaled;

use std::f64::consts::{LN_10, PI};

use serde::Serialize;

pub use numbers::{NumbersError, read_numbers};

/// Cells of the recursion up to which the exact p-value is computed: a few seconds. n = m = 30 000 is within it at
/// any distance, larger samples when they are as close as those are that the test does not tell apart at once.
const EXACT_CELLS: u64 = 2_000_000_000;

/// The result of a test.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KsTest {
    /// Size of the first sample.
    pub n: usize,
    /// Size of the second sample.
    pub m: usize,
    /// The largest distance between the two empirical distribution functions: `h / lcm`.
    pub d: f64,
    /// Its numerator.
    pub h: u64,
    /// Its denominator, the least common multiple of n and m.
    pub lcm: u64,
    /// The two-sided p-value; 0 when it is below what a double can hold.
    pub p: f64,
    /// Its decimal logarithm, finite even then.
    pub log10_p: f64,
    /// How p was computed.
    pub method: Method,
}

/// How a p-value was computed. It decides verdicts, so it is printed with each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Exact, conditional on the ties.
    Exact,
    /// Kolmogorov's limit for large samples, which knows nothing of ties.
    Asymptotic,
}

impl Method {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Asymptotic => "asymptotic",
        }
    }
}

/// Which of the two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Which {
    /// The first.
    First,
    /// The second.
    Second,
}

impl std::fmt::Display for Which {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::First => "first",
            Self::Second => "second",
        })
    }
}

/// Why two samples cannot be compared.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum KsError {
    /// A sample without values.
    #[error("the {which} sample is empty")]
    Empty {
        /// Which.
        which: Which,
    },
    /// A value that is not a number or not finite.
    #[error("value {position} of the {which} sample is {value}, which has no place in an order")]
    NotFinite {
        /// Which.
        which: Which,
        /// Where, from 1.
        position: usize,
        /// What.
        value: f64,
    },
}

impl KsError {
    /// What to do about it.
    #[must_use]
    pub const fn hint(&self) -> &'static str {
        match self {
            Self::Empty { .. } => "a test needs at least one value on each side",
            Self::NotFinite { .. } => "remove the value, or find out what produced it",
        }
    }
}

/// Compares two samples.
///
/// # Errors
/// When a sample is empty or has a value that is NaN or infinite.
pub fn test(x: &[f64], y: &[f64]) -> Result<KsTest, KsError> {
    let x = sorted(x, Which::First)?;
    let y = sorted(y, Which::Second)?;
    let steps = Steps::of(x.len() as u64, y.len() as u64);
    let pooled = Pooled::of(&x, &y, steps);
    let lcm = steps.of_x * x.len() as u64;
    let d = pooled.h as f64 / lcm as f64;
    let band = paths::Band {
        n: x.len(),
        m: y.len(),
        step_x: steps.of_x,
        step_y: steps.of_y,
        h: pooled.h,
    };
    let exact = band.cells() <= EXACT_CELLS;
    let (p, log10_p) = if exact {
        band.share_leaving(&pooled.ends)
    } else {
        let (n, m) = (x.len() as f64, y.len() as f64);
        kolmogorov_tail(d * (n * (m / (n + m))).sqrt())
    };
    Ok(KsTest {
        n: x.len(),
        m: y.len(),
        d,
        h: pooled.h,
        lcm,
        p,
        log10_p,
        method: if exact { Method::Exact } else { Method::Asymptotic },
    })
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

fn sorted(values: &[f64], which: Which) -> Result<Vec<f64>, KsError> {
    if values.is_empty() {
        return Err(KsError::Empty { which });
    }
    if let Some(at) = values.iter().position(|value| !value.is_finite()) {
        return Err(KsError::NotFinite {
            which,
            position: at + 1,
            value: values[at],
        });
    }
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    Ok(values)
}

/// By how much one value of each sample moves the distance, in units of 1 / lcm.
#[derive(Debug, Clone, Copy)]
struct Steps {
    of_x: u64,
    of_y: u64,
}

impl Steps {
    fn of(n: u64, m: u64) -> Self {
        let (mut divisor, mut rest) = (n, m);
        while rest != 0 {
            (divisor, rest) = (rest, divisor % rest);
        }
        Self {
            of_x: m / divisor,
            of_y: n / divisor,
        }
    }
}

/// Two sorted samples merged.
struct Pooled {
    /// The distance, in units of 1 / lcm.
    h: u64,
    /// How many pooled values there are up to and including each distinct one: where the distance is looked at.
    ends: Vec<usize>,
}

impl Pooled {
    fn of(x: &[f64], y: &[f64], steps: Steps) -> Self {
        let (mut i, mut j, mut h) = (0, 0, 0);
        let mut ends = Vec::with_capacity(x.len() + y.len());
        while let Some(value) = smaller(x.get(i), y.get(j)) {
            i += x[i..].iter().take_while(|other| **other == value).count();
            j += y[j..].iter().take_while(|other| **other == value).count();
            h = h.max((i as u64 * steps.of_x).abs_diff(j as u64 * steps.of_y));
            ends.push(i + j);
        }
        Self { h, ends }
    }
}

fn smaller(a: Option<&f64>, b: Option<&f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(*b)),
        (one, other) => one.or(other).copied(),
    }
}

/// P(K ≥ λ) of Kolmogorov's distribution and its decimal logarithm: the series in λ where it converges fast, its theta
/// transform where λ is small.
fn kolmogorov_tail(lambda: f64) -> (f64, f64) {
    if lambda < 0.2 {
        // The distribution function is below 1e-12 here.
        return (1.0, 0.0);
    }
    if lambda < 1.0 {
        let below: f64 = (1..=20)
            .map(|k| (-f64::from(2 * k - 1).powi(2) * PI * PI / (8.0 * lambda * lambda)).exp())
            .sum();
        let p = (1.0 - (2.0 * PI).sqrt() / lambda * below).clamp(0.0, 1.0);
        return (p, p.log10());
    }
    // 2 exp(-2λ²) times a series that is near 1: the logarithm stays finite.
    let series: f64 = (1..=20)
        .map(|k: i32| {
            let sign = if k % 2 == 1 { 1.0 } else { -1.0 };
            sign * (-2.0 * f64::from(k * k - 1) * lambda * lambda).exp()
        })
        .sum();
    let ln_p = (2.0 * series).ln() - 2.0 * lambda * lambda;
    (ln_p.exp().min(1.0), (ln_p / LN_10).min(0.0))
}

#[cfg(test)]
mod tests;
