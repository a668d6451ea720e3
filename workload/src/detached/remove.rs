//! `remove`: ends the workload and removes the environment. The function is [`remove`].

use std::time::Duration;

use record::detached::Removed;

use super::{
    DetachedError, EnvironmentFolder,
    process::{self, Process, Role},
};

/// Ends the workload, in order if it does so within `timeout`, then removes the folder. What is gone already is fine.
///
/// # Errors
/// When we may not, or something cannot be ended or removed.
pub fn remove(folder: &EnvironmentFolder, timeout: Duration) -> Result<Removed, DetachedError> {
    let mut removed = false;
    loop {
        let mut living = process::find(folder)?;
        for process in &living {
            end(process, timeout)?;
        }
        // Whoever might have ended what a command started is gone.
        let commands = process::find_commands(folder)?;
        for process in &commands {
            process.kill()?;
        }
        living.extend(commands);
        removed |= folder.remove()?;
        // Another `start` may have been between its steps: a supervisor may have started a workload, or made files.
        if living.is_empty() {
            return Ok(Removed { removed });
        }
    }
}

fn end(process: &Process, timeout: Duration) -> Result<(), DetachedError> {
    match process.role {
        Role::Workload => {
            process.ask_to_end()?;
        }
        // A supervisor ends by itself when its workload has, and has written down how.
        Role::Supervisor | Role::Leaseholder | Role::Command => {}
    }
    match process.wait(timeout)? {
        true => Ok(()),
        false => process.kill(),
    }
}
