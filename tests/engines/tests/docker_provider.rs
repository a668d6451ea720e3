//! What can happen to containers, on a real engine. Without one these tests fail.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{collections::HashMap, path::Path, time::Duration};

use bollard::{
    Docker as Api, body_full,
    models::{ContainerConfig, ContainerCreateBody, VolumeCreateRequest},
    query_parameters::{
        CommitContainerOptionsBuilder, CreateContainerOptionsBuilder, RemoveContainerOptionsBuilder,
        RemoveImageOptions, RemoveVolumeOptions, UploadToContainerOptionsBuilder,
    },
};
use orchestrator::provider::{
    Availability, Leftover, Provider, ProviderError,
    docker::{Docker, DockerSettings},
};
use provider_contract::{HOST, Platform, contract_tests, left_of, lines_of, request, until};
use record::{
    progress::Progress,
    quantity::Bytes,
    run_directory::Resource,
    settings::{Need, Processes},
    window::WindowRecord,
};
use tokio::{
    io::copy_bidirectional,
    net::{UnixListener, UnixStream},
    task::JoinSet,
};

contract_tests!(
    "docker": keeps_the_contract,
    outlives_us_and_ends_in_order,
    is_discarded_while_it_runs,
    leftovers_are_removed,
);

async fn engine() -> Api {
    Api::connect_with_defaults()
        .unwrap()
        .negotiate_version()
        .await
        .unwrap()
}

fn first_window_is_whole(line: &Progress) -> bool {
    matches!(line, Progress::WindowComplete { window: 1, .. })
}

#[tokio::test]
async fn a_container_that_is_killed_in_a_window_keeps_the_windows_before() {
    let provider = Platform::docker().provider();
    let request = request("killed", 2);
    let mut environment = provider.create(&request).await.unwrap();
    until(environment.as_mut(), first_window_is_whole).await;
    engine()
        .await
        .kill_container(&request.environment, None)
        .await
        .unwrap();

    let said = lines_of(environment.as_mut()).await;
    assert!(!said.contains(&Progress::Finished));
    let ended = environment.ended().await.unwrap();
    assert!(!ended.success);
    assert!(ended.how.starts_with("killed by signal 9"), "{}", ended.how);

    let into = tempfile::tempdir().unwrap();
    environment.collect(into.path()).await.unwrap();
    let record = std::fs::read(into.path().join("window-1/window.json")).unwrap();
    assert!(serde_json::from_slice::<WindowRecord>(&record).unwrap().complete);
    assert!(!into.path().join("window-2/window.json").exists());
    environment.discard().await.unwrap();
}

/// Passes connections on to the engine until it is dropped, and with it all that it passes on.
struct Doorway(tokio::task::JoinHandle<()>);

impl Doorway {
    fn open(socket: &Path) -> Self {
        let listener = UnixListener::bind(socket).unwrap();
        Self(tokio::spawn(async move {
            let mut passing = JoinSet::new();
            while let Ok((mut ours, _)) = listener.accept().await {
                passing.spawn(async move {
                    let mut engines = UnixStream::connect("/var/run/docker.sock").await.unwrap();
                    let _ = copy_bidirectional(&mut ours, &mut engines).await;
                });
            }
        }))
    }

    /// As when the engine ends.
    async fn close(self, socket: &Path) {
        self.0.abort();
        let _ = self.0.await;
        std::fs::remove_file(socket).unwrap();
    }
}

#[tokio::test]
async fn an_engine_that_goes_away_in_a_window_is_waited_for_and_every_line_comes_once() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("docker.sock");
    let address = format!("unix://{}", socket.display());
    let doorway = Doorway::open(&socket);
    let provider = Docker::at(&address, HOST, DockerSettings::default());
    let request = request("away", 2);
    let mut environment = provider.create(&request).await.unwrap();
    let mut said = Vec::new();
    while !matches!(said.last(), Some(Progress::Measuring { .. })) {
        said.push(environment.next_progress().await.unwrap().unwrap());
    }

    doorway.close(&socket).await;
    let away = provider.find(&request).await.map(|_| ()).unwrap_err();
    assert!(matches!(away, ProviderError::Disconnected { .. }), "{away}");
    let waiting = tokio::time::timeout(Duration::from_secs(1), environment.next_progress()).await;
    assert!(waiting.is_err(), "neither an end nor an error: {waiting:?}");

    let doorway = Doorway::open(&socket);
    said.extend(lines_of(environment.as_mut()).await);
    let times = |what: fn(&Progress) -> bool| said.iter().filter(|line| what(line)).count();
    let started = times(|line| matches!(line, Progress::Started { .. }));
    let measuring = times(|line| matches!(line, Progress::Measuring { window: 1, .. }));
    let whole = times(first_window_is_whole);
    assert_eq!((started, measuring, whole), (1, 1, 1), "{said:?}");
    assert_eq!(said.last(), Some(&Progress::Finished));

    // What is cut while it is under way is called again.
    doorway.close(&socket).await;
    let into = tempfile::tempdir().unwrap();
    let mut collecting = environment.collect(into.path());
    let waiting = tokio::time::timeout(Duration::from_secs(1), &mut collecting).await;
    assert!(waiting.is_err(), "neither collected nor an error: {waiting:?}");
    let doorway = Doorway::open(&socket);
    collecting.await.unwrap();
    for window in ["window-1", "window-2"] {
        assert!(into.path().join(window).join("window.json").exists());
    }
    assert!(environment.ended().await.unwrap().success);
    environment.discard().await.unwrap();
    assert_eq!(
        left_of(&provider, &request.environment).await,
        Vec::<String>::new()
    );
    doorway.close(&socket).await;
}

#[tokio::test]
async fn an_engine_that_is_not_there_is_unreachable_with_a_fix() {
    let provider = Docker::at("unix:///nowhere/docker.sock", HOST, DockerSettings::default());
    let Availability::Unavailable { reason, fix } = provider.survey().await else {
        panic!("available");
    };
    assert!(reason.contains("/nowhere/docker.sock"), "{reason}");
    assert!(fix.unwrap().contains("apt-get install docker.io"));
    let error = provider.leftovers().await.unwrap_err();
    assert!(matches!(error, ProviderError::Unreachable { .. }), "{error}");
}

#[tokio::test]
async fn a_volume_whose_container_is_gone_is_still_collected() {
    let provider = Platform::docker().provider();
    let request = request("gone", 2);
    let mut environment = provider.create(&request).await.unwrap();
    until(environment.as_mut(), first_window_is_whole).await;
    drop(environment);
    let force = RemoveContainerOptionsBuilder::default().force(true).build();
    engine()
        .await
        .remove_container(&request.environment, Some(force))
        .await
        .unwrap();

    let mut found = provider.find(&request).await.unwrap().unwrap();
    assert!(!found.running());
    let said = lines_of(found.as_mut()).await;
    assert!(matches!(said.first(), Some(Progress::Started { .. })), "{said:?}");
    assert!(said.iter().any(first_window_is_whole), "{said:?}");
    assert!(!found.ended().await.unwrap().success);
    found.stop().await.unwrap();
    let into = tempfile::tempdir().unwrap();
    found.collect(into.path()).await.unwrap();
    assert!(into.path().join("window-1/window.json").exists());
    found.discard().await.unwrap();
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
}

#[tokio::test]
async fn what_others_have_on_the_engine_is_neither_listed_nor_removed() {
    let api = engine().await;
    let provider = Platform::docker().provider();
    let request = request("foreign", 2);
    let mut environment = provider.create(&request).await.unwrap();
    let image = environment.facts()["image_id"].as_str().unwrap().to_owned();
    until(environment.as_mut(), first_window_is_whole).await;

    // One of another user's matrix, and one of somebody who likes our names.
    let name = |what: &str| format!("{}-{what}", request.environment);
    let labels = HashMap::from([
        ("matrix.owner".to_owned(), "4711@elsewhere".to_owned()),
        ("matrix.environment".to_owned(), name("theirs")),
    ]);
    let body = |labels| ContainerCreateBody {
        image: Some(image.clone()),
        labels,
        ..ContainerCreateBody::default()
    };
    let named = |name: &str| Some(CreateContainerOptionsBuilder::default().name(name).build());
    for (what, labels) in [("theirs", Some(labels)), ("plain", None)] {
        let container = named(&name(what));
        api.create_container(container, body(labels.clone()))
            .await
            .unwrap();
        let volume = VolumeCreateRequest {
            name: Some(name(what)),
            labels,
            ..VolumeCreateRequest::default()
        };
        api.create_volume(volume).await.unwrap();
    }

    environment.discard().await.unwrap();
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
    for (what, kind) in [
        ("theirs", "container"),
        ("plain", "container"),
        ("theirs", "volume"),
        ("plain", "volume"),
    ] {
        // Even asked by name.
        let resource = Resource {
            host: HOST.to_owned(),
            kind: kind.to_owned(),
            name: name(what),
        };
        let leftover = Leftover {
            resource,
            run: None,
            run_directory: None,
            scenario: None,
            running: false,
            job: None,
        };
        provider.remove(&leftover).await.unwrap();
    }
    for what in ["theirs", "plain"] {
        api.inspect_container(&name(what), None).await.unwrap();
        api.inspect_volume(&name(what)).await.unwrap();
        api.remove_container(&name(what), None).await.unwrap();
        api.remove_volume(&name(what), None::<RemoveVolumeOptions>)
            .await
            .unwrap();
    }
}

#[tokio::test]
async fn the_workload_runs_in_an_image_that_the_user_names_and_leaves_it_alone() {
    let api = engine().await;
    let plain = Platform::docker().provider();
    let of_ours = request("base", 2);
    let environment = plain.create(&of_ours).await.unwrap();
    // An image that nobody else has.
    let base = of_ours.environment.clone();
    let commit = CommitContainerOptionsBuilder::default()
        .container(&base)
        .repo(&base)
        .tag("1")
        .build();
    let labels = HashMap::from([("matrix.owner".to_owned(), "4711@elsewhere".to_owned())]);
    let config = ContainerConfig {
        labels: Some(labels),
        ..ContainerConfig::default()
    };
    api.commit_container(commit, config).await.unwrap();
    environment.discard().await.unwrap();

    let settings = DockerSettings {
        image: Some(format!("{base}:1")),
        ..DockerSettings::default()
    };
    let provider = Platform::docker_with(settings).provider();
    assert!(matches!(provider.survey().await, Availability::Available { .. }));
    let request = request("upon", 2);
    let mut environment = provider.create(&request).await.unwrap();
    let facts = environment.facts();
    assert_eq!(facts["image_base"]["name"], format!("{base}:1"));
    let said = lines_of(environment.as_mut()).await;
    assert_eq!(
        said.last(),
        Some(&Progress::Finished),
        "{:?}",
        environment.ended().await
    );

    // The image that was built upon it is ours, and used; then it is only ours.
    let ours = provider.leftovers().await.unwrap();
    let image = ours
        .iter()
        .find(|leftover| facts["image"] == leftover.resource.name)
        .unwrap();
    assert_eq!((image.resource.kind.as_str(), &image.run), ("image", &None));
    let in_use = provider.remove(image).await.unwrap_err();
    assert!(matches!(in_use, ProviderError::Refused { .. }), "{in_use}");
    environment.discard().await.unwrap();
    provider.remove(image).await.unwrap();
    provider.remove(image).await.unwrap();
    assert!(!provider.leftovers().await.unwrap().contains(image));

    api.inspect_image(&format!("{base}:1")).await.unwrap();
    api.remove_image(&format!("{base}:1"), None::<RemoveImageOptions>, None)
        .await
        .unwrap();
}

/// tcpdump and what it is linked with, as a tar archive for the root of a container.
fn tcpdump() -> Vec<u8> {
    let program = ["/usr/bin/tcpdump", "/usr/sbin/tcpdump"]
        .into_iter()
        .find(|path| Path::new(path).exists())
        .unwrap_or_else(|| panic!("tcpdump is missing: apt-get install tcpdump"));
    let linked = std::process::Command::new("ldd").arg(program).output().unwrap();
    let linked = String::from_utf8(linked.stdout).unwrap();
    let libraries = linked.split_whitespace().filter(|word| word.starts_with('/'));
    let mut archive = tar::Builder::new(Vec::new());
    for path in libraries {
        let mut file = std::fs::File::open(path).unwrap();
        archive
            .append_file(path.trim_start_matches('/'), &mut file)
            .unwrap();
    }
    let mut file = std::fs::File::open(program).unwrap();
    archive.append_file("usr/bin/tcpdump", &mut file).unwrap();
    archive.into_inner().unwrap()
}

fn need(json: serde_json::Value) -> Need {
    Need::of_the_network(&serde_json::from_value(json).unwrap())
}

#[tokio::test]
async fn the_workload_itself_says_whether_an_image_has_what_a_need_demands() {
    let api = engine().await;
    let plain = Platform::docker().provider();
    let of_ours = request("needs", 2);
    let environment = plain.create(&of_ours).await.unwrap();
    let base = of_ours.environment.clone();
    // The container's own root cannot be written.
    let commit = |container: &str, tag: &str| {
        CommitContainerOptionsBuilder::default()
            .container(container)
            .repo(&base)
            .tag(tag)
            .build()
    };
    let config = ContainerConfig::default;
    api.commit_container(commit(&base, "1"), config()).await.unwrap();
    environment.discard().await.unwrap();
    let body = ContainerCreateBody {
        image: Some(format!("{base}:1")),
        ..ContainerCreateBody::default()
    };
    let options = CreateContainerOptionsBuilder::default().name(&base).build();
    api.create_container(Some(options), body).await.unwrap();
    let options = UploadToContainerOptionsBuilder::default().path("/").build();
    api.upload_to_container(&base, Some(options), body_full(tcpdump().into()))
        .await
        .unwrap();
    api.commit_container(commit(&base, "2"), config()).await.unwrap();
    api.remove_container(&base, None).await.unwrap();

    let with = |tag: &str| {
        let settings = DockerSettings {
            image: Some(format!("{base}:{tag}")),
            ..DockerSettings::default()
        };
        Platform::docker_with(settings).provider()
    };
    let filter = need(serde_json::json!({"capture": {"filter": "tcp"}}));
    let kernel = need(serde_json::json!({"network": {"backend": "kernel"}}));
    let met = with("2").survey_need(&filter).await;
    assert!(matches!(met, Some(Availability::Available { .. })), "{met:?}");
    for (provider, need, words, what_to_do) in [
        (with("2"), &kernel, "ip is not installed", "`image:`"),
        (with("1"), &filter, "tcpdump could not be started", "`image:`"),
        (plain, &filter, "the built-in image has not got", "image"),
    ] {
        let Some(Availability::Unavailable { reason, fix }) = provider.survey_need(need).await else {
            panic!("{need} is met");
        };
        assert!(reason.contains(words), "{reason}");
        assert!(fix.unwrap().contains(what_to_do));
    }
    let defaults = need(serde_json::json!({}));
    assert_eq!(
        with("2").survey_need(&defaults).await,
        None,
        "the workload is enough"
    );
    let provider = with("2");
    assert_eq!(
        left_of(
            provider.as_ref(),
            &format!("matrix-check-{}-", std::process::id())
        )
        .await,
        Vec::<String>::new()
    );
    for tag in ["2", "1"] {
        api.remove_image(&format!("{base}:{tag}"), None::<RemoveImageOptions>, None)
            .await
            .unwrap();
    }
}

#[tokio::test]
async fn an_image_that_the_engine_does_not_have_makes_the_scenario_infeasible() {
    let settings = DockerSettings {
        image: Some("matrix-test/nobody-has-this:1".to_owned()),
        ..DockerSettings::default()
    };
    let provider = Platform::docker_with(settings).provider();
    let Availability::Unavailable { reason, fix } = provider.survey().await else {
        panic!("available");
    };
    assert!(reason.contains("matrix-test/nobody-has-this:1"), "{reason}");
    assert!(fix.unwrap().contains("docker pull matrix-test/nobody-has-this:1"));
    let error = provider
        .create(&request("missing", 2))
        .await
        .map(|_| ())
        .unwrap_err();
    assert!(matches!(error, ProviderError::Unsupported { .. }), "{error}");
}

#[tokio::test]
async fn a_workload_that_uses_up_its_memory_is_said_to_have() {
    let settings = DockerSettings {
        memory: Some(Bytes::new(6 << 20)),
        ..DockerSettings::default()
    };
    let provider = Platform::docker_with(settings).provider();
    let mut hungry = request("memory", 2);
    // One process, of which all pages have to be there.
    hungry.settings.loops.processes = Processes::Threads;
    hungry.settings.realtime.lock_memory = true;
    let mut environment = provider.create(&hungry).await.unwrap();
    let ended = environment.ended().await.unwrap();
    environment.discard().await.unwrap();
    assert!(!ended.success);
    assert!(ended.how.contains("memory"), "{}", ended.how);
}

#[tokio::test]
async fn limits_that_the_engine_refuses_are_explained() {
    let settings = DockerSettings {
        cpus: Some(1e6),
        ..DockerSettings::default()
    };
    let provider = Platform::docker_with(settings).provider();
    let error = provider
        .create(&request("limits", 2))
        .await
        .map(|_| ())
        .unwrap_err();
    assert!(matches!(error, ProviderError::Refused { .. }), "{error}");
    assert!(
        error
            .hint()
            .is_some_and(|hint| hint.contains("providers.docker.cpus")),
        "{error}"
    );
}

/// Against the engine's own client, which asks for the same in another way.
#[tokio::test]
async fn an_environment_says_what_its_engine_makes_containers_with() {
    let provider = Platform::docker().provider();
    let environment = provider.create(&request("parts", 1)).await.unwrap();
    let facts = environment.facts();
    environment.discard().await.unwrap();

    let client = |of: &str, format: &str| {
        let output = std::process::Command::new("docker")
            .args([of, "--format", format])
            .output()
            .unwrap();
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    let runc = r#"{{range .Server.Components}}{{if eq .Name "runc"}}{{.Version}}{{end}}{{end}}"#;
    for (part, said) in [
        ("storage_driver", client("info", "{{.Driver}}")),
        ("default_runtime", client("info", "{{.DefaultRuntime}}")),
        ("cgroup_version", client("info", "{{.CgroupVersion}}")),
        ("cgroup_driver", client("info", "{{.CgroupDriver}}")),
        ("runc_version", client("version", runc)),
    ] {
        assert_eq!(facts["engine_parts"][part], said, "{part}");
        assert_ne!(said, "", "{part}");
    }
}
