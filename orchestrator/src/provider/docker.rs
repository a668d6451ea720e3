//! The `docker` provider: the workload as the main process of a container. The main type is [`Docker`].
//!
//! ```text
//! survey   engine, image named by the user; the workload in a container of it -> can it work here
//! create   image (built once) -> container with its volume, both named after the environment -> started
//! follow   the container's log, from its first line
//! collect  the volume, through the container; through one that is never started if the container is gone
//! discard  container, volume; the image stays until `matrix clean`
//! ```

mod archive;
mod check;
mod container;
mod engine;
mod environment;
mod folders;
mod follow;
mod image;
mod job;
mod known_images;
mod labels;
mod recipe;
mod seccomp;
mod settings;
mod transport;

use std::sync::Arc;

use async_trait::async_trait;
use bollard::{
    body_full,
    models::{ContainerInspectResponse, ImageInspect},
    query_parameters::{
        CreateContainerOptionsBuilder, InspectContainerOptions, ListContainersOptionsBuilder,
        ListImagesOptionsBuilder, ListVolumesOptionsBuilder, RemoveImageOptionsBuilder,
        StartContainerOptions, UploadToContainerOptionsBuilder,
    },
};
use record::{
    run_directory::{Resource, fact},
    settings::Need,
};
use serde_json::{Map, Value, json};
use tokio::sync::OnceCell;

use self::{
    engine::{Engine, Way, if_there, is_missing, translate},
    environment::{DockerEnvironment, Remains, is_being_removed},
    folders::DATA,
    follow::{Follower, until_removed},
    image::Image,
    known_images::KnownImages,
    labels::Labels,
    settings::Base,
};
use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError, ShellRequest,
    capability_probe,
};
use crate::{
    host::{Host, Program},
    state_directory::StateDirectory,
};

pub use job::container as job_container;
pub use settings::{DockerSettings, NAME};

const CONTAINER: &str = "container";
const VOLUME: &str = "volume";
const IMAGE: &str = "image";

/// Containers of one Docker Engine.
pub struct Docker {
    host: String,
    way: Way,
    settings: DockerSettings,
    /// Connected to when it is needed first.
    engine: OnceCell<Engine>,
}

impl Docker {
    /// On a host: this machine's engine is found as `docker` would find it, another's at its usual socket there.
    #[must_use]
    pub fn on(host: &Arc<dyn Host>, settings: DockerSettings) -> Self {
        if host.is_this_machine() {
            return Self::new(host.name(), settings);
        }
        Self {
            host: host.name().to_owned(),
            way: Way::Forwarded(Arc::clone(host)),
            settings,
            engine: OnceCell::new(),
        }
    }

    /// On this machine, by its name in the matrix file, whose engine is found as `docker` would find it.
    #[must_use]
    pub fn new(host: &str, settings: DockerSettings) -> Self {
        Self::at(&engine::usual_address(), host, settings)
    }

    /// On the engine at an address such as `unix:///var/run/docker.sock`.
    #[must_use]
    pub fn at(address: &str, host: &str, settings: DockerSettings) -> Self {
        Self {
            host: host.to_owned(),
            way: Way::Address(address.to_owned()),
            settings,
            engine: OnceCell::new(),
        }
    }

    async fn engine(&self) -> Result<&Engine, ProviderError> {
        self.engine.get_or_try_init(|| Engine::connect(&self.way)).await
    }

    fn resource(&self, kind: &str, name: &str) -> Resource {
        Resource {
            host: self.host.clone(),
            kind: kind.to_owned(),
            name: name.to_owned(),
        }
    }

    fn leftover(&self, kind: &str, name: &str, labels: &Labels, running: bool) -> Leftover {
        Leftover {
            resource: self.resource(kind, name),
            run: labels.run(),
            run_directory: labels.run_directory(),
            scenario: labels.scenario(),
            running,
            job: None,
        }
    }

    /// What explains a container: its engine, its image, its limits.
    fn facts(&self, engine: &Engine, image: &Image, warnings: &[String]) -> Map<String, Value> {
        let facts = json!({
            (fact::PROVIDER): NAME,
            (fact::ENGINE_VERSION): engine.version,
            "engine_api_version": engine.api_version,
            "engine_kernel": engine.kernel,
            (fact::ENGINE_PARTS): engine.parts,
            "image": image.name,
            (fact::IMAGE_ID): image.id,
            "image_base": image.base.as_ref().map(|(name, id)| json!({"name": name, "id": id})),
            (fact::WORKLOAD_SHA256): image.workload_sha256,
            "limits": self.settings,
            "engine_warnings": warnings,
        });
        match facts {
            Value::Object(facts) => facts,
            _ => Map::new(),
        }
    }

    /// The name of the image that the workload is to be on, made if need be; none for the workload alone.
    async fn base(&self, engine: &Engine) -> Result<Option<String>, ProviderError> {
        match self.settings.base()? {
            Base::Nothing => Ok(None),
            Base::Image(image) => Ok(Some(image.to_owned())),
            Base::Recipe(recipe) => recipe.ensure(engine).await.map(Some),
        }
    }

    async fn inspect(engine: &Engine, name: &str) -> Result<Option<ContainerInspectResponse>, ProviderError> {
        if_there(
            "looking for the container",
            engine
                .api
                .inspect_container(name, None::<InspectContainerOptions>)
                .await,
        )
    }

    /// The environment whose container is gone, if its volume is not.
    async fn find_volume(
        &self,
        engine: &Engine,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let name = &request.environment;
        let volume = if_there("looking for the volume", engine.api.inspect_volume(name).await)?;
        let labels = Labels::read(volume.map(|volume| volume.labels));
        if !labels.are_of(request) {
            return Ok(None);
        }
        let image = Image {
            // Not necessarily the one that is used to read it.
            workload_sha256: labels.workload(),
            ..image::ensure(engine, self.base(engine).await?.as_deref()).await?
        };
        let reader = format!("{name}-reader");
        if Self::inspect(engine, &reader).await?.is_none() {
            let options = CreateContainerOptionsBuilder::default().name(&reader).build();
            engine
                .api
                .create_container(Some(options), container::reader(request, &image))
                .await
                .map_err(|error| translate("creating a container to read the volume", error))?;
        }
        let lines = archive::progress(engine, &reader).await?.into();
        let remains = Remains::Volume { reader, lines };
        let facts = self.facts(engine, &image, &[]);
        Ok(Some(Box::new(DockerEnvironment::new(
            engine.clone(),
            request,
            facts,
            remains,
        ))))
    }
}

#[async_trait]
impl Provider for Docker {
    fn name(&self) -> &'static str {
        NAME
    }

    async fn survey(&self) -> Availability {
        let surveyed = async {
            let engine = self.engine().await?;
            match self.settings.base()? {
                Base::Image(image) => drop(image::base_id(engine, image).await?),
                Base::Recipe(recipe) if !recipe.look(engine).await? => {
                    return Ok(match engine.judge()? {
                        Availability::Available { detail } => Availability::Available {
                            detail: format!("{detail}; the image of providers.docker.recipe is made first"),
                        },
                        unavailable => unavailable,
                    });
                }
                Base::Recipe(_) => {}
                Base::Nothing if self.settings.entrypoint.is_empty() => {}
                Base::Nothing => return Err(no_entrypoint()),
            }
            engine.judge()
        };
        surveyed.await.unwrap_or_else(Availability::prevented_by)
    }

    /// The image that is built in has the workload and nothing else. What one that the user names has, and what the kernel
    /// of an engine elsewhere has, is asked of the workload in a container, which takes a second or more; so not where the
    /// workload alone is enough and its devices were looked at.
    async fn survey_need(&self, need: &Need) -> Option<Availability> {
        let programs = need.programs();
        let base = match self.settings.base() {
            Ok(base) => base,
            Err(error) => return Some(Availability::prevented_by(error)),
        };
        if let Some(lacking) = lacking(base, need) {
            return Some(lacking);
        }
        let asked = async {
            let engine = self.engine().await?;
            if programs.is_empty() && engine.is_here && self.settings.entrypoint.is_empty() {
                return Ok(None);
            }
            let image = match base {
                Base::Nothing => None,
                Base::Image(image) => Some(image.to_owned()),
                // What its packages will bring, nobody can ask yet.
                Base::Recipe(recipe) if !recipe.look(engine).await? => return Ok(None),
                Base::Recipe(recipe) => Some(recipe.image(&engine.architecture)),
            };
            let record = check::check(engine, image.as_deref(), need, &self.settings).await?;
            Ok(Some(capability_probe::availability(&record)))
        };
        asked
            .await
            .unwrap_or_else(|error| Some(Availability::prevented_by(error)))
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        let volumes = container::volume_names(request).into_iter();
        let volumes = volumes.map(|name| self.resource(VOLUME, &name));
        [self.resource(CONTAINER, &request.environment)]
            .into_iter()
            .chain(volumes)
            .collect()
    }

    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        let engine = self.engine().await?;
        let name = &request.environment;
        let image = image::ensure(engine, self.base(engine).await?.as_deref()).await?;
        let options = CreateContainerOptionsBuilder::default().name(name).build();
        let created = engine
            .api
            .create_container(
                Some(options),
                container::workload(request, &self.settings, &image, engine.memory),
            )
            .await
            .map_err(|error| translate(&format!("creating the container {name}"), error))?;
        let made_ready = async {
            check_workload(engine, name, &image).await?;
            put_files(engine, name, request).await
        };
        if let Err(error) = made_ready.await {
            environment::remove_container(engine, name).await?;
            for volume in container::volume_names(request) {
                environment::remove_volume(engine, &volume).await?;
            }
            return Err(error);
        }
        engine
            .api
            .start_container(name, None::<StartContainerOptions>)
            .await
            .map_err(|error| translate(&format!("starting the container {name}"), error))?;
        let remains = Remains::Container {
            running: true,
            lines: Follower::of(engine.clone(), name.clone()),
        };
        let facts = self.facts(engine, &image, &created.warnings);
        Ok(Box::new(DockerEnvironment::new(
            engine.clone(),
            request,
            facts,
            remains,
        )))
    }

    async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let engine = self.engine().await?;
        let name = &request.environment;
        let Some(found) = Self::inspect(engine, name).await? else {
            return self.find_volume(engine, request).await;
        };
        let config = found.config.unwrap_or_default();
        let labels = Labels::read(config.labels);
        if !labels.are_of(request) {
            return Ok(None);
        }
        if found.state.as_ref().is_some_and(is_being_removed) {
            until_removed(engine, name).await?;
            return self.find_volume(engine, request).await;
        }
        let id = found.image.unwrap_or_default();
        let image = Image {
            name: image::name_of(engine, &id).await?,
            id,
            base: None,
            workload_sha256: labels.workload(),
        };
        let remains = Remains::Container {
            running: found.state.and_then(|state| state.running) == Some(true),
            lines: Follower::of(engine.clone(), name.clone()),
        };
        let facts = self.facts(engine, &image, &[]);
        Ok(Some(Box::new(DockerEnvironment::new(
            engine.clone(),
            request,
            facts,
            remains,
        ))))
    }

    async fn shell(&self, request: &ShellRequest<'_>) -> Result<Program, ProviderError> {
        request.in_no_network(NAME)?;
        let environment = request.environment;
        if self.settings.base()? == Base::Nothing && request.image.is_none() {
            return Err(ProviderError::Unsupported {
                provider: NAME.to_owned(),
                reason: "the built-in image has the workload in it and no shell".to_owned(),
                hint: Some("add `--image debian:12`, or another image that the engine has: its shell is opened beside the data".to_owned()),
            });
        }
        let engine = self.engine().await?;
        let Some(container) = Self::inspect(engine, environment).await? else {
            return Err(ProviderError::NotFound {
                what: format!("container {environment}"),
            });
        };
        let running = container.state.and_then(|state| state.running) == Some(true);
        let script = if running && request.image.is_none() {
            r#"exec docker exec -i $terminal "$1" /bin/sh"#
        } else {
            // One that has ended cannot be entered: another container, with its volumes. Nothing is pulled.
            r#"exec docker run --rm -i $terminal --pull never --network none --volumes-from "$1" --workdir "$3" --entrypoint /bin/sh "$2""#
        };
        let script = format!("terminal=; if [ -t 0 ]; then terminal=-t; fi; {script}");
        let own = container.image.unwrap_or_default();
        let image = request.image.unwrap_or(&own);
        Ok(Program::new(
            "sh",
            ["-c", &script, "sh", environment, image, DATA],
        ))
    }

    /// Containers first, since what they use cannot be removed before them.
    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let engine = self.engine().await?;
        let failed = |error| translate("listing what is ours", error);
        let mut leftovers = Vec::new();

        let options = ListContainersOptionsBuilder::default()
            .all(true)
            .filters(&labels::of_any_owner())
            .build();
        for found in engine.api.list_containers(Some(options)).await.map_err(failed)? {
            let running = found.state.is_some_and(|state| state.to_string() == "running");
            let name = found.names.into_iter().flatten().next().or(found.id);
            let name = name.unwrap_or_default();
            let labels = Labels::read(found.labels);
            if labels.are_ours() {
                leftovers.push(self.leftover(CONTAINER, name.trim_start_matches('/'), &labels, running));
            }
        }

        let options = ListVolumesOptionsBuilder::default()
            .filters(&labels::of_any_owner())
            .build();
        let volumes = engine.api.list_volumes(Some(options)).await.map_err(failed)?;
        for found in volumes.volumes.into_iter().flatten() {
            let labels = Labels::read(Some(found.labels));
            if labels.are_ours() {
                leftovers.push(self.leftover(VOLUME, &found.name, &labels, false));
            }
        }

        let options = ListImagesOptionsBuilder::default()
            .filters(&labels::images_of_any_owner())
            .build();
        for found in engine.api.list_images(Some(options)).await.map_err(failed)? {
            let labels = Labels::read(Some(found.labels));
            if labels.are_of_our_image() && image::is_our_name(&found.repo_tags) {
                let name = found.repo_tags.into_iter().next().unwrap_or(found.id);
                // Runs share it, whatever an image it was built upon says of its own.
                leftovers.push(self.leftover(IMAGE, &name, &Labels::default(), false));
            }
        }
        Ok(leftovers)
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        let engine = self.engine().await?;
        let name = &leftover.resource.name;
        // The name may have passed to something of another's since it was listed.
        match leftover.resource.kind.as_str() {
            CONTAINER => {
                let found = Self::inspect(engine, name).await?;
                let labels = found.and_then(|found| found.config).map(|config| config.labels);
                if labels.is_some_and(|labels| Labels::read(labels).are_ours()) {
                    environment::remove_container(engine, name).await?;
                }
                Ok(())
            }
            VOLUME => {
                let found = if_there("looking for the volume", engine.api.inspect_volume(name).await)?;
                if found.is_some_and(|found| Labels::read(Some(found.labels)).are_ours()) {
                    environment::remove_volume(engine, name).await?;
                }
                Ok(())
            }
            IMAGE => {
                let found = if_there("looking for the image", engine.api.inspect_image(name).await)?;
                let ours = |found: ImageInspect| {
                    let labels = found.config.and_then(|config| config.labels);
                    Labels::read(labels).are_of_our_image()
                        && image::is_our_name(&found.repo_tags.unwrap_or_default())
                };
                if found.is_some_and(ours) {
                    remove_image(engine, name).await?;
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

/// Puts the files of a user's experiment into a container that is not started yet.
async fn put_files(
    engine: &Engine,
    container: &str,
    request: &EnvironmentRequest,
) -> Result<(), ProviderError> {
    const ACTION: &str = "copying the experiment's files into the container";
    let Some(files) = &request.files else {
        return Ok(());
    };
    let tar = files.as_tar().map_err(|source| ProviderError::Data {
        what: "the archive with the experiment's files".to_owned(),
        reason: source.to_string(),
    })?;
    let options = UploadToContainerOptionsBuilder::default()
        .path(folders::WORK)
        .build();
    engine
        .api
        .upload_to_container(container, Some(options), body_full(tar.into()))
        .await
        .map_err(|error| translate(ACTION, error))
}

/// Whether the workload in a container, not started yet, is the one that was built into its image: a name and a label are what
/// anybody can give an image of his (`docker load`, `docker tag`).
async fn check_workload(engine: &Engine, container: &str, image: &Image) -> Result<(), ProviderError> {
    let known = KnownImages::of(&StateDirectory::of_this_user());
    let expected = image.workload_sha256.as_deref().unwrap_or_default();
    if known.has(&image.id, expected) {
        return Ok(());
    }
    let found = archive::sha256(engine, container, container::WORKLOAD).await?;
    if found.is_some_and(|found| found == expected) {
        known.keep(&image.id, expected);
        return Ok(());
    }
    Err(ProviderError::Unsupported {
        provider: NAME.to_owned(),
        reason: format!(
            "the image {} on the engine has another workload than its name says: somebody else put it there",
            image.name
        ),
        hint: Some(format!(
            "remove it, with `docker image rm {}`: matrix then builds it anew",
            image.name
        )),
    })
}

/// Why an image without programs does not do for a need.
#[must_use]
pub fn lacking(base: Base<'_>, need: &Need) -> Option<Availability> {
    let programs = need.programs();
    (base == Base::Nothing && !programs.is_empty()).then(|| Availability::Unavailable {
        reason: format!(
            "`{need}` needs {}, which the built-in image has not got",
            programs.join(" and ")
        ),
        fix: Some(
            "name an image that has what it needs: `providers: {docker: {image: …}}`, or do without the setting"
                .to_owned(),
        ),
    })
}

/// An entry point is a program of an image.
fn no_entrypoint() -> ProviderError {
    ProviderError::Unsupported {
        provider: NAME.to_owned(),
        reason:
            "providers.docker.entrypoint names a program, and the built-in image has none but the workload"
                .to_owned(),
        hint: Some(
            "name the image that has it in `providers.docker.image`, or leave `entrypoint` out".to_owned(),
        ),
    }
}

/// Without force: what a container uses stays, and the engine says so.
async fn remove_image(engine: &Engine, name: &str) -> Result<(), ProviderError> {
    let options = RemoveImageOptionsBuilder::default().build();
    match engine.api.remove_image(name, Some(options), None).await {
        Err(error) if !is_missing(&error) => Err(translate(&format!("removing the image {name}"), error)),
        _ => Ok(()),
    }
}
