//! Gives what others wrote to what reads it, without a host, an engine or a terminal.

use std::path::Path;

use record::{
    detached::{AlreadyThere, Ending, Failure, Host, LeaseAnswer, Listed, Removed, Started, Stopping},
    platform_model::PlatformModel,
    progress::Progress,
    settings::Settings,
};

use crate::{
    batch::{JobOwner, slurm::answers},
    cli::{command::drift, plain_log},
    host::ssh::{SshClient, configuration},
    matrix_file::{self, MatrixFile},
    plan::{self, order::Order, selection::Selection},
    provider::{
        EnvironmentRequest, capability_probe,
        data_folder::{self, Allowance},
        detached::transfer,
        lines::Lines,
        vagrant::{output, ssh_config},
    },
    survey,
};

/// A matrix file, read and planned as `matrix check` does.
pub fn matrix_file(bytes: &[u8]) {
    match MatrixFile::parse("matrix.yaml", bytes, None) {
        Ok(file) => {
            let facts = survey::unasked(&file);
            match plan::plan(&file, &facts, &Selection::default(), Order::Randomised, 1) {
                Ok(plan) => assert!(plan.record.scenarios.len() <= 1000),
                Err(found) => assert!(!found.is_empty()),
            }
        }
        Err(found) => {
            assert!(!found.is_empty());
            let _ = (found.to_json(), found.to_string());
        }
    }
}

/// A platform's file; the platform, if scenarios are simulated on it.
#[must_use]
pub fn platform(bytes: &[u8]) -> Option<PlatformModel> {
    match matrix_file::platform("platform.yaml", bytes) {
        Ok(platform) => Some(platform),
        Err(found) => {
            assert!(!found.is_empty());
            let _ = (found.to_json(), found.to_string());
            None
        }
    }
}

/// `drift.yaml`.
pub fn drift_file(bytes: &[u8]) {
    if let Ok(text) = matrix_file::within_limits("drift.yaml", bytes) {
        let _ = drift::acknowledgements(&text).map(|known| known.problems());
    }
}

/// What a workload says, in pieces, and the lines that a person reads of it.
pub fn progress(bytes: &[u8]) {
    let mut lines = Lines::default();
    for piece in bytes.chunks(100) {
        lines.push(piece);
        while let Ok(Some(said)) = lines.next_line() {
            let _ = serde_json::to_string::<Progress>(&said);
            let event = record::run_directory::Event::Workload {
                scenario: "s".to_owned(),
                progress: said,
            };
            let line = plain_log::line(&event).unwrap_or_default();
            assert!(!line.contains(char::is_control), "{line:?}");
        }
    }
}

/// Each of the answers of a host.
pub fn answers(bytes: &[u8]) {
    fn any<T: serde::de::DeserializeOwned + serde::Serialize>(bytes: &[u8]) {
        if let Ok(answer) = serde_json::from_slice::<T>(bytes) {
            let _ = serde_json::to_string(&answer);
        }
    }
    any::<Started>(bytes);
    any::<Ending>(bytes);
    any::<Stopping>(bytes);
    any::<Removed>(bytes);
    any::<Listed>(bytes);
    any::<Host>(bytes);
    any::<Failure>(bytes);
    any::<LeaseAnswer>(bytes);
    if let Ok(record) = capability_probe::answer(bytes) {
        let _ = capability_probe::availability(&record);
    }
}

/// The data folder of a host's environment, as it is sent: nothing else is written.
pub fn host_archive(bytes: &[u8]) {
    alone_in_a_folder(|into| {
        let _ = transfer::unpack(bytes, &AlreadyThere::new(), into, &allowance());
    });
}

/// The data folder of a container, as an engine sends it: nothing else is written.
pub fn engine_archive(bytes: &[u8]) {
    alone_in_a_folder(|into| {
        let _ = data_folder::unpack(bytes, "data", into, &allowance());
    });
}

/// That of an environment with two windows.
fn allowance() -> Allowance {
    Allowance::of(&EnvironmentRequest {
        environment: "e".to_owned(),
        run: "r".to_owned(),
        run_directory: "/runs/r".into(),
        scenario: "s".to_owned(),
        host: "here".to_owned(),
        settings: Settings::default(),
        windows: vec![1, 2],
        files: None,
    })
}

/// Unpacks into a folder beside which nothing appears, and in which no link is.
fn alone_in_a_folder(unpack: impl FnOnce(&Path)) {
    let Ok(folder) = tempfile::tempdir_in("/dev/shm") else {
        return;
    };
    let into = folder.path().join("into");
    let made = std::fs::create_dir(&into);
    unpack(&into);
    let beside = std::fs::read_dir(folder.path()).map_or(0, Iterator::count);
    assert!(made.is_ok() && beside == 1, "something is beside the folder");
    let mut folders = vec![into];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let kind = entry.file_type();
            assert!(kind.as_ref().is_ok_and(|kind| kind.is_dir() || kind.is_file()));
            if kind.is_ok_and(|kind| kind.is_dir()) {
                folders.push(entry.path());
            }
        }
    }
}

/// What `ssh -G` prints.
pub fn ssh_configuration(bytes: &[u8]) {
    let client = SshClient::of_this_user();
    let _ = configuration::Answer::read(&String::from_utf8_lossy(bytes), &client);
}

/// What the tools of Slurm print: its jobs, nodes and partitions, and what it says of a job.
pub fn slurm(bytes: &[u8]) {
    let printed = String::from_utf8_lossy(bytes);
    for job in printed.lines().filter_map(answers::job) {
        assert!(job.id.chars().all(|c| c.is_ascii_digit()), "{job:?}");
        if let Some(owner) = &job.owner {
            assert_eq!(JobOwner::of_comment(&owner.comment()).as_ref(), Some(owner));
        }
        let _ = job.standing();
    }
    for is_named in [false, true] {
        let (in_service, out_of_service) = answers::nodes(&printed, is_named);
        let nodes = in_service
            .iter()
            .chain(out_of_service.iter().map(|(node, _)| node));
        for node in nodes {
            assert!(!node.contains(char::is_control), "{node:?}");
        }
        let _ = answers::longest_minutes(&printed, is_named);
    }
    let _ = (answers::forecast(&printed), answers::job_number(&printed));
    let _ = (
        answers::does_not_fit(&printed),
        answers::is_passing(&printed),
        answers::is_gone(&printed),
    );
    let _ = answers::hint(&printed);
    assert!(!answers::first_words(&printed).contains(char::is_control));
}

/// What Vagrant prints.
pub fn vagrant(bytes: &[u8]) {
    let printed = String::from_utf8_lossy(bytes);
    for line in output::read(&printed) {
        let _ = output::value(std::slice::from_ref(&line), &line.kind);
    }
    let _ = output::failure(&printed, &printed);
    let _ = ssh_config::read(&printed);
}
