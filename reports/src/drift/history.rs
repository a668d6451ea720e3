//! The newest night against all before it, and each of those against the others. The main function is [`judge`].
//!
//! Each scenario and metric is looked at in [`LOOKS`] ways, each at the level α divided by that and by how many there are, so
//! that in one night the probability of any false finding is at most α:
//!
//! - the newest night, the newest two, three and four, against what those since the last change make one expect
//!   ([`Prediction`]): this tells of a jump in the night in which it comes, and goes on to tell of it. Each of them must be
//!   beyond all that came before, so that one night far off is told once;
//! - change points by distances and by ranks ([`super::change_points`]), which tell of small jumps after some nights, and of
//!   where they were;
//! - a slope since the last change ([`Trend`]), which tells of what never jumps.

use super::{
    Acknowledgement, Cause, Drift, Finding, Judgement, Kind, Night, Prediction, Search, Settings, Statistic,
    Trend, Verdict, change_points,
    prediction::FEWEST_NIGHTS,
    series::{Point, Series, gone, lacking, level_of, remarks, series_of},
};
use crate::statistics::effect::median;

/// The fewest nights between two changes.
pub const SHORTEST: usize = 5;

/// The ways in which each series is looked at: the newest 1 to 4 nights, change points of two kinds, a slope.
pub const LOOKS: usize = SHORTEST - 1 + 3;

/// Judges a history, its nights in order.
#[must_use]
pub fn judge(nights: &[Night], settings: &Settings) -> Drift {
    let series = series_of(nights);
    let looks = (LOOKS * series.len().max(1)) as f64;
    let mut remarks = remarks(nights);
    remarks.extend(settings.acknowledgements.of_no_night(nights));
    let mut judgements = Vec::new();
    for series in series {
        let lacking = lacking(&series);
        let judgement = judgement(series, looks, nights, settings);
        if let (Verdict::Drift, Some(lacking)) = (&judgement.verdict, lacking) {
            remarks.push(format!(
                "{} {}: the newest run has no number ({}: {})",
                judgement.scenario,
                judgement.metric.name(),
                lacking.name(),
                lacking.reason().unwrap_or_default()
            ));
        }
        judgements.push(judgement);
    }
    judgements.extend(gone(nights, &settings.acknowledgements));
    Drift {
        nights: nights.iter().map(|night| night.run.clone()).collect(),
        judgements,
        remarks,
    }
}

fn judgement(series: Series<'_>, looks: f64, nights: &[Night], settings: &Settings) -> Judgement {
    let level = settings.alpha / looks;
    let known = &settings.acknowledgements;
    let begins = known.begins(nights, &series.scenario, series.metric);
    let series = series.from(begins);
    let step = known
        .last_step(nights, &series.scenario, series.metric)
        .and_then(|run| series.points.iter().position(|point| point.run == run));
    let Changes { changes, usual } = changes(&series, step, level, settings.seed);
    let mut findings: Vec<Finding> = changes
        .into_iter()
        .map(|change| finding(&series, &change, looks, nights, settings))
        .collect();
    findings.sort_by(|a, b| a.since.cmp(&b.since));
    // What was told and nobody knows of is there yet, whatever became of tonight.
    let verdict = if findings.iter().any(Finding::is_news) {
        Verdict::Drift
    } else {
        lacking(&series).unwrap_or_else(|| quiet(&usual, level))
    };
    Judgement {
        scenario: series.scenario,
        metric: series.metric,
        verdict,
        nights: series.points.len(),
        findings,
    }
}

/// What is to be said where nothing was found that is new, of what the newest night was held against.
fn quiet(before: &[f64], level: f64) -> Verdict {
    match Prediction::of(before) {
        Some(prediction) => Verdict::NoDrift {
            detectable: prediction.detectable(level),
        },
        None if before.len() >= FEWEST_NIGHTS => Verdict::TooLittle {
            reason: "all nights have the very same number".to_owned(),
        },
        None => Verdict::TooLittle {
            reason: format!(
                "{} nights before the newest have a number, and how much nights differ takes {FEWEST_NIGHTS}",
                before.len()
            ),
        },
    }
}

/// A change of a series, by places in it.
struct Change {
    kind: Kind,
    /// The first night of what is before it.
    begins: usize,
    /// The first night with it.
    since: usize,
    /// The night after the last with it.
    ends: usize,
    /// For one look at one series.
    p: f64,
}

/// What was found of a series.
struct Changes {
    changes: Vec<Change>,
    /// The levels that the newest night was held against, for what would have been found of it.
    usual: Vec<f64>,
}

/// The changes of a series; `step` is the place of the last night that begins a change which is known.
fn changes(series: &Series<'_>, step: Option<usize>, level: f64, seed: u64) -> Changes {
    let levels = series.levels();
    let slope = |from: usize| {
        let trend = levels.get(from..).and_then(Trend::of);
        trend.filter(|trend| trend.p < level)
    };
    let jumps = jumps(&levels, level, seed);
    // What rises night after night is split into jumps as well: it is a slope if a line fits it better than the jumps do.
    if let Some(trend) = slope(0)
        && badness_of_line(&levels, trend.slope) < badness_of_steps(&levels, &jumps)
    {
        return Changes {
            changes: vec![slope_over(0, levels.len(), trend.p)],
            usual: all_but_newest(&levels).to_vec(),
        };
    }
    let jumps = without_misplaced(jumps, &levels, level);
    let jump = |begins, since, ends, p| Change {
        kind: Kind::Jump,
        begins,
        since,
        ends,
        p,
    };
    let places: Vec<usize> = jumps.iter().map(|(at, _)| *at).collect();
    let mut changes: Vec<Change> = jumps
        .iter()
        .enumerate()
        .map(|(nth, (since, p))| {
            let before = nth.checked_sub(1).and_then(|before| places.get(before));
            let next = places.get(nth + 1);
            jump(
                before.copied().unwrap_or(0),
                *since,
                next.copied().unwrap_or(levels.len()),
                *p,
            )
        })
        .collect();
    let last = places.last().copied().unwrap_or(0);
    if last > 0
        && let Some(trend) = slope(last)
    {
        changes.push(slope_over(last, levels.len(), trend.p));
    }
    let since_last = levels.get(last..).unwrap_or_default();
    let step = step.and_then(|step| step.checked_sub(last)).unwrap_or(0);
    let mut ends = levels.len();
    if let Some((count, p)) = newest_apart(since_last, step, level) {
        changes.push(jump(last + step, ends - count, ends, p));
        ends -= count;
    }
    // The step itself is told too, as one that is known.
    let nights = (ends - last - step).min(SHORTEST - 1);
    if step > 0
        && let Some(p) = since_last
            .get(..step + nights)
            .and_then(|nights_since| p_of_newest(nights_since, nights, 0))
            .filter(|p| *p < level)
    {
        changes.push(jump(last, last + step, ends, p));
    }
    Changes {
        changes,
        usual: usual(all_but_newest(since_last), step),
    }
}

fn all_but_newest(levels: &[f64]) -> &[f64] {
    levels.split_last().map_or(&[], |(_, before)| before)
}

/// A change point has 5 nights behind it. One with the very last 5 may be a jump that came later: that is told by the nights
/// themselves.
fn without_misplaced(mut jumps: Vec<(usize, f64)>, levels: &[f64], level: f64) -> Vec<(usize, f64)> {
    if let Some(((last, _), earlier)) = jumps.split_last() {
        let begins = earlier.last().map_or(0, |(at, _)| *at);
        let since = levels.get(begins..).unwrap_or_default();
        if last + SHORTEST == levels.len() && newest_apart(since, 0, level).is_some() {
            jumps.pop();
        }
    }
    jumps
}

/// How many of the newest nights are apart from those before, with their p: as many as can be told.
fn newest_apart(levels: &[f64], step: usize, level: f64) -> Option<(usize, f64)> {
    let each = (1..SHORTEST).rev();
    each.filter_map(|count| Some((count, p_of_newest(levels, count, step)?)))
        .find(|(_, p)| *p < level)
}

/// The p of the newest so many nights; none where one of them is not beyond all before, or those are too few.
fn p_of_newest(levels: &[f64], count: usize, step: usize) -> Option<f64> {
    let (before, newest) = levels.split_at_checked(levels.len().checked_sub(count)?)?;
    // What begins with a step that is known is that step.
    if step > 0 && before.len() <= step {
        return None;
    }
    Prediction::of(&usual(before, step))?.p(newest)
}

/// What is usual after some nights, of which those from `step` on are on another level than the others, and it is known why (0
/// if there is no such step). As long as these are few the others say by how much nights differ: brought to the new level, and
/// further apart, since that is not known well from so few.
fn usual(before: &[f64], step: usize) -> Vec<f64> {
    let (earlier, own) = before.split_at_checked(step).unwrap_or((before, &[]));
    let (Some(old), Some(new)) = (median(earlier.to_vec()), median(own.to_vec())) else {
        return before.to_vec();
    };
    if own.len() >= FEWEST_NIGHTS {
        return own.to_vec();
    }
    let wider = (1.0 + 1.0 / own.len() as f64).sqrt();
    let moved = earlier.iter().map(|level| new + (level - old) * wider);
    moved.chain(own.iter().copied()).collect()
}

/// From the first half to the second, as far as a slope can be told of as before and since.
const fn slope_over(begins: usize, ends: usize, p: f64) -> Change {
    Change {
        kind: Kind::Slope,
        begins,
        since: begins + 1,
        ends,
        p,
    }
}

/// Change points by distances, and those by ranks that are not near one of them; each with its p.
fn jumps(levels: &[f64], level: f64, seed: u64) -> Vec<(usize, f64)> {
    let search = |statistic| {
        let search = Search {
            statistic,
            level,
            shortest: SHORTEST,
            seed,
        };
        change_points(levels, &search)
    };
    let mut found = search(Statistic::Energy);
    for other in search(Statistic::Ranks) {
        if found
            .iter()
            .all(|change| change.at.abs_diff(other.at) >= SHORTEST)
        {
            found.push(other);
        }
    }
    found.sort_by_key(|change| change.at);
    found.into_iter().map(|change| (change.at, change.p)).collect()
}

/// How badly the best line of that slope fits.
fn badness_of_line(levels: &[f64], slope: f64) -> f64 {
    let flat: Vec<f64> = levels
        .iter()
        .enumerate()
        .map(|(night, level)| level - slope * night as f64)
        .collect();
    let middle = median(flat.clone()).unwrap_or_default();
    badness(
        flat.iter().map(|level| (level - middle).abs()).sum(),
        levels.len(),
        2,
    )
}

/// How badly levels with jumps between them fit.
fn badness_of_steps(levels: &[f64], jumps: &[(usize, f64)]) -> f64 {
    let ends = jumps.iter().map(|(at, _)| *at).chain([levels.len()]);
    let mut begins = 0;
    let mut sum = 0.0;
    for end in ends {
        let stretch = levels.get(begins..end).unwrap_or_default();
        let middle = median(stretch.to_vec()).unwrap_or_default();
        sum += stretch.iter().map(|level| (level - middle).abs()).sum::<f64>();
        begins = end;
    }
    // The places of the jumps, and the levels.
    badness(sum, levels.len(), 2 * jumps.len() + 1)
}

/// Schwarz's criterion (*Estimating the dimension of a model*, Annals of Statistics 6, 1978), for distances from what fits
/// as Laplace has them: more parameters always fit better.
fn badness(distances: f64, nights: usize, parameters: usize) -> f64 {
    let count = nights as f64;
    2.0 * count * (distances / count).ln() + parameters as f64 * count.ln()
}

fn finding(
    series: &Series<'_>,
    change: &Change,
    looks: f64,
    nights: &[Night],
    settings: &Settings,
) -> Finding {
    let level = settings.alpha / looks;
    let points = &series.points;
    let stretch = |from: usize, to: usize| points.get(from..to).unwrap_or_default();
    // A slope goes from its first nights to its last ones.
    let (before, since) = match change.kind {
        Kind::Slope => {
            let few = SHORTEST.min((change.ends - change.begins) / 2);
            (
                stretch(change.begins, change.begins + few),
                stretch(change.ends - few, change.ends),
            )
        }
        Kind::Jump | Kind::FromBaseline => (
            stretch(change.begins, change.since),
            stretch(change.since, change.ends),
        ),
    };
    let run = |point: Option<&Point<'_>>| point.map_or_else(String::new, |point| point.run.to_owned());
    let (level_before, level_since) = (level_of(before), level_of(since));
    let since_run = run(since.first());
    let acknowledged = settings
        .acknowledgements
        .near(nights, &series.scenario, series.metric, &since_run)
        .find(|known| change.kind == Kind::Slope || is_that_jump(series, known, before, level_since, level))
        .cloned();
    Finding {
        kind: change.kind,
        before: run(before.last()),
        level_before,
        level_since,
        p: (change.p * looks).min(1.0),
        cause: match (before.last(), since.first()) {
            (Some(before), Some(since)) => Cause::between(before.measured, since.measured),
            _ => Cause::Unexplained,
        },
        acknowledged,
        immaterial: settings.is_immaterial(series.metric, level_since - level_before),
        since: since_run,
    }
}

/// Whether a jump led to the level of the run with which it was acknowledged, or to one that would not be told from that: what
/// is near and leads elsewhere is another change.
fn is_that_jump(
    series: &Series<'_>,
    known: &Acknowledgement,
    before: &[Point<'_>],
    level_since: f64,
    level: f64,
) -> bool {
    let Some(its) = series.points.iter().find(|point| point.run == known.since) else {
        return true;
    };
    let levels: Vec<f64> = before.iter().map(|point| point.level).collect();
    let detectable = Prediction::of(&levels).map(|prediction| prediction.detectable(level));
    let tolerance = detectable.unwrap_or_else(|| (its.level - level_of(before)).abs());
    (level_since - its.level).abs() <= tolerance
}
