//! What can happen to a process of this machine.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use provider_contract::{Platform, contract_tests, lines_of, request, until};
use record::progress::Progress;
use rustix::process::{Pid, Signal, kill_process};

contract_tests!(
    "native": keeps_the_contract,
    outlives_us_and_ends_in_order,
    is_discarded_while_it_runs,
    leftovers_are_removed,
);

#[tokio::test]
async fn a_process_that_is_killed_in_a_window_keeps_the_windows_before() {
    let provider = Platform::native().provider();
    let request = request("killed", 2);
    let mut environment = provider.create(&request).await.unwrap();
    let Some(Progress::Started { pid }) = environment.next_progress().await.unwrap() else {
        panic!("it did not start");
    };
    until(environment.as_mut(), |line| {
        matches!(line, Progress::WindowComplete { window: 1, .. })
    })
    .await;
    // Found by another process, as it were.
    let mut found = provider.find(&request).await.unwrap().unwrap();
    assert!(found.running());
    kill_process(Pid::from_raw(pid.try_into().unwrap()).unwrap(), Signal::KILL).unwrap();

    for environment in [&mut environment, &mut found] {
        lines_of(environment.as_mut()).await;
        let ended = environment.ended().await.unwrap();
        assert_eq!(
            (ended.success, ended.how.as_str()),
            (false, "killed by signal 9 (SIGKILL)")
        );
    }

    let into = tempfile::tempdir().unwrap();
    environment.collect(into.path()).await.unwrap();
    assert!(into.path().join("window-1/window.json").exists());
    assert!(!into.path().join("window-2/window.json").exists());
    environment.discard().await.unwrap();
}

#[tokio::test]
async fn settings_that_the_workload_refuses_are_told_in_its_words() {
    let provider = Platform::native().provider();
    let mut request = request("wrong", 2);
    request.settings.windows = 0;
    let mut environment = provider.create(&request).await.unwrap();
    let said = lines_of(environment.as_mut()).await;
    assert!(matches!(said.last(), Some(Progress::Failed { .. })), "{said:?}");
    let ended = environment.ended().await.unwrap();
    assert!(ended.how.starts_with("exit code 2"), "{}", ended.how);
    environment.discard().await.unwrap();
}
