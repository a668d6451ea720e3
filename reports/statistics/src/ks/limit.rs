//! P-values in the limit of large samples. They know nothing of ties. The main functions are [`asymptotic`] and
//! [`paper`]; both give p and its decimal logarithm.

use std::f64::consts::{LN_10, PI};

use super::Alternative;

/// Kolmogorov's and Smirnov's limit: λ = D √(nm / (n + m)).
pub(super) fn asymptotic(n: usize, m: usize, d: f64, alternative: Alternative) -> (f64, f64) {
    tail(d * root_of_effective_size(n, m), alternative)
}

/// The limit with Stephens's correction, λ = D (√e + 0.12 + 0.11 / √e) with e = nm / (n + m), which he gave for one
/// sample (*Use of the Kolmogorov-Smirnov, Cramér-von Mises and related statistics without extensive tables*, 1970) and
/// Numerical Recipes, MATLAB's `kstest2` and SciPy's `ks_2samp` before 1.3 took for two.
pub(super) fn paper(n: usize, m: usize, d: f64, alternative: Alternative) -> (f64, f64) {
    let root = root_of_effective_size(n, m);
    tail(d * (root + 0.12 + 0.11 / root), alternative)
}

fn root_of_effective_size(n: usize, m: usize) -> f64 {
    let (n, m) = (n as f64, m as f64);
    (n * (m / (n + m))).sqrt()
}

fn tail(lambda: f64, alternative: Alternative) -> (f64, f64) {
    match alternative {
        Alternative::TwoSided => kolmogorov_tail(lambda),
        Alternative::Less | Alternative::Greater => {
            let ln_p = -2.0 * lambda * lambda;
            (ln_p.exp(), ln_p / LN_10)
        }
    }
}

/// P(K ≥ λ) of Kolmogorov's distribution and its decimal logarithm: the series in λ where it converges fast, its theta
/// transform where λ is small.
pub(super) fn kolmogorov_tail(lambda: f64) -> (f64, f64) {
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
