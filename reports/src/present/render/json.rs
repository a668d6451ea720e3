//! JSON: fills the types of `document`, the shape that others build on. Fields are added there;
//! CHANGELOG.md lists any field that is renamed or taken away.

use captures::traffic::{DirectionTraffic, ScenarioTraffic, Spread};
use statistics::effect::{Effect, Estimate, Interval};

use super::document::{
    AgreementEntry, BlocksEntry, BrokenEntry, CallsEntry, ComparisonList, ConclusionEntry, ContrastEntry,
    CountBetween, CountWithin, CutWindow, DifferenceEntry, EffectEntry, EstimateEntry, ExpectedEntry,
    FamilyEntry, GroupEntry, HealthEntry, IntervalEntry, MaxTEntry, PartingEntry, PeriodsEntry,
    QuantityEntry, ReportDocument, RunEntry, ScenarioEntry, SerialEntry, ShapeEntry, UnlikePair, Unmeasured,
    UnseenEntry, UnsteadyWindow, WindowEntry, WithinEntry,
    packets::{
        DirectionPackets, FactorEntry, PacketCount, PacketExplanation, ScenarioPackets, SpreadEntry,
        UnreadableCapture, WindowPackets,
    },
    replicates::ReplicatesEntry,
};
use crate::{
    analysis::{
        agreement::{Agreement, Parting},
        conclusion::Conclusion,
        contrast::Contrast,
        expectation::ExpectedMean,
        health::Health,
        measured_experiment::MeasuredExperiment,
        packet_counts::TrafficTally,
        packet_explanations::{Explanation, Factor},
        report::Report,
        scenario::{ScenarioReport, Standing},
        within::WithinWindows,
    },
    input::run::RunPart,
    present::Presentation,
};

pub(super) fn document<'a>(page: &'a Presentation<'a>) -> ReportDocument<'a> {
    let report = page.report;
    let settings = &report.settings;
    let (within, between): (Vec<_>, Vec<_>) = report.tallies.iter().partition(|tally| tally.a == tally.b);
    let of = |standing: Standing| {
        report
            .scenarios
            .iter()
            .filter(move |scenario| scenario.standing == standing)
            .map(unmeasured)
            .collect::<Vec<_>>()
    };
    ReportDocument {
        run: &report.run,
        created: &report.created,
        runs: report.parts.iter().map(part).collect(),
        simulated: report.is_simulated(),
        alpha: settings.alpha,
        method: settings.method,
        quantity: QuantityEntry {
            name: &report.quantity.name,
            unit: &report.quantity.unit,
            origin: &report.quantity.origin,
        },
        metrics: &report.metrics,
        periods: report.quantity.is_tracking_error.then_some(PeriodsEntry {
            metric: settings.metric,
            error: settings.error,
            discard_periods: settings.discard_periods,
            warm_up: settings.warm_up,
        }),
        agreements: report.agreements.iter().map(agreement).collect(),
        control: &settings.baseline,
        findings: report.findings(),
        remarks: &page.remarks,
        scenarios: report.scenarios.iter().map(scenario).collect(),
        infeasible: of(Standing::Infeasible),
        errored: of(Standing::Errored),
        within: within
            .into_iter()
            .map(|tally| CountWithin {
                id: &tally.a,
                pairs: tally.pairs,
                rejected: tally.rejected,
            })
            .collect(),
        between: between
            .into_iter()
            .map(|tally| CountBetween {
                a: &tally.a,
                b: &tally.b,
                pairs: tally.pairs,
                rejected: tally.rejected,
                unlike: report.setup_differences(&tally.a, &tally.b),
            })
            .collect(),
        unlike: report
            .setup_differences
            .iter()
            .map(|unlike| UnlikePair {
                a: &unlike.a,
                b: &unlike.b,
                fields: &unlike.fields,
            })
            .collect(),
        family: family(report),
        contrasts: report
            .contrasts
            .pairs
            .iter()
            .map(|pair| contrast(report, pair))
            .collect(),
        replicates: report.replicates.as_ref().map(ReplicatesEntry::of),
        expected: report.expected.iter().map(expected).collect(),
        conclusions: report.conclusions.iter().map(conclusion).collect(),
        packets: report.traffic.scenarios.iter().map(packets).collect(),
        packet_counts: report.traffic_tallies.iter().flat_map(packet_counts).collect(),
        packet_explanations: report.explanations.iter().map(explanation).collect(),
        causes: &report.causes,
        replays: &report.replays,
        comparisons: ComparisonList(report),
    }
}

fn part(part: &RunPart) -> RunEntry<'_> {
    RunEntry {
        run: &part.run,
        created: &part.created,
        matrix_version: &part.matrix_version,
        matrix_revision: part.matrix_revision.as_ref(),
        scenarios: &part.scenarios,
    }
}

fn scenario(scenario: &ScenarioReport) -> ScenarioEntry<'_> {
    let windows = scenario.windows.iter().map(|window| WindowEntry {
        window: window.number,
        verdict: window.verdict,
        counted: window.is_counted,
        n: window.n,
        reasons: &window.reasons,
    });
    let broken = scenario.broken.iter().map(|broken| BrokenEntry {
        window: broken.window,
        environment: &broken.environment,
        reason: &broken.reason,
    });
    let (dynamics, overridden, experiment) = match &scenario.experiment {
        MeasuredExperiment::Ball {
            dynamics, overridden, ..
        } => (Some(*dynamics), Some(overridden.as_slice()), None),
        MeasuredExperiment::Command { name, .. } => (None, None, Some(name.as_str())),
    };
    ScenarioEntry {
        id: &scenario.id,
        slug: &scenario.slug,
        axes: &scenario.axes,
        is_control: scenario.is_baseline,
        dynamics,
        overridden,
        experiment,
        simulated: scenario.is_simulated,
        outcome: scenario.standing.name().replace(' ', "-"),
        reason: scenario.reason.as_deref(),
        hint: scenario.hint.as_deref(),
        windows: windows.collect(),
        broken: broken.collect(),
        environment: scenario.environment.as_ref(),
        within: scenario.within.as_ref().map(within),
        health: scenario.health.as_ref().map(health),
        calls: scenario.calls.map(|calls| CallsEntry {
            mean_s: calls.mean_s,
            longest_s: calls.longest_s,
            cpu_share: calls.cpu_share,
            peak_memory_bytes: calls.peak_memory_bytes,
            left_behind: calls.left_behind,
        }),
    }
}

fn agreement(agreement: &Agreement) -> AgreementEntry<'_> {
    fn parting(parting: &Parting) -> PartingEntry<'_> {
        PartingEntry {
            window: parting.window,
            byte: parting.byte,
            line: parting.line,
            first: &parting.first,
            this: &parting.this,
        }
    }
    let groups = agreement.groups.iter().map(|group| GroupEntry {
        scenarios: &group.scenarios,
        compared: group.compared,
        same_as_first: group.same_as_first,
        parts: group.parts.as_ref().map(parting),
    });
    AgreementEntry {
        metric: &agreement.metric,
        windows: &agreement.windows,
        groups: groups.collect(),
        without_data: &agreement.without_data,
    }
}

fn within(within: &WithinWindows) -> WithinEntry<'_> {
    let dependence = within.dependence.as_ref();
    let cut = within
        .cut
        .iter()
        .map(|&(window, periods)| CutWindow { window, periods });
    let unsteady = within.unsteady.iter().map(|(window, found)| UnsteadyWindow {
        window: *window,
        warm_up_periods: found.warm_up,
        change_after_periods: found.change.map(|change| change.after),
        change: found.change.map(|change| change.by),
        change_p: found.change.map(|change| change.p),
    });
    let unseen = within.unseen.iter().map(|(window, look, why)| UnseenEntry {
        window: *window,
        look: look.name(),
        reason: why.to_string(),
    });
    WithinEntry {
        autocorrelation: dependence.map(|found| found.autocorrelation.as_slice()),
        autocorrelation_time_periods: dependence.map(|found| found.time),
        effective_n: dependence.map(|found| found.effective),
        cut: cut.collect(),
        unsteady: unsteady.collect(),
        change_block_periods: within.change_block,
        not_looked_for: unseen.collect(),
    }
}

fn health(health: &Health) -> HealthEntry {
    HealthEntry {
        cpu_share: health.cpu_share,
        late_share: health.late_share,
        missed_deadlines: health.missed_deadlines,
        lost_ticks: health.lost_ticks,
        stale_share: health.stale_share,
        state_age_s: health.state_age_s,
        worst_lateness_ns: health.worst_lateness_ns,
        capture_dropped: health.capture_dropped,
        releases: health.releases,
    }
}

fn unmeasured(scenario: &ScenarioReport) -> Unmeasured<'_> {
    Unmeasured {
        id: &scenario.id,
        slug: &scenario.slug,
        reason: scenario.reason.as_deref(),
        hint: scenario.hint.as_deref(),
    }
}

fn family(report: &Report) -> FamilyEntry<'_> {
    let contrasts = &report.contrasts;
    FamilyEntry {
        declared: &contrasts.family,
        pairs: contrasts.pairs.len(),
        without_data: &contrasts.without_data,
        equivalence_margin: report.quantity.equivalence_margin,
        seed: report.settings.seed,
        max_t: contrasts.max_t.as_ref().map(|max_t| MaxTEntry {
            labellings: max_t.labellings,
            method: max_t.coverage.name(),
            smallest_p: max_t.smallest_p,
        }),
        simultaneous_confidence: contrasts.simultaneous_confidence(&report.settings),
        serial: contrasts.serial.map(|serial| SerialEntry {
            lag_one: serial.lag_one,
            p: serial.p,
            windows: serial.windows,
        }),
    }
}

fn contrast<'a>(report: &'a Report, pair: &'a Contrast) -> ContrastEntry<'a> {
    let differences = report.differences(&pair.a, &pair.b).into_iter();
    let differences = differences.map(|one| DifferenceEntry {
        field: one.field,
        a: one.first,
        b: one.second,
    });
    ContrastEntry {
        a: &pair.a,
        b: &pair.b,
        n: pair.n,
        m: pair.m,
        p: pair.level.p,
        smallest_p: pair.level.smallest_p,
        labellings: pair.level.labellings,
        method: pair.level.coverage.name(),
        shape: ShapeEntry(&pair.shape),
        shape_labellings: pair.shape.labellings(),
        blocks: pair.blocks.map(|blocks| BlocksEntry {
            block: blocks.block,
            pairs: blocks.pairs,
            rejected: blocks.rejected,
            possible: blocks.possible,
        }),
        p_holm: pair.p_holm,
        p_benjamini_yekutieli: pair.p_benjamini_yekutieli,
        p_max_t: pair.p_max_t,
        p_shift: pair.p_shift,
        p_shift_holm: pair.p_shift_holm,
        simultaneous: pair.simultaneous.map(|interval| IntervalEntry {
            low: interval.low,
            high: interval.high,
            confidence: interval.confidence,
        }),
        verdict: pair.verdict.name(),
        unlike: report.setup_differences(&pair.a, &pair.b),
        effect: effect(&pair.effect),
        differences: differences.collect(),
    }
}

fn expected(it: &ExpectedMean) -> ExpectedEntry<'_> {
    let miss = it.miss();
    let is_within = |interval: Interval| {
        it.low.is_none_or(|low| low <= interval.low) && it.high.is_none_or(|high| interval.high <= high)
    };
    ExpectedEntry {
        scenario: &it.scenario,
        value: it.value,
        low: it.low,
        high: it.high,
        windows: it.windows,
        mean: estimate(&it.mean),
        as_expected: miss.is_none(),
        sure: miss.map_or_else(|| it.mean.interval.is_some_and(is_within), |miss| miss.is_sure),
    }
}

fn conclusion(one: &Conclusion) -> ConclusionEntry<'_> {
    ConclusionEntry {
        axis: one.axis,
        first: &one.first,
        second: &one.second,
        hardware_differs: one.hardware_differs,
        strata: &one.strata,
        p: one.test.p,
        p_holm: one.p_holm,
        smallest_p: one.smallest_p,
        labellings: one.test.labellings,
        method: one.test.coverage.name(),
        shift: estimate(&one.shift),
    }
}

fn effect(effect: &Effect) -> EffectEntry {
    EffectEntry {
        shift: estimate(&effect.shift),
        wasserstein: estimate(&effect.wasserstein),
        superiority: estimate(&effect.superiority),
    }
}

fn estimate(estimate: &Estimate) -> EstimateEntry {
    EstimateEntry {
        value: estimate.value,
        low: estimate.interval.map(|interval| interval.low),
        high: estimate.interval.map(|interval| interval.high),
        confidence: estimate.interval.map(|interval| interval.confidence),
    }
}

/// The packets of a scenario's windows.
fn packets<'a>((id, found): (&'a String, &'a ScenarioTraffic)) -> ScenarioPackets<'a> {
    let windows = found.windows.iter().map(|window| WindowPackets {
        window: window.window,
        dropped: window.dropped,
        directions: window.directions.iter().map(direction).collect(),
    });
    let unreadable = found.unreadable.iter().map(|(window, reason)| UnreadableCapture {
        window: *window,
        reason,
    });
    ScenarioPackets {
        id,
        windows: windows.collect(),
        unreadable: unreadable.collect(),
    }
}

fn direction(direction: &DirectionTraffic) -> DirectionPackets {
    DirectionPackets {
        topic: direction.topic.name(),
        sent: direction.total(|period| period.sent),
        retransmitted: direction.total(|period| period.retransmitted),
        lost: direction.total(|period| period.lost),
        reordered: direction.total(|period| period.reordered),
        strays: direction.strays,
        one_way: direction.one_way.as_ref().map(spread),
        rtt: direction.rtt.as_ref().map(spread),
        jitter: direction.jitter.as_ref().map(spread),
        gap: direction.gap.as_ref().map(spread),
    }
}

fn spread(spread: &Spread) -> SpreadEntry {
    SpreadEntry {
        count: spread.count,
        mean_s: spread.mean_s,
        min_s: spread.min_s,
        median_s: spread.median_s(),
        p99_s: spread.p99_s(),
        max_s: spread.max_s,
    }
}

fn packet_counts(one: &TrafficTally) -> impl Iterator<Item = PacketCount<'_>> {
    one.tallies.iter().map(move |tally| PacketCount {
        topic: one.topic.name(),
        quantity: one.quantity.name(),
        a: &tally.a,
        b: &tally.b,
        pairs: tally.pairs,
        rejected: tally.rejected,
    })
}

fn explanation(one: &Explanation) -> PacketExplanation<'_> {
    PacketExplanation {
        a: &one.a,
        b: &one.b,
        shift: one.shift,
        factors: one.factors.iter().map(factor).collect(),
    }
}

fn factor(factor: &Factor) -> FactorEntry {
    FactorEntry {
        topic: factor.topic.name(),
        quantity: factor.quantity.name(),
        unit: match factor.quantity.is_time() {
            true => "s",
            false => "packets a period",
        },
        difference: factor.explained.difference,
        correlation: factor.explained.correlation,
        slope: factor.explained.slope,
        part: estimate(&factor.explained.part),
    }
}
