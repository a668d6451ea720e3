//! Runs without the names of people and machines.

use std::{
    fs,
    path::{Path, PathBuf},
};

use captures::traffic::Traffic;
use record::run_directory::{Event, Outcome, Place, Resource, RunDirectory};
use reports::{
    analyse, load,
    redaction::{Redaction, copy},
};
use serde_json::{Value, json};

use crate::synthetic::{Scenario, Synthetic, journal, sha256};

const MEASURED: &str = "x86_64-debian-native";
const ERRORED: &str = "x86_64-debian-docker";

/// All that must not be found again.
const SECRETS: [&str; 15] = [
    "jane",
    "lab-mac",
    "lab.example.org",
    "example",
    "node17",
    "cluster.uni.edu",
    "203.0.113.9",
    "/srv/keys",
    "smith",
    "kaputnik",
    "root=UUID",
    "acme-robotics",
    "zeus31",
    "grant-4711",
    "/srv/novak",
];

/// A run that has names wherever a run may have them.
fn with_names() -> Synthetic {
    let reason = "cannot reach Jane@LAB-MAC.lab.example.org:2222 (203.0.113.9:2222): key /srv/keys/mac of /home/jane, told in /srv/novak/state/log";
    let scenarios = [
        Scenario::measured(MEASURED, &[0.010, 0.011, 0.010, 0.011]),
        Scenario::ended(ERRORED, Outcome::Errored, reason),
    ];
    let synthetic = Synthetic::new(&scenarios);
    let directory = &synthetic.directory;
    edit(&directory.manifest().path(), |manifest| {
        manifest["matrix_file"] = json!("/home/jane/acme-robotics/matrix.yaml");
        let matrix = "# by Dr Kaputnik\nhosts: {lab-mac: {}}\n";
        manifest["state_directory"] = json!("/srv/novak/state");
        manifest["matrix_text"] = json!(matrix);
        manifest["profile"] = json!("lab-mac");
        manifest["invocation"] = json!(["/home/jane/matrix", "run", "--profile", "kaputnik"]);
        manifest["matrix_sha256"] = json!(sha256(matrix));
        manifest["hosts"] = json!([
            {"name": "local", "connect": "local", "hardware": "x86_64", "os": "debian", "kernel": "6.1"},
            {
                "name": "lab-mac",
                "connect": {
                    "ssh": "jane@lab-mac.lab.example.org:2222", "identity": "/srv/keys/mac", "jump": "smith@node17",
                },
                "hardware": "arm64", "os": "osx", "kernel": "23",
            },
        ]);
    });
    edit(&directory.plan().path(), |plan| {
        plan["scenarios"][1]["host"] = json!("lab-mac")
    });
    edit(&directory.environment(MEASURED).path(), |environment| {
        environment["facts"] = json!({"machine": {"options": {"storage": "/Users/smith/disks"}}, "box": {"sha256": "aa"},
                "job": "17", "node": "zeus31", "job_wishes": ["--account=grant-4711", "--exclusive"]});
        environment["platform"] = json!({
            "hostname": "node17.cluster.uni.edu",
            "kernel": "6.1",
            "kernel_command_line": "BOOT_IMAGE=/vmlinuz root=UUID=1234",
            "changes": [{"what": "kernel_command_line", "before": "root=UUID=1234", "after": null}],
        });
    });
    fs::write(
        directory.scenario(MEASURED).path().join("network.txt"),
        "$ ip link # on node17, by jane\n",
    )
    .unwrap();
    synthetic.edit_window(MEASURED, 2, |record| {
        record.reasons = vec!["Others on node17 used 95 %.".to_owned()];
        record.notices.first = vec!["h1: 203.0.113.9 asked for /talker".to_owned()];
    });
    let mut events = journal(&scenarios);
    events.insert(
        1,
        Event::HostBusy {
            host: "lab-mac".to_owned(),
            holder: "smith on node17, process 7".to_owned(),
        },
    );
    if let Some(Event::EnvironmentCreating { resources, .. }) = events.get_mut(3) {
        resources.push(Resource {
            host: "lab-mac".to_owned(),
            kind: "directory".to_owned(),
            name: "/home/jane/state".to_owned(),
        });
    }
    synthetic.write_journal(&events);
    synthetic
}

fn edit(path: &Path, edit: impl FnOnce(&mut Value)) {
    let mut value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    edit(&mut value);
    fs::write(path, serde_json::to_vec(&value).unwrap()).unwrap();
}

fn redaction(run: &Synthetic) -> Redaction {
    Redaction::of(
        std::slice::from_ref(&run.directory),
        &["acme-robotics".to_owned()],
    )
    .unwrap()
}

fn all_files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| {
            if path.is_dir() {
                all_files(&path)
            } else {
                vec![path]
            }
        })
        .collect()
}

/// What of the secrets is in the files of a folder or in their names, in capitals or not.
fn told_by(folder: &Path) -> Vec<String> {
    let mut told = Vec::new();
    for file in all_files(folder) {
        let name = file.strip_prefix(folder).unwrap().display().to_string();
        let text = String::from_utf8_lossy(&fs::read(&file).unwrap()).to_lowercase();
        for secret in SECRETS.map(str::to_lowercase) {
            if text.contains(&secret) || name.to_lowercase().contains(&secret) {
                told.push(format!("{secret} in {name}"));
            }
        }
    }
    told
}

#[test]
fn a_redacted_copy_has_no_names_and_what_was_measured_byte_for_byte() {
    let run = with_names();
    assert!(
        told_by(run.directory.path()).len() > SECRETS.len(),
        "the names are there to be found"
    );
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("copy");
    copy(&run.directory, &to, &redaction(&run)).unwrap();
    assert_eq!(told_by(&to), Vec::<String>::new());

    let there = RunDirectory::new(&to);
    for window in 1..=4 {
        let [log, copied] =
            [&run.directory, &there].map(|it| it.window(MEASURED, window).join("control.csv").path());
        assert_eq!(fs::read(log).unwrap(), fs::read(copied).unwrap());
    }
    // Reading verifies the checksums.
    let (original, copied) = (load(run.directory.path()).unwrap(), load(&to).unwrap());
    let counts = |run: &reports::Run| analyse(run, Traffic::default(), &run.manifest.report).tallies;
    assert_eq!(counts(&copied), counts(&original));
    assert!(copied.manifest.redacted);
}

#[test]
fn a_copy_is_never_made_over_something() {
    let run = with_names();
    let error = copy(&run.directory, run.directory.path(), &redaction(&run)).unwrap_err();
    assert!(error.hint().contains("--output"), "{error}");
}

#[test]
fn no_file_of_a_redacted_report_has_a_name() {
    let run = with_names();
    let folder = tempfile::tempdir().unwrap();
    let redacted = load(run.directory.path())
        .unwrap()
        .redacted(&redaction(&run))
        .unwrap();
    let redacted = reports::Run {
        report_folder: Place::root(folder.path()),
        ..redacted
    };
    let report = analyse(&redacted, Traffic::default(), &redacted.manifest.report);
    reports::write(&redacted, &report, reports::Layout::default()).unwrap();
    assert_eq!(told_by(folder.path()), Vec::<String>::new());
    assert!(
        report
            .present()
            .remarks
            .iter()
            .any(|remark| remark.starts_with("Redacted:")),
        "{:?}",
        report.present().remarks
    );
}

#[test]
fn a_name_has_one_other_name_in_all_runs_that_are_redacted_together() {
    let (first, second) = (with_names(), with_names());
    edit(&second.directory.manifest().path(), |manifest| {
        manifest["hosts"][1]["name"] = json!("attic")
    });
    let both = Redaction::of(&[first.directory.clone(), second.directory.clone()], &[]).unwrap();
    let names = both.names();
    assert_eq!(names["attic"], "host-1");
    assert_eq!(names["lab-mac"], "host-2");
    assert_eq!(both.text("attic, lab-mac, attic"), "host-1, host-2, host-1");
    let again = Redaction::of(&[second.directory.clone(), first.directory.clone()], &[]).unwrap();
    assert_eq!(again, both, "whatever their order");
}

#[test]
fn a_name_goes_as_a_word_and_stays_as_a_part_of_one() {
    let run = with_names();
    let text = redaction(&run).text("JANE's janet: /home/jane/x lab-mac-1 203.0.113.99");
    assert_eq!(text, "user-1's janet: /home/user-1/x host-1-1 203.0.113.99");
}

#[test]
fn a_host_that_is_called_as_an_axis_value_keeps_its_name() {
    let run = with_names();
    edit(&run.directory.environment(MEASURED).path(), |environment| {
        environment["platform"]["hostname"] = json!("debian-docker");
    });
    let redaction = redaction(&run);
    assert_eq!(Vec::from_iter(redaction.kept()), ["debian-docker"]);
    let redacted = load(run.directory.path()).unwrap().redacted(&redaction).unwrap();
    assert_eq!(redacted.scenarios[1].planned.slug, ERRORED);
}

#[test]
fn the_experiments_own_hosts_keep_their_names() {
    let run = with_names();
    edit(&run.directory.environment(MEASURED).path(), |environment| {
        environment["platform"]["capture"] = json!({"host": "sta1"});
    });
    assert_eq!(redaction(&run).text("lab-mac, sta1"), "host-1, sta1");
}

#[test]
fn what_several_runs_make_together_can_be_redacted_too() {
    let run = with_names();
    let redaction = redaction(&run);
    let mut run = load(run.directory.path()).unwrap();
    run.manifest.run = "20261123-035357-2d7d + 20261123-042249-3c1a".to_owned();
    let redacted = run.clone().redacted(&redaction).unwrap();
    assert_eq!(redacted.manifest.run, run.manifest.run);
    assert!(redacted.manifest.redacted);
}

#[test]
fn who_held_a_host_meanwhile_is_not_in_a_copy() {
    let busy = serde_json::json!({
        "event": "host-busy", "host": "desk", "holder": "process 7 on attic, for /srv/lovelace/runs/1",
    });
    let copied = Redaction::default().document(busy);
    assert_eq!(copied["holder"], "another run");
}
