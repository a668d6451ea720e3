//! What a host promises of its programs and sockets, tried on this machine.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{ffi::OsString, time::Duration};

use orchestrator::{
    host::{Exit, Here, Host, HostError, Listener, Program, output},
    state_directory::StateDirectory,
    workload_binary,
};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

/// Only ends a wait for what never comes.
const TIMEOUT: Duration = Duration::from_secs(60);

fn here() -> (Here, TempDir) {
    let state = tempfile::tempdir().unwrap();
    (Here::new("here", StateDirectory::new(state.path())), state)
}

fn shell(script: &str) -> Program {
    Program::new("sh", ["-c", script])
}

async fn run(program: &Program, input: &[u8]) -> (Exit, String) {
    let (here, _state) = here();
    let (exit, answer) = output(&here, program, input, TIMEOUT).await.unwrap();
    (exit, String::from_utf8(answer).unwrap())
}

#[tokio::test]
async fn a_program_reads_to_the_end_of_its_input_answers_and_says_how_it_ended() {
    let (exit, answer) = run(&shell("cat; echo sorry >&2; exit 3"), b"question\n").await;
    assert_eq!(answer, "question\n");
    assert_eq!((exit.code, exit.last_words.as_str()), (Some(3), "sorry\n"));
    assert!(!exit.success());
}

#[tokio::test]
async fn arguments_are_handed_on_as_they_are() {
    let nasty = ["", "a b", "'", "\"", "$HOME", "`id`", "\\", "*", "-n", "\n"];
    let arguments = ["-c", "printf '%s|' \"$@\"", "sh"].into_iter().chain(nasty);
    let (_, answer) = run(&Program::new("sh", arguments), b"").await;
    assert_eq!(answer, nasty.map(|word| format!("{word}|")).concat());
}

#[tokio::test]
async fn of_the_surroundings_a_program_gets_path_and_home_only() {
    let (_, answer) = run(&Program::new("env", Vec::<OsString>::new()), b"").await;
    assert!(!answer.is_empty());
    for line in answer.lines() {
        let name = line.split('=').next().unwrap();
        assert!(["PATH", "HOME"].contains(&name), "{line}");
    }
    assert_eq!(
        run(&Program::new("pwd", Vec::<OsString>::new()), b"").await.1,
        "/\n"
    );
}

#[tokio::test]
async fn a_program_that_is_not_there_ends_as_a_shell_says_it() {
    let (exit, answer) = run(&Program::new("/no/such/program", ["x"]), b"input").await;
    assert_eq!((exit.code, answer.as_str()), (Some(127), ""));
    let (exit, _) = run(&Program::new("/etc/passwd", ["x"]), b"").await;
    assert_eq!(exit.code, Some(126));
}

#[tokio::test]
async fn a_program_that_a_signal_ended_has_no_code() {
    let (exit, _) = run(&shell("kill -9 $$"), b"").await;
    assert_eq!(exit.code, None);
}

#[tokio::test]
async fn what_a_program_does_not_read_is_no_error() {
    let (exit, answer) = run(&shell("echo no"), &vec![0; 4 << 20]).await;
    assert_eq!((exit.code, answer.as_str()), (Some(0), "no\n"));
}

#[tokio::test]
async fn of_a_long_complaint_the_end_is_kept() {
    let (exit, _) = run(&shell("head -c 1000000 /dev/zero >&2; echo the end >&2"), b"").await;
    assert_eq!(exit.last_words.len(), 64 << 10);
    assert!(exit.last_words.ends_with("the end\n"));
}

#[tokio::test]
async fn what_a_program_started_and_left_does_not_hold_up_its_end() {
    let (exit, _) = run(
        &shell("echo words >&2; sleep 1000 >/dev/null </dev/null & echo $! >&2"),
        b"",
    )
    .await;
    let (words, pid) = exit.last_words.trim().split_once('\n').unwrap();
    let pid = rustix::process::Pid::from_raw(pid.parse().unwrap()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::KILL).unwrap();
    assert_eq!((exit.code, words), (Some(0), "words"));
}

#[tokio::test]
async fn a_program_whose_stream_is_dropped_is_told_so() {
    let (here, _state) = here();
    let running = here.start(&shell("echo there; cat; exit 7")).await.unwrap();
    let mut stream = running.stream;
    let mut said = [0; 6];
    stream.read_exact(&mut said).await.unwrap();
    assert_eq!(&said, b"there\n");
    drop(stream);
    let exit = tokio::time::timeout(TIMEOUT, running.end.wait())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(exit.code, Some(7));
}

#[tokio::test]
async fn a_call_that_takes_too_long_or_says_too_much_is_given_up() {
    let (here, _state) = here();
    let waits = output(
        &here,
        &shell("cat >/dev/null; exec sleep 100"),
        b"",
        Duration::from_millis(200),
    )
    .await;
    assert!(matches!(waits, Err(HostError::TimedOut { .. })), "{waits:?}");
    let talks = output(&here, &shell("cat /dev/zero"), b"", TIMEOUT).await;
    assert!(matches!(talks, Err(HostError::Refused { .. })));
}

#[tokio::test]
async fn sockets_are_reached_by_path_and_by_port() {
    let (here, state) = here();
    let path = state.path().join("socket");
    let unix = tokio::net::UnixListener::bind(&path).unwrap();
    let tcp = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = tcp.local_addr().unwrap().port();
    tokio::spawn(async move {
        let (mut peer, _) = unix.accept().await.unwrap();
        peer.write_all(b"unix").await.unwrap();
        drop(peer);
        let (mut peer, _) = tcp.accept().await.unwrap();
        peer.write_all(b"tcp").await.unwrap();
    });
    let host = "localhost".to_owned();
    for (listener, word) in [
        (Listener::Unix(path), "unix"),
        (Listener::Tcp { host, port }, "tcp"),
    ] {
        let mut said = String::new();
        here.connect(&listener)
            .await
            .unwrap()
            .read_to_string(&mut said)
            .await
            .unwrap();
        assert_eq!(said, word);
    }
    let nobody = here
        .connect(&Listener::Unix(state.path().join("nobody")))
        .await
        .unwrap_err();
    assert!(matches!(nobody, HostError::Refused { .. }), "{nobody}");
}

#[tokio::test]
async fn the_workload_is_put_there_and_runs() {
    let (here, state) = here();
    let deployed = here.deploy().await.unwrap();
    assert_eq!(here.deploy().await.unwrap(), deployed);
    assert!(deployed.program.starts_with(state.path()) && deployed.environments.starts_with(state.path()));
    assert_eq!(deployed.sha256, workload_binary::sha256());
    let (exit, version) = output(
        &here,
        &Program::new(deployed.program, ["--version"]),
        b"",
        TIMEOUT,
    )
    .await
    .unwrap();
    assert!(exit.success() && version.starts_with(b"workload"), "{exit:?}");
}

#[tokio::test]
async fn a_state_directory_that_cannot_be_written_is_named() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let here = Here::new("here", StateDirectory::new(file.path()));
    let error = here.deploy().await.unwrap_err();
    let source = std::error::Error::source(&error).unwrap().to_string();
    assert!(source.contains(file.path().to_str().unwrap()), "{source}");
}
