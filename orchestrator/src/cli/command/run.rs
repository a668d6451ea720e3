//! `matrix run FILE`: measures every scenario that can run here and prints what was found.

use std::{
    fs,
    path::{self, PathBuf},
    time::SystemTime,
};

use clap::Args;
use record::{
    exit::matrix::Exit,
    run_directory::{FORMAT, HostRecord, Manifest, RecordedConnection, Revision, RunState},
};
use sha2::{Digest, Sha256};

use super::{plan, report};
use crate::{
    cli::{
        command::options::{OutputArguments, SelectionArguments},
        run_argument::RUNS,
        session::{self, JobArguments, RunOptions},
        terminal::{self, CommandError},
    },
    experiment_files::ExperimentFiles,
    journal, matrix_file,
    preparation::{self, Prepared},
    provider::Catalogue,
    run::{keep::Keep, recorded::RecordedRun, session::lock},
    state_directory::StateDirectory,
    workload_binary,
};

/// What it takes.
#[derive(Debug, Args)]
pub struct RunArguments {
    /// The matrix file.
    file: PathBuf,
    #[command(flatten)]
    selection: SelectionArguments,
    /// Folder in which the run directory is made.
    #[arg(long, value_name = "DIR", default_value = RUNS)]
    out: PathBuf,
    /// Say what would be done, create nothing.
    #[arg(long)]
    dry_run: bool,
    /// Which environments to keep when they have done their work, for `matrix shell`.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "never")]
    keep: Keep,
    #[command(flatten)]
    jobs: JobArguments,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Measures and reports.
///
/// # Errors
/// When the file is wrong, nothing can run here, or the run cannot go on.
pub async fn execute(arguments: &RunArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let request = arguments.selection.request(&arguments.file);
    let planned = preparation::prepare(&request, catalogue).await?;
    plan::show_warnings(&planned.plan, arguments.output);
    let quiet = arguments.output.quiet;
    if arguments.dry_run {
        match arguments.output.json {
            true => terminal::json(&plan::document(&planned.plan)),
            false => terminal::result(&plan::as_text(&planned.plan)),
        }
        return Ok(Exit::Done);
    }
    if !quiet {
        terminal::print_note(plan::as_text(&planned.plan).trim_end());
    }
    let record = &planned.plan.record;
    if record.order.is_empty() {
        if quiet {
            // Nothing else says why.
            terminal::print_note(plan::as_text(&planned.plan).trim_end());
        }
        return Err(CommandError {
            what: "no scenario can run here".into(),
            hint: Some("`matrix doctor` says what is missing and how to get it".to_owned()),
            exit: Exit::Infrastructure,
        });
    }
    let manifest = manifest(arguments, &planned)?;
    // Plans, labels and leases are JSON and have it in them.
    if path::absolute(&arguments.out).is_ok_and(|out| out.to_str().is_none()) {
        return Err(CommandError {
            what: format!("the name of the folder {} is not UTF-8", arguments.out.display()).into(),
            hint: Some("give another folder with `--out`".to_owned()),
            exit: Exit::Wrong,
        });
    }
    let directory = RecordedRun::create(
        &arguments.out.join(&manifest.run),
        &manifest,
        record,
        planned.files.as_ref(),
    )?;
    let _lock = lock(&directory, &manifest.run)?;
    if !quiet {
        terminal::print_note(&format!(
            "if this is killed, {}",
            session::how_to_go_on(directory.path())
        ));
    }
    let carried = session::carry_out(
        &directory,
        &manifest,
        record,
        &planned.providers,
        RunState::default(),
        RunOptions {
            resumed: false,
            show: arguments.output.progress(),
            keep: arguments.keep,
            patience: arguments.jobs.patience(),
        },
    )
    .await?;
    report::after_run(&directory, carried, arguments.output)
}

fn manifest(arguments: &RunArguments, planned: &Prepared) -> Result<Manifest, CommandError> {
    let text = planned.file.source.text();
    let path = fs::canonicalize(&arguments.file).unwrap_or_else(|_| arguments.file.clone());
    let providers = planned.file.providers.to_record();
    let providers = providers.map_err(|error| CommandError::new(Exit::Infrastructure, &error, None))?;
    Ok(Manifest {
        format: FORMAT,
        run: run_name(),
        created: journal::now(),
        matrix_version: env!("CARGO_PKG_VERSION").to_owned(),
        matrix_revision: revision(),
        workload_sha256: workload_binary::sha256().to_owned(),
        invocation: std::env::args_os()
            .map(|word| word.to_string_lossy().into_owned())
            .collect(),
        matrix_file: path.display().to_string(),
        matrix_text: text.to_owned(),
        matrix_sha256: format!("{:x}", Sha256::digest(text.as_bytes())),
        profile: arguments.selection.profile.clone(),
        order: arguments.selection.order.name().to_owned(),
        seed: arguments.selection.seed,
        providers,
        hosts: hosts(planned),
        experiment_sha256: planned.files.as_ref().map(ExperimentFiles::sha256),
        report: planned.file.report.clone(),
        state_directory: Some(StateDirectory::of_this_user().path().to_owned()),
        redacted: false,
    })
}

/// The revision of the sources of this program, as the build script found it.
fn revision() -> Option<Revision> {
    let commit = env!("MATRIX_SOURCE_COMMIT");
    (!commit.is_empty()).then(|| Revision {
        commit: commit.to_owned(),
        dirty: env!("MATRIX_SOURCE_DIRTY") == "true",
    })
}

fn hosts(planned: &Prepared) -> Vec<HostRecord> {
    let record = |host: &matrix_file::Host| {
        let name = host.name.value.clone();
        let facts = planned.facts.get(&name).cloned().unwrap_or_default();
        HostRecord {
            name,
            connect: RecordedConnection::Known(host.connection.clone()),
            hardware: facts.hardware,
            os: facts.os,
            kernel: facts.kernel,
        }
    };
    planned.file.hosts.iter().map(record).collect()
}

/// A name for a run: the time to the second, and what tells apart two that start within one.
fn run_name() -> String {
    let time = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    let digits: String = time.chars().filter(char::is_ascii_digit).collect();
    let (day, clock) = digits.split_at(8.min(digits.len()));
    format!("{day}-{clock}-{:x}", std::process::id())
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;
    use crate::workload_binary::start;

    #[test]
    fn the_revision_is_the_one_that_git_has_checked_out() {
        let git = |arguments: &[&str]| {
            let mut git = Command::new("git");
            git.args(arguments)
                .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
            let output = start(|| git.output());
            let output = output.ok().filter(|output| output.status.success());
            output.map(|output| String::from_utf8(output.stdout).unwrap().trim().to_owned())
        };
        // Outside of git there is none.
        let commit = git(&["rev-parse", "HEAD"]);
        assert_eq!(revision().map(|revision| revision.commit), commit);
    }
}
