//! `matrix shell SCENARIO`: a shell in an environment that was kept (`--keep`), or that a crash left, or in a host of its network.

use std::{
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
};

use clap::Args;
use record::{
    exit::matrix::Exit,
    run_directory::{PlannedScenario, RunDirectory, ScenarioState},
    virtual_host::VirtualHost,
};

use crate::{
    cli::{
        completion,
        run_argument::{RUNS, run_argument},
        terminal::{self, CommandError},
    },
    lease,
    provider::{Catalogue, Fleet as _, ProviderError, ShellRequest},
    run::recorded::{RecordedRun, newest_first},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct ShellArguments {
    /// The scenario, by its letter or its name.
    #[arg(add = completion::scenarios_to_enter())]
    scenario: String,
    /// The run directory; otherwise the newest in `runs/` that has kept an environment of that scenario.
    #[arg(long, value_name = "RUN", value_parser = run_argument(), add = completion::runs())]
    run: Option<PathBuf>,
    /// Open the shell in a host of the experiment's network, such as `h1`, with the experiment's nodes running. The network is made
    /// for the shell and is gone with it. For native environments.
    #[arg(long, value_name = "HOST")]
    virtual_host: Option<VirtualHost>,
    /// Take the shell from this image of the engine, such as `debian:12`, beside the container's data. For Docker environments.
    #[arg(long)]
    image: Option<String>,
    /// Print the command and do not run it.
    #[arg(long)]
    print: bool,
}

/// Becomes the shell.
///
/// # Errors
/// When there is no such environment, something is measured in it, or its platform has no shell for it.
pub async fn execute(arguments: &ShellArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let Left {
        recorded,
        planned,
        environment,
        kept,
    } = find(arguments)?;
    let providers = recorded.providers(catalogue)?;
    let infrastructure = |error: ProviderError| {
        let hint = error.hint();
        CommandError::new(Exit::Infrastructure, &error, hint)
    };
    let mut found = None;
    for host in planned.hosts() {
        let provider = providers.provider(&planned, host).map_err(infrastructure)?;
        let leftovers = provider.leftovers().await.map_err(infrastructure)?;
        let ours = leftovers.into_iter().find(|it| it.resource.name == environment);
        found = ours.map(|leftover| (host, provider, leftover));
        if found.is_some() {
            break;
        }
    }
    let Some((host, provider, leftover)) = found else {
        return Err(wrong(
            format!("{environment} does not exist any more"),
            "`matrix clean` or somebody else removed it",
        ));
    };
    if !kept && leftover.running {
        return Err(wrong(
            format!("{environment} may still be measuring, which a shell would disturb"),
            "`matrix resume` goes on with it",
        ));
    }
    let request = ShellRequest {
        environment: &environment,
        settings: &planned.settings,
        virtual_host: arguments.virtual_host,
        image: arguments.image.as_deref(),
    };
    let program = provider.shell(&request).await.map_err(infrastructure)?;
    let host = providers.host(host).map_err(infrastructure)?;
    let mut command = host.terminal(&program);
    if arguments.print {
        let words = std::iter::once(command.get_program()).chain(command.get_args());
        terminal::result(&format!("{}\n", crate::escaping::quoted(words)));
        return Ok(Exit::Done);
    }
    // Only comes back when it could not become it.
    let error = command.exec();
    Err(CommandError {
        what: format!("cannot start {}: {error}", command.get_program().display()).into(),
        hint: None,
        exit: Exit::Infrastructure,
    })
}

/// An environment that can be entered.
struct Left {
    recorded: RecordedRun,
    planned: PlannedScenario,
    environment: String,
    /// Whether it was left by a wish, and not by a crash.
    kept: bool,
}

fn find(arguments: &ShellArguments) -> Result<Left, CommandError> {
    let wanted = &arguments.scenario;
    if let Some(run) = &arguments.run {
        let directory = RecordedRun::directory(run)?;
        return match look(&directory, wanted)? {
            Some(left) => Ok(left),
            None => Err(nothing_kept(wanted, &format!("in {}", run.display()))),
        };
    }
    for run in newest_first(Path::new(RUNS)) {
        // What is no run directory, or one of another version, is passed by.
        let found = RecordedRun::directory(&run)
            .map_err(CommandError::from)
            .and_then(|directory| look(&directory, wanted));
        if let Ok(Some(left)) = found {
            return Ok(left);
        }
    }
    Err(nothing_kept(wanted, "in `runs/`"))
}

fn nothing_kept(wanted: &str, place: &str) -> CommandError {
    wrong(
        format!("no environment of a scenario `{wanted}` was kept {place}"),
        "`matrix run --keep always` keeps them; `--run RUN` names another run directory",
    )
}

fn wrong(what: String, hint: &str) -> CommandError {
    CommandError {
        what: what.into(),
        hint: Some(hint.to_owned()),
        exit: Exit::Wrong,
    }
}

/// The environment of a scenario of a run that can be entered, if there is one.
fn look(directory: &RunDirectory, wanted: &str) -> Result<Option<Left>, CommandError> {
    let recorded = RecordedRun::read(directory)?;
    let is_it = |planned: &&PlannedScenario| planned.is_called(wanted);
    let Some(planned) = recorded.plan.scenarios.iter().find(is_it).cloned() else {
        return Ok(None);
    };
    let state = recorded.state.scenario(&planned.slug);
    // Of several rounds, the one that was begun last.
    let open = state.open().last().map(|open| open.environment.clone());
    let ScenarioState { kept, .. } = state;
    // Names end with the number of the attempt.
    let attempt = |name: &String| {
        name.rsplit('-')
            .next()
            .and_then(|number| number.parse::<u32>().ok())
    };
    let left = match kept.into_iter().max_by_key(attempt) {
        Some(environment) => Some((environment, true)),
        None if lease::is_held(&directory.lock()) => {
            return Err(wrong(
                format!("the run {} goes on", directory.path().display()),
                "what is measured there would be disturbed: wait for it, or end it with Ctrl-C",
            ));
        }
        None => open.map(|environment| (environment, false)),
    };
    Ok(left.map(|(environment, kept)| Left {
        recorded,
        planned,
        environment,
        kept,
    }))
}
