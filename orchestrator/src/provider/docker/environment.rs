//! A live container with its volume. The main type is [`DockerEnvironment`].

use std::{collections::VecDeque, path::Path};

use async_trait::async_trait;
use bollard::{
    models::{ContainerState, ContainerStateStatusEnum},
    query_parameters::{
        KillContainerOptionsBuilder, LogsOptionsBuilder, RemoveContainerOptionsBuilder,
        RemoveVolumeOptionsBuilder,
    },
};
use futures_util::TryStreamExt as _;
use record::progress::Progress;
use serde_json::{Map, Value};

use super::{
    archive,
    container::volume_names,
    engine::{Engine, if_there, is_missing, translate},
    follow::{Follower, until_ended, until_removed},
};
use crate::provider::{Ended, Environment, EnvironmentRequest, ProviderError, data_folder::Allowance};

/// A container, or what is left of it.
#[derive(Debug)]
pub struct DockerEnvironment {
    engine: Engine,
    /// Its name, which is its container's and that of the volume with its data.
    name: String,
    volumes: Vec<String>,
    allowance: Allowance,
    facts: Map<String, Value>,
    remains: Remains,
    /// What it said last, and whether we have asked it to end.
    last: Option<Progress>,
    asked_to_end: bool,
}

/// What there is of an environment.
#[derive(Debug)]
pub enum Remains {
    /// The container in which the workload runs, or has run.
    Container {
        /// Whether the workload ran when the environment was created or found.
        running: bool,
        /// What it says.
        lines: Follower,
    },
    /// Somebody removed the container; the volume is there, and a container of that name through which it is read.
    Volume {
        /// The container.
        reader: String,
        /// What the workload's own record says, as far as it was not taken yet.
        lines: VecDeque<Progress>,
    },
}

impl DockerEnvironment {
    /// Of what there is.
    pub fn new(
        engine: Engine,
        request: &EnvironmentRequest,
        facts: Map<String, Value>,
        remains: Remains,
    ) -> Self {
        Self {
            engine,
            name: request.environment.clone(),
            volumes: volume_names(request),
            allowance: Allowance::of(request),
            facts,
            remains,
            last: None,
            asked_to_end: false,
        }
    }

    async fn state(&self) -> Result<ContainerState, ProviderError> {
        let found = if_there(
            "asking how the workload ended",
            self.engine.api.inspect_container(&self.name, None).await,
        )?;
        found
            .and_then(|container| container.state)
            .ok_or_else(|| ProviderError::NotFound {
                what: format!("the container {}", self.name),
            })
    }

    /// The end of what the workload wrote to its standard error.
    async fn last_words(&self) -> Result<String, ProviderError> {
        let options = LogsOptionsBuilder::default().stderr(true).tail("20").build();
        let words: Result<Vec<_>, _> = self
            .engine
            .api
            .logs(&self.name, Some(options))
            .try_collect()
            .await;
        let words = match words {
            // Somebody has removed it, or is about to. That is told when its data is wanted.
            Err(error) if is_gone(&error) => return Ok(String::new()),
            words => words.map_err(|error| translate("reading the workload's last words", error))?,
        };
        Ok(words.iter().map(ToString::to_string).collect())
    }
}

/// Whether the engine says that a container does not run, is being removed, or is not there.
fn is_gone(error: &bollard::errors::Error) -> bool {
    matches!(
        error,
        bollard::errors::Error::DockerResponseServerError {
            status_code: 404 | 409,
            ..
        }
    )
}

/// Whether somebody is removing a container: the engine gives nothing out of it any more.
pub fn is_being_removed(state: &ContainerState) -> bool {
    matches!(
        state.status,
        Some(ContainerStateStatusEnum::REMOVING | ContainerStateStatusEnum::DEAD)
    )
}

/// How a container's main process ended, as the engine saw it.
fn judge(state: &ContainerState) -> Ended {
    if state.status == Some(ContainerStateStatusEnum::CREATED) {
        let why = state.error.as_deref().unwrap_or_default();
        return Ended::failed(format!("its container was never started {why}").trim_end());
    }
    let ended = Ended::by_exit_code(state.exit_code.unwrap_or(-1));
    if state.oom_killed == Some(true) {
        return Ended::failed("killed by the kernel since the container had used up its memory");
    }
    ended
}

/// How a workload ended that said that it was asked to, though not by us: in order, and too early.
fn ended_by_another(engine_was_lost: bool) -> Ended {
    let who = if engine_was_lost {
        "the Docker Engine, which was stopped or restarted meanwhile: without `live-restore` in its daemon.json, containers \
         end with it"
    } else {
        "somebody else, as `docker stop` does"
    };
    Ended::failed(&format!("it was asked to end by {who}"))
}

#[async_trait]
impl Environment for DockerEnvironment {
    fn facts(&self) -> Map<String, Value> {
        self.facts.clone()
    }

    fn running(&self) -> bool {
        matches!(self.remains, Remains::Container { running: true, .. })
    }

    async fn next_progress(&mut self) -> Result<Option<Progress>, ProviderError> {
        let next = match &mut self.remains {
            Remains::Container { lines, .. } => lines.next().await?,
            Remains::Volume { lines, .. } => lines.pop_front(),
        };
        if next.is_some() {
            self.last.clone_from(&next);
        }
        Ok(next)
    }

    async fn stop(&mut self) -> Result<(), ProviderError> {
        if matches!(self.remains, Remains::Volume { .. }) {
            return Ok(());
        }
        self.asked_to_end = true;
        let ask = || async {
            let options = KillContainerOptionsBuilder::default().signal("SIGTERM").build();
            let answer = self.engine.api.kill_container(&self.name, Some(options)).await;
            match answer {
                // What has ended, or is gone, needs no asking.
                Err(error) if is_gone(&error) => Ok(()),
                Ok(()) => Ok(()),
                Err(error) => Err(translate("asking the workload to end", error)),
            }
        };
        self.engine.retried(ask).await
    }

    async fn ended(&mut self) -> Result<Ended, ProviderError> {
        while self.next_progress().await?.is_some() {}
        let Remains::Container { lines, .. } = &self.remains else {
            return Ok(Ended::by_last_line(self.last.as_ref()));
        };
        let engine = &self.engine;
        engine.retried(|| until_ended(engine, &self.name)).await?;
        let ended = judge(&engine.retried(|| self.state()).await?);
        let stopped = matches!(self.last, Some(Progress::Stopped { .. }));
        if stopped && !self.asked_to_end {
            return Ok(ended_by_another(lines.was_cut()));
        }
        let words = engine.retried(|| self.last_words()).await?;
        Ok(ended.with_last_words(&words))
    }

    async fn collect(&mut self, into: &Path) -> Result<(), ProviderError> {
        let container = match &self.remains {
            Remains::Container { .. } => &self.name,
            Remains::Volume { reader, .. } => reader,
        };
        let engine = &self.engine;
        engine
            .retried(|| archive::collect(engine, container, into, &self.allowance))
            .await?;
        // An engine that is removing a container gives out a folder in which its volume is no longer.
        if let Remains::Container { .. } = &self.remains
            && is_being_removed(&engine.retried(|| self.state()).await?)
        {
            return Err(ProviderError::NotFound {
                what: format!("the container {}", self.name),
            });
        }
        Ok(())
    }

    async fn discard(self: Box<Self>) -> Result<(), ProviderError> {
        let engine = &self.engine;
        if let Remains::Volume { reader, .. } = &self.remains {
            engine.retried(|| remove_container(engine, reader)).await?;
        }
        engine.retried(|| remove_container(engine, &self.name)).await?;
        for volume in &self.volumes {
            engine.retried(|| remove_volume(engine, volume)).await?;
        }
        Ok(())
    }
}

/// Removes a container, running or not; it may be gone already. Afterwards it is.
///
/// # Errors
/// When the engine refuses.
pub async fn remove_container(engine: &Engine, name: &str) -> Result<(), ProviderError> {
    let action = format!("removing the container {name}");
    // Those of its volumes that have no name go with it. The one that has is removed by it, when nothing needs it any more.
    let options = RemoveContainerOptionsBuilder::default()
        .force(true)
        .v(true)
        .build();
    match engine.api.remove_container(name, Some(options)).await {
        // Somebody else removes it just now.
        Err(error) if is_gone(&error) => until_removed(engine, name).await?,
        Err(error) => return Err(translate(&action, error)),
        Ok(()) => {}
    }
    gone(&action, engine.api.inspect_container(name, None).await)
}

/// Removes a volume; it may be gone already. Afterwards it is.
///
/// # Errors
/// When the engine refuses, for instance since a container has it.
pub async fn remove_volume(engine: &Engine, name: &str) -> Result<(), ProviderError> {
    let action = format!("removing the volume {name}");
    let options = RemoveVolumeOptionsBuilder::default().build();
    match engine.api.remove_volume(name, Some(options)).await {
        Err(error) if !is_missing(&error) => return Err(translate(&action, error)),
        _ => {}
    }
    gone(&action, engine.api.inspect_volume(name).await)
}

/// The engine's yes is not enough.
fn gone<T>(action: &str, answer: Result<T, bollard::errors::Error>) -> Result<(), ProviderError> {
    match if_there(action, answer)? {
        None => Ok(()),
        Some(_) => Err(ProviderError::TimedOut {
            action: action.to_owned(),
            after: std::time::Duration::ZERO,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(status: ContainerStateStatusEnum, exit_code: i64, oom_killed: bool) -> ContainerState {
        ContainerState {
            status: Some(status),
            exit_code: Some(exit_code),
            oom_killed: Some(oom_killed),
            ..ContainerState::default()
        }
    }

    #[rstest::rstest]
    #[case::done(state(ContainerStateStatusEnum::EXITED, 0, false), true, "exit code 0")]
    #[case::killed(state(ContainerStateStatusEnum::EXITED, 137, false), false, "signal 9")]
    #[case::memory(state(ContainerStateStatusEnum::EXITED, 137, true), false, "memory")]
    #[case::never(state(ContainerStateStatusEnum::CREATED, 0, false), false, "never started")]
    #[case::unknown(ContainerState::default(), false, "exit code -1")]
    fn the_engines_words_become_ours(
        #[case] state: ContainerState,
        #[case] success: bool,
        #[case] how: &str,
    ) {
        let ended = judge(&state);
        assert_eq!(ended.success, success);
        assert!(ended.how.contains(how), "{}", ended.how);
    }
}
