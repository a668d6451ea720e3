//! JSON: the shape that others build on. Fields are added here, never renamed or taken away.

use serde_json::{Value, json};

use crate::{
    comparison::Comparison,
    health::Health,
    report::{Report, ScenarioReport, Standing},
};

pub(super) fn render(report: &Report) -> Value {
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
        "simulated": report.is_simulated(),
        "alpha": settings.alpha,
        "metric": settings.metric,
        "discard_periods": settings.discard_periods,
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
            .map(|tally| json!({"a": tally.a, "b": tally.b, "pairs": tally.pairs, "rejected": tally.rejected}))
            .collect::<Vec<_>>(),
        "comparisons": report.comparisons.iter().map(comparison).collect::<Vec<_>>(),
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
        "simulated": scenario.is_simulated,
        "outcome": scenario.standing.name().replace(' ', "-"),
        "reason": scenario.reason,
        "hint": scenario.hint,
        "windows": windows.collect::<Vec<_>>(),
        "broken": broken.collect::<Vec<_>>(),
        "environment": scenario.environment,
        "health": scenario.health.as_ref().map(health),
    })
}

fn health(health: &Health) -> Value {
    json!({
        "cpu_share": health.cpu_share,
        "late_share": health.late_share,
        "missed_deadlines": health.missed_deadlines,
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

fn comparison(comparison: &Comparison) -> Value {
    let test = &comparison.test;
    json!({
        "a": comparison.a,
        "a_window": comparison.a_window,
        "b": comparison.b,
        "b_window": comparison.b_window,
        "n": test.n,
        "m": test.m,
        "d": test.d,
        "h": test.h,
        "lcm": test.lcm,
        "p": test.p,
        "log10_p": test.log10_p,
        "method": test.method.name(),
        "rejected": comparison.rejected,
    })
}
