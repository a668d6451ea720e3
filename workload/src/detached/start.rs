//! `start` and `prepare`: make the environment, with the files of a user's experiment. The functions are [`start`], which has a
//! supervisor start its workload, and [`prepare`], which leaves that to a job.

use std::{
    env, fs,
    io::{self, BufRead as _, BufReader, Read, Write as _},
    process::{Child, Command, Stdio},
};

use record::{
    call::{Detached, Root, Which},
    detached::{Failure, Start, Started},
    experiment::CommandExperiment,
    transfer::files,
};

use super::{DetachedError, EnvironmentFolder, stream};

/// Settings are three kilobytes when all are written. An argument of a program has at most 128 KiB.
const MOST: u64 = 64 << 10;
const ACTION: &str = "start the supervisor";

/// Returns once the workload runs; from then on it needs nobody. Where it could not be started, nothing is left.
///
/// # Errors
/// When there is an environment of that name already, or something refuses.
pub fn start(folder: &EnvironmentFolder) -> Result<Started, DetachedError> {
    make(folder, |folder, request| {
        spawn(folder).and_then(|supervisor| hand_over(supervisor, request))
    })
}

/// Makes the environment for a job, with the settings in it, and starts nothing. Where that fails, nothing is left.
///
/// # Errors
/// When there is an environment of that name already, or something refuses.
pub fn prepare(folder: &EnvironmentFolder) -> Result<(), DetachedError> {
    make(folder, |folder, request| {
        if let Some(container) = &request.container {
            folder.write_container(container)?;
        }
        folder.write_settings(&request.settings)
    })
}

/// Makes the environment that standard input describes and goes on with it.
fn make<T>(
    folder: &EnvironmentFolder,
    then: impl FnOnce(&EnvironmentFolder, &Start) -> Result<T, DetachedError>,
) -> Result<T, DetachedError> {
    let mut input = io::stdin().lock();
    let request: Start = stream::read_line(&mut input, "an owner and settings", MOST)?;
    let folder = folder.create(&request.owner)?;
    let made = unpack(&folder, &request, input).and_then(|()| then(&folder, &request));
    if made.is_err() {
        folder.remove()?;
    }
    made
}

/// The files of a user's experiment follow the request.
fn unpack(folder: &EnvironmentFolder, request: &Start, input: impl Read) -> Result<(), DetachedError> {
    let has_files = |experiment: &CommandExperiment| !experiment.files.is_empty();
    if !request.settings.experiment.as_ref().is_some_and(has_files) {
        return Ok(());
    }
    let work = folder.folders().work;
    fs::create_dir_all(&work)
        .and_then(|()| files::unpack(&work, input))
        .map_err(DetachedError::file("unpack the experiment's files into", &work))
}

fn spawn(folder: &EnvironmentFolder) -> Result<Child, DetachedError> {
    let supervise = Detached::Supervise(Which {
        root: Root {
            root: folder.root().to_owned(),
        },
        environment: folder.environment().to_owned(),
    });
    env::current_exe()
        .and_then(|program| {
            Command::new(program)
                .args(supervise.arguments())
                // Nothing of the surroundings in which it happened to be started may reach the experiment.
                .env_clear()
                .current_dir("/")
                // None of our own streams: whoever waits for their ends must not wait for the workload's.
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                .spawn()
        })
        .map_err(DetachedError::system(ACTION))
}

fn hand_over(mut supervisor: Child, request: &Start) -> Result<Started, DetachedError> {
    let mut answer = String::new();
    let mut complaint = String::new();
    if let (Some(mut input), Some(output), Some(errors)) = (
        supervisor.stdin.take(),
        supervisor.stdout.take(),
        supervisor.stderr.take(),
    ) {
        // Plain data can always be written as JSON. One that has ended already says why on its standard error.
        let _ = input.write_all(&serde_json::to_vec(&request.settings).unwrap_or_default());
        drop(input);
        BufReader::new(output.take(MOST))
            .read_line(&mut answer)
            .map_err(DetachedError::system(ACTION))?;
        if let Ok(started) = serde_json::from_str(&answer) {
            return Ok(started);
        }
        // It has not answered, so it ends, and its complaint is all there will be.
        errors
            .take(MOST)
            .read_to_string(&mut complaint)
            .map_err(DetachedError::system(ACTION))?;
    }
    let ended = supervisor.wait().map_err(DetachedError::system(ACTION))?;
    Err(match serde_json::from_str::<Failure>(&complaint) {
        Ok(failure) => DetachedError::Supervisor(failure),
        Err(_) => {
            DetachedError::system(ACTION)(io::Error::other(format!("it ended with {ended}: {complaint}")))
        }
    })
}
