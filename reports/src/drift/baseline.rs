//! A night against others that were chosen as the baseline. The main function is [`judge`].
//!
//! With four nights or more, the new one is held against what these predict of one more ([`Prediction`]). With fewer, how much
//! nights differ anyway cannot be known. Then the windows are the units, in the exact permutation test of means, and the
//! report says what that is blind to.

use statistics::{
    multiplicity::holm,
    permutation, power,
    prediction::{FEWEST_NIGHTS, Prediction},
    relabelling::Effort,
};

use super::{
    Cause, Change, Drift, Finding, Judgement, Kind, LevelChange, Metric, Night, Settings, Verdict, content,
    series::{Point, Series, gone, lacking, level_of, remarks, series_of},
};

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
                metric: series.metric.clone(),
                verdict,
                nights: series.points.len(),
                findings: Vec::new(),
            },
        })
        .chain(content::of_baseline(nights, settings))
        .chain(gone(nights, &settings.acknowledgements))
        .collect();
    Drift::of(nights, judgements, remarks)
}

/// Levels that cannot be told apart, as far apart as they may truly be: they would have no spread, and anything else would be drift.
fn apart(levels: Vec<f64>, resolution: f64) -> Vec<f64> {
    let range = levels.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        - levels.iter().copied().fold(f64::INFINITY, f64::min);
    if range > resolution {
        return levels;
    }
    let aside = [resolution / 2.0, -resolution / 2.0].into_iter().cycle();
    levels
        .iter()
        .zip(aside)
        .map(|(level, aside)| level + aside)
        .collect()
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
    let levels = apart(
        before.iter().map(|point| point.level).collect(),
        series.metric.resolution(),
    );
    if before.len() >= FEWEST_NIGHTS {
        let Some(prediction) = Prediction::of(&levels) else {
            return Err(too_little(
                "all runs of the baseline have the very same number".to_owned(),
            ));
        };
        return Ok(Comparison {
            // Within what the baseline has seen nothing is off.
            p: prediction.p(tonight.level).unwrap_or(1.0),
            detectable: Some(prediction.detectable(level)),
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
            change: Change::Level(LevelChange {
                before: level_before,
                since: tonight.level,
                p,
            }),
            cause: Cause::between(last.measured, tonight.measured),
            acknowledged: known
                .of_run(nights, &series.scenario, &series.metric, tonight.run)
                .cloned(),
            immaterial: settings.is_immaterial(&series.metric, tonight.level - level_before),
            withdrawn: None,
            explained: None,
            report: None,
        });
    }
    let verdict = match (findings.iter().any(Finding::is_news), comparison.detectable) {
        (true, _) => Verdict::Drift,
        (false, detectable @ Some(_)) => Verdict::NoDrift { detectable },
        (false, None) => Verdict::TooLittle {
            reason: "there are too few windows for any p to be small enough".to_owned(),
        },
    };
    Judgement {
        scenario: series.scenario.clone(),
        metric: series.metric.clone(),
        verdict,
        nights: series.points.len(),
        findings,
    }
}
