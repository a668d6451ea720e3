//! The commands, one module each: what it takes, what it does, what it prints.

pub mod calibrate;
pub mod check;
pub mod ci_generate;
pub mod clean;
pub mod completions;
pub mod doctor;
pub mod drift;
pub mod explain;
pub mod fit;
pub mod ks;
pub mod man;
pub mod messages;
pub mod options;
pub mod plan;
pub mod prune;
pub mod redact;
pub mod replay;
pub mod report;
pub mod resume;
pub mod run;
pub mod runs;
pub mod schema;
pub mod shell;
pub mod status;
pub mod watch;
use record::exit::matrix::Exit;

use crate::{
    cli::{arguments::Command, terminal::CommandError},
    provider::Catalogue,
};

/// Does what the command line asks, with these providers.
///
/// # Errors
/// What a person should read, with the exit code.
pub async fn execute(command: &Command, catalogue: Catalogue) -> Result<Exit, CommandError> {
    match command {
        Command::Check(arguments) => check::execute(arguments, catalogue).await,
        Command::CiGenerate(arguments) => ci_generate::execute(arguments, catalogue),
        Command::Plan(arguments) => plan::execute(arguments, catalogue).await,
        Command::Run(arguments) => run::execute(arguments, catalogue).await,
        Command::Resume(arguments) => resume::execute(arguments, catalogue).await,
        Command::Status(arguments) => status::execute(arguments).await,
        Command::Watch(arguments) => watch::execute(arguments).await,
        Command::Runs(arguments) => runs::execute(arguments),
        Command::Report(arguments) => report::execute(arguments),
        Command::Redact(arguments) => redact::execute(arguments),
        Command::Messages(arguments) => messages::execute(arguments),
        Command::Explain(arguments) => explain::execute(arguments),
        Command::Fit(arguments) => fit::execute(arguments),
        Command::Replay(arguments) => replay::execute(arguments),
        Command::Calibrate(arguments) => calibrate::execute(arguments),
        Command::Drift(arguments) => drift::execute(arguments),
        Command::Prune(arguments) => prune::execute(arguments),
        Command::Ks(arguments) => ks::execute(arguments),
        Command::Shell(arguments) => shell::execute(arguments, catalogue).await,
        Command::Clean(arguments) => clean::execute(arguments, catalogue).await,
        Command::Doctor(arguments) => doctor::execute(arguments, catalogue).await,
        Command::Schema(arguments) => Ok(schema::execute(arguments, catalogue)),
        Command::Completions(arguments) => Ok(completions::execute(arguments)),
        Command::Man(arguments) => man::execute(arguments),
    }
}
