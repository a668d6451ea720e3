//! The command line. The main type is [`Arguments`]; what only one command takes stands with that command.

use clap::{Parser, Subcommand};

use crate::cli::command::{
    calibrate::CalibrateArguments, check::CheckArguments, ci_generate::CiGenerateArguments,
    clean::CleanArguments, completions::CompletionsArguments, doctor::DoctorArguments, drift::DriftArguments,
    explain::ExplainArguments, fit::FitArguments, ks::KsArguments, man::ManArguments,
    messages::MessagesArguments, options::OutputArguments, plan::PlanArguments, prune::PruneArguments,
    redact::RedactArguments, replay::ReplayArguments, report::ReportArguments, resume::ResumeArguments,
    run::RunArguments, runs::RunsArguments, schema::SchemaArguments, shell::ShellArguments,
    status::StatusArguments, watch::WatchArguments,
};

const AFTER_HELP: &str = "\
Exit codes:
  0    done
  1    a scenario failed: its workload said that the experiment went wrong
  2    the matrix file, the run directory or the call is wrong
  3    the infrastructure failed, or nothing can run here
  4    `matrix drift` found drift
  5    `matrix drift`: the newest measurement is invalid
  6    `matrix drift`: there is too little data to say anything
  130  interrupted; `matrix resume RUN` goes on";

/// Run one networked robot-control experiment on every combination of hardware, operating system and virtualization,
/// and say whether the results depend on where they ran.
#[derive(Debug, Parser)]
#[command(name = "matrix", version, after_help = AFTER_HELP)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Say whether a matrix file is right.
    Check(CheckArguments),
    /// Show every scenario, whether it can run here and why not, the order, the duration.
    Plan(PlanArguments),
    /// Measure every scenario that can run here and print what was found.
    Run(RunArguments),
    /// Go on with a run that was interrupted or killed.
    Resume(ResumeArguments),
    /// Say where a run stands.
    Status(StatusArguments),
    /// Follow a run that this or another process carries out, until it ends; begin and leave at any time.
    Watch(WatchArguments),
    /// List the runs in a folder, the newest first, with how they ended.
    Runs(RunsArguments),
    /// Make the tables and figures of a run, or of several as one, in its `report/` folder, and print what was found.
    Report(ReportArguments),
    /// Copy runs without the names of hosts and users, for a review that is to be blind.
    Redact(RedactArguments),
    /// Make a row for every message from the captures: sent, on the wire, arrived, received, retransmitted.
    Messages(MessagesArguments),
    /// Say how much of the difference of two scenarios' errors comes from late ticks, stalls, delays and losses.
    Explain(ExplainArguments),
    /// Write what the platforms of a run did to the experiment into files that simulated scenarios can be put on.
    Fit(FitArguments),
    /// Put the times recorded in a run through the loop, and say whether they give its errors again.
    Replay(ReplayArguments),
    /// Say how often each method finds a difference where there is none, for data like that of a run.
    #[command(alias = "selftest")]
    Calibrate(CalibrateArguments),
    /// Say whether what is measured night after night has changed, and what else changed with it.
    Drift(DriftArguments),
    /// Remove the logs and captures of all runs in a folder but the newest, and keep what `matrix drift` needs of them.
    Prune(PruneArguments),
    /// Compare two files of numbers, one a line, with the two-sample Kolmogorov-Smirnov test.
    Ks(KsArguments),
    /// Open a shell in an environment that was kept.
    Shell(ShellArguments),
    /// List what earlier runs left behind on this machine, then remove it.
    Clean(CleanArguments),
    /// Say what this machine can do, what is missing and how to get it.
    Doctor(DoctorArguments),
    /// Print a pipeline of GitLab or GitHub with a job for each scenario, and one that makes a report of them all.
    CiGenerate(CiGenerateArguments),
    /// Print the JSON Schema of matrix files, of `drift.yaml`, or of what a command prints with `--json`.
    Schema(SchemaArguments),
    /// Print a shell's completions.
    Completions(CompletionsArguments),
    /// Print the manual page, or write those of all commands.
    Man(ManArguments),
}

impl Command {
    /// Whether its result is for a program.
    #[must_use]
    pub fn wants_json(&self) -> bool {
        let output = match self {
            Self::Check(arguments) => arguments.output,
            Self::Plan(arguments) => arguments.output,
            Self::Run(arguments) => arguments.output,
            Self::Resume(arguments) => arguments.output,
            Self::Status(arguments) => arguments.output,
            Self::Runs(arguments) => arguments.output,
            Self::Report(arguments) => arguments.output,
            Self::Redact(arguments) => arguments.output,
            Self::Messages(arguments) => arguments.output,
            Self::Explain(arguments) => arguments.output,
            Self::Replay(arguments) => arguments.output,
            Self::Calibrate(arguments) => arguments.output,
            Self::Drift(arguments) => arguments.output,
            Self::Prune(arguments) => arguments.output,
            Self::Ks(arguments) => arguments.output,
            Self::Clean(arguments) => arguments.output,
            Self::Doctor(arguments) => arguments.output,
            Self::Watch(_)
            | Self::Fit(_)
            | Self::CiGenerate(_)
            | Self::Schema(_)
            | Self::Completions(_)
            | Self::Man(_)
            | Self::Shell(_) => OutputArguments::default(),
        };
        output.json
    }
}
