//! What every provider promises. Each function panics where the promise is not kept.

use std::path::Path;

use orchestrator::provider::{Availability, Environment, ProviderError};
use record::{platform::PlatformRecord, progress::Progress, window::WindowRecord};
use sha2::{Digest as _, Sha256};

use crate::{Platform, left_of, lines_of, request, until};

fn assert_whole(folder: &Path, windows: &[u32]) {
    let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
    let platform: PlatformRecord = serde_json::from_slice(&read("environment.json")).unwrap();
    assert!(!platform.kernel.is_empty());
    for window in windows {
        let name = |file: &str| format!("window-{window}/{file}");
        let record: WindowRecord = serde_json::from_slice(&read(&name("window.json"))).unwrap();
        assert_eq!(record.window, *window);
        assert!(record.complete);
        assert!(record.files.iter().any(|file| file.name == "control.csv"));
        for file in record.files {
            let content = read(&name(&file.name));
            assert_eq!(content.len() as u64, file.bytes, "{}", file.name);
            assert_eq!(
                format!("{:x}", Sha256::digest(&content)),
                file.sha256,
                "{}",
                file.name
            );
        }
    }
}

/// create → progress → ended → collect → discard → nothing is left.
pub async fn keeps_the_contract(platform: Platform) {
    let provider = platform.provider();
    let request = request("contract", 2);
    let survey = provider.survey().await;
    assert!(matches!(survey, Availability::Available { .. }), "{survey:?}");
    assert!(
        provider.find(&request).await.unwrap().is_none(),
        "before it is created"
    );

    let mut environment = provider.create(&request).await.unwrap();
    assert!(environment.running());
    let again = provider.create(&request).await.map(|_| ()).unwrap_err();
    assert!(
        matches!(again, ProviderError::Refused { .. } | ProviderError::File { .. }),
        "{again}"
    );
    let announced = provider.resources(&request);
    let there = provider.leftovers().await.unwrap();
    for leftover in there.iter().filter(|found| announced.contains(&found.resource)) {
        assert_eq!(leftover.run.as_deref(), Some(request.run.as_str()));
        assert_eq!(leftover.run_directory.as_ref(), Some(&request.run_directory));
        assert_eq!(leftover.scenario.as_deref(), Some(request.scenario.as_str()));
    }
    for kind in left_of(provider.as_ref(), &request.environment).await {
        assert!(
            announced.iter().any(|resource| resource.kind == kind),
            "{kind} was not announced"
        );
    }

    let said = lines_of(environment.as_mut()).await;
    assert!(matches!(said.first(), Some(Progress::Started { .. })), "{said:?}");
    for window in &request.windows {
        let whole =
            |line: &Progress| matches!(line, Progress::WindowComplete { window: done, .. } if done == window);
        assert!(said.iter().any(whole), "{said:?}");
    }
    assert_eq!(said.last(), Some(&Progress::Finished));
    assert_eq!(
        environment.next_progress().await.unwrap(),
        None,
        "asked once more"
    );
    let ended = environment.ended().await.unwrap();
    assert!(ended.success, "{}", ended.how);

    // A process that comes later finds it, ended, with all it said and all its data.
    let later = platform.provider();
    let mut found = later.find(&request).await.unwrap().unwrap();
    assert!(!found.running());
    assert_eq!(lines_of(found.as_mut()).await, said);
    assert!(found.ended().await.unwrap().success);

    for environment in [&mut environment, &mut found] {
        let into = tempfile::tempdir().unwrap();
        environment.collect(into.path()).await.unwrap();
        assert_whole(into.path(), &request.windows);
    }
    assert!(!environment.facts().is_empty());
    environment.discard().await.unwrap();
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
    assert!(
        provider.find(&request).await.unwrap().is_none(),
        "after it was discarded"
    );
}

/// A crash of ours, then `matrix resume`, then Ctrl-C.
pub async fn outlives_us_and_ends_in_order(platform: Platform) {
    let request = request("outlive", 2000);
    let mut environment = platform.provider().create(&request).await.unwrap();
    let first = environment.next_progress().await.unwrap();
    drop(environment);

    let later = platform.provider();
    let mut found = later.find(&request).await.unwrap().unwrap();
    assert!(found.running());
    assert_eq!(found.next_progress().await.unwrap(), first, "from its first line");
    until_measuring(found.as_mut()).await;
    let leftovers = later.leftovers().await.unwrap();
    let own = leftovers
        .iter()
        .find(|left| left.resource.name == request.environment);
    assert!(own.unwrap().running);

    found.stop().await.unwrap();
    let said = lines_of(found.as_mut()).await;
    assert_eq!(said.last(), Some(&Progress::Stopped { window: 1 }), "{said:?}");
    assert!(found.ended().await.unwrap().success);
    found.stop().await.unwrap();
    found.discard().await.unwrap();
    assert_eq!(
        left_of(later.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
}

async fn until_measuring(environment: &mut dyn Environment) {
    until(environment, |line| matches!(line, Progress::Measuring { .. })).await;
}

/// Discarding what runs leaves nothing, not even a process.
pub async fn is_discarded_while_it_runs(platform: Platform) {
    let provider = platform.provider();
    let request = request("discard", 2000);
    let mut environment = provider.create(&request).await.unwrap();
    until_measuring(environment.as_mut()).await;
    environment.discard().await.unwrap();
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
}

/// What a crash left is listed with its run and can be removed one by one, twice.
pub async fn leftovers_are_removed(platform: Platform) {
    let request = request("leftovers", 2000);
    let mut environment = platform.provider().create(&request).await.unwrap();
    until_measuring(environment.as_mut()).await;
    drop(environment);

    let provider = platform.provider();
    let mut ours = provider.leftovers().await.unwrap();
    ours.retain(|leftover| leftover.run.as_deref() == Some(request.run.as_str()));
    assert!(!ours.is_empty());
    for leftover in ours.iter().chain(&ours) {
        provider.remove(leftover).await.unwrap();
    }
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
    assert!(provider.find(&request).await.unwrap().is_none());
}
