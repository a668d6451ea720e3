//! JSON: the shape that others build on. Fields are added here, never renamed or taken away.

use serde::{Serialize, Serializer, ser::SerializeMap};
use serde_json::{Value, json};

use crate::{
    comparison::{Comparison, Tally},
    conclusion::Conclusion,
    contrast::Contrast,
    effect::{Effect, Estimate},
    health::Health,
    report::{Report, ScenarioReport, Standing},
    run::RunPart,
    traffic::{DirectionTraffic, Explanation, Factor, ScenarioTraffic, Spread, TrafficTally},
    within::WithinWindows,
};

/// The whole. All is small but the comparisons, of which there may be half a million: these are made one by one, as they
/// are written.
pub(super) struct Document<'a> {
    report: &'a Report,
    /// All else, in order.
    fields: Value,
}

impl<'a> Document<'a> {
    pub fn of(report: &'a Report) -> Self {
        Self {
            report,
            fields: fields(report),
        }
    }
}

impl Serialize for Document<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let fields = self.fields.as_object().into_iter().flatten();
        let mut map = serializer.serialize_map(None)?;
        for (name, value) in fields {
            map.serialize_entry(name, value)?;
        }
        map.serialize_entry("comparisons", &Comparisons(self.report))?;
        map.end()
    }
}

struct Comparisons<'a>(&'a Report);

impl Serialize for Comparisons<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.comparisons.rows().map(|one| comparison(self.0, &one)))
    }
}

fn fields(report: &Report) -> Value {
    let settings = &report.settings;
    let (within, between): (Vec<_>, Vec<_>) = report.tallies.iter().partition(|tally| tally.a == tally.b);
    let of = |standing| {
        report
            .scenarios
            .iter()
            .filter(move |scenario| scenario.standing == standing)
    };
    json!({
        "run": report.run,
        "created": report.created,
        "runs": report.parts.iter().map(part).collect::<Vec<_>>(),
        "simulated": report.is_simulated(),
        "alpha": settings.alpha,
        "method": settings.method,
        "metric": settings.metric,
        "error": settings.error,
        "discard_periods": settings.discard_periods,
        "warm_up": settings.warm_up,
        "control": settings.control,
        "remarks": report.remarks,
        "scenarios": report.scenarios.iter().map(scenario).collect::<Vec<_>>(),
        "infeasible": of(Standing::Infeasible).map(unmeasured).collect::<Vec<_>>(),
        "errored": of(Standing::Errored).map(unmeasured).collect::<Vec<_>>(),
        "within": within
            .iter()
            .map(|tally| json!({"id": tally.a, "pairs": tally.pairs, "rejected": tally.rejected}))
            .collect::<Vec<_>>(),
        "between": between
            .iter()
            .map(|tally| {
                json!({
                    "a": tally.a,
                    "b": tally.b,
                    "pairs": tally.pairs,
                    "rejected": tally.rejected,
                    "unlike": report.unlike(&tally.a, &tally.b),
                })
            })
            .collect::<Vec<_>>(),
        "unlike": report
            .unlike
            .iter()
            .map(|unlike| json!({"a": unlike.a, "b": unlike.b, "fields": unlike.fields}))
            .collect::<Vec<_>>(),
        "family": family(report),
        "contrasts": report.contrasts.pairs.iter().map(|pair| contrast(report, pair)).collect::<Vec<_>>(),
        "conclusions": report.conclusions.iter().map(conclusion).collect::<Vec<_>>(),
        "packets": report.traffic.scenarios.iter().map(packets).collect::<Vec<_>>(),
        "packet_counts": report.traffic_tallies.iter().flat_map(packet_counts).collect::<Vec<_>>(),
        "packet_explanations": report.explanations.iter().map(explanation).collect::<Vec<_>>(),
    })
}

fn part(part: &RunPart) -> Value {
    json!({
        "run": part.run,
        "created": part.created,
        "matrix_version": part.matrix_version,
        "matrix_revision": part.matrix_revision,
        "scenarios": part.scenarios,
    })
}

fn scenario(scenario: &ScenarioReport) -> Value {
    let windows = scenario.windows.iter().map(|window| {
        json!({
            "window": window.number,
            "verdict": window.verdict,
            "counted": window.n > 0,
            "n": window.n,
            "reasons": window.reasons,
        })
    });
    let broken = scenario.broken.iter().map(
        |broken| json!({"window": broken.window, "environment": broken.environment, "reason": broken.reason}),
    );
    json!({
        "id": scenario.id,
        "slug": scenario.slug,
        "axes": scenario.axes,
        "is_control": scenario.is_control,
        "dynamics": scenario.dynamics,
        "overridden": scenario.overridden,
        "simulated": scenario.is_simulated,
        "outcome": scenario.standing.name().replace(' ', "-"),
        "reason": scenario.reason,
        "hint": scenario.hint,
        "windows": windows.collect::<Vec<_>>(),
        "broken": broken.collect::<Vec<_>>(),
        "environment": scenario.environment,
        "within": scenario.within.as_ref().map(within),
        "health": scenario.health.as_ref().map(health),
    })
}

fn within(within: &WithinWindows) -> Value {
    json!({
        "autocorrelation": within.dependence.as_ref().map(|found| &found.autocorrelation),
        "autocorrelation_time_periods": within.dependence.as_ref().map(|found| found.time),
        "effective_n": within.dependence.as_ref().map(|found| found.effective),
        "cut": within
            .cut
            .iter()
            .map(|(window, periods)| json!({"window": window, "periods": periods}))
            .collect::<Vec<_>>(),
        "unsteady": within.unsteady.iter().map(|(window, found)| json!({
            "window": window,
            "warm_up_periods": found.warm_up,
            "change_after_periods": found.change.map(|change| change.after),
            "change_m": found.change.map(|change| change.by),
            "change_p": found.change.map(|change| change.p),
        })).collect::<Vec<_>>(),
        "change_block_periods": within.change_block,
        "not_looked_for": within.unseen.iter().map(|(window, look, why)| json!({
            "window": window,
            "look": look.name(),
            "reason": why.to_string(),
        })).collect::<Vec<_>>(),
    })
}

fn health(health: &Health) -> Value {
    json!({
        "cpu_share": health.cpu_share,
        "late_share": health.late_share,
        "missed_deadlines": health.missed_deadlines,
        "lost_ticks": health.lost_ticks,
        "stale_share": health.stale_share,
        "state_age_s": health.state_age_s,
        "worst_lateness_ns": health.worst_lateness_ns,
        "capture_dropped": health.capture_dropped,
        "releases": health.releases,
    })
}

fn unmeasured(scenario: &ScenarioReport) -> Value {
    json!({"id": scenario.id, "slug": scenario.slug, "reason": scenario.reason, "hint": scenario.hint})
}

fn comparison(report: &Report, comparison: &Comparison<'_>) -> Value {
    let test = &comparison.test;
    json!({
        "a": comparison.a,
        "a_window": comparison.a_window,
        "b": comparison.b,
        "b_window": comparison.b_window,
        "n": test.n,
        "m": test.m,
        "d": test.d,
        "signed_d": test.signed_d,
        "at_m": test.at,
        "h": test.h,
        "lcm": test.lcm,
        "p": test.p,
        "log10_p": test.log10_p,
        "method": test.method.name(),
        "rejected": comparison.rejected,
        "unlike": report.unlike(comparison.a, comparison.b),
    })
}

fn family(report: &Report) -> Value {
    let contrasts = &report.contrasts;
    json!({
        "declared": contrasts.family,
        "pairs": contrasts.pairs.len(),
        "without_data": contrasts.without_data,
        "matters_m": report.settings.matters.map(workload::quantity::Length::metres),
        "seed": report.settings.seed,
        "max_t": contrasts.max_t.as_ref().map(|max_t| json!({
            "labellings": max_t.labellings,
            "method": max_t.coverage.name(),
            "smallest_p": max_t.smallest_p,
        })),
    })
}

fn contrast(report: &Report, pair: &Contrast) -> Value {
    let differences = report.differences(&pair.a, &pair.b);
    let differences = differences
        .iter()
        .map(|one| json!({"field": one.field, "a": one.first, "b": one.second}));
    json!({
        "a": pair.a,
        "b": pair.b,
        "n": pair.n,
        "m": pair.m,
        "p": pair.level.p,
        "smallest_p": pair.level.smallest_p,
        "labellings": pair.level.labellings,
        "method": pair.level.coverage.name(),
        "p_kolmogorov_smirnov": pair.shape.kolmogorov_smirnov.p,
        "p_anderson_darling": pair.shape.anderson_darling.p,
        "p_energy": pair.shape.energy.p,
        "shape_labellings": pair.shape.energy.labellings,
        "blocks": pair.blocks.map(|blocks| json!({
            "block": blocks.block,
            "pairs": blocks.pairs,
            "rejected": blocks.rejected,
            "possible": blocks.possible,
        })),
        "p_holm": pair.p_holm,
        "p_benjamini_yekutieli": pair.p_benjamini_yekutieli,
        "p_max_t": pair.p_max_t,
        "verdict": pair.verdict.name(),
        "unlike": report.unlike(&pair.a, &pair.b),
        "effect": effect(&pair.effect),
        "differences": differences.collect::<Vec<_>>(),
    })
}

fn conclusion(one: &Conclusion) -> Value {
    json!({
        "axis": one.axis,
        "first": one.first,
        "second": one.second,
        "hardware_differs": one.hardware_differs,
        "strata": one.strata,
        "p": one.test.p,
        "p_holm": one.p_holm,
        "smallest_p": one.smallest_p,
        "labellings": one.test.labellings,
        "method": one.test.coverage.name(),
        "shift_m": estimate(&one.shift_m),
    })
}

fn effect(effect: &Effect) -> Value {
    json!({
        "shift_m": estimate(&effect.shift_m),
        "wasserstein_m": estimate(&effect.wasserstein_m),
        "superiority": estimate(&effect.superiority),
    })
}

fn estimate(estimate: &Estimate) -> Value {
    json!({
        "value": estimate.value,
        "low": estimate.interval.map(|interval| interval.low),
        "high": estimate.interval.map(|interval| interval.high),
        "confidence": estimate.interval.map(|interval| interval.confidence),
    })
}

/// The packets of a scenario's windows.
fn packets((id, found): (&String, &ScenarioTraffic)) -> Value {
    let windows = found.windows.iter().map(|window| {
        json!({
            "window": window.window,
            "dropped": window.dropped,
            "directions": window.directions.iter().map(direction).collect::<Vec<_>>(),
        })
    });
    let unreadable = found.unreadable.iter();
    json!({
        "id": id,
        "windows": windows.collect::<Vec<_>>(),
        "unreadable": unreadable
            .map(|(window, reason)| json!({"window": window, "reason": reason}))
            .collect::<Vec<_>>(),
    })
}

fn direction(direction: &DirectionTraffic) -> Value {
    json!({
        "topic": direction.topic.name(),
        "sent": direction.total(|period| period.sent),
        "sent_again": direction.total(|period| period.sent_again),
        "lost": direction.total(|period| period.lost),
        "overtaken": direction.total(|period| period.overtaken),
        "strays": direction.strays,
        "one_way": direction.one_way.as_ref().map(spread),
        "round_trip": direction.round_trip.as_ref().map(spread),
        "jitter": direction.jitter.as_ref().map(spread),
        "gap": direction.gap.as_ref().map(spread),
    })
}

fn spread(spread: &Spread) -> Value {
    json!({
        "count": spread.count,
        "mean_s": spread.mean_s,
        "min_s": spread.min_s,
        "median_s": spread.median_s(),
        "p99_s": spread.p99_s(),
        "max_s": spread.max_s,
    })
}

fn packet_counts(one: &TrafficTally) -> Vec<Value> {
    let count = |tally: &Tally| {
        json!({
            "topic": one.topic.name(),
            "quantity": one.quantity.name(),
            "a": tally.a,
            "b": tally.b,
            "pairs": tally.pairs,
            "rejected": tally.rejected,
        })
    };
    one.tallies.iter().map(count).collect()
}

fn explanation(one: &Explanation) -> Value {
    let factor = |factor: &Factor| {
        json!({
            "topic": factor.topic.name(),
            "quantity": factor.quantity.name(),
            "unit": if factor.quantity.is_time() { "s" } else { "packets a period" },
            "difference": factor.difference,
            "correlation": factor.correlation,
            "slope_m": factor.slope_m,
            "part_m": estimate(&factor.part_m),
        })
    };
    json!({
        "a": one.a,
        "b": one.b,
        "shift_m": one.shift_m,
        "factors": one.factors.iter().map(factor).collect::<Vec<_>>(),
    })
}
