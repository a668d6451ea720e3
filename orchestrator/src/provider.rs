//! Providers turn a host into an environment: a live place in which the workload runs.
//!
//! A [`Provider`] is asked whether it can work here, what it would create, and to create it; an [`Environment`] is the
//! live handle. What is asked for is an [`EnvironmentRequest`], plain data, so that a crashed run can ask again for the
//! very same thing. Every resource is named after the environment or labelled with it: that is how leftovers are found.
//!
//! [`ProviderKind`] is a row of the one place that knows which providers there are, the [`Catalogue`].

mod asked_right;
pub(crate) mod backoff;
pub(crate) mod capability_probe;
mod catalogue;
pub(crate) mod data_folder;
pub mod detached;
pub mod docker;
mod ended;
pub(crate) mod environment_directory;
mod error;
pub mod facts;
pub mod fake;
mod fleet;
pub mod jobs;
pub(crate) mod lines;
pub mod native;
mod providers;
mod settings;
pub mod simulated;
pub mod time_limit;
pub mod vagrant;

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};

use async_trait::async_trait;
use record::{
    call::{Folders, Run},
    causes::with_causes,
    detached::Owner,
    progress::Progress,
    run_directory::{JobStanding, Resource},
    settings::{Need, Settings},
    virtual_host::VirtualHost,
};
use serde_json::{Map, Value};

use self::time_limit::TimeLimit;
use crate::{experiment_files::ExperimentFiles, host::Program};

pub use asked_right::AskedRight;
pub use catalogue::{Catalogue, Hosts, Make, Making, NameTaken, ProviderKind};
pub use ended::Ended;
pub use error::ProviderError;
pub use fleet::Fleet;
pub use providers::Providers;
pub use settings::ProviderSettings;
pub use vagrant::kind::VagrantKind;

/// Whether something can be had on a host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Availability {
    /// It can; with what a person wants to know of it, such as `Engine 20.10.24`.
    Available {
        /// One line for `matrix doctor`.
        detail: String,
    },
    /// It cannot.
    Unavailable {
        /// The reason, as the plan and the report print it.
        reason: String,
        /// What would make it available.
        fix: Option<String>,
    },
}

impl Availability {
    /// Not available, since asking ended with this error.
    #[must_use]
    pub fn prevented_by(error: ProviderError) -> Self {
        Self::Unavailable {
            reason: with_causes(&error),
            fix: error.hint(),
        }
    }
}

/// An environment to be created, or to be found again.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentRequest {
    /// Its name, unique for ever and safe as a file and container name: `matrix-<run>-<slug>-<attempt>`.
    pub environment: String,
    /// The run's name.
    pub run: String,
    /// The run directory, absolute, so that leftovers can say where they belong.
    pub run_directory: PathBuf,
    /// The scenario's slug.
    pub scenario: String,
    /// The host's name in the matrix file.
    pub host: String,
    /// What the workload is to do.
    pub settings: Settings,
    /// The numbers of the windows it is to measure, one contiguous stretch of the loop.
    pub windows: Vec<u32>,
    /// The files of a user's experiment, if it has any.
    pub files: Option<ExperimentFiles>,
}

impl EnvironmentRequest {
    /// What an environment that a provider makes of it belongs to.
    #[must_use]
    pub fn owner(&self, provider: &str) -> Owner {
        Owner {
            provider: provider.to_owned(),
            run: self.run.clone(),
            run_directory: self.run_directory.clone(),
            scenario: self.scenario.clone(),
            host: self.host.clone(),
            windows: self.windows.clone(),
        }
    }

    /// The workload's arguments: what `workload run` is to do, in these folders.
    #[must_use]
    pub fn arguments(&self, folders: Folders) -> Vec<OsString> {
        Run::of(&self.environment, &self.settings, folders, &self.windows).arguments()
    }
}

/// The shell that a person asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShellRequest<'a> {
    /// The name of an environment that was kept.
    pub environment: &'a str,
    /// What was measured in it.
    pub settings: &'a Settings,
    /// The host of the experiment's network to be in. The network is made anew for the shell: that of the measurement is gone.
    pub virtual_host: Option<VirtualHost>,
    /// The image whose shell it is, where an environment is a container.
    pub image: Option<&'a str>,
}

impl ShellRequest<'_> {
    /// For a provider that has no network for a shell.
    ///
    /// # Errors
    /// When one is asked for.
    pub fn in_no_network(&self, provider: &str) -> Result<(), ProviderError> {
        let Some(host) = self.virtual_host else {
            return Ok(());
        };
        Err(ProviderError::Unsupported {
            provider: provider.to_owned(),
            reason: format!("`{host}` can be entered where an environment is native, and this one is not"),
            hint: Some("leave `--virtual-host` out, or enter a native scenario of the run".to_owned()),
        })
    }

    /// For a provider whose environments are not made of images.
    ///
    /// # Errors
    /// When one is asked for.
    pub fn of_no_image(&self, provider: &str) -> Result<(), ProviderError> {
        match self.image {
            None => Ok(()),
            Some(_) => Err(ProviderError::Unsupported {
                provider: provider.to_owned(),
                reason: "its environments are no containers".to_owned(),
                hint: Some("leave `--image` out".to_owned()),
            }),
        }
    }
}

/// Makes environments of one kind on one host.
#[async_trait]
pub trait Provider: Send + Sync {
    /// The name under which the journal knows it.
    fn name(&self) -> &'static str;

    /// Whether it can work here, whatever the settings need. Creates nothing.
    async fn survey(&self) -> Availability;

    /// Whether its environments meet a need; none if that can only be known once there is one. Asked where it can work
    /// here. Creates nothing that outlives the call.
    async fn survey_need(&self, need: &Need) -> Option<Availability> {
        let _ = need;
        None
    }

    /// All that [`Self::create`] will create, journaled before it does.
    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource>;

    /// Creates the environment and starts the workload in it, so that it outlives this process.
    ///
    /// # Errors
    /// When the platform refuses; what had been created by then is found by [`Self::leftovers`].
    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError>;

    /// Finds an environment that an earlier process created, running or ended.
    ///
    /// # Errors
    /// When the platform cannot be asked.
    async fn find(&self, request: &EnvironmentRequest)
    -> Result<Option<Box<dyn Environment>>, ProviderError>;

    /// A shell in an environment that exists, for a person: a program of the host's that wants a terminal.
    ///
    /// # Errors
    /// When there is no shell in it, or not the one that is asked for.
    async fn shell(&self, request: &ShellRequest<'_>) -> Result<Program, ProviderError>;

    /// How long one environment may take; none where as long as it needs.
    ///
    /// # Errors
    /// When the platform cannot be asked.
    async fn time_limit(&self) -> Result<Option<TimeLimit>, ProviderError> {
        Ok(None)
    }

    /// Everything that environments of this provider left on this host, whichever run they belong to. What has no owner
    /// on record, and the bridges of networks, are `native`'s.
    ///
    /// # Errors
    /// When the platform cannot be asked.
    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError>;

    /// Removes one of them. Removing what is gone already is not an error.
    ///
    /// # Errors
    /// When the platform refuses.
    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError>;
}

/// What is new of an environment.
#[derive(Debug, Clone, PartialEq)]
pub enum News {
    /// The workload said this.
    Workload(Progress),
    /// Its job stands so now.
    Job(JobStanding),
}

/// A live environment with the workload in it.
#[async_trait]
pub trait Environment: Send {
    /// What explains it: engine version, image digest, limits. Kept in `environment.json` as [`facts::of`] has it.
    fn facts(&self) -> Map<String, Value>;

    /// Whether the workload still ran when the environment was created or found.
    fn running(&self) -> bool;

    /// The workload's next line, from its first one even in an environment that was found again; `None` when the
    /// workload has ended and all its lines were read. Cancel-safe.
    ///
    /// # Errors
    /// When the platform stops answering.
    async fn next_progress(&mut self) -> Result<Option<Progress>, ProviderError>;

    /// Where its job stood when it was created or found, if it is one.
    fn job(&self) -> Option<&JobStanding> {
        None
    }

    /// What is new: the workload's next line, or where its job stands. Cancel-safe.
    ///
    /// # Errors
    /// As [`Self::next_progress`].
    async fn next_news(&mut self) -> Result<Option<News>, ProviderError> {
        Ok(self.next_progress().await?.map(News::Workload))
    }

    /// Whether a silence of the workload says nothing, since something else tells whether it lives.
    fn may_be_silent(&self) -> bool {
        false
    }

    /// Asks the workload to end in order; its lines go on until it has.
    ///
    /// # Errors
    /// When the platform refuses.
    async fn stop(&mut self) -> Result<(), ProviderError>;

    /// How the workload ended, in words for a person: `exit code 0`, `killed by signal 9`.
    ///
    /// # Errors
    /// When the platform cannot be asked.
    async fn ended(&mut self) -> Result<Ended, ProviderError>;

    /// Copies the workload's data folder into an empty folder: `environment.json` and the `window-N` folders.
    ///
    /// # Errors
    /// When something could not be read or written; what arrived stays.
    async fn collect(&mut self, into: &Path) -> Result<(), ProviderError>;

    /// Ends the workload if it runs and removes every resource. The image is kept for the next environment.
    ///
    /// # Errors
    /// When the platform refuses; what is left is found by [`Provider::leftovers`].
    async fn discard(self: Box<Self>) -> Result<(), ProviderError>;
}

/// Something of ours that exists on a host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Leftover {
    /// What and where.
    pub resource: Resource,
    /// The run it was created for; none for what runs share, such as the image.
    pub run: Option<String>,
    /// That run's directory.
    pub run_directory: Option<PathBuf>,
    /// The scenario.
    pub scenario: Option<String>,
    /// Whether a workload runs in it now.
    pub running: bool,
    /// The number of the job that this is, if a batch system has one that has not ended.
    pub job: Option<String>,
}
