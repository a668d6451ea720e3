//! A night against others that were chosen as the baseline. The main functions are [`judge`] and [`Expectation::of`].
//!
//! With four nights or more, the new one is held against Student's prediction interval for one more night (Hahn, *Factors
//! for calculating two-sided prediction intervals for samples from a normal distribution*, JASA 64, 1969):
//!
//! ```text
//! T = |x − mean| / (s · √(1/k + 1/n))        t with n − 1 degrees of freedom; x the mean of k nights, here one
//! ```
//!
//! With fewer, how much nights differ anyway cannot be known. Then the windows are the units, in the exact permutation test
//! of means, and the report says what that is blind to.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{
    Cause, Drift, Finding, Judgement, Kind, Lack, Metric, Night, Settings, Verdict,
    series::{Point, Series, level_of, remarks, series_of},
};
use crate::{multiplicity::holm, permutation, power, relabelling::Effort};

/// The fewest nights that say how much nights differ.
pub const FEWEST_NIGHTS: usize = 4;

/// What more nights are expected to be, from those before them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expectation {
    mean: f64,
    /// The standard deviation of nights.
    spread: f64,
    /// How many nights it is from.
    nights: f64,
}

impl Expectation {
    /// From the levels of nights; none of fewer than [`FEWEST_NIGHTS`], or of equal ones.
    #[must_use]
    pub fn of(levels: &[f64]) -> Option<Self> {
        if levels.len() < FEWEST_NIGHTS {
            return None;
        }
        let count = levels.len() as f64;
        let mean = levels.iter().sum::<f64>() / count;
        let squares: f64 = levels.iter().map(|level| (level - mean).powi(2)).sum();
        let spread = (squares / (count - 1.0)).sqrt();
        // Sums of equal numbers differ by rounding.
        (spread > mean.abs() * 1e-12).then_some(Self {
            mean,
            spread,
            nights: count,
        })
    }

    /// Their mean.
    pub(super) const fn mean(&self) -> f64 {
        self.mean
    }

    /// The standard deviation of nights.
    pub(super) const fn spread(&self) -> f64 {
        self.spread
    }

    /// The probability of nights whose mean is as far off as that of these, or further; 1 of none.
    #[must_use]
    pub fn p(&self, newest: &[f64]) -> f64 {
        if newest.is_empty() {
            return 1.0;
        }
        let mean = newest.iter().sum::<f64>() / newest.len() as f64;
        let t = (mean - self.mean).abs() / self.deviation(newest.len() as f64);
        self.student().map_or(1.0, |student| 2.0 * student.sf(t))
    }

    /// The jump of one night that a test at that level finds with [`power::POWER`].
    #[must_use]
    pub fn detectable(&self, level: f64) -> f64 {
        self.student().map_or(f64::INFINITY, |student| {
            (student.inverse_cdf(1.0 - level / 2.0) + student.inverse_cdf(power::POWER)) * self.deviation(1.0)
        })
    }

    /// The standard deviation of the mean of so many nights from the mean.
    fn deviation(&self, count: f64) -> f64 {
        self.spread * (1.0 / count + 1.0 / self.nights).sqrt()
    }

    fn student(&self) -> Option<StudentsT> {
        StudentsT::new(0.0, 1.0, self.nights - 1.0).ok()
    }
}

/// What a comparison of one series came to, before it is known how many there are.
struct Comparison {
    p: f64,
    /// None where no p can be small enough.
    detectable: Option<f64>,
}

/// Judges the last of the nights against all others.
#[must_use]
pub fn judge(nights: &[Night], settings: &Settings) -> Drift {
    let mut series = series_of(nights);
    let has_nights = |it: &Series<'_>| it.points.len() > FEWEST_NIGHTS;
    let mut remarks = remarks(nights);
    // There is one a night, and none of the nights says how much nights differ.
    series.retain(|it| it.metric != Metric::Provisioning || has_nights(it));
    if series.iter().any(|it| !has_nights(it)) {
        remarks.push(format!(
            "with fewer than {FEWEST_NIGHTS} runs as the baseline windows are the units: how much nights differ anyway is not \
             known, and a difference may be no more than that"
        ));
    }
    let level = settings.alpha / series.len().max(1) as f64;
    let compared: Vec<Result<Comparison, Verdict>> = series
        .iter()
        .map(|series| compare(series, level, settings.seed))
        .collect();
    let p: Vec<f64> = compared
        .iter()
        .map(|compared| compared.as_ref().map_or(1.0, |it| it.p))
        .collect();
    let judgements = series
        .iter()
        .zip(compared)
        .zip(holm(&p))
        .map(|((series, compared), p)| match compared {
            Ok(comparison) => judgement(series, &comparison, p, nights, settings),
            Err(verdict) => Judgement {
                scenario: series.scenario.clone(),
                metric: series.metric,
                verdict,
                nights: series.points.len(),
                findings: Vec::new(),
            },
        })
        .collect();
    Drift {
        nights: nights.iter().map(|night| night.run.clone()).collect(),
        judgements,
        remarks,
    }
}

/// What a series has to say that has no number tonight.
pub(super) fn lacking(series: &Series<'_>) -> Option<Verdict> {
    Some(match series.lack.clone()? {
        Lack::Invalid(reason) => Verdict::Invalid { reason },
        Lack::Absent(reason) | Lack::NotAsked(reason) => Verdict::TooLittle { reason },
    })
}

fn compare(series: &Series<'_>, level: f64, seed: u64) -> Result<Comparison, Verdict> {
    if let Some(lacking) = lacking(series) {
        return Err(lacking);
    }
    let too_little = |reason: String| Verdict::TooLittle { reason };
    let Some((tonight, before)) = series
        .points
        .split_last()
        .filter(|(_, before)| !before.is_empty())
    else {
        return Err(too_little("no run of the baseline has a number".to_owned()));
    };
    let levels: Vec<f64> = before.iter().map(|point| point.level).collect();
    if before.len() >= FEWEST_NIGHTS {
        let Some(expectation) = Expectation::of(&levels) else {
            return Err(too_little(
                "all runs of the baseline have the very same number".to_owned(),
            ));
        };
        return Ok(Comparison {
            p: expectation.p(&[tonight.level]),
            detectable: Some(expectation.detectable(level)),
        });
    }
    let values = |point: &Point<'_>| {
        point
            .measured
            .values
            .get(&series.metric)
            .cloned()
            .unwrap_or_default()
    };
    let (a, b): (Vec<f64>, Vec<f64>) = (before.iter().flat_map(values).collect(), values(tonight));
    let Some(test) = permutation::mean_difference(&a, &b, Effort::of_a_report(seed)) else {
        return Err(too_little("there is no window".to_owned()));
    };
    if permutation::smallest_p(a.len(), b.len()) >= level {
        return Err(too_little(format!(
            "{} windows against {} have no p below {:.4}, and that is asked for among so many: measure more, or give \
             {FEWEST_NIGHTS} runs as the baseline",
            b.len(),
            a.len(),
            level
        )));
    }
    Ok(Comparison {
        p: test.p,
        detectable: power::pooled_spread([a.as_slice(), &b])
            .and_then(|spread| power::detectable_shift(a.len(), b.len(), spread, level)),
    })
}

fn judgement(
    series: &Series<'_>,
    comparison: &Comparison,
    p: f64,
    nights: &[Night],
    settings: &Settings,
) -> Judgement {
    let mut findings = Vec::new();
    if p < settings.alpha
        && let Some((tonight, before)) = series.points.split_last()
        && let Some(last) = before.last()
    {
        let level_before = level_of(before);
        let known = &settings.acknowledgements;
        findings.push(Finding {
            kind: Kind::FromBaseline,
            before: last.run.to_owned(),
            since: tonight.run.to_owned(),
            level_before,
            level_since: tonight.level,
            p,
            cause: Cause::between(last.measured, tonight.measured),
            acknowledged: known
                .of(nights, &series.scenario, series.metric, tonight.run)
                .cloned(),
            immaterial: settings.is_immaterial(series.metric, tonight.level - level_before),
        });
    }
    let verdict = match (findings.iter().any(Finding::is_news), comparison.detectable) {
        (true, _) => Verdict::Drift,
        (false, Some(detectable)) => Verdict::NoDrift { detectable },
        (false, None) => Verdict::TooLittle {
            reason: "there are too few windows for any p to be small enough".to_owned(),
        },
    };
    Judgement {
        scenario: series.scenario.clone(),
        metric: series.metric,
        verdict,
        nights: series.points.len(),
        findings,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_more_night_is_expected_where_hahns_factor_says() {
        // n = 5, s = 1: the 95 % prediction interval is ±t(0.975, 4)·√(6/5) = ±2.776·1.0954 = ±3.04 (Hahn 1969, table 1).
        let levels = [-1.0, -1.0, 0.0, 1.0, 1.0];
        let expectation = Expectation::of(&levels).unwrap();
        let p = expectation.p(&[3.041]);
        assert!((p - 0.05).abs() < 1e-3, "{p}");
        assert_eq!((expectation.p(&[0.0]), expectation.p(&[])), (1.0, 1.0));
        assert!(expectation.p(&[3.0, 3.1]) < p, "two nights say more");
    }

    #[test]
    fn nothing_is_expected_of_three_nights_or_of_equal_ones() {
        assert_eq!(Expectation::of(&[1.0, 2.0, 3.0]), None);
        assert_eq!(Expectation::of(&[1.0; 9]), None);
    }

    #[test]
    fn a_stricter_level_finds_only_larger_jumps() {
        let expectation = Expectation::of(&[1.0, 2.0, 3.0, 2.0, 1.0, 3.0]).unwrap();
        assert!(expectation.detectable(0.001) > expectation.detectable(0.01));
    }
}
