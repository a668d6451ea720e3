//! `job`: the workload of a prepared environment, in a job of a batch system. The function is [`job`].
//!
//! What a job leaves behind is killed with it, so that this process stays in the job and supervises the workload itself. It needs
//! nobody: windows go to the folder, which the machine that submitted the job sees too.

use std::{sync::mpsc, thread};

use nix::{
    errno::Errno,
    sys::signal::{SigSet, Signal, kill},
    unistd::Pid,
};
use record::{
    call::Job,
    detached::{JobRecord, LeaseRequest},
    identity::HostIdentity,
    platform::RealtimeGrant,
};
use serde_json::json;

use super::{DetachedError, EnvironmentFolder, container::Engine, lease, supervise};
use crate::survey;

/// Returns when the workload has ended, however it has: that is in the folder, and the job has done what it was to do.
///
/// # Errors
/// When the environment is another job's, the node another machine than was said, or the workload cannot be started.
pub fn job(folder: &EnvironmentFolder, call: &Job) -> Result<(), DetachedError> {
    // Before another thread is: it would take the signals.
    let ends = SigSet::from_iter([Signal::SIGTERM, Signal::SIGUSR1]);
    ends.thread_block()
        .map_err(DetachedError::system("block signals"))?;
    folder.look()?;
    let (Some(settings), Some(owner)) = (folder.settings(), folder.owner()) else {
        return Err(DetachedError::Unprepared {
            name: folder.environment().to_owned(),
        });
    };
    let claim = JobRecord {
        job: call.job.clone(),
        node: call.node.clone(),
    };
    folder.claim(&claim)?;
    let platform = survey::platform(RealtimeGrant::default());
    let said = HostIdentity {
        host: &owner.host,
        hardware: Some(&call.hardware),
        os: Some(&call.os),
    };
    if let Some(mismatch) = said.contradiction(&platform.machine, &platform.os) {
        return Err(DetachedError::AnotherHost(mismatch));
    }
    // Whoever reaches the node over SSH measures there, or waits for us.
    let holder = json!({
        "pid": std::process::id(),
        "machine": call.node,
        "run_directory": owner.run_directory,
        "since": format!("job {} began", call.job),
    });
    let request = LeaseRequest {
        token: format!("{} in job {}", folder.environment(), call.job),
        holder: holder.as_object().cloned().unwrap_or_default(),
    };
    let (waiting, _) = mpsc::channel();
    let _lease = lease::take(&call.lease, &request, &waiting)?;
    let container = folder.container()?;
    let ended = match &container {
        None => supervise::attend(
            folder,
            &settings,
            supervise::on_the_node(folder, &settings)?,
            |pid| pass_on(ends, pid),
        )?,
        Some(container) => {
            let engine = Engine::look(container)?;
            folder.write_engine(engine.record())?;
            let command = engine.command(folder, &settings)?;
            // The client passes signals on.
            let ended = supervise::attend(folder, &settings, command, |pid| pass_on(ends, pid));
            Engine::end(folder)?;
            ended?
        }
    };
    folder.write_ended(ended)
}

/// Asks the workload to end whenever this process is asked to. The batch system asks all processes of a job when its time is over,
/// and this one alone when somebody wishes the job to end in order.
fn pass_on(ends: SigSet, workload: u32) -> Result<(), DetachedError> {
    let pid = Pid::from_raw(i32::try_from(workload).unwrap_or(i32::MAX));
    let watching = thread::Builder::new().name("signals".to_owned()).spawn(move || {
        while ends.wait().is_ok() {
            // The workload is our child until this process ends, so that its number is nobody else's.
            if kill(pid, Signal::SIGTERM) == Err(Errno::ESRCH) {
                return;
            }
        }
    });
    watching
        .map(drop)
        .map_err(DetachedError::system("start a thread"))
}
