//! What a window is worth: each reason is a sentence with what was measured and its limit. The main function is [`judge`];
//! docs/validity.md is about the rules and their limits.
//!
//! A window is *invalid* when its log no longer is a record of the experiment as asked for: something is missing from it,
//! or the loop was not run at its rate. It is *suspect* when it is one of a platform that was disturbed: slowness of the
//! platform is what the experiment is there to measure, so that it must not be thrown away.

use std::cmp::Reverse;

use super::{Limits, ValiditySettings, nanoseconds, span};
use crate::{
    quantity::{Bytes, Fraction, TimeSpan},
    window::{CommandRecord, LoopsRecord, OfExperiment, Verdict, WindowRecord},
};

/// What the window was to be, as far as its record does not say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expectation<'a> {
    /// Length of a step.
    pub step_ns: i64,
    /// Control steps of a period.
    pub steps_per_period: u64,
    /// How many captures there were to be.
    pub captures: usize,
    /// What it may suffer.
    pub limits: &'a ValiditySettings,
}

/// The verdict on a record and its reasons; the record's own are not looked at.
#[must_use]
pub fn judge(record: &WindowRecord, expected: &Expectation<'_>) -> (Verdict, Vec<String>) {
    let limits = expected.limits;
    let mut findings = Findings::default();
    match &record.of {
        OfExperiment::Loops(loops) => {
            completeness(record.complete, loops, expected, &mut findings);
            limits.timing(&mut findings, "controller", &loops.controller, expected.step_ns);
            limits.timing(&mut findings, "plant", &loops.plant, expected.step_ns);
        }
        OfExperiment::Command { command } => ending(command, &mut findings),
    }
    limits.whole(&mut findings, record, expected.step_ns);
    captures(record, expected, &mut findings);
    limits.conditions(&mut findings, &record.conditions);
    findings.conclude()
}

/// What was found, and what it makes of the window.
#[derive(Default)]
pub(super) struct Findings(Vec<(Verdict, String)>);

impl Findings {
    fn invalid(&mut self, reason: String) {
        self.0.push((Verdict::Invalid, reason));
    }

    fn suspect(&mut self, reason: String) {
        self.0.push((Verdict::Suspect, reason));
    }

    /// Holds what was measured, if it could be, against its limits. `says` makes a sentence of it, without its stop.
    pub(super) fn rule<T: Measured>(
        &mut self,
        limits: Limits<T>,
        measured: Option<T>,
        says: impl Fn(&str) -> String,
    ) {
        let Some(measured) = measured else { return };
        let sentence = |level: &str, limit: &T| {
            format!(
                "{} ({level} above {}).",
                says(&measured.in_words()),
                limit.in_words()
            )
        };
        if let Some(limit) = limits.invalid.exceeded_by(&measured) {
            self.invalid(sentence("invalid", limit));
        } else if let Some(limit) = limits.suspect.exceeded_by(&measured) {
            self.suspect(sentence("suspect", limit));
        }
    }

    /// The worst of it, and all reasons: those of the verdict first, since the first one is what a line has room for.
    fn conclude(mut self) -> (Verdict, Vec<String>) {
        self.0.sort_by_key(|(found, _)| Reverse(*found));
        let verdict = self.0.first().map_or(Verdict::Valid, |(worst, _)| *worst);
        (verdict, self.0.into_iter().map(|(_, reason)| reason).collect())
    }
}

/// Something with a limit. Words are for a person: rounded, always in the same unit.
pub(super) trait Measured: PartialOrd {
    fn in_words(&self) -> String;
}

impl Measured for Fraction {
    fn in_words(&self) -> String {
        format!("{:.2} %", self.probability() * 100.0)
    }
}

impl Measured for TimeSpan {
    fn in_words(&self) -> String {
        let milliseconds = self.as_nanos() as f64 / 1e6;
        if milliseconds < 10.0 {
            format!("{milliseconds:.2} ms")
        } else {
            format!("{milliseconds:.0} ms")
        }
    }
}

impl Measured for u64 {
    fn in_words(&self) -> String {
        self.to_string()
    }
}

impl Measured for Bytes {
    fn in_words(&self) -> String {
        format!("{:.1} MiB", self.get() as f64 / 1_048_576.0)
    }
}

/// What is missing has no limit: the report needs every step.
fn completeness(
    is_complete: bool,
    loops: &LoopsRecord,
    expectation: &Expectation<'_>,
    findings: &mut Findings,
) {
    let (done, expected) = (loops.steps_done, loops.steps_expected);
    let lost = loops.controller.lost_ticks;
    if !is_complete {
        findings.invalid(format!("The window was cut after {done} of {expected} steps."));
    } else if done + lost != expected {
        let besides = besides(lost);
        findings.invalid(format!("The log has {done} steps, not {expected}{besides}."));
    }
    // Without a step there is no error to average over the period.
    let period_ns = u64::try_from(expectation.step_ns)
        .unwrap_or(0)
        .saturating_mul(expectation.steps_per_period);
    let gap_ns = nanoseconds(loops.longest_gap_ns);
    if gap_ns > period_ns {
        findings.invalid(format!(
            "For {} no control step was done, longer than a period.",
            span(gap_ns).in_words()
        ));
    }
    if loops.log_dropped > 0 {
        findings.invalid(format!(
            "{} rows were lost since the log's queue was full.",
            loops.log_dropped
        ));
    }
    if is_complete && loops.plant.steps + loops.plant.lost_ticks != expected {
        findings.invalid(format!(
            "The plant did {} steps, not {expected}{}.",
            loops.plant.steps,
            besides(loops.plant.lost_ticks)
        ));
    }
}

/// What a command measures is there only if it says that all went well.
fn ending(command: &CommandRecord, findings: &mut Findings) {
    // Why it was ended, only those know who did.
    if let Some(code) = command.exit_code.filter(|code| *code != 0) {
        findings.invalid(format!("the command ended with exit code {code}"));
    }
}

fn besides(lost: u64) -> String {
    match lost {
        0 => String::new(),
        lost => format!(", and {lost} ticks were lost"),
    }
}

fn captures(record: &WindowRecord, expected: &Expectation<'_>, findings: &mut Findings) {
    let wanted = expected.captures;
    if record.captures.len() < wanted {
        let missing = wanted - record.captures.len();
        findings.suspect(format!("{missing} of {wanted} captures are missing."));
    }
    for capture in &record.captures {
        expected.limits.capture(findings, capture);
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;
    use crate::{
        FORMAT,
        settings::Limit,
        virtual_host::VirtualHost,
        window::{
            CaptureRecord, ConditionsRecord, LoopRecord, LoopsRecord, NoticesRecord, OfExperiment,
            ReleaseRecord,
        },
    };

    const STEP_NS: i64 = 20_000_000;

    fn expected(limits: &ValiditySettings) -> Expectation<'_> {
        Expectation {
            step_ns: STEP_NS,
            steps_per_period: 5000,
            captures: 1,
            limits,
        }
    }

    fn clean() -> WindowRecord {
        let held = LoopRecord {
            steps: 10_000,
            ..LoopRecord::default()
        };
        WindowRecord {
            format: FORMAT,
            window: 1,
            environment: "test".into(),
            starts_run: true,
            complete: true,
            started_unix_ns: 0,
            ended_unix_ns: 0,
            started_ns: 0,
            ended_ns: 0,
            of: OfExperiment::Loops(LoopsRecord {
                steps_expected: 10_000,
                steps_done: 10_000,
                controller: held,
                plant: held,
                stale_steps: 0,
                longest_gap_ns: 20_500_000,
                log_dropped: 0,
            }),
            clock_jump_ns: 0,
            cpu_share: 0.0,
            conditions: ConditionsRecord::default(),
            captures: vec![CaptureRecord {
                host: VirtualHost::STA1,
                packets: 996,
                dropped: 0,
                tool: "builtin".into(),
            }],
            network_seed: None,
            links: Vec::new(),
            notices: NoticesRecord::default(),
            releases: None,
            files: Vec::new(),
            verdict: Verdict::Valid,
            reasons: Vec::new(),
        }
    }

    fn loops(record: &mut WindowRecord) -> &mut LoopsRecord {
        record.loops_mut().unwrap()
    }

    fn of_a_command(record: &mut WindowRecord, exit_code: i32) {
        record.of = OfExperiment::Command {
            command: CommandRecord {
                exit_code: Some(exit_code),
                ..CommandRecord::default()
            },
        };
    }

    #[rstest]
    #[case::clean(|_: &mut WindowRecord| (), Verdict::Valid, &[])]
    #[case::command(|it: &mut WindowRecord| of_a_command(it, 0), Verdict::Valid, &[])]
    #[case::failed_command(
        |it: &mut WindowRecord| of_a_command(it, 3), Verdict::Invalid, &["the command ended with exit code 3"]
    )]
    #[case::cut(
        |it: &mut WindowRecord| { it.complete = false; loops(it).steps_done = 7; },
        Verdict::Invalid, &["The window was cut after 7 of 10000 steps."]
    )]
    #[case::steps_missing(|it: &mut WindowRecord| loops(it).steps_done = 9999, Verdict::Invalid, &["The log has 9999 steps, not 10000."])]
    #[case::rows_lost(
        |it: &mut WindowRecord| loops(it).log_dropped = 2, Verdict::Invalid, &["2 rows were lost since the log's queue was full."]
    )]
    #[case::plant_stopped(|it: &mut WindowRecord| loops(it).plant.steps = 1, Verdict::Invalid, &["The plant did 1 steps, not 10000."])]
    #[case::ten_misses_are_few(|it: &mut WindowRecord| loops(it).controller.missed_deadlines = 10, Verdict::Valid, &[])]
    #[case::eleven_misses(
        |it: &mut WindowRecord| loops(it).controller.missed_deadlines = 11,
        Verdict::Suspect, &["The controller missed 0.11 % of its deadlines (suspect above 0.10 %)."]
    )]
    #[case::many_misses(
        |it: &mut WindowRecord| loops(it).plant.missed_deadlines = 600,
        Verdict::Invalid, &["The plant missed 6.00 % of its deadlines (invalid above 5.00 %)."]
    )]
    #[case::a_tenth_of_a_step_is_not_late(|it: &mut WindowRecord| loops(it).controller.lateness_p99_ns = 2_000_000, Verdict::Valid, &[])]
    #[case::late(
        |it: &mut WindowRecord| loops(it).plant.lateness_p99_ns = 2_500_000,
        Verdict::Suspect, &["1 % of the plant's steps began more than 2.50 ms late (suspect above 2.00 ms)."]
    )]
    #[case::short_gap(|it: &mut WindowRecord| loops(it).longest_gap_ns = 100_000_000, Verdict::Valid, &[])]
    #[case::gap(
        |it: &mut WindowRecord| loops(it).longest_gap_ns = 101_000_000,
        Verdict::Suspect, &["For 101 ms no control step was done (suspect above 100 ms)."]
    )]
    #[case::hole(
        |it: &mut WindowRecord| loops(it).longest_gap_ns = 1_001_000_000,
        Verdict::Invalid, &["For 1001 ms no control step was done (invalid above 1000 ms)."]
    )]
    #[case::slow_network(
        |it: &mut WindowRecord| it.releases = Some(ReleaseRecord { lateness_p99_ns: 1_500_000, ..ReleaseRecord::default() }),
        Verdict::Suspect, &["The network let 1 % of the packets go more than 1.50 ms late (suspect above 1.00 ms)."]
    )]
    #[case::network_of_another_delay(
        |it: &mut WindowRecord| it.releases = Some(ReleaseRecord { lateness_p99_ns: 11_000_000, ..ReleaseRecord::default() }),
        Verdict::Invalid, &["The network let 1 % of the packets go more than 11 ms late (invalid above 10 ms)."]
    )]
    #[case::clock_set_back(
        |it: &mut WindowRecord| it.clock_jump_ns = -3_000_000_000,
        Verdict::Suspect, &["The wall clock was set back by 3000 ms (suspect above 1.00 ms)."]
    )]
    #[case::capture_missing(|it: &mut WindowRecord| it.captures.clear(), Verdict::Suspect, &["1 of 1 captures are missing."])]
    #[case::capture_dropped(
        |it: &mut WindowRecord| it.captures[0].dropped = 4,
        Verdict::Suspect, &["The kernel dropped 4 packets of the capture on sta1, 0.40 % (suspect above 0.00 %)."]
    )]
    #[case::steal(
        |it: &mut WindowRecord| it.conditions.steal_share = Some(0.02),
        Verdict::Suspect, &["A hypervisor gave 2.00 % of the processors' time to others (suspect above 1.00 %)."]
    )]
    #[case::quota(
        |it: &mut WindowRecord| it.conditions.throttled_share = Some(0.25),
        Verdict::Suspect,
        &["A quota of the control group held the workload up for 25.00 % of the window (suspect above 0.10 %)."]
    )]
    #[case::heat(
        |it: &mut WindowRecord| it.conditions.thermal_throttles = Some(3),
        Verdict::Suspect, &["Processors slowed down 3 times since they were too hot (suspect above 0)."]
    )]
    #[case::others(
        |it: &mut WindowRecord| it.conditions.other_load_share = Some(0.5),
        Verdict::Suspect, &["Others on the machine used 50.00 % of the processors' time (suspect above 10.00 %)."]
    )]
    #[case::quiet_others(|it: &mut WindowRecord| it.conditions.other_load_share = Some(0.1), Verdict::Valid, &[])]
    #[case::memory(
        |it: &mut WindowRecord| it.conditions.memory_pressure_share = Some(0.03),
        Verdict::Suspect, &["Something on the machine waited for memory in 3.00 % of the window (suspect above 1.00 %)."]
    )]
    #[case::faults(
        |it: &mut WindowRecord| it.conditions.major_faults = 11,
        Verdict::Suspect, &["11 pages of the workload had to be read from a disk (suspect above 10)."]
    )]
    #[case::swapping(
        |it: &mut WindowRecord| it.conditions.swapped_bytes = Some(3 << 20),
        Verdict::Suspect, &["The machine swapped 3.0 MiB (suspect above 1.0 MiB)."]
    )]
    #[case::the_worst_counts(
        |it: &mut WindowRecord| { it.clock_jump_ns = 20_000_000; loops(it).log_dropped = 1; },
        Verdict::Invalid,
        &["1 rows were lost since the log's queue was full.", "The wall clock was set forward by 20 ms (suspect above 1.00 ms)."]
    )]
    #[case::the_reasons_of_the_verdict_come_first(
        |it: &mut WindowRecord| { loops(it).controller.missed_deadlines = 11; loops(it).longest_gap_ns = 1_001_000_000; },
        Verdict::Invalid,
        &[
            "For 1001 ms no control step was done (invalid above 1000 ms).",
            "The controller missed 0.11 % of its deadlines (suspect above 0.10 %).",
        ]
    )]
    fn a_window_is_worth(
        #[case] spoil: fn(&mut WindowRecord),
        #[case] verdict: Verdict,
        #[case] reasons: &[&str],
    ) {
        let mut record = clean();
        spoil(&mut record);
        let (found, why) = judge(&record, &expected(&ValiditySettings::default()));
        assert_eq!(
            (found, why),
            (verdict, reasons.iter().map(ToString::to_string).collect())
        );
    }

    #[test]
    fn the_limits_are_those_of_the_settings() {
        let mut record = clean();
        record.conditions.steal_share = Some(0.02);
        let mut limits = ValiditySettings::default();
        limits.steal.invalid = Limit::Above(Fraction::from_percent(1.5));
        let (verdict, reasons) = judge(&record, &expected(&limits));
        assert_eq!(verdict, Verdict::Invalid);
        assert_eq!(
            reasons,
            ["A hypervisor gave 2.00 % of the processors' time to others (invalid above 1.50 %)."]
        );
        limits.steal = Limits {
            suspect: Limit::Never,
            invalid: Limit::Never,
        };
        assert_eq!(judge(&record, &expected(&limits)), (Verdict::Valid, Vec::new()));
    }

    #[test]
    fn what_a_platform_hides_is_no_reason() {
        let mut record = clean();
        record.conditions = ConditionsRecord::default();
        record.releases = None;
        assert_eq!(
            judge(&record, &expected(&ValiditySettings::default())).0,
            Verdict::Valid
        );
    }
}
