//! `matrix doctor`: what this machine can do, what is missing and how to get it.

use std::fmt::Write;

use clap::Args;
use serde_json::{Value, json};
use workload::{record::check::Check, settings::NetworkBackend};

use crate::{
    arguments::OutputArguments,
    exit::Exit,
    matrix_file::THIS_MACHINE,
    plan::HostFacts,
    provider::{self, Availability, ProviderSettings, Roster, native},
    state_directory::StateDirectory,
    survey,
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct DoctorArguments {
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Asks every provider, and the workload itself, and prints what they say.
///
/// # Errors
/// When the workload's own check cannot be run.
pub async fn execute(arguments: &DoctorArguments) -> Result<Exit, Complaint> {
    let facts = survey::this_machine(
        THIS_MACHINE,
        &provider::names(),
        &NetworkBackend::ALL,
        &Roster::new(ProviderSettings::default()),
    )
    .await;
    let checks = native::check(&StateDirectory::of_this_user(), NetworkBackend::Userspace)
        .await
        .map_err(|error| Complaint::new(Exit::Infrastructure, &error, error.hint()))?
        .checks;
    if arguments.output.json {
        terminal::json(&json!({
            "hardware": facts.hardware,
            "os": facts.os,
            "checks": checks,
            "providers": facts.providers.iter().map(|(name, availability)| {
                let mut answer = as_json(name, availability);
                let networks = facts.networks.get(name).into_iter().flatten();
                answer["networks"] = networks
                    .map(|(backend, availability)| as_json(backend.name(), availability))
                    .collect();
                answer
            }).collect::<Vec<_>>(),
        }));
    } else {
        terminal::result(&as_text(&facts, &checks));
    }
    Ok(Exit::Done)
}

fn as_json(name: &str, availability: &Availability) -> Value {
    match availability {
        Availability::Available { detail } => json!({"name": name, "available": true, "detail": detail}),
        Availability::Unavailable { reason, fix } => {
            json!({"name": name, "available": false, "reason": reason, "fix": fix})
        }
    }
}

fn as_text(facts: &HostFacts, checks: &[Check]) -> String {
    let mut text = format!(
        "this machine: {}, {}\n\nwhat the experiment needs\n",
        facts.hardware, facts.os
    );
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
    for (name, availability) in &facts.providers {
        place(&mut text, name, availability);
        for (backend, availability) in facts.networks.get(name).into_iter().flatten() {
            place(&mut text, &format!("  {} network", backend.name()), availability);
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
    let _ = writeln!(text, "  {name:18} {standing}{reason}");
    if let Some(fix) = fix {
        let _ = writeln!(text, "  {:18} fix: {fix}", "");
    }
}
