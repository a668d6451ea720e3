//! `matrix doctor [FILE]`: what this machine, or each host of a matrix file, can do, what is missing and how to get it.

use std::{fmt::Write, path::PathBuf, sync::Arc};

use clap::Args;
use serde_json::{Value, json};
use workload::{
    causes::with_causes,
    record::check::Check,
    settings::{Need, Settings},
};

use crate::{
    arguments::OutputArguments,
    exit::Exit,
    host::{Here, Host},
    matrix_file::{MatrixFile, THIS_MACHINE},
    plan::{HostFacts, Obstacle},
    provider::{self, Availability, ProviderError, ProviderSettings, Roster, detached::Keeper},
    state_directory::StateDirectory,
    survey,
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct DoctorArguments {
    /// A matrix file, whose hosts are asked in place of this machine.
    file: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// What a host says.
struct Answer {
    name: String,
    facts: HostFacts,
    /// What the experiment needs; none where it could not be asked.
    checks: Result<Vec<Check>, ProviderError>,
}

/// Asks every provider, and the workload itself, and prints what they say.
///
/// # Errors
/// When the file is wrong, or the workload's own check cannot be run on this machine.
pub async fn execute(arguments: &DoctorArguments) -> Result<Exit, Complaint> {
    let Some(path) = &arguments.file else {
        return of_this_machine(arguments.output.json).await;
    };
    let file = MatrixFile::read(path, None).map_err(Complaint::of_mistakes)?;
    let roster = survey::roster(&file);
    let mut answers = Vec::new();
    for host in roster.hosts() {
        answers.push(ask(host, &roster).await);
    }
    if arguments.output.json {
        let hosts: Vec<_> = answers.iter().map(host_as_json).collect();
        terminal::json(&json!({ "hosts": hosts }));
    } else {
        let texts: Vec<_> = answers
            .iter()
            .map(|answer| as_text(&answer.name, answer))
            .collect();
        terminal::result(&texts.join("\n"));
    }
    Ok(Exit::Done)
}

async fn of_this_machine(json: bool) -> Result<Exit, Complaint> {
    let here: Arc<dyn Host> = Arc::new(Here::new(THIS_MACHINE, StateDirectory::of_this_user()));
    let roster = Roster::new(ProviderSettings::default(), [Arc::clone(&here)]);
    let answer = ask(&here, &roster).await;
    match answer.checks {
        Err(error) => Err(Complaint::new(Exit::Infrastructure, &error, error.hint())),
        Ok(_) if json => {
            terminal::json(&host_as_json(&answer));
            Ok(Exit::Done)
        }
        Ok(_) => {
            terminal::result(&as_text("this machine", &answer));
            Ok(Exit::Done)
        }
    }
}

async fn ask(host: &Arc<dyn Host>, roster: &Roster) -> Answer {
    let name = host.name().to_owned();
    let mut facts = survey::identity(Arc::clone(host)).await;
    let defaults = Need::of(&Settings::default());
    let checks = Keeper::new(Arc::clone(host)).check(&defaults).await;
    if facts.obstacle.is_none() {
        let everything = provider::NAMES
            .into_iter()
            .map(|name| (name.to_owned(), Need::each().into_iter().collect()))
            .collect();
        facts.providers = survey::ask(&name, everything, roster).await;
    }
    Answer {
        name,
        facts,
        checks: checks.map(|record| record.checks),
    }
}

fn host_as_json(answer: &Answer) -> Value {
    let facts = &answer.facts;
    json!({
        "host": answer.name,
        "hardware": facts.hardware,
        "os": facts.os,
        "kernel": facts.kernel,
        "obstacle": facts.obstacle,
        "checks": answer.checks.as_ref().ok(),
        "providers": facts.providers.iter().map(|(name, provider)| {
            let mut answer = as_json(name, &provider.availability);
            answer["settings"] = provider
                .needs
                .iter()
                .map(|(need, availability)| as_json(&need.to_string(), availability))
                .collect();
            answer
        }).collect::<Vec<_>>(),
    })
}

fn as_json(name: &str, availability: &Availability) -> Value {
    match availability {
        Availability::Available { detail } => json!({"name": name, "available": true, "detail": detail}),
        Availability::Unavailable { reason, fix } => {
            json!({"name": name, "available": false, "reason": reason, "fix": fix})
        }
    }
}

fn as_text(title: &str, answer: &Answer) -> String {
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
            item(
                &mut text,
                "the workload",
                "no",
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
            "missing, recorded with the results"
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
