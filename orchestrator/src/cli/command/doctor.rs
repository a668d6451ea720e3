//! `matrix doctor [FILE]`: what this machine, or each host of a matrix file, can do, what is missing and how to get it.

use std::{fmt::Write, path::PathBuf};

use clap::Args;
use record::{axis::NATIVE, causes::with_causes, check::Check, exit::matrix::Exit};
use schemars::JsonSchema;
use serde::Serialize;

use crate::{
    cli::{
        command::options::OutputArguments,
        terminal::{self, CommandError},
    },
    disk_space, escaping,
    examination::{self, Examination, Probing, Standing},
    plan::Obstacle,
    provider::{Availability, Catalogue, ProviderError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct DoctorArguments {
    /// A matrix file, whose hosts are asked in place of this machine.
    file: Option<PathBuf>,
    /// Submit a job of a minute to each cluster of the file, which looks whether its node has what the experiment needs.
    #[arg(long, requires = "file")]
    probe: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// What this machine can do, or, with a matrix file, each of its hosts.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
#[schemars(title = "matrix doctor --json")]
pub enum DoctorDocument<'a> {
    /// Without a matrix file: this machine.
    Machine(Box<HostRecord<'a>>),
    /// With a matrix file: its hosts.
    Hosts {
        /// Each host of the file.
        hosts: Vec<HostRecord<'a>>,
    },
}

/// What a host can do.
#[derive(Debug, Serialize, JsonSchema)]
pub struct HostRecord<'a> {
    /// Its name in the matrix file; without one, `local`.
    host: &'a str,
    /// Its hardware, as `uname -m` prints it; empty if it cannot be asked.
    hardware: &'a str,
    /// `ID` and `VERSION_ID` of its os-release, such as `debian-12`.
    os: &'a str,
    /// Its kernel, as `uname -r` prints it.
    kernel: &'a str,
    /// Why it cannot be asked; null if it can.
    obstacle: Option<&'a Obstacle>,
    /// The number of the user whose rights are used there; null if it cannot be asked.
    uid: Option<u32>,
    /// Free space on the disk with its state folder, in bytes; null if it cannot be asked.
    free_bytes: Option<u64>,
    /// What the windows of the matrix file take on its disk, in bytes; null without a file.
    to_come_bytes: Option<u64>,
    /// How far its clock is ahead of this machine's, in milliseconds; null if it cannot be asked.
    clock_ahead_ms: Option<f64>,
    /// By how much that may be wrong, in milliseconds.
    clock_within_ms: Option<f64>,
    /// What the experiment needs; null if it cannot be asked.
    checks: Option<&'a [Check]>,
    /// The providers, and the settings that need something of the host.
    providers: Vec<AvailabilityRecord<'a>>,
}

/// Whether a provider, or a setting with it, can be had on a host.
#[derive(Debug, Serialize, JsonSchema)]
struct AvailabilityRecord<'a> {
    /// The provider or the setting, such as `docker` or `network.backend: kernel`.
    name: String,
    /// Whether it can be had.
    available: bool,
    /// What is known of it, such as `Engine 20.10.24`; only if it can be had.
    #[serde(skip_serializing_if = "Option::is_none")]
    detail: Option<&'a str>,
    /// Why not; only if it cannot be had.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'a str>,
    /// What would make it available, null if that is not known; only if it cannot be had.
    #[serde(skip_serializing_if = "Option::is_none")]
    fix: Option<Option<&'a str>>,
    /// The settings that need something of the host; only for a provider.
    #[serde(skip_serializing_if = "Option::is_none")]
    settings: Option<Vec<AvailabilityRecord<'a>>>,
}

/// Asks every provider, and the workload itself, and prints what they say.
///
/// # Errors
/// When the file is wrong, or the workload's own check cannot be run on this machine.
pub async fn execute(arguments: &DoctorArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let Some(path) = &arguments.file else {
        return of_this_machine(arguments.output.json, catalogue).await;
    };
    let probing = match arguments.probe {
        true => Probing::SubmitsJobs,
        false => Probing::SubmitsNothing,
    };
    let answers = examination::of_hosts(path, catalogue, probing).await?;
    if arguments.output.json {
        terminal::json(&DoctorDocument::Hosts {
            hosts: answers.iter().map(record).collect(),
        });
    } else {
        let texts: Vec<_> = answers
            .iter()
            .map(|answer| as_text(&answer.name, answer))
            .collect();
        terminal::result(&format!("{}\n{}", table(&answers, catalogue), texts.join("\n")));
        if nothing_can_run(&answers) {
            terminal::print_note(&format!(
                "no scenario of the file can run: `matrix plan {}` says of each why",
                escaping::pasted(path)
            ));
        }
    }
    Ok(exit(&answers, catalogue))
}

/// A script that asks before it measures learns from this that it cannot.
fn exit(answers: &[Examination], catalogue: Catalogue) -> Exit {
    match nothing_can_run(answers) || answers.iter().any(|answer| answer.is_lacking(catalogue)) {
        true => Exit::Infrastructure,
        false => Exit::Done,
    }
}

/// Whether no scenario of the file can run on any of its hosts.
fn nothing_can_run(answers: &[Examination]) -> bool {
    answers.iter().all(|answer| answer.to_come_bytes == Some(0))
}

/// All hosts at a glance.
fn table(answers: &[Examination], catalogue: Catalogue) -> String {
    let head: Vec<_> = ["host", "machine"]
        .into_iter()
        .chain(columns(catalogue))
        .chain(["vagrant", "spaces", "netem", "rights", "free", "to come", "clock"])
        .map(str::to_owned)
        .collect();
    let count = head.len();
    let mut rows = vec![head];
    rows.extend(answers.iter().map(|answer| row(answer, catalogue)));
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<_> = (0..count).map(width).collect();
    let mut text = String::new();
    for row in &rows {
        let cells: Vec<_> = std::iter::zip(row, &widths)
            .map(|(cell, width)| format!("{cell:width$}"))
            .collect();
        let _ = writeln!(text, "{}", cells.join("  ").trim_end());
    }
    text
}

/// The providers with a column of their own.
fn columns(catalogue: Catalogue) -> impl Iterator<Item = &'static str> {
    catalogue.kinds().filter(|kind| kind.column).map(|kind| kind.name)
}

fn row(answer: &Examination, catalogue: Catalogue) -> Vec<String> {
    let facts = &answer.facts;
    if facts.obstacle.is_some() {
        return vec![answer.name.clone(), "not reached, see below".to_owned()];
    }
    let yes_or_no = |yes: bool| if yes { "yes" } else { "no" }.to_owned();
    let works = |name: &str| {
        let provider = facts.providers.get(name);
        provider.is_some_and(|it| matches!(it.availability, Availability::Available { .. }))
    };
    let machines: Vec<_> = catalogue
        .kinds()
        .filter(|kind| kind.vagrant.is_some() && works(kind.name))
        .map(|kind| kind.name)
        .collect();
    let has_netem = facts.providers.get(NATIVE).is_some_and(|native| {
        native.needs.iter().any(|(need, answer)| {
            need.to_string() == "network.backend: kernel" && matches!(answer, Availability::Available { .. })
        })
    });
    let namespaces = match &answer.checks {
        Ok(checks) => {
            let mut networks = checks.iter().filter(|check| check.name == "network");
            yes_or_no(networks.any(|check| check.available))
        }
        Err(ProviderError::KnownInAJob { .. }) => "?".to_owned(),
        Err(_) => yes_or_no(false),
    };
    let standing = answer.standing.as_ref();
    let said = |text: Option<String>| text.unwrap_or_else(|| "?".to_owned());
    let mut row = vec![answer.name.clone(), facts.hardware.clone()];
    row.extend(columns(catalogue).map(|name| yes_or_no(works(name))));
    row.extend([
        match machines.is_empty() {
            true => "no".to_owned(),
            false => machines.join(" "),
        },
        namespaces,
        yes_or_no(has_netem),
        said(standing.map(rights)),
        said(standing.map(|it| disk_space::in_words(it.free_bytes))),
        said(answer.to_come_bytes.map(disk_space::in_words)),
        said(standing.map(clock)),
    ]);
    row
}

fn rights(standing: &Standing) -> String {
    match standing.uid {
        0 => "root".to_owned(),
        uid => format!("user {uid}"),
    }
}

fn clock(standing: &Standing) -> String {
    format!(
        "{:+.0} ± {:.0} ms",
        standing.clock.ahead_ms,
        standing.clock.within_ms.ceil()
    )
}

async fn of_this_machine(json: bool, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let answer = examination::of_this_machine(catalogue).await;
    match answer.checks {
        Err(error) => Err(CommandError::new(Exit::Infrastructure, &error, error.hint())),
        Ok(_) => {
            match json {
                true => terminal::json(&DoctorDocument::Machine(Box::new(record(&answer)))),
                false => terminal::result(&as_text("this machine", &answer)),
            }
            Ok(exit(&[answer], catalogue))
        }
    }
}

fn record(answer: &Examination) -> HostRecord<'_> {
    let facts = &answer.facts;
    let standing = answer.standing.as_ref();
    let providers = facts.providers.iter().map(|(name, provider)| {
        let settings = provider.needs.iter();
        let settings =
            settings.map(|(need, availability)| availability_record(need.to_string(), availability));
        AvailabilityRecord {
            settings: Some(settings.collect()),
            ..availability_record(name.clone(), &provider.availability)
        }
    });
    HostRecord {
        host: &answer.name,
        hardware: &facts.hardware,
        os: &facts.os,
        kernel: &facts.kernel,
        obstacle: facts.obstacle.as_ref(),
        uid: standing.map(|it| it.uid),
        free_bytes: standing.map(|it| it.free_bytes),
        to_come_bytes: answer.to_come_bytes,
        clock_ahead_ms: standing.map(|it| it.clock.ahead_ms),
        clock_within_ms: standing.map(|it| it.clock.within_ms),
        checks: answer.checks.as_deref().ok(),
        providers: providers.collect(),
    }
}

fn availability_record(name: String, availability: &Availability) -> AvailabilityRecord<'_> {
    let (detail, reason, fix) = match availability {
        Availability::Available { detail } => (Some(detail.as_str()), None, None),
        Availability::Unavailable { reason, fix } => (None, Some(reason.as_str()), Some(fix.as_deref())),
    };
    AvailabilityRecord {
        name,
        available: matches!(availability, Availability::Available { .. }),
        detail,
        reason,
        fix,
        settings: None,
    }
}

fn as_text(title: &str, answer: &Examination) -> String {
    let facts = &answer.facts;
    if let Some(Obstacle { reason, fix }) = &facts.obstacle {
        let fix = fix.as_ref().map(|fix| format!("\n  fix: {fix}"));
        return format!("{title}: {reason}{}\n", fix.unwrap_or_default());
    }
    let mut text = format!(
        "{title}: {}, {}\n\nwhat the experiment needs\n",
        facts.hardware, facts.os
    );
    let checks = match &answer.checks {
        Ok(checks) => checks.as_slice(),
        Err(error) => {
            let standing = match error {
                ProviderError::KnownInAJob { .. } => "not known yet",
                _ => "no",
            };
            item(
                &mut text,
                "the workload",
                standing,
                Some(&with_causes(error)),
                error.hint().as_deref(),
            );
            &[]
        }
    };
    for check in checks {
        let missing = if check.required {
            "MISSING"
        } else {
            "missing; the experiment runs without it"
        };
        let standing = if check.available { "there" } else { missing };
        item(
            &mut text,
            &check.name,
            standing,
            check.reason.as_deref(),
            check.fix.as_deref(),
        );
    }
    text.push_str("\nwhere it can run\n");
    for (name, provider) in &facts.providers {
        place(&mut text, name, &provider.availability);
        for (need, availability) in &provider.needs {
            place(&mut text, &format!("  {need}"), availability);
        }
    }
    text
}

fn place(text: &mut String, name: &str, availability: &Availability) {
    match availability {
        Availability::Available { detail } => {
            let detail = (!detail.is_empty()).then_some(detail.as_str());
            item(text, name, "yes", detail, None);
        }
        Availability::Unavailable { reason, fix } => item(text, name, "no", Some(reason), fix.as_deref()),
    }
}

fn item(text: &mut String, name: &str, standing: &str, reason: Option<&str>, fix: Option<&str>) {
    let reason = reason.map(|reason| format!(": {reason}")).unwrap_or_default();
    let _ = writeln!(text, "  {name:28} {standing}{reason}");
    if let Some(fix) = fix {
        let _ = writeln!(text, "  {:28} fix: {fix}", "");
    }
}
