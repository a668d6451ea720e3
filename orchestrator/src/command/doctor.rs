//! `matrix doctor [FILE]`: what this machine, or each host of a matrix file, can do, what is missing and how to get it.

use std::{fmt::Write, path::PathBuf, sync::Arc};

use clap::Args;
use reports::run_directory::PlannedScenario;
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
    plan::{self, HostFacts, Obstacle, Selection, order::Order},
    provider::{
        self, Availability, ProviderError, ProviderSettings, Roster,
        detached::{ClockReading, Keeper},
    },
    room,
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
    /// None where it could not be asked.
    standing: Option<Standing>,
    /// What the windows that the matrix file has for it take on its disk; none without a file.
    to_come_bytes: Option<u64>,
}

/// What a host is like at the moment.
struct Standing {
    uid: u32,
    /// Of the disk with its state folder.
    free_bytes: u64,
    clock: ClockReading,
}

impl Standing {
    async fn of(host: &Arc<dyn Host>) -> Option<Self> {
        let (clock, said) = ClockReading::of(&Keeper::new(Arc::clone(host))).await.ok()?;
        Some(Self {
            uid: said.uid,
            free_bytes: said.free_bytes,
            clock,
        })
    }

    fn rights(&self) -> String {
        match self.uid {
            0 => "root".to_owned(),
            uid => format!("user {uid}"),
        }
    }

    fn clock(&self) -> String {
        format!(
            "{:+.0} ± {:.0} ms",
            self.clock.ahead_ms,
            self.clock.within_ms.ceil()
        )
    }
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
    foresee(&file, &mut answers);
    if arguments.output.json {
        let hosts: Vec<_> = answers.iter().map(host_as_json).collect();
        terminal::json(&json!({ "hosts": hosts }));
    } else {
        let texts: Vec<_> = answers
            .iter()
            .map(|answer| as_text(&answer.name, answer))
            .collect();
        terminal::result(&format!("{}\n{}", table(&answers), texts.join("\n")));
    }
    Ok(Exit::Done)
}

/// What is to come on each host, if all that can run there does.
fn foresee(file: &MatrixFile, answers: &mut [Answer]) {
    let facts = answers
        .iter()
        .map(|answer| (answer.name.clone(), answer.facts.clone()))
        .collect();
    // What is wrong with the file is for `check` and `plan` to say.
    let Ok(plan) = plan::plan(file, &facts, &Selection::default(), Order::default(), 0) else {
        return;
    };
    for answer in answers {
        let runs_there = |it: &&PlannedScenario| it.runs() && it.host.as_ref() == Some(&answer.name);
        let scenarios = plan.record.scenarios.iter().filter(runs_there);
        let bytes = scenarios.map(|it| room::windows_take(&it.settings, it.settings.windows as usize));
        answer.to_come_bytes = Some(bytes.sum());
    }
}

/// All hosts at a glance.
fn table(answers: &[Answer]) -> String {
    let head = [
        "host", "machine", "docker", "vagrant", "spaces", "netem", "rights", "free", "to come", "clock",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(answers.iter().map(row));
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<_> = (0..head.len()).map(width).collect();
    let mut text = String::new();
    for row in &rows {
        let cells: Vec<_> = std::iter::zip(row, &widths)
            .map(|(cell, width)| format!("{cell:width$}"))
            .collect();
        let _ = writeln!(text, "{}", cells.join("  ").trim_end());
    }
    text
}

fn row(answer: &Answer) -> Vec<String> {
    let facts = &answer.facts;
    if facts.obstacle.is_some() {
        return vec![answer.name.clone(), "not reached, see below".to_owned()];
    }
    let yes_or_no = |yes: bool| if yes { "yes" } else { "no" }.to_owned();
    let works = |name: &str| {
        let provider = facts.providers.get(name);
        provider.is_some_and(|it| matches!(it.availability, Availability::Available { .. }))
    };
    let machines: Vec<_> = provider::MACHINES
        .into_iter()
        .filter(|name| works(name))
        .collect();
    let has_netem = facts.providers.get("native").is_some_and(|native| {
        native.needs.iter().any(|(need, answer)| {
            need.to_string() == "network.backend: kernel" && matches!(answer, Availability::Available { .. })
        })
    });
    let has_namespaces = answer.checks.as_ref().is_ok_and(|checks| {
        let mut networks = checks.iter().filter(|check| check.name == "network");
        networks.any(|check| check.available)
    });
    let standing = answer.standing.as_ref();
    let said = |text: Option<String>| text.unwrap_or_else(|| "?".to_owned());
    vec![
        answer.name.clone(),
        facts.hardware.clone(),
        yes_or_no(works("docker")),
        match machines.is_empty() {
            true => "no".to_owned(),
            false => machines.join(" "),
        },
        yes_or_no(has_namespaces),
        yes_or_no(has_netem),
        said(standing.map(Standing::rights)),
        said(standing.map(|it| room::in_words(it.free_bytes))),
        said(answer.to_come_bytes.map(room::in_words)),
        said(standing.map(Standing::clock)),
    ]
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
        standing: Standing::of(host).await,
        to_come_bytes: None,
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
        "uid": answer.standing.as_ref().map(|it| it.uid),
        "free_bytes": answer.standing.as_ref().map(|it| it.free_bytes),
        "to_come_bytes": answer.to_come_bytes,
        "clock_ahead_ms": answer.standing.as_ref().map(|it| it.clock.ahead_ms),
        "clock_within_ms": answer.standing.as_ref().map(|it| it.clock.within_ms),
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
