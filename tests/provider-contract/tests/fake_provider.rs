//! The faults that the fake platform plays, and how strict it is.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{collections::BTreeMap, path::Path};

use orchestrator::provider::{
    Environment, ProviderError,
    fake::{FakeScenario, FakeSettings, Fault, FaultPoint},
};
use provider_contract::{Platform, contract_tests, left_of, lines_of, request, until};
use record::{progress::Progress, window::Verdict};

contract_tests!("fake": keeps_the_contract);

fn failing(at: FaultPoint, window: Option<u32>) -> Platform {
    let special = FakeScenario {
        shift_m: 0.0,
        fail: Some(Fault {
            at,
            window,
            attempts: None,
        }),
    };
    Platform::fake_with(FakeSettings {
        scenarios: BTreeMap::from([("a".to_owned(), special)]),
        ..FakeSettings::default()
    })
}

async fn collected(environment: &mut dyn Environment) -> tempfile::TempDir {
    let into = tempfile::tempdir().unwrap();
    environment.collect(into.path()).await.unwrap();
    into
}

fn has(folder: &Path, file: &str) -> bool {
    folder.join(file).exists()
}

#[tokio::test]
async fn a_workload_that_is_killed_leaves_a_window_without_its_record() {
    let provider = failing(FaultPoint::Kill, Some(2)).provider();
    let mut environment = provider.create(&request("a", 2)).await.unwrap();
    let said = lines_of(environment.as_mut()).await;
    assert!(
        matches!(said.last(), Some(Progress::WindowComplete { window: 1, .. })),
        "{said:?}"
    );
    let ended = environment.ended().await.unwrap();
    assert_eq!(
        (ended.success, ended.how.as_str()),
        (false, "killed by signal 9 (SIGKILL)")
    );
    let folder = collected(environment.as_mut()).await;
    assert!(has(folder.path(), "window-1/window.json"));
    assert!(has(folder.path(), "window-2/control.csv"));
    assert!(!has(folder.path(), "window-2/window.json"));
}

#[tokio::test]
async fn an_experiment_that_fails_says_so() {
    let provider = failing(FaultPoint::Measure, None).provider();
    let mut environment = provider.create(&request("a", 2)).await.unwrap();
    let said = lines_of(environment.as_mut()).await;
    assert!(
        matches!(said.last(), Some(Progress::Failed { platform: false, .. })),
        "{said:?}"
    );
    assert!(!environment.ended().await.unwrap().success);
}

#[tokio::test]
async fn a_lost_connection_is_found_again_with_all_its_lines() {
    let platform = failing(FaultPoint::Disconnect, Some(2));
    let request = request("a", 2);
    let mut environment = platform.provider().create(&request).await.unwrap();
    until(environment.as_mut(), |line| {
        matches!(line, Progress::WindowComplete { window: 1, .. })
    })
    .await;
    let error = environment.next_progress().await.unwrap_err();
    assert!(matches!(error, ProviderError::Disconnected { .. }), "{error}");
    drop(environment);

    let mut found = platform.provider().find(&request).await.unwrap().unwrap();
    assert!(found.running());
    let said = lines_of(found.as_mut()).await;
    assert!(matches!(said.first(), Some(Progress::Started { .. })), "{said:?}");
    assert_eq!(said.last(), Some(&Progress::Finished));
    assert!(has(
        collected(found.as_mut()).await.path(),
        "window-2/window.json"
    ));
}

#[tokio::test]
async fn an_environment_that_could_not_be_created_is_a_leftover() {
    let provider = failing(FaultPoint::Create, None).provider();
    let request = request("a", 2);
    let error = provider.create(&request).await.map(|_| ()).unwrap_err();
    assert!(matches!(error, ProviderError::Played { .. }), "{error}");
    assert!(provider.find(&request).await.unwrap().is_none());
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        ["directory"]
    );
    for leftover in provider.leftovers().await.unwrap() {
        provider.remove(&leftover).await.unwrap();
    }
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
}

#[tokio::test]
async fn collecting_and_discarding_fail_when_told_to_and_lose_nothing() {
    for at in [FaultPoint::Collect, FaultPoint::Discard] {
        let provider = failing(at, None).provider();
        let request = request("a", 2);
        let mut environment = provider.create(&request).await.unwrap();
        lines_of(environment.as_mut()).await;
        let into = tempfile::tempdir().unwrap();
        let done = match environment.collect(into.path()).await {
            Ok(()) => environment.discard().await,
            error => error,
        };
        assert!(matches!(done, Err(ProviderError::Played { .. })), "{done:?}");
        assert!(provider.find(&request).await.unwrap().is_some());
    }
}

#[tokio::test]
async fn it_is_strict() {
    let provider = Platform::fake().provider();
    let request = request("a", 2);
    let mut environment = provider.create(&request).await.unwrap();
    let into = tempfile::tempdir().unwrap();
    let early = environment.collect(into.path()).await.unwrap_err();
    assert!(matches!(early, ProviderError::OutOfOrder { .. }), "{early}");

    lines_of(environment.as_mut()).await;
    environment.collect(into.path()).await.unwrap();
    let twice = environment.collect(into.path()).await.unwrap_err();
    assert!(matches!(twice, ProviderError::OutOfOrder { .. }), "{twice}");

    let other = provider.find(&request).await.unwrap().unwrap();
    environment.discard().await.unwrap();
    let twice = other.discard().await.unwrap_err();
    assert!(matches!(twice, ProviderError::OutOfOrder { .. }), "{twice}");
}

#[tokio::test]
async fn a_window_that_was_cut_is_marked() {
    let provider = Platform::fake().provider();
    let mut environment = provider.create(&request("a", 2)).await.unwrap();
    until(environment.as_mut(), |line| {
        matches!(line, Progress::WindowComplete { window: 1, .. })
    })
    .await;
    environment.stop().await.unwrap();
    assert_eq!(
        lines_of(environment.as_mut()).await,
        [Progress::Stopped { window: 2 }]
    );
    assert!(environment.ended().await.unwrap().success);
    let folder = collected(environment.as_mut()).await;
    let record = std::fs::read_to_string(folder.path().join("window-2/window.json")).unwrap();
    assert!(record.contains("\"complete\": false"), "{record}");
}

/// One that ends unseen has said enough of itself for a verdict on its windows.
#[tokio::test]
async fn a_window_of_the_contract_is_worth_something() {
    let provider = Platform::fake().provider();
    let mut environment = provider.create(&request("verdict", 2)).await.unwrap();
    let said = lines_of(environment.as_mut()).await;
    let verdicts = said.iter().filter_map(|line| match line {
        Progress::WindowComplete { verdict, .. } => Some(*verdict),
        _ => None,
    });
    assert_eq!(verdicts.collect::<Vec<_>>(), [Verdict::Valid, Verdict::Valid]);
}
