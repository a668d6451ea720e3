//! How much the values within a window depend on each other: autocorrelation, and how many independent values they are
//! worth. The main type is [`Dependence`].
//!
//! ```text
//! ρ(k) = Σ (x_t − x̄)(x_{t+k} − x̄) / Σ (x_t − x̄)²        over all windows, each around its own mean
//! τ = 1 + 2 Σ ρ(k)                                         n_eff = n / τ
//! ```
//!
//! The sum ends where Geyer's initial positive sequence does (*Practical Markov Chain Monte Carlo*, 1992): ρ(2m) +
//! ρ(2m + 1) is added as long as it is positive. It needs no window width to be chosen, as Sokal's rule does, and with 60
//! values that choice would matter more than the estimate. τ is taken to be at least 1: that negative correlation made
//! values worth more than they are is not believed.
//!
//! Around the mean of a window of l values ρ is estimated too small by some (1 + 4ρ)/l (Kendall, *Note on bias in the estimation of
//! autocorrelation*, 1954), which for 60 values of an AR(1) process with φ = 0.9 makes half of τ. So τ is also at least that of
//! an AR(1) process with the corrected ρ(1), (1 + ρ)/(1 − ρ), though no more
//! than half of a window: beyond, so few values say nothing of it.

/// The dependence within the windows of one scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Dependence {
    /// ρ(1), ρ(2), … up to where Geyer's sequence ends, and at least ρ(1).
    pub autocorrelation: Vec<f64>,
    /// Integrated autocorrelation time τ, in periods; at least 1.
    pub time: f64,
    /// Values in all windows.
    pub n: usize,
    /// Independent values they are worth.
    pub effective: f64,
}

impl Dependence {
    /// That of some windows; none where no window has two values that differ.
    #[must_use]
    pub fn of(windows: &[&[f64]]) -> Option<Self> {
        let centred: Vec<Vec<f64>> = windows
            .iter()
            .filter(|window| !window.is_empty())
            .map(|window| {
                let mean = window.iter().sum::<f64>() / window.len() as f64;
                window.iter().map(|value| value - mean).collect()
            })
            .collect();
        let n = centred.iter().map(Vec::len).sum();
        let longest = centred.iter().map(Vec::len).max()?;
        let covariance = |lag: usize| -> f64 {
            centred
                .iter()
                .flat_map(|values| values.iter().zip(values.iter().skip(lag)))
                .map(|(a, b)| a * b)
                .sum()
        };
        let variance = covariance(0);
        let largest = windows
            .iter()
            .flat_map(|w| w.iter())
            .fold(0.0_f64, |most, v| most.max(v.abs()));
        // Equal values differ from their mean by rounding.
        if longest < 2 || variance <= n as f64 * (largest * 1e-12).powi(2) {
            return None;
        }
        let rho = |lag: usize| covariance(lag) / variance;
        let mut autocorrelation = vec![rho(1)];
        // ρ(0) + ρ(1), then ρ(2) + ρ(3), …
        let mut pair = 1.0 + rho(1);
        let mut sum = 0.0;
        let mut lag = 2;
        while pair > 0.0 {
            sum += pair;
            if lag + 1 >= longest {
                break;
            }
            let (even, odd) = (rho(lag), rho(lag + 1));
            pair = even + odd;
            if pair > 0.0 {
                autocorrelation.extend([even, odd]);
            }
            lag += 2;
        }
        let length = n as f64 / centred.len() as f64;
        let corrected = rho(1) + (1.0 + 4.0 * rho(1)) / length;
        let of_ar1 = if corrected < 1.0 {
            (1.0 + corrected) / (1.0 - corrected)
        } else {
            f64::INFINITY
        };
        // An estimate within its own error of 0 is none of dependence.
        let of_ar1 = if corrected > 2.0 / (n as f64).sqrt() {
            of_ar1.min(length / 2.0)
        } else {
            1.0
        };
        let time = (2.0 * sum - 1.0).max(of_ar1).max(1.0);
        Some(Self {
            autocorrelation,
            time,
            n,
            effective: n as f64 / time,
        })
    }

    /// The block of some windows; one value where nothing is known of them.
    #[must_use]
    pub fn block_of(windows: &[&[f64]]) -> usize {
        Self::of(windows).map_or(1, |found| found.block())
    }

    /// ρ(1).
    #[must_use]
    pub fn lag_one(&self) -> f64 {
        self.autocorrelation.first().copied().unwrap_or(0.0)
    }

    /// Values in a block that is about independent of the next: twice the autocorrelation time, and one where values
    /// are independent.
    #[must_use]
    pub fn block(&self) -> usize {
        if self.time > 1.0 {
            (2.0 * self.time).ceil() as usize
        } else {
            1
        }
    }
}

/// Values as AR(1) noise around a level of each window's own, fitted by moments.
///
/// A window's values stand around its own mean, which follows them: 60 values of φ = 0.9 have a lag-one autocorrelation of 0.84 and
/// an autocorrelation time of 9 by [`Dependence`], in place of 0.9 and 19 (Marriott and Pope 1954, Kendall 1954). φ is the one whose
/// *expected* sums are in the ratio of those found, exactly for the windows' lengths,
///
/// ```text
/// E Σ (x_t − x̄)²                 = σ² N (1 − V)
/// E Σ (x_t − x̄)(x_{t+1} − x̄)    = σ² ((N − 1) φ − (N + 1) V + 2 g)
/// V = Var(x̄) / σ²,  g = (1 − φᴺ) / (N (1 − φ))
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ar1 {
    /// Autocorrelation of neighbouring values, from 0 to [`Ar1::LARGEST`].
    pub phi: f64,
    /// Variance of the values around the level of their window.
    pub variance: f64,
}

impl Ar1 {
    /// Above it, a window of some hundred values is one value.
    pub const LARGEST: f64 = 0.99;

    /// That of some windows; none where no window has two values that differ.
    #[must_use]
    pub fn of(windows: &[&[f64]]) -> Option<Self> {
        let found = Dependence::of(windows)?;
        let lengths = || {
            let lengths = windows.iter().map(|window| window.len());
            lengths.filter(|length| *length > 0)
        };
        let squares = |phi: f64| -> f64 {
            let of = |n: usize| n as f64 * (1.0 - Self::variance_share(n, phi));
            lengths().map(of).sum()
        };
        let products = |phi: f64| -> f64 {
            let of = |n: usize| {
                let (length, v) = (n as f64, Self::variance_share(n, phi));
                let g = (1.0 - phi.powf(length)) / (length * (1.0 - phi));
                (length - 1.0) * phi - (length + 1.0) * v + 2.0 * g
            };
            lengths().map(of).sum()
        };
        // The ratio grows with φ.
        let is_less = |phi: f64| products(phi) < found.lag_one() * squares(phi);
        let (mut low, mut high) = (0.0, Self::LARGEST);
        if !is_less(low) {
            high = low;
        } else if is_less(high) {
            low = high;
        }
        while high - low > 1e-6 {
            let middle = f64::midpoint(low, high);
            if is_less(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        let sum: f64 = windows
            .iter()
            .filter(|window| !window.is_empty())
            .map(|window| {
                let mean = window.iter().sum::<f64>() / window.len() as f64;
                window.iter().map(|value| (value - mean).powi(2)).sum::<f64>()
            })
            .sum();
        Some(Self {
            phi: high,
            variance: sum / squares(high),
        })
    }

    /// Integrated autocorrelation time τ, in values.
    #[must_use]
    pub fn time(&self) -> f64 {
        (1.0 + self.phi) / (1.0 - self.phi)
    }

    /// Variance of the mean of a window of n values around the window's level.
    #[must_use]
    pub fn variance_of_mean(&self, n: usize) -> f64 {
        self.variance * Self::variance_share(n, self.phi)
    }

    /// V: of one value's variance, the share that a mean of n has.
    fn variance_share(n: usize, phi: f64) -> f64 {
        let n = n as f64;
        let rest = 1.0 - phi;
        let products = (n * phi * rest - phi * (1.0 - phi.powf(n))) / (rest * rest);
        (n + 2.0 * products) / (n * n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise_model::Noise;

    // Closed form for AR(1): ρ(k) = φ^k and τ = (1 + φ)/(1 − φ).
    #[rstest::rstest]
    #[case(0.0, 1.0)]
    #[case(0.5, 3.0)]
    #[case(0.9, 19.0)]
    fn ar1_noise_has_the_time_of_its_closed_form(#[case] phi: f64, #[case] time: f64) {
        let mut noise = Noise::new(3);
        let windows: Vec<Vec<f64>> = (0..4).map(|_| noise.ar1(20_000, phi)).collect();
        let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
        let found = Dependence::of(&windows).unwrap();
        assert!((found.lag_one() - phi).abs() < 0.02, "{}", found.lag_one());
        assert!((found.time / time - 1.0).abs() < 0.1, "{}", found.time);
    }

    // Of 12 windows of 60 values, 300 times. By Geyer's sequence the mean τ is 2.6, 4.3, 8.8 of 3, 5.67, 19.
    #[rstest::rstest]
    #[case(0.0, 1.0)]
    #[case(0.5, 3.0)]
    #[case(0.7, 17.0 / 3.0)]
    #[case(0.9, 19.0)]
    fn the_fitted_noise_has_the_time_of_its_closed_form_also_in_short_windows(
        #[case] phi: f64,
        #[case] time: f64,
    ) {
        // All three are convex in φ, so that the error of φ makes them too large: by a tenth at 0.9.
        const TO: f64 = 0.125;
        let mut noise = Noise::new(4);
        let fits: Vec<Ar1> = (0..300)
            .map(|_| {
                let windows: Vec<Vec<f64>> = (0..12).map(|_| noise.ar1(60, phi)).collect();
                let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
                Ar1::of(&windows).unwrap()
            })
            .collect();
        let mean = |of: fn(&Ar1) -> f64| fits.iter().map(of).sum::<f64>() / fits.len() as f64;
        let (found, variance) = (mean(Ar1::time), mean(|fit| fit.variance));
        assert!((found / time - 1.0).abs() < TO, "{found}");
        assert!((variance - 1.0).abs() < TO, "{variance}");
        // The window's level is 0 in truth: its mean has this variance.
        let of_mean = mean(|fit| fit.variance_of_mean(60));
        let expected = Ar1 { phi, variance: 1.0 }.variance_of_mean(60);
        assert!((of_mean / expected - 1.0).abs() < TO, "{of_mean} {expected}");
    }

    #[test]
    fn a_mean_of_two_has_the_variance_that_their_covariance_leaves() {
        let two = Ar1 {
            phi: 0.4,
            variance: 2.0,
        };
        assert!((two.variance_of_mean(2) - 1.4).abs() < 1e-12);
        assert!((two.variance_of_mean(1) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_hardly_noise_is_fitted_at_the_ends() {
        let rising: Vec<f64> = (0..60).map(f64::from).collect();
        assert_eq!(Ar1::of(&[&rising]).unwrap().phi, Ar1::LARGEST);
        let jagged: Vec<f64> = (0..60).map(|at| f64::from(at % 2)).collect();
        assert_eq!(Ar1::of(&[&jagged]).unwrap().phi, 0.0);
        assert_eq!(Ar1::of(&[&[1.0]]), None);
    }

    // As long as windows are. Without a correction the mean is 8.7 where 19 is true, as until version 0.1.
    #[rstest::rstest]
    #[case(0.0, 1.0, 1.4)]
    #[case(0.5, 2.4, 3.6)]
    #[case(0.9, 13.0, 24.0)]
    fn windows_of_sixty_values_have_about_the_time_of_the_closed_form(
        #[case] phi: f64,
        #[case] low: f64,
        #[case] high: f64,
    ) {
        let mut noise = Noise::new(4);
        let mut time = || {
            let windows: Vec<Vec<f64>> = (0..4).map(|_| noise.ar1(60, phi)).collect();
            let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
            Dependence::of(&windows).unwrap().time
        };
        let mean = (0..200).map(|_| time()).sum::<f64>() / 200.0;
        assert!((low..high).contains(&mean), "{mean}");
    }

    #[test]
    fn a_window_is_worth_two_values_or_more_however_steadily_it_rises() {
        let rising: Vec<f64> = (0..20).map(f64::from).collect();
        let found = Dependence::of(&[&rising, &rising]).unwrap();
        assert!(found.effective >= 4.0 - 1e-9, "{found:?}");
    }

    // Expected: statsmodels.tsa.stattools.acf([...], nlags=3); reports/statistics/tests/data/window_tests.py.
    #[test]
    fn a_windows_autocorrelation_is_that_of_statsmodels() {
        let found = Dependence::of(&[&[1.0, 2.0, 4.0, 3.0, 5.0, 6.0, 5.0, 7.0]]).unwrap();
        let expected = [0.410_714_285_7, 0.232_683_982_7, 0.102_272_727_3];
        for (found, expected) in found.autocorrelation.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found}");
        }
    }

    #[test]
    fn negative_correlation_makes_no_value_worth_more_than_one() {
        let found = Dependence::of(&[&[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0]]).unwrap();
        assert!(found.lag_one() < -0.8);
        assert_eq!((found.time, found.effective, found.block()), (1.0, 8.0, 1));
    }

    #[test]
    fn windows_at_different_levels_are_no_correlation_within_them() {
        let found = Dependence::of(&[&[1.0, 2.0, 1.0, 2.0, 1.5], &[9.0, 8.0, 9.0, 8.0, 8.5]]).unwrap();
        assert!(found.lag_one() < 0.0);
    }

    #[rstest::rstest]
    #[case(&[])]
    #[case(&[&[][..]])]
    #[case(&[&[1.0][..]])]
    #[case(&[&[0.1, 0.1, 0.1][..]])]
    fn without_two_values_that_differ_there_is_none(#[case] windows: &[&[f64]]) {
        assert_eq!(Dependence::of(windows), None);
    }
}
