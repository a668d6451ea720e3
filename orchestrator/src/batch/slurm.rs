//! Slurm, by its command line tools on the submit host. The main type is [`SlurmCommands`].
//!
//! Fixed formats of `squeue` and `sinfo`, and no JSON: that of 22.05 ignores which jobs are meant and has 3 kB for each, and its fields
//! have changed from version to version. No `sacct`: many clusters do without, and it says of a job that was requeued once that it is
//! requeued for ever. docs/clusters.md has the table of states.

pub(crate) mod answers;

use std::{env, ffi::OsString, path::PathBuf, sync::Arc, time::Duration};

use async_trait::async_trait;
use futures_util::future::try_join_all;
use record::connection::{Connection, Slurm};
use tokio::sync::Semaphore;

use super::{BatchSystem, FittingNodes, Forecast, Job, JobRequest};
use crate::{
    host::{Exit, Host, HostError, Program, output},
    provider::ProviderError,
};

/// A controller that starts jobs just now takes its time: Slurm's own tools give up after 10 s a try, and try again.
const TIMEOUT: Duration = Duration::from_secs(90);
/// So many programs at a time: a submit host is shared by many.
const AT_ONCE: usize = 4;
/// Before the time of a job is over, by so many seconds, its workload is asked to end in order: what it has measured of a window is
/// worth nothing, and its other files are to be whole.
const WARNED_S: u32 = 120;
/// A shorter job is not warned: Slurm is up to a minute early.
const SHORTEST_WARNED_MINUTES: u32 = 20;

/// A cluster's tools on its submit host.
pub struct SlurmCommands {
    host: Arc<dyn Host>,
    bin: Option<PathBuf>,
    at_once: Semaphore,
}

impl SlurmCommands {
    /// Those of this host, in this folder if it is not in its `PATH`.
    #[must_use]
    pub fn new(host: Arc<dyn Host>, bin: Option<PathBuf>) -> Self {
        Self {
            host,
            bin,
            at_once: Semaphore::new(AT_ONCE),
        }
    }

    /// A program of Slurm's. It has no variables of ours: `SBATCH_…` would be options.
    fn program(&self, name: &str, arguments: Vec<String>) -> Program {
        let file = self
            .bin
            .as_ref()
            .map_or_else(|| PathBuf::from(name), |bin| bin.join(name));
        // Which cluster this machine is part of, where that is not written in its usual place.
        let is_here = |_: &OsString| {
            let nodes = self.host.nodes();
            nodes.is_some_and(|it| *it.slurm.submit.connection() == Connection::Local)
        };
        match env::var_os("SLURM_CONF").filter(is_here) {
            Some(configuration) => {
                let mut variable = OsString::from("SLURM_CONF=");
                variable.push(configuration);
                let words = [variable, file.into_os_string()];
                Program::new(
                    "env",
                    words.into_iter().chain(arguments.into_iter().map(Into::into)),
                )
            }
            None => Program::new(file, arguments),
        }
    }

    async fn run(
        &self,
        action: &str,
        name: &str,
        arguments: Vec<String>,
    ) -> Result<(Exit, String), ProviderError> {
        let program = self.program(name, arguments);
        // It is never closed.
        let _turn = self.at_once.acquire().await;
        let (exit, said) = output(self.host.as_ref(), &program, b"", TIMEOUT)
            .await
            .map_err(|error| match error {
                HostError::TimedOut { after, .. } => ProviderError::TimedOut {
                    action: format!("{action} for host `{}`", self.host.name()),
                    after,
                },
                error => error.into(),
            })?;
        if exit.code == Some(127) {
            return Err(ProviderError::Unreachable {
                platform: format!("Slurm on the submit host of `{}`", self.host.name()),
                hint: Some(format!(
                    "install Slurm's client tools there, or write the folder with `{name}` as `connect.slurm.bin`"
                )),
                source: format!("there is no program {name}").into(),
            });
        }
        Ok((exit, String::from_utf8_lossy(&said).into_owned()))
    }

    /// What a program printed that has to succeed.
    async fn ask(&self, action: &str, name: &str, arguments: Vec<String>) -> Result<String, ProviderError> {
        let (exit, said) = self.run(action, name, arguments).await?;
        match exit.success() {
            true => Ok(said),
            false => Err(self.refused(action, &exit)),
        }
    }

    fn refused(&self, action: &str, exit: &Exit) -> ProviderError {
        let words = exit.last_words.trim();
        let source = match (words, exit.code) {
            ("", Some(code)) => format!("it ended with exit code {code} and said nothing"),
            ("", None) => "it was killed".to_owned(),
            (words, _) => answers::first_words(words),
        };
        match answers::is_passing(words) {
            true => ProviderError::Disconnected {
                platform: format!("Slurm's controller of host `{}`", self.host.name()),
                action: action.to_owned(),
                source: source.into(),
            },
            false => ProviderError::Refused {
                platform: format!("Slurm of host `{}`", self.host.name()),
                action: action.to_owned(),
                hint: answers::hint(words).map(str::to_owned),
                source: source.into(),
            },
        }
    }
}

fn text(option: &str, value: impl std::fmt::Display) -> String {
    format!("--{option}={value}")
}

impl SlurmCommands {
    /// Whether a node is one that a job asks for.
    async fn could_run_on(&self, job: &JobRequest, node: &str) -> Result<bool, ProviderError> {
        let action = "asking which nodes fit";
        let job = JobRequest {
            node: Some(node.to_owned()),
            ..job.clone()
        };
        let (exit, _) = self.run(action, "sbatch", test_only(&job)).await?;
        match exit.success() {
            true => Ok(true),
            false if answers::does_not_fit(&exit.last_words) => Ok(false),
            false => Err(self.refused(action, &exit)),
        }
    }
}

/// The options that ask when a job would run, and submit nothing.
fn test_only(job: &JobRequest) -> Vec<String> {
    let mut arguments = vec!["--test-only".to_owned()];
    arguments.extend(options(job));
    arguments.push("--wrap=true".to_owned());
    arguments
}

/// The options by which a job is made: whole node, once, and no variables of ours.
fn options(job: &JobRequest) -> Vec<String> {
    let mut options = job.wishes.wishes();
    options.extend([
        "--parsable".to_owned(),
        text("job-name", &job.name),
        text("comment", job.owner.comment()),
        "--nodes=1".to_owned(),
        "--exclusive".to_owned(),
        "--mem=0".to_owned(),
        "--no-requeue".to_owned(),
        "--open-mode=append".to_owned(),
        text("time", job.minutes),
        text(
            "output",
            answers::file_name_pattern(&job.output.display().to_string()),
        ),
        "--chdir=/".to_owned(),
    ]);
    // Slurm takes a job back that cannot end by then any more.
    let waits = job.wishes.wait.duration().as_secs().div_ceil(60);
    let deadline = waits.saturating_add(u64::from(job.minutes));
    options.push(format!("--deadline=now+{deadline}minutes"));
    if job.minutes >= SHORTEST_WARNED_MINUTES {
        options.push(format!("--signal=B:USR1@{WARNED_S}"));
    }
    if let Some(after) = &job.after {
        options.push(text("dependency", format_args!("afterany:{after}")));
    }
    match (&job.node, &job.wishes.nodelist) {
        (Some(node), _) | (None, Some(node)) => options.push(text("nodelist", node)),
        (None, None) => {}
    }
    let excluded: Vec<&str> = job
        .wishes
        .exclude
        .iter()
        .chain(&job.not_on)
        .map(String::as_str)
        .collect();
    if !excluded.is_empty() {
        options.push(text("exclude", excluded.join(",")));
    }
    options
}

#[async_trait]
impl BatchSystem for SlurmCommands {
    async fn version(&self) -> Result<String, ProviderError> {
        let said = self
            .ask("asking for its version", "sinfo", vec!["--version".to_owned()])
            .await?;
        // `slurm 23.11.4`, and of Debian's package `slurm-wlm 22.05.8`.
        let version = said
            .split_whitespace()
            .last()
            .unwrap_or("of a version that it does not say");
        Ok(format!("Slurm {}", answers::first_words(version)))
    }

    async fn forecast(&self, job: &JobRequest) -> Result<Forecast, ProviderError> {
        let action = "asking when a job would run";
        let (exit, _) = self.run(action, "sbatch", test_only(job)).await?;
        match exit.success() {
            true => Ok(answers::forecast(&exit.last_words)),
            false => Err(self.refused(action, &exit)),
        }
    }

    async fn nodes(&self, job: &JobRequest) -> Result<FittingNodes, ProviderError> {
        let mut arguments = vec![
            "--noheader".to_owned(),
            "--Node".to_owned(),
            text("format", answers::NODES),
        ];
        let narrowed = [
            ("partition", &job.wishes.partition),
            ("nodes", &job.wishes.nodelist),
        ];
        let narrowed = narrowed
            .into_iter()
            .filter_map(|(option, value)| Some(text(option, value.as_ref()?)));
        arguments.extend(narrowed);
        let said = self.ask("asking for its nodes", "sinfo", arguments).await?;
        let (names, out_of_service) = answers::nodes(&said, job.wishes.partition.is_some());
        // Constraints are expressions, and reservations and accounts have rules: Slurm itself answers for each node.
        let fit = names.iter().map(|name| self.could_run_on(job, name));
        let fit = try_join_all(fit).await?;
        let fitting = std::iter::zip(names, fit).filter(|(_, fits)| *fits);
        Ok(FittingNodes {
            fit: fitting.map(|(name, _)| name).collect(),
            out_of_service,
        })
    }

    async fn longest_minutes(&self, wishes: &Slurm) -> Result<Option<u32>, ProviderError> {
        let mut arguments = vec!["--noheader".to_owned(), text("format", answers::LIMITS)];
        arguments.extend(
            wishes
                .partition
                .as_ref()
                .map(|partition| text("partition", partition)),
        );
        let said = self.ask("asking for its partitions", "sinfo", arguments).await?;
        Ok(answers::longest_minutes(&said, wishes.partition.is_some()))
    }

    async fn submit(&self, job: &JobRequest) -> Result<String, ProviderError> {
        let mut arguments = options(job);
        arguments.push(job.script.display().to_string());
        arguments.extend(job.arguments.iter().map(|it| it.to_string_lossy().into_owned()));
        let action = format!("submitting the job {}", job.name);
        let submitted = self.ask(&action, "sbatch", arguments).await;
        let refusal = match submitted.map(|said| answers::job_number(&said)) {
            Ok(Some(number)) => return Ok(number),
            Ok(None) => ProviderError::Data {
                what: "the answer of `sbatch`".to_owned(),
                reason: "there is no number of a job in it".to_owned(),
            },
            Err(error) => error,
        };
        // Slurm may refuse a job and keep it, and its answer may be lost on the way.
        let found = self
            .jobs()
            .await?
            .into_iter()
            .rev()
            .find(|it| it.name == job.name);
        match found {
            Some(found) if found.standing.is_alive() && refusal.is_passing() => Ok(found.id),
            Some(found) => {
                self.cancel(&found.id).await?;
                Err(refusal)
            }
            None => Err(refusal),
        }
    }

    async fn jobs(&self) -> Result<Vec<Job>, ProviderError> {
        let arguments = vec![
            "--noheader".to_owned(),
            "--me".to_owned(),
            "--states=all".to_owned(),
            text("format", answers::JOBS),
        ];
        let said = self.ask("asking for its jobs", "squeue", arguments).await?;
        Ok(said.lines().filter_map(answers::job).collect())
    }

    async fn stop(&self, job: &str) -> Result<(), ProviderError> {
        // In this order: one that begins in between is found running by the second.
        for how in [&["--state=PENDING"][..], &["--batch", "--signal=USR1"]] {
            let mut arguments: Vec<String> = how.iter().map(|&it| it.to_owned()).collect();
            arguments.push(job.to_owned());
            let (exit, _) = self.run("asking a job to end", "scancel", arguments).await?;
            if !exit.success() && !answers::is_gone(&exit.last_words) {
                return Err(self.refused("asking a job to end", &exit));
            }
        }
        Ok(())
    }

    async fn cancel(&self, job: &str) -> Result<(), ProviderError> {
        let (exit, _) = self
            .run("taking a job back", "scancel", vec![job.to_owned()])
            .await?;
        match exit.success() || answers::is_gone(&exit.last_words) {
            true => Ok(()),
            false => Err(self.refused("taking a job back", &exit)),
        }
    }

    fn shell(&self, job: &str) -> Program {
        let words = ["--jobid", job, "--overlap", "--pty", "sh", "-l"];
        self.program("srun", words.map(str::to_owned).into())
    }
}
