//! The newest night after all before it, each as it came. The main function is [`judge`].
//!
//! Each scenario and metric is watched from its first night on ([`watch`]). Among all that have a number in a night, α is divided
//! evenly, so that in one night the probability of any false finding is at most α, however they depend on each other. What was
//! found in an earlier night is found again from the same nights, and so is told until somebody acknowledges it.

use statistics::{
    prediction::FEWEST_NIGHTS,
    watch::{self, Change, Watched, watch},
};

use super::{
    Acknowledgement, Cause, Drift, Finding, Judgement, Kind, LevelChange, Night, Settings, Verdict, content,
    series::{Point, Series, gone, lacking, level_of, remarks, series_of},
};

/// Nights at the two ends of a slope that its levels are taken from.
const ENDS: usize = 5;

/// The correlation of successive nights from which on it is remarked on, if it is also beyond so many standard errors.
const REMARKED: (f64, f64) = (0.2, 2.6);

/// Judges a history, its nights in order.
#[must_use]
pub fn judge(nights: &[Night], settings: &Settings) -> Drift {
    let levels = levels(nights, settings.alpha);
    let mut remarks = remarks(nights);
    remarks.extend(settings.acknowledgements.of_no_night(nights));
    let mut judgements = Vec::new();
    for series in series_of(nights) {
        let lacking = lacking(&series);
        let (judgement, of_dependence) = judgement(series, &levels, nights, settings);
        if let (Verdict::Drift, Some(lacking)) = (&judgement.verdict, lacking) {
            remarks.push(format!(
                "{} {}: the newest run has no number ({}: {})",
                judgement.scenario,
                judgement.metric.name(),
                lacking.name(),
                lacking.reason().unwrap_or_default()
            ));
        }
        remarks.extend(of_dependence);
        judgements.push(judgement);
    }
    judgements.extend(content::of_history(nights, settings));
    judgements.extend(gone(nights, &settings.acknowledgements));
    Drift::of(nights, judgements, remarks)
}

/// Of each night, the probability of a false alarm that a series has which has a number there: α among all that have one. A series
/// that comes later changes nothing of what was told before.
fn levels(nights: &[Night], alpha: f64) -> Vec<f64> {
    let with_number = |night: &Night| {
        let scenarios = night.scenarios.values();
        scenarios
            .flat_map(|measured| measured.values.values())
            .filter(|values| !values.is_empty())
            .count()
    };
    nights
        .iter()
        .map(|night| alpha / with_number(night).max(1) as f64)
        .collect()
}

fn judgement(
    series: Series<'_>,
    levels: &[f64],
    nights: &[Night],
    settings: &Settings,
) -> (Judgement, Vec<String>) {
    let known = &settings.acknowledgements;
    let begins = known.begins(nights, &series.scenario, &series.metric);
    let series = series.from(begins);
    let steps: Vec<(usize, &Acknowledgement)> = known
        .steps(nights, &series.scenario, &series.metric)
        .filter_map(|(night, known)| {
            let later = |point: &Point<'_>| point.night >= night;
            Some((series.points.iter().position(later)?, known))
        })
        .collect();
    let watched = watch(&watched_nights(&series, &steps, levels, nights));
    let findings: Vec<Finding> = watched
        .changes
        .iter()
        .map(|change| finding(&series, change, &steps, levels, settings))
        .collect();
    // What was told and nobody knows of is there yet, whatever became of tonight.
    let verdict = if findings.iter().any(Finding::is_news) {
        Verdict::Drift
    } else {
        lacking(&series).unwrap_or_else(|| quiet(&series, &watched))
    };
    let remarks = of_dependence(&series, &watched);
    let judgement = Judgement {
        scenario: series.scenario,
        metric: series.metric,
        verdict,
        nights: series.points.len(),
        findings,
    };
    (judgement, remarks)
}

fn watched_nights(
    series: &Series<'_>,
    steps: &[(usize, &Acknowledgement)],
    levels: &[f64],
    nights: &[Night],
) -> Vec<watch::Night> {
    let night = |(at, point): (usize, &Point<'_>)| watch::Night {
        value: point.level,
        level: levels.get(point.night).copied().unwrap_or(1.0),
        weekday: nights.get(point.night).and_then(Night::weekday),
        is_known_change: steps.iter().any(|(step, _)| *step == at),
    };
    series.points.iter().enumerate().map(night).collect()
}

/// What is to be said where nothing was found that is new.
fn quiet(series: &Series<'_>, watched: &Watched) -> Verdict {
    let before = series.points.len().saturating_sub(1);
    if let Some(reason) = without_spread(series) {
        return Verdict::TooLittle { reason };
    }
    match watched.detectable {
        detectable @ Some(_) if before >= FEWEST_NIGHTS => Verdict::NoDrift { detectable },
        _ => Verdict::TooLittle {
            reason: format!(
                "{before} nights before the newest have a number, and how much nights differ takes {FEWEST_NIGHTS}"
            ),
        },
    }
}

/// That the first nights do not differ at all, and no later ones enough: how far off another would be is not known, not even of one
/// that is. None where enough nights differ.
fn without_spread(series: &Series<'_>) -> Option<String> {
    let first = series.points.first()?;
    let is_the_same = |point: &Point<'_>| point.level.to_bits() == first.level.to_bits();
    let same = series
        .points
        .iter()
        .take_while(|point| is_the_same(point))
        .count();
    let others = series.points.get(same..).unwrap_or_default();
    if same < FEWEST_NIGHTS || others.len() >= FEWEST_NIGHTS {
        return None;
    }
    let text = |level: f64| series.metric.text(level);
    Some(match others.last() {
        None => "all nights have the very same number".to_owned(),
        Some(newest) => format!(
            "the first {same} nights have the very same number, {}, and the newest has {}: how much nights differ is not known from nights \
             that do not",
            text(first.level),
            text(newest.level)
        ),
    })
}

/// That nights are not independent of each other, where they are not.
fn of_dependence(series: &Series<'_>, watched: &Watched) -> Vec<String> {
    let name = format!("{} {}", series.scenario, series.metric.name());
    let (least, errors) = REMARKED;
    let is_shown = |lag: &statistics::chart::Lag| {
        lag.correlation > least && lag.correlation > errors / lag.nights.sqrt()
    };
    let lag = watched.lag.filter(is_shown).map(|lag| {
        format!(
            "{name}: each night resembles the one before it (correlation {:.2} of {} nights); the limits are wider for that, and \
             changes are found later",
            lag.correlation, lag.nights
        )
    });
    let weekly = (watched.weekly > 0.0).then(|| {
        format!(
            "{name}: the days of the week differ by {}; that is taken out before nights are compared",
            series.metric.text(watched.weekly)
        )
    });
    lag.into_iter().chain(weekly).collect()
}

fn finding(
    series: &Series<'_>,
    change: &Change,
    steps: &[(usize, &Acknowledgement)],
    levels: &[f64],
    settings: &Settings,
) -> Finding {
    let points = &series.points;
    let stretch = |from: usize, to: usize| points.get(from..to).unwrap_or_default();
    let (kind, before, since) = match change.kind {
        watch::Kind::Jump => (
            Kind::Jump,
            stretch(change.begins, change.at),
            stretch(change.at, change.ends),
        ),
        // A slope goes from its first nights to its last ones.
        watch::Kind::Slope => {
            let few = ENDS.min((change.ends - change.begins) / 2);
            (
                Kind::Slope,
                stretch(change.begins, change.begins + few),
                stretch(change.ends - few, change.ends),
            )
        }
    };
    let (last_before, first) = (
        change.at.checked_sub(1).and_then(|at| points.get(at)),
        points.get(change.at),
    );
    let run = |point: Option<&Point<'_>>| point.map_or_else(String::new, |point| point.run.to_owned());
    let (level_before, level_since) = (level_of(before), level_of(since));
    let known = steps.iter().find(|(step, _)| change.known.contains(step));
    let alpha_of_series = points
        .get(change.told)
        .and_then(|point| levels.get(point.night))
        .copied()
        .unwrap_or(settings.alpha);
    Finding {
        kind,
        before: run(last_before),
        since: run(first),
        change: super::Change::Level(LevelChange {
            before: level_before,
            since: level_since,
            p: (change.probability * settings.alpha / alpha_of_series).min(1.0),
        }),
        cause: match (last_before, first) {
            (Some(before), Some(since)) => Cause::between(before.measured, since.measured),
            _ => Cause::Unexplained,
        },
        acknowledged: known.map(|(_, known)| (*known).clone()),
        immaterial: settings.is_immaterial(&series.metric, level_since - level_before),
        withdrawn: change.withdrawn.map(|night| run(points.get(night))),
        explained: None,
        report: None,
    }
}
