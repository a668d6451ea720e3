//! What can happen to a process of this machine.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{fs, os::unix::fs::PermissionsExt as _};

use orchestrator::experiment_files::ExperimentFiles;
use provider_contract::{Platform, contract_tests, left_of, lines_of, request, until};
use record::{
    progress::Progress,
    window::{Verdict, WindowRecord},
};
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

#[tokio::test]
async fn a_command_of_the_users_runs_beside_its_files_and_its_windows_are_collected() {
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("sim/reach.sh");
    fs::create_dir(folder.path().join("sim")).unwrap();
    fs::write(
        &script,
        "#!/bin/sh\nprintf 'error\\n%s\\n%s\\n' $(cat sim/offset) $2 >$1/errors.csv\n",
    )
    .unwrap();
    fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
    fs::write(folder.path().join("sim/offset"), "0.25\n").unwrap();

    let mut request = request("command", 2);
    let experiment = serde_json::json!({
        "name": "reach",
        "files": ["sim"],
        "run": ["sim/reach.sh", "{window.folder}", "{parameters.steps}"],
        "window": {"timeout": "1min"},
        "parameters": {"steps": "5e3"},
        "metrics": [{"name": "reach_error", "unit": "mm", "from": "errors.csv", "column": "error"}],
    });
    request.settings.experiment = Some(serde_json::from_value(experiment).unwrap());
    request.files = Some(ExperimentFiles::pack(folder.path(), &["sim".to_owned()]).unwrap());

    let provider = Platform::native().provider();
    let mut environment = provider.create(&request).await.unwrap();
    let said = lines_of(environment.as_mut()).await;
    assert_eq!(said.last(), Some(&Progress::Finished), "{said:?}");
    let into = tempfile::tempdir().unwrap();
    environment.collect(into.path()).await.unwrap();
    for window in [1, 2] {
        let folder = into.path().join(format!("window-{window}"));
        let record: WindowRecord =
            serde_json::from_slice(&fs::read(folder.join("window.json")).unwrap()).unwrap();
        assert_ne!(record.verdict, Verdict::Invalid, "{record:?}");
        assert_eq!(
            fs::read_to_string(folder.join("errors.csv")).unwrap(),
            "error\n0.25\n5e3\n"
        );
    }
    environment.discard().await.unwrap();
    assert_eq!(
        left_of(provider.as_ref(), &request.environment).await,
        Vec::<String>::new()
    );
}
