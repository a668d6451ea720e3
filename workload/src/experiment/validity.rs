//! What a window is worth: the rules in one place, each reason a sentence. The main function is [`judge`].
//!
//! A rule makes a window *invalid* when its log no longer is a record of the experiment as asked for (something is
//! missing from it), and *suspect* when it is one of a platform that was disturbed: slowness of the platform is what
//! the experiment is there to measure, so that it must not be thrown away.

use crate::record::window::{LoopRecord, Verdict, WindowRecord};

/// Share of steps that may miss their deadline without a remark.
const MISSED_SHARE: f64 = 0.001;
/// From this share on the loop did not run at its rate.
const MISSED_SHARE_INVALID: f64 = 0.05;
/// Steps without one being done that are a remark, and that are a hole.
const GAP_STEPS: i64 = 5;
const GAP_STEPS_INVALID: i64 = 50;
/// A step of the wall clock that is a remark: captures are stamped with it.
const CLOCK_JUMP_NS: i64 = 10_000_000;

/// What the window was to be, as far as its record does not say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Expectation {
    /// Length of a step.
    pub step_ns: i64,
    /// How many captures there were to be.
    pub captures: usize,
}

/// The verdict on a record and its reasons; the record's own are not looked at.
#[must_use]
pub fn judge(record: &WindowRecord, expected: &Expectation) -> (Verdict, Vec<String>) {
    let mut findings = Vec::new();
    completeness(record, &mut findings);
    deadlines("controller", &record.controller, &mut findings);
    deadlines("plant", &record.plant, &mut findings);
    gaps(record, expected.step_ns, &mut findings);
    clock(record, &mut findings);
    captures(record, expected.captures, &mut findings);
    let worst = |verdict| findings.iter().any(|(found, _)| *found == verdict);
    let verdict = if worst(Verdict::Invalid) {
        Verdict::Invalid
    } else if worst(Verdict::Suspect) {
        Verdict::Suspect
    } else {
        Verdict::Valid
    };
    (verdict, findings.into_iter().map(|(_, reason)| reason).collect())
}

type Findings = Vec<(Verdict, String)>;

fn completeness(record: &WindowRecord, findings: &mut Findings) {
    if !record.complete {
        findings.push((
            Verdict::Invalid,
            format!(
                "The window was cut after {} of {} steps.",
                record.steps_done, record.steps_expected
            ),
        ));
    } else if record.steps_done != record.steps_expected {
        findings.push((
            Verdict::Invalid,
            format!(
                "The log has {} steps, not {}.",
                record.steps_done, record.steps_expected
            ),
        ));
    }
    if record.log_dropped > 0 {
        findings.push((
            Verdict::Invalid,
            format!(
                "{} rows were lost since the log's queue was full.",
                record.log_dropped
            ),
        ));
    }
    if record.complete && record.plant.steps != record.steps_expected {
        findings.push((
            Verdict::Invalid,
            format!(
                "The plant did {} steps, not {}.",
                record.plant.steps, record.steps_expected
            ),
        ));
    }
}

fn deadlines(who: &str, done: &LoopRecord, findings: &mut Findings) {
    let share = done.missed_deadlines as f64 / done.steps.max(1) as f64;
    let verdict = if share > MISSED_SHARE_INVALID {
        Verdict::Invalid
    } else if share > MISSED_SHARE {
        Verdict::Suspect
    } else {
        return;
    };
    findings.push((
        verdict,
        format!("The {who} missed {:.2} % of its deadlines.", share * 100.0),
    ));
}

fn gaps(record: &WindowRecord, step_ns: i64, findings: &mut Findings) {
    let verdict = if record.longest_gap_ns >= GAP_STEPS_INVALID * step_ns {
        Verdict::Invalid
    } else if record.longest_gap_ns >= GAP_STEPS * step_ns {
        Verdict::Suspect
    } else {
        return;
    };
    let gap_ms = record.longest_gap_ns as f64 / 1e6;
    findings.push((verdict, format!("For {gap_ms:.0} ms no control step was done.")));
}

fn clock(record: &WindowRecord, findings: &mut Findings) {
    if record.clock_jump_ns.abs() > CLOCK_JUMP_NS {
        let jump_ms = record.clock_jump_ns as f64 / 1e6;
        findings.push((
            Verdict::Suspect,
            format!("The wall clock was set by {jump_ms:+.0} ms."),
        ));
    }
}

fn captures(record: &WindowRecord, expected: usize, findings: &mut Findings) {
    if record.captures.len() < expected {
        findings.push((
            Verdict::Suspect,
            format!(
                "{} of {expected} captures are missing.",
                expected - record.captures.len()
            ),
        ));
    }
    for capture in record.captures.iter().filter(|capture| capture.dropped > 0) {
        findings.push((
            Verdict::Suspect,
            format!(
                "The kernel dropped {} packets of the capture on {}.",
                capture.dropped, capture.host
            ),
        ));
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;
    use crate::{
        record::{
            FORMAT,
            window::{CaptureRecord, NoticesRecord},
        },
        virtual_host::VirtualHost,
    };

    const EXPECTED: Expectation = Expectation {
        step_ns: 20_000_000,
        captures: 1,
    };

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
            steps_expected: 10_000,
            steps_done: 10_000,
            controller: held,
            plant: held,
            stale_steps: 0,
            longest_gap_ns: 20_500_000,
            clock_jump_ns: 0,
            log_dropped: 0,
            cpu_share: 0.0,
            captures: vec![CaptureRecord {
                host: VirtualHost::Sta1,
                packets: 1,
                dropped: 0,
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

    #[rstest]
    #[case::clean(|_: &mut WindowRecord| (), Verdict::Valid, &[])]
    #[case::cut(
        |it: &mut WindowRecord| { it.complete = false; it.steps_done = 7; },
        Verdict::Invalid, &["The window was cut after 7 of 10000 steps."]
    )]
    #[case::steps_missing(|it: &mut WindowRecord| it.steps_done = 9999, Verdict::Invalid, &["The log has 9999 steps, not 10000."])]
    #[case::rows_lost(
        |it: &mut WindowRecord| it.log_dropped = 2, Verdict::Invalid, &["2 rows were lost since the log's queue was full."]
    )]
    #[case::plant_stopped(|it: &mut WindowRecord| it.plant.steps = 1, Verdict::Invalid, &["The plant did 1 steps, not 10000."])]
    #[case::ten_misses_are_few(|it: &mut WindowRecord| it.controller.missed_deadlines = 10, Verdict::Valid, &[])]
    #[case::eleven_misses(
        |it: &mut WindowRecord| it.controller.missed_deadlines = 11,
        Verdict::Suspect, &["The controller missed 0.11 % of its deadlines."]
    )]
    #[case::many_misses(
        |it: &mut WindowRecord| it.plant.missed_deadlines = 600,
        Verdict::Invalid, &["The plant missed 6.00 % of its deadlines."]
    )]
    #[case::short_gap(|it: &mut WindowRecord| it.longest_gap_ns = 99_000_000, Verdict::Valid, &[])]
    #[case::gap(
        |it: &mut WindowRecord| it.longest_gap_ns = 100_000_000, Verdict::Suspect, &["For 100 ms no control step was done."]
    )]
    #[case::hole(
        |it: &mut WindowRecord| it.longest_gap_ns = 1_000_000_000, Verdict::Invalid, &["For 1000 ms no control step was done."]
    )]
    #[case::clock_set_back(
        |it: &mut WindowRecord| it.clock_jump_ns = -3_000_000_000, Verdict::Suspect, &["The wall clock was set by -3000 ms."]
    )]
    #[case::capture_missing(|it: &mut WindowRecord| it.captures.clear(), Verdict::Suspect, &["1 of 1 captures are missing."])]
    #[case::capture_dropped(
        |it: &mut WindowRecord| it.captures[0].dropped = 4,
        Verdict::Suspect, &["The kernel dropped 4 packets of the capture on sta1."]
    )]
    #[case::the_worst_counts(
        |it: &mut WindowRecord| { it.clock_jump_ns = 20_000_000; it.log_dropped = 1; },
        Verdict::Invalid,
        &["1 rows were lost since the log's queue was full.", "The wall clock was set by +20 ms."]
    )]
    fn a_window_is_worth(
        #[case] spoil: fn(&mut WindowRecord),
        #[case] verdict: Verdict,
        #[case] reasons: &[&str],
    ) {
        let mut record = clean();
        spoil(&mut record);
        let (found, why) = judge(&record, &EXPECTED);
        assert_eq!(
            (found, why),
            (verdict, reasons.iter().map(ToString::to_string).collect())
        );
    }
}
