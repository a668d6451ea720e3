//! One plain line an event, for pipes, files and CI. The main type is [`PlainLog`].

use std::io::Write;

use record::{
    progress::Progress,
    run_directory::{Event, JobStanding, Standing, fact},
};

use crate::{escaping, observer::Observer};

/// Writes a line for each event that a person wants to know of.
pub struct PlainLog<W>(W);

impl<W: Write + Send> PlainLog<W> {
    /// Writes to `out`. A reader that went away is no reason to stop measuring.
    pub fn new(out: W) -> Self {
        Self(out)
    }
}

impl<W: Write + Send> Observer for PlainLog<W> {
    fn observe(&mut self, event: &Event) {
        if let Some(line) = line(event) {
            // The journal has it, whether or not anybody reads this.
            let _ = writeln!(self.0, "{line}").and_then(|()| self.0.flush());
        }
    }
}

/// The line for an event, whatever is in it; none for what only machines care for.
#[must_use]
pub fn line(event: &Event) -> Option<String> {
    words(event).map(|words| escaping::harmless_line(&words))
}

fn words(event: &Event) -> Option<String> {
    Some(match event {
        Event::RunStarted { resumed: true, .. } => "run: going on".to_owned(),
        Event::RunStarted { .. }
        | Event::EnvironmentRecorded { .. }
        | Event::EnvironmentDiscarding { .. } => {
            return None;
        }
        Event::HostBusy { host, holder } => format!("{host}: waiting, held by {holder}"),
        Event::ScenarioStarted {
            scenario,
            windows,
            round,
        } => format!("{scenario}: {}windows {}", environment(*round), list(windows)),
        Event::EnvironmentCreating {
            scenario,
            provider,
            environment,
            ..
        } => {
            format!("{scenario}: creating {provider} environment {environment}")
        }
        // Where its job stands comes next.
        Event::EnvironmentCreated { facts, .. } if facts.contains_key(fact::JOB) => return None,
        Event::EnvironmentCreated { scenario, .. } => format!("{scenario}: environment is up"),
        Event::JobChanged {
            scenario, standing, ..
        } => format!("{scenario}: {}", job(standing)),
        Event::EnvironmentFound {
            scenario,
            environment,
            running,
        } => {
            // Whether it gets on is known when it says so.
            let doing = if *running { "has not ended" } else { "has ended" };
            format!("{scenario}: found {environment} again, its workload {doing}")
        }
        Event::Workload { scenario, progress } => format!("{scenario}: {}", said(progress)?),
        Event::WorkloadSilent { scenario, for_s } => {
            format!(
                "{scenario}: nothing was heard of the workload for {for_s} s: it, its host or its engine stands still"
            )
        }
        Event::WorkloadHeard { scenario, after_s } => {
            format!("{scenario}: the workload was heard of again after {after_s} s")
        }
        Event::WindowCollected {
            scenario,
            window,
            verdict,
            ..
        } => {
            format!("{scenario}: window {window} collected, {}", verdict.name())
        }
        Event::WindowBroken {
            scenario,
            window,
            reason,
            ..
        } => {
            format!("{scenario}: window {window} broke and is kept aside: {reason}")
        }
        Event::EnvironmentDiscarded { scenario, .. } => format!("{scenario}: environment discarded"),
        Event::EnvironmentKept {
            scenario,
            environment,
        } => {
            format!(
                "{scenario}: {environment} is kept: `matrix shell {scenario}` enters it, `matrix clean` removes it"
            )
        }
        Event::ScenarioFinished {
            scenario,
            outcome,
            reason,
            hint,
            round,
        } => {
            let mut line = format!("{scenario}: {}{}", environment(*round), outcome.name());
            for part in [reason, hint].into_iter().flatten() {
                line.push_str(": ");
                line.push_str(part);
            }
            line
        }
        Event::RunLeft => "run: left, its jobs go on".to_owned(),
        Event::RunFinished => "run: finished".to_owned(),
        Event::RunInterrupted => "run: interrupted".to_owned(),
    })
}

/// Where a job stands, in one line.
#[must_use]
pub fn job(standing: &JobStanding) -> String {
    let JobStanding {
        job,
        standing,
        state,
        reason,
        node,
        start,
    } = standing;
    let reason = reason.as_ref().map(|reason| format!(" ({reason})"));
    let node = node.as_ref().map(|node| match standing.is_alive() {
        true => format!(" on {node}"),
        false => format!(", it ran on {node}"),
    });
    // Of a job that runs the node says more.
    let is_to_come = matches!(standing, Standing::Waits | Standing::WaitsForEver);
    let start = start.as_ref().filter(|_| is_to_come && node.is_none());
    let start = start.map(|start| format!(", expected to start at {start} of the cluster's clock"));
    format!(
        "job {job} is {state}{}{}{}",
        reason.unwrap_or_default(),
        node.unwrap_or_default(),
        start.unwrap_or_default()
    )
}

fn said(progress: &Progress) -> Option<String> {
    Some(match progress {
        Progress::Started { .. }
        | Progress::Health { .. }
        | Progress::Running { .. }
        | Progress::Preparing => return None,
        Progress::NetworkUp => "virtual hosts are linked".to_owned(),
        Progress::Connected => "controller and plant are connected".to_owned(),
        Progress::Rehearsing { .. } => "nothing is measured".to_owned(),
        Progress::Notice { host, text } => format!("{host}: {text}"),
        Progress::Measuring { window } => format!("measuring window {window}"),
        Progress::WindowComplete {
            window,
            verdict,
            reason,
        } => {
            let reason = reason.as_ref().map(|reason| format!(": {reason}"));
            format!(
                "window {window} complete, {}{}",
                verdict.name(),
                reason.unwrap_or_default()
            )
        }
        Progress::PlatformChanged { changes } => {
            let changes: Vec<String> = changes.iter().map(ToString::to_string).collect();
            format!(
                "the platform changed while it was measured: {}",
                changes.join("; ")
            )
        }
        Progress::Stopped { window } => format!("stopped in window {window}"),
        Progress::Finished => "all windows measured".to_owned(),
        Progress::Failed { reason, .. } => format!("failed: {reason}"),
    })
}

/// Which environment of a scenario it is, where there are several.
fn environment(round: Option<u32>) -> String {
    round.map_or_else(String::new, |round| format!("environment {round}, "))
}

/// What is beside the name of a scenario whose windows were computed.
pub const fn if_simulated(simulated: bool) -> &'static str {
    match simulated {
        true => " (simulated, not measured)",
        false => "",
    }
}

fn list(windows: &[u32]) -> String {
    windows.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use record::run_directory::Outcome;

    use super::*;

    #[test]
    fn an_errored_scenario_is_told_with_its_reason_and_what_to_do() {
        let event = Event::ScenarioFinished {
            scenario: "x86-64-debian-12-docker".into(),
            outcome: Outcome::Errored,
            reason: Some("no space left".into()),
            hint: Some("make room".into()),
            round: None,
        };
        assert_eq!(
            line(&event).unwrap(),
            "x86-64-debian-12-docker: errored: no space left: make room"
        );
    }

    #[test]
    fn the_environment_is_named_where_a_scenario_has_several() {
        let event = Event::ScenarioStarted {
            scenario: "x86-64-debian-12-docker".into(),
            windows: vec![5, 6],
            round: Some(3),
        };
        assert_eq!(
            line(&event).unwrap(),
            "x86-64-debian-12-docker: environment 3, windows 5, 6"
        );
    }

    #[test]
    fn health_is_not_a_line() {
        let progress = Progress::Health {
            window: 1,
            steps_done: 1,
            steps_expected: 2,
            missed_deadlines: 0,
            worst_lateness_ns: 0,
        };
        assert_eq!(
            line(&Event::Workload {
                scenario: "s".into(),
                progress
            }),
            None
        );
    }
}
