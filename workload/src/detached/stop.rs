//! `stop`: asks the workload to end in order. The function is [`stop`].

use record::detached::Stopping;

use super::{
    DetachedError, EnvironmentFolder,
    process::{self, Role},
};

/// Does not wait until it has ended.
///
/// # Errors
/// When there is no such environment, or we may not.
pub fn stop(folder: &EnvironmentFolder) -> Result<Stopping, DetachedError> {
    folder.look()?;
    let mut asked = false;
    for process in process::find(folder)? {
        if process.role == Role::Workload {
            process.ask_to_end()?;
            asked = true;
        }
    }
    Ok(Stopping { asked })
}
