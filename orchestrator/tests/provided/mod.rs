//! What the tests of providers share: platforms to try them on, and requests that are short.
#![allow(dead_code)] // Each test file uses a part of it.

use std::{
    process,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
};

use orchestrator::{
    host::Here,
    provider::{
        Environment, EnvironmentRequest, Provider,
        docker::{Docker, DockerSettings},
        fake::{Fake, FakeSettings},
        native::Native,
    },
    state_directory::StateDirectory,
};
use tempfile::TempDir;
use workload::{quantity::TimeSpan, record::progress::Progress, settings::Settings};

/// The host's name in these tests.
pub const HOST: &str = "here";

/// Something to make providers for, again and again, as one process after another would.
pub struct Platform(Box<dyn Fn() -> Box<dyn Provider> + Send + Sync>);

impl Platform {
    pub fn fake() -> Self {
        Self::fake_with(FakeSettings::default())
    }

    pub fn fake_with(settings: FakeSettings) -> Self {
        Self::with_state(move |state| Box::new(Fake::new(HOST, settings.clone(), state)))
    }

    pub fn native() -> Self {
        Self::with_state(|state| Box::new(Native::new(Arc::new(Here::new(HOST, state)))))
    }

    pub fn docker() -> Self {
        Self::docker_with(DockerSettings::default())
    }

    pub fn docker_with(settings: DockerSettings) -> Self {
        Self(Box::new(move || Box::new(Docker::new(HOST, settings.clone()))))
    }

    fn with_state(make: impl Fn(StateDirectory) -> Box<dyn Provider> + Send + Sync + 'static) -> Self {
        let state: Arc<TempDir> = Arc::new(tempfile::tempdir().unwrap());
        Self(Box::new(move || make(StateDirectory::new(state.path()))))
    }

    /// As another process would have it.
    pub fn provider(&self) -> Box<dyn Provider> {
        (self.0)()
    }
}

/// Two windows of so many seconds, in an environment of its own.
pub fn request(scenario: &str, window_s: u64) -> EnvironmentRequest {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let run = format!("test{}-{}", process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
    EnvironmentRequest {
        environment: format!("matrix-{run}-{scenario}-1"),
        run_directory: format!("/runs/{run}").into(),
        run,
        scenario: scenario.to_owned(),
        host: HOST.to_owned(),
        settings: Settings {
            windows: 2,
            window: TimeSpan::from_secs(window_s),
            period: TimeSpan::from_secs(1),
            ..Settings::default()
        },
        windows: vec![1, 2],
    }
}

/// All that it still says.
pub async fn lines_of(environment: &mut dyn Environment) -> Vec<Progress> {
    let mut said = Vec::new();
    while let Some(line) = environment.next_progress().await.unwrap() {
        said.push(line);
    }
    said
}

/// Takes lines until one is as wanted.
pub async fn until(environment: &mut dyn Environment, wanted: impl Fn(&Progress) -> bool) {
    loop {
        match environment.next_progress().await.unwrap() {
            Some(line) if wanted(&line) => return,
            Some(Progress::Failed { reason, .. }) => panic!("{reason}"),
            Some(_) => {}
            None => panic!("it ended: {:?}", environment.ended().await),
        }
    }
}

/// What belongs to this environment of all that the provider has left on the host, by kind.
pub async fn left_of(provider: &dyn Provider, environment: &str) -> Vec<String> {
    let leftovers = provider.leftovers().await.unwrap();
    leftovers
        .into_iter()
        .filter(|leftover| leftover.resource.name.contains(environment))
        .map(|leftover| leftover.resource.kind)
        .collect()
}
