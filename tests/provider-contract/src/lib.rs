//! The contract that every provider keeps, as functions that a test calls with a [`Platform`]: [`keeps_the_contract`] for
//! all of them, and [`outlives_us_and_ends_in_order`], [`is_discarded_while_it_runs`] and [`leftovers_are_removed`] for those
//! whose environments outlive `matrix`. A provider of the catalogue is tested by [`contract_tests!`] with its name.
//!
//! A promise that is not kept is a panic, as in any test.

#![allow(clippy::unwrap_used, clippy::panic, clippy::missing_panics_doc)] // As in tests, which is what this is for.

mod contract;

use std::{
    process,
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
};

use orchestrator::{
    batch::Clusters,
    host::{Here, Host},
    provider::{
        Catalogue, Environment, EnvironmentRequest, Provider, ProviderSettings, docker::DockerSettings,
        fake::FakeSettings,
    },
    state_directory::StateDirectory,
};
use record::{progress::Progress, quantity::TimeSpan, settings::Settings};
use tempfile::TempDir;
#[doc(hidden)]
pub use tokio;

pub use contract::{
    is_discarded_while_it_runs, keeps_the_contract, leftovers_are_removed, outlives_us_and_ends_in_order,
};

/// One test for each promise on a platform that makes it: `contract_tests!("native": keeps_the_contract,
/// leftovers_are_removed);`. The platform is the name of a built-in provider, or a function without arguments.
#[macro_export]
macro_rules! contract_tests {
    ($name:literal: $($promise:ident),+ $(,)?) => {
        fn platform() -> $crate::Platform {
            $crate::Platform::named($name)
        }

        $crate::contract_tests!(platform: $($promise),+);
    };
    ($platform:path: $($promise:ident),+ $(,)?) => {
        $(#[test]
        fn $promise() {
            let runtime = $crate::tokio::runtime::Builder::new_current_thread().enable_all().build();
            runtime.expect("a runtime starts").block_on($crate::$promise($platform()));
        })+
    };
}

/// The host's name in these tests.
pub const HOST: &str = "here";

/// Something to make providers for, again and again, as one process after another would.
pub struct Platform(Box<dyn Fn() -> Box<dyn Provider> + Send + Sync>);

impl Platform {
    /// The fake platform, without faults.
    pub fn fake() -> Self {
        Self::fake_with(FakeSettings::default())
    }

    /// The fake platform with the faults of these settings.
    pub fn fake_with(fake: FakeSettings) -> Self {
        let settings = ProviderSettings {
            fake,
            ..ProviderSettings::default()
        };
        Self::of(Catalogue::default(), "fake", settings)
    }

    /// This machine.
    pub fn native() -> Self {
        Self::named("native")
    }

    /// The Docker Engine of this machine.
    pub fn docker() -> Self {
        Self::docker_with(DockerSettings::default())
    }

    /// The same, with settings of the matrix file's `providers: docker:`.
    pub fn docker_with(docker: DockerSettings) -> Self {
        let settings = ProviderSettings {
            docker,
            ..ProviderSettings::default()
        };
        Self::of(Catalogue::default(), "docker", settings)
    }

    /// The built-in provider of that name on this machine, with the default settings.
    pub fn named(name: &str) -> Self {
        Self::of(Catalogue::default(), name, ProviderSettings::default())
    }

    /// The provider of that name in a catalogue, which may be from outside, on this machine with these settings.
    pub fn of(catalogue: Catalogue, name: &str, settings: ProviderSettings) -> Self {
        let kind = catalogue.kind(name).unwrap();
        let state: TempDir = tempfile::tempdir().unwrap();
        Self(Box::new(move || {
            let state = StateDirectory::new(state.path());
            let host: Arc<dyn Host> = Arc::new(Here::new(HOST, state.clone()));
            kind.provider(&host, &settings, &state, &Clusters::default())
                .unwrap()
        }))
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
        files: None,
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
