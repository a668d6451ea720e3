//! `supervise`: starts the workload, waits for it and writes down how it ended. The function is [`supervise`].

use std::{
    env,
    fs::File,
    io,
    os::unix::process::ExitStatusExt as _,
    path::Path,
    process::{Command, ExitStatus, Stdio},
};

use record::{
    call::Run,
    detached::{Ended, Started},
    settings::Settings,
};

use super::{DetachedError, EnvironmentFolder, process, stream};
use crate::descendants::Descendants;

/// `start` bounds what it hands over.
const MOST: u64 = 1 << 20;

/// Answers once the workload runs, and returns when it has ended.
///
/// # Errors
/// When the workload cannot be started, or its end not be written down.
pub fn supervise(folder: &EnvironmentFolder) -> Result<(), DetachedError> {
    // So that neither a terminal's hanging up nor its Ctrl-C reaches it, nor the workload, which is in it too.
    rustix::process::setsid().map_err(DetachedError::system("begin a session"))?;
    let settings: Settings = stream::read("settings", MOST)?;
    let ended = attend(folder, &settings, on_the_node(folder, &settings)?, |pid| {
        // Whoever asked may be gone: that is what this is for.
        let _ = stream::write_line(&mut io::stdout(), &Started { pid });
        Ok(())
    })?;
    folder.write_ended(ended)
}

/// How the workload of an environment is called.
pub fn arguments(folder: &EnvironmentFolder, settings: &Settings) -> Run {
    let windows = folder.owner().map(|owner| owner.windows).unwrap_or_default();
    Run::of(folder.environment(), settings, folder.folders(), &windows)
}

/// The workload as a process, in no container.
///
/// # Errors
/// When nobody knows where it is.
pub fn on_the_node(folder: &EnvironmentFolder, settings: &Settings) -> Result<Command, DetachedError> {
    let program = env::current_exe().map_err(DetachedError::system("find the workload"))?;
    let mut command = Command::new(program);
    command
        .args(arguments(folder, settings).arguments())
        // Of a job's variables none may reach the experiment either.
        .env_clear()
        .stdin(Stdio::null());
    Ok(command)
}

/// Runs the workload of an environment, which that command starts, to its end. `started` is told its process number. What it reads is
/// open until then.
///
/// # Errors
/// When the workload cannot be started.
pub fn attend(
    folder: &EnvironmentFolder,
    settings: &Settings,
    mut command: Command,
    started: impl FnOnce(u32) -> Result<(), DetachedError>,
) -> Result<Ended, DetachedError> {
    let create = |path: &Path| File::create_new(path).map_err(DetachedError::file("create", path));
    let lines = create(&folder.lines())?;
    let errors = create(&folder.errors())?;
    // What a user's command started is ended even if its workload is killed.
    let descendants = settings.experiment.as_ref().map(|_| Descendants::begin());
    let descendants = descendants.transpose().map_err(DetachedError::Command)?;
    let mut workload = command
        .current_dir("/")
        .stdout(lines)
        .stderr(errors)
        .spawn()
        .map_err(DetachedError::system("start the workload"))?;
    // To wait for it would close it.
    let input = workload.stdin.take();
    process::wait_until_found(&mut workload)?;
    started(workload.id())?;
    let status = workload
        .wait()
        .map_err(DetachedError::system("wait for the workload"))?;
    if let Some(descendants) = descendants {
        descendants.end_all().map_err(DetachedError::Command)?;
    }
    drop(input);
    Ok(ended(status))
}

fn ended(status: ExitStatus) -> Ended {
    match status.signal() {
        Some(signal) => Ended::Signal(signal),
        // One that has ended without a signal has a code.
        None => Ended::Code(status.code().unwrap_or_default()),
    }
}
