//! What somebody else's files cannot make `matrix` do.

use std::{
    net::TcpListener,
    os::unix::net::UnixListener,
    path::{Path, PathBuf},
};

use tests::{Workplace, without_checksums};

/// A matrix of a host that is reached over SSH, and of containers.
fn matrix(port: u16) -> String {
    format!(
        "hosts:\n  lab:\n    hardware: x86_64\n    os: debian-12\n    connect: {{ssh: somebody@127.0.0.1:{port}}}\n\
         matrix: {{virtualization: [docker, native], network.backend: [kernel, userspace]}}\n\
         providers: {{docker: {{image: \"somebody/image:1\"}}}}\n"
    )
}

#[test]
fn check_reads_a_matrix_file_and_reaches_no_host_and_no_engine() {
    let host = TcpListener::bind("127.0.0.1:0").unwrap();
    host.set_nonblocking(true).unwrap();
    let workplace = Workplace::new();
    let socket = workplace.path().join("engine");
    let engine = UnixListener::bind(&socket).unwrap();
    engine.set_nonblocking(true).unwrap();
    workplace.write("m.yaml", matrix(host.local_addr().unwrap().port()));
    let check = |arguments: &[&str]| {
        let mut command = workplace.matrix(["check", "m.yaml"]);
        command
            .args(arguments)
            .env("DOCKER_HOST", format!("unix://{}", socket.display()));
        command.output().unwrap()
    };

    let checked = check(&[]);
    let told = String::from_utf8(checked.stdout).unwrap();
    assert!(checked.status.success(), "{told}");
    assert_eq!(told, "m.yaml: right, 4 scenarios\n");
    assert!(
        checked.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&checked.stderr)
    );
    assert!(host.accept().is_err(), "the host was reached");
    assert!(engine.accept().is_err(), "the engine was reached");
}

#[test]
fn check_asks_the_hosts_where_that_is_wished() {
    let workplace = Workplace::new();
    // Nobody listens there any more.
    let port = {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.local_addr().unwrap().port()
    };
    workplace.write("m.yaml", matrix(port));
    let checked = workplace.run(&["check", "m.yaml", "--hosts"]);
    assert_eq!(checked.code, Some(0), "{checked:?}");
    assert!(checked.err.contains("host `lab` cannot be asked"), "{checked:?}");
}

/// A run of one window that has ended, and its directory.
fn played() -> (Workplace, PathBuf) {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        "matrix: {virtualization: [fake]}\nworkload: {windows: 1, window: 8s, period: 1s}\n",
    );
    assert_eq!(workplace.run(&["run", "m.yaml"]).code, Some(0));
    let directory = workplace.run_directory();
    (workplace, directory)
}

#[test]
fn what_a_run_directory_says_does_nothing_to_a_terminal_or_a_runner() {
    let (workplace, directory) = played();
    without_checksums(&directory);
    change(&directory.join("plan.json"), |plan| {
        let scenario = &mut plan["scenarios"][0];
        scenario["feasible"] = false.into();
        scenario["reason"] = "\u{1b}]0;mine\u{7}\n::set-output name=a::b\n##[error]\u{202e}".into();
    });
    let path = directory.to_str().unwrap();
    for command in ["status", "report"] {
        let ran = workplace.run(&[command, path]);
        let said = format!("{}{}", ran.out, ran.err);
        assert!(said.contains("set-output"), "{said}");
        let unseen = |it: char| (it.is_control() && it != '\n') || it == '\u{202e}';
        assert!(!said.contains(unseen), "{said:?}");
        assert!(!said.contains("##["), "{said}");
        let commands = said.lines().filter(|line| line.trim_start().starts_with("::"));
        assert_eq!(commands.count(), 0, "{said}");
    }
}

#[test]
fn status_calls_no_program_that_a_run_directory_names() {
    let (workplace, run) = played();
    let bin = workplace.path().join("bin");
    std::fs::create_dir(&bin).unwrap();
    let squeue = bin.join("squeue");
    std::fs::write(&squeue, format!("#!/bin/sh\ntouch {}/called\n", bin.display())).unwrap();
    std::fs::set_permissions(&squeue, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    without_checksums(&run);
    change(&run.join("manifest.json"), |manifest| {
        manifest["hosts"][0]["connect"] = serde_json::json!({"slurm": {"bin": bin}});
    });
    let run = run.to_str().unwrap();
    let asked = workplace.run(&["status", run, "--hosts"]);
    assert_eq!(asked.code, Some(2), "{asked:?}");
    assert!(
        asked
            .err
            .contains("the list of runs that were begun here does not have it"),
        "{asked:?}"
    );
    assert_eq!(workplace.run(&["status", run]).code, Some(0));
    assert!(!bin.join("called").exists());
}

#[test]
fn resume_refuses_names_that_are_paths() {
    let (workplace, directory) = played();
    without_checksums(&directory);
    let outside = workplace.path().join("outside");
    std::fs::create_dir(&outside).unwrap();
    let name = outside.to_str().unwrap().to_owned();
    for (file, field) in [("manifest.json", "/run"), ("plan.json", "/scenarios/0/slug")] {
        let path = directory.join(file);
        let before = std::fs::read(&path).unwrap();
        change(&path, |record| {
            *record.pointer_mut(field).unwrap() = name.clone().into()
        });
        let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
        assert_eq!(resumed.code, Some(2), "{resumed:?}");
        assert!(resumed.err.contains("is no name"), "{resumed:?}");
        std::fs::write(&path, before).unwrap();
    }
    let journal = directory.join("events.jsonl");
    let text = std::fs::read_to_string(&journal).unwrap();
    let environment = text
        .split("\"environment\":\"")
        .nth(1)
        .unwrap()
        .split('"')
        .next()
        .unwrap();
    std::fs::write(&journal, text.replace(environment, &name)).unwrap();
    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    assert_eq!(resumed.code, Some(2), "{resumed:?}");
    assert_eq!(std::fs::read_dir(&outside).unwrap().count(), 0);
}

fn change(path: &Path, change: impl FnOnce(&mut serde_json::Value)) {
    let mut record = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    change(&mut record);
    std::fs::write(path, record.to_string()).unwrap();
}
