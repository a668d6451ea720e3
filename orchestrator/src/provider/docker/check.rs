//! Whether containers meet a need, by asking the workload in one: what the user's image has, and what an engine elsewhere
//! has, whose devices cannot be looked at from here. The function is [`check`].

use std::{
    process,
    sync::atomic::{AtomicU32, Ordering},
};

use bollard::{
    body_full,
    container::LogOutput,
    query_parameters::{
        CreateContainerOptionsBuilder, LogsOptionsBuilder, StartContainerOptions,
        UploadToContainerOptionsBuilder,
    },
};
use futures_util::TryStreamExt as _;
use record::{check::CheckRecord, settings::Need};

use super::{
    container,
    engine::{Engine, translate},
    environment::remove_container,
    folders,
    follow::until_ended,
    image,
    settings::DockerSettings,
};
use crate::provider::{
    ProviderError,
    capability_probe::{self, ACTION, TIMEOUT},
};

/// Asks the workload in a container, with the rights and limits of one that measures, and removes the container. The image
/// that the user names stays as it is, and none is built upon it; without one it is our own, which is built if need be, as
/// a host over SSH is given the workload before it can be asked. Who is killed meanwhile leaves a container that `matrix
/// clean` finds.
///
/// # Errors
/// When the engine refuses, or the workload does not answer in time and as agreed.
pub async fn check(
    engine: &Engine,
    image: Option<&str>,
    need: &Need,
    settings: &DockerSettings,
) -> Result<CheckRecord, ProviderError> {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let name = format!("matrix-check-{}-{number}", process::id());
    let failed = |error| translate(ACTION, error);
    let own = match image {
        Some(_) => None,
        None => Some(image::ensure(engine, None).await?.name),
    };
    let image = image.or(own.as_deref()).unwrap_or_default();
    let options = CreateContainerOptionsBuilder::default().name(&name).build();
    engine
        .api
        .create_container(
            Some(options),
            container::check(need, settings, image, engine.memory),
        )
        .await
        .map_err(failed)?;
    let asked = async {
        put_workload(engine, &name).await?;
        ask(engine, &name).await
    };
    let asked = tokio::time::timeout(TIMEOUT, asked).await;
    remove_container(engine, &name).await?;
    asked.map_err(|_| ProviderError::TimedOut {
        action: ACTION.to_owned(),
        after: TIMEOUT,
    })?
}

async fn put_workload(engine: &Engine, name: &str) -> Result<(), ProviderError> {
    let workload = image::archive(ACTION, &[image::file_of(engine.workload()?)])?;
    let options = UploadToContainerOptionsBuilder::default()
        .path(folders::DATA)
        .build();
    engine
        .api
        .upload_to_container(name, Some(options), body_full(workload.into()))
        .await
        .map_err(|error| translate(ACTION, error))
}

/// Runs the container to its end and reads what it printed.
async fn ask(engine: &Engine, name: &str) -> Result<CheckRecord, ProviderError> {
    let failed = |error| translate(ACTION, error);
    engine
        .api
        .start_container(name, None::<StartContainerOptions>)
        .await
        .map_err(failed)?;
    until_ended(engine, name).await?;
    let options = LogsOptionsBuilder::default()
        .stdout(true)
        .stderr(true)
        .tail("all")
        .build();
    let logged: Vec<_> = engine
        .api
        .logs(name, Some(options))
        .try_collect()
        .await
        .map_err(failed)?;
    let (words, printed): (Vec<_>, Vec<_>) = logged
        .into_iter()
        .partition(|piece| matches!(piece, LogOutput::StdErr { .. }));
    let printed: Vec<u8> = printed.into_iter().flat_map(LogOutput::into_bytes).collect();
    let words: String = words.iter().map(ToString::to_string).collect();
    capability_probe::answer(&printed).map_err(|unreadable| unanswered(&words).unwrap_or(unreadable))
}

/// Why there is no answer, where what was to be done before the workload could not be done and said so.
fn unanswered(words: &str) -> Option<ProviderError> {
    let last = words.lines().rfind(|line| !line.trim().is_empty())?;
    Some(ProviderError::Unsupported {
        provider: "docker".to_owned(),
        reason: format!("the container ended before the workload in it could answer: {}", last.trim()),
        hint: Some(
            "see whether `providers.docker` gives the `entrypoint` what it needs: `capabilities`, `writable` folders"
                .to_owned(),
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_point_that_failed_is_quoted() {
        let error = unanswered("starting\novsdb-server: Read-only file system\n\n").unwrap();
        assert!(
            error
                .to_string()
                .ends_with("could answer: ovsdb-server: Read-only file system")
        );
        assert!(error.hint().unwrap().contains("`writable` folders"));
        assert!(unanswered("\n").is_none());
    }
}
