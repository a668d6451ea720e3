//! A container of a job: what the node's `docker run` is given, since nobody can reach a node's engine while no `matrix` lives. Pure.
//! The function is [`container`].
//!
//! The job's user has the container's processes, without a capability. The workload makes its networks as an ordinary user's does, in
//! a namespace of its own, which is the one call that it may make beside those of other containers.

use std::collections::BTreeMap;

use record::{
    detached::{JobContainer, JobImage},
    quantity::Bytes,
};

use super::{
    container::{HOSTNAME, MOST_PROCESSES, TUN},
    image,
    labels::Labels,
    no_entrypoint, seccomp,
    settings::{Base, DockerSettings, NAME},
};
use crate::provider::{EnvironmentRequest, ProviderError};

/// The container in which the workload runs.
///
/// # Errors
/// When the settings ask for what a job's container cannot have.
pub fn container(
    request: &EnvironmentRequest,
    settings: &DockerSettings,
) -> Result<JobContainer, ProviderError> {
    // Each is looked at: a new setting must not be passed over.
    let DockerSettings {
        image: _,
        recipe: _,
        entrypoint,
        capabilities,
        system_calls,
        writable,
        apparmor,
        cpus,
        cpuset,
        memory,
        realtime_runtime,
    } = settings;
    let not_of_a_job = |setting: &str| {
        Err(ProviderError::Unsupported {
            provider: NAME.to_owned(),
            reason: format!(
                "a container of a job has the rights of the job's user, to whom `providers.docker.{setting}` gives nothing"
            ),
            hint: Some(format!(
                "take `{setting}` out, or measure on a node that you can log in to, as a host of its own"
            )),
        })
    };
    if !capabilities.is_empty() {
        return not_of_a_job("capabilities");
    }
    if realtime_runtime.is_some() {
        return not_of_a_job("realtime_runtime");
    }
    let image = match settings.base()? {
        Base::Image(image) => JobImage::Named(image.to_owned()),
        Base::Nothing if entrypoint.is_empty() => JobImage::Empty {
            name: image::EMPTY.to_owned(),
            labels: Labels::of_image_without_workload().write().into_iter().collect(),
        },
        Base::Nothing => return Err(no_entrypoint()),
        Base::Recipe(_) => {
            return Err(ProviderError::Unsupported {
                provider: NAME.to_owned(),
                reason: "`providers.docker.recipe` is made by an engine that `matrix` reaches, and a job's node is none".to_owned(),
                hint: Some(
                    "make the image elsewhere, load it into the engine of each node, and name it in `providers.docker.image`"
                        .to_owned(),
                ),
            });
        }
    };
    let mut options = Options::default();
    options.say("--network", "none");
    options.say("--hostname", HOSTNAME);
    options.0.push("--read-only".to_owned());
    options.say("--cap-drop", "ALL");
    options.say("--security-opt", "no-new-privileges:true");
    options.say("--pids-limit", MOST_PROCESSES);
    // Its output is the client's.
    options.say("--log-driver", "none");
    let labels: BTreeMap<_, _> = Labels::of_environment(request).write().into_iter().collect();
    for (key, value) in labels {
        options.say("--label", format_args!("{key}={value}"));
    }
    if request.settings.network_in_use().is_some() {
        options.say("--device", TUN);
    }
    for folder in writable {
        options.say("--tmpfs", folder);
    }
    if let Some(profile) = apparmor {
        options.say("--security-opt", format_args!("apparmor={profile}"));
    }
    if let Some(cpus) = cpus {
        options.say("--cpus", cpus);
    }
    if let Some(cpuset) = cpuset {
        options.say("--cpuset-cpus", cpuset);
    }
    Ok(JobContainer {
        options: options.0,
        image,
        entrypoint: entrypoint.clone(),
        seccomp: seccomp::profile_of_an_ordinary_user(system_calls),
        memory: memory.map(Bytes::get),
    })
}

/// Options of `docker run`.
#[derive(Debug, Default)]
struct Options(Vec<String>);

impl Options {
    fn say(&mut self, option: &str, value: impl std::fmt::Display) {
        self.0.push(format!("{option}={value}"));
    }
}

#[cfg(test)]
mod tests {
    use record::quantity::TimeSpan;
    use rstest::rstest;

    use super::*;
    use crate::provider::docker::{container::tests::request, recipe::Recipe, settings::SystemCalls};

    #[test]
    fn a_container_of_a_job_has_no_capability_and_no_network_of_the_engines() {
        let container = container(&request(), &DockerSettings::default()).unwrap();
        let without_owner = |option: &&String| !option.starts_with("--label=matrix.owner=");
        let options: Vec<_> = container.options.iter().filter(without_owner).collect();
        insta::assert_debug_snapshot!(options, @r#"
        [
            "--network=none",
            "--hostname=workload",
            "--read-only",
            "--cap-drop=ALL",
            "--security-opt=no-new-privileges:true",
            "--pids-limit=4096",
            "--log-driver=none",
            "--label=matrix.environment=matrix-r1-a-1",
            "--label=matrix.run=r1",
            "--label=matrix.run-directory=/runs/r1",
            "--label=matrix.scenario=a",
            "--device=/dev/net/tun",
        ]
        "#);
        assert!(matches!(container.image, JobImage::Empty { name, .. } if name == "matrix-workload:empty"));
        assert_eq!(container.memory, None);
    }

    #[test]
    fn what_a_matrix_file_asks_for_reaches_the_nodes_engine() {
        let settings = DockerSettings {
            image: Some("debian:12".to_owned()),
            entrypoint: vec!["env".to_owned(), "A=1".to_owned()],
            writable: vec!["/run".to_owned().try_into().unwrap()],
            apparmor: Some("unconfined".to_owned()),
            cpus: Some(1.5),
            cpuset: Some("0-1".to_owned()),
            memory: Some(Bytes::new(512 << 20)),
            system_calls: vec![SystemCalls::Mount],
            ..DockerSettings::default()
        };
        let container = container(&request(), &settings).unwrap();
        let asked = [
            "--tmpfs=/run",
            "--security-opt=apparmor=unconfined",
            "--cpus=1.5",
            "--cpuset-cpus=0-1",
        ];
        assert_eq!(container.options[container.options.len() - 4..], asked);
        assert_eq!(container.image, JobImage::Named("debian:12".to_owned()));
        assert_eq!(container.entrypoint, ["env", "A=1"]);
        assert_eq!(container.memory, Some(512 << 20));
        assert!(container.seccomp.contains("umount2"));
    }

    #[rstest]
    #[case::rights(
        DockerSettings { capabilities: vec!["SETGID".to_owned().try_into().unwrap()], ..DockerSettings::default() },
        "capabilities"
    )]
    #[case::realtime(
        DockerSettings { realtime_runtime: Some(TimeSpan::from_millis(900)), ..DockerSettings::default() },
        "realtime_runtime"
    )]
    #[case::recipe(DockerSettings { recipe: Some(Recipe { packages: Vec::new() }), ..DockerSettings::default() }, "recipe")]
    #[case::entrypoint(DockerSettings { entrypoint: vec!["env".to_owned()], ..DockerSettings::default() }, "entrypoint")]
    fn what_a_container_of_a_job_cannot_have_is_said_before_one_is_asked_for(
        #[case] settings: DockerSettings,
        #[case] setting: &str,
    ) {
        let error = container(&request(), &settings).unwrap_err();
        assert!(error.to_string().contains(setting), "{error}");
        assert!(error.hint().is_some());
    }
}
