//! Hosts over SSH, against a real sshd.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{
    fs,
    net::TcpListener,
    os::unix::{fs::MetadataExt as _, net::UnixListener},
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, mpsc},
    thread,
    time::Duration,
};

use orchestrator::{
    host::{
        Exit, Forward, Host, HostError, Listener, Program, output,
        ssh::{SshClient, SshHost, Trust},
    },
    workload_binary,
};
use record::connection::Ssh;
use sha2::{Digest as _, Sha256};
use tests::sshd::{Agent, Sshd, make_key, user, wait_until};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::UnixStream,
};

/// Only ends a wait for what never comes.
const TIMEOUT: Duration = Duration::from_secs(120);

/// As the matrix file of a careful user has it.
fn connection(sshd: &Sshd) -> Ssh {
    Ssh {
        address: sshd.address().parse().unwrap(),
        identity: Some(sshd.identity()),
        jump: None,
        known_hosts: Some(sshd.known_hosts()),
    }
}

/// A user without keys, agent and configuration.
fn client(sshd: &Sshd) -> SshClient {
    let configuration = sshd.folder().join("ssh_config");
    if !configuration.exists() {
        fs::write(&configuration, "IdentityFile none\n").unwrap();
    }
    SshClient {
        home: Some(sshd.folder().to_owned()),
        configuration: Some(configuration),
        ..SshClient::default()
    }
}

fn host(sshd: &Sshd) -> SshHost {
    host_by(sshd, connection(sshd))
}

fn host_by(sshd: &Sshd, connection: Ssh) -> SshHost {
    SshHost::new("lab", connection, Trust::KnownHosts, client(sshd))
}

/// Its output and its end, with this input.
async fn run(host: &SshHost, program: &Program, input: &[u8]) -> (Vec<u8>, Exit) {
    let (exit, answer) = output(host, program, input, TIMEOUT).await.unwrap();
    (answer, exit)
}

async fn exchange(stream: UnixStream, input: &[u8]) -> Vec<u8> {
    let (mut from, mut into) = stream.into_split();
    let mut output = Vec::new();
    let write = async {
        into.write_all(input).await.unwrap();
        into.shutdown().await.unwrap();
    };
    let (read, ()) = tokio::join!(from.read_to_end(&mut output), write);
    read.unwrap();
    output
}

fn shell(script: &str) -> Program {
    Program::new("sh", ["-c", script])
}

async fn refusal(host: &SshHost) -> HostError {
    match host.start(&shell("true")).await {
        Ok(_) => panic!("it was let in"),
        Err(error) => error,
    }
}

/// All that a user reads of an error.
fn in_words(error: &HostError) -> String {
    let mut words = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        words.push_str(": ");
        words.push_str(&error.to_string());
        cause = error.source();
    }
    match error.hint() {
        Some(hint) => format!("{words}\nhint: {hint}"),
        None => words,
    }
}

#[tokio::test]
async fn a_program_has_its_streams_and_its_exit_code() {
    let sshd = Sshd::start();
    let program = shell("cat; echo bye >&2; exit 7");
    let (output, exit) = run(&host(&sshd), &program, b"hello\n").await;
    assert_eq!(output, b"hello\n");
    let last_words = "bye\n".to_owned();
    let code = Some(7);
    assert_eq!(exit, Exit { code, last_words });
}

#[tokio::test]
async fn a_program_that_a_signal_ends_has_no_exit_code() {
    let sshd = Sshd::start();
    let (_, exit) = run(&host(&sshd), &shell("kill -KILL $$"), b"").await;
    assert_eq!(exit.code, None);
}

#[tokio::test]
async fn a_program_that_is_not_there_ends_as_a_shell_says_it() {
    let sshd = Sshd::start();
    let (_, exit) = run(&host(&sshd), &Program::new("no-such-program", [""; 0]), b"").await;
    assert_eq!(exit.code, Some(127));
    assert!(exit.last_words.contains("no-such-program"), "{}", exit.last_words);
}

#[tokio::test]
async fn a_program_has_nothing_of_the_surroundings_but_path_and_home() {
    let sshd = Sshd::start();
    let (output, _) = run(&host(&sshd), &Program::new("env", [""; 0]), b"").await;
    let output = String::from_utf8(output).unwrap();
    let mut names: Vec<_> = output.lines().filter_map(|line| line.split_once('=')).collect();
    names.sort_unstable();
    let names: Vec<_> = names.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["HOME", "PATH"]);
}

#[tokio::test]
async fn arguments_arrive_as_they_are() {
    let nasty = [
        "",
        "two  words",
        "it's",
        "$HOME `id` $(id)",
        "a;b|c>d&",
        "\n\t\\",
        "-n",
        "*",
        "plaça 🦀",
    ];
    let sshd = Sshd::start();
    let program = Program::new("printf", [r"%s\0"].iter().chain(&nasty));
    let (output, _) = run(&host(&sshd), &program, b"").await;
    let expected: String = nasty.iter().map(|word| format!("{word}\0")).collect();
    assert_eq!(String::from_utf8(output).unwrap(), expected);
}

#[tokio::test]
async fn much_goes_both_ways_at_once_and_nothing_is_lost() {
    let sshd = Sshd::start();
    // 50 MB that do not repeat.
    let mut state = 1_u64;
    let data: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 32).to_le_bytes()
    })
    .take(50_000_000 / 8)
    .flatten()
    .collect();
    let running = host(&sshd).start(&Program::new("cat", [""; 0])).await.unwrap();
    let output = exchange(running.stream, &data).await;
    let exit = running.end.wait().await.unwrap();
    assert_eq!((output.len(), exit.code), (data.len(), Some(0)));
    assert_eq!(Sha256::digest(&output), Sha256::digest(&data));
}

#[tokio::test]
async fn the_end_of_standard_error_is_kept_however_much_there_is() {
    let sshd = Sshd::start();
    let script = "head -c 1000000 /dev/zero | tr '\\0' x >&2; echo the end >&2";
    let (_, exit) = run(&host(&sshd), &shell(script), b"").await;
    assert_eq!(exit.last_words.len(), 64 << 10);
    assert!(exit.last_words.ends_with("xthe end\n"));
}

#[tokio::test]
async fn a_program_that_closes_its_output_early_is_still_waited_for() {
    let sshd = Sshd::start();
    let running = host(&sshd)
        // SSH has one end for both of a program's outputs.
        .start(&shell("exec >&- 2>&-; read line; exit 3"))
        .await
        .unwrap();
    let (mut from, mut into) = running.stream.into_split();
    let mut output = Vec::new();
    from.read_to_end(&mut output).await.unwrap();
    into.write_all(b"go on\n").await.unwrap();
    drop((from, into));
    assert_eq!(running.end.wait().await.unwrap().code, Some(3));
}

#[tokio::test]
async fn a_program_ends_when_its_stream_is_dropped() {
    let sshd = Sshd::start();
    let host = host(&sshd);
    let mut running = host.start(&shell("echo $$; exec yes")).await.unwrap();
    let mut pid = Vec::new();
    while !pid.ends_with(b"\n") {
        pid.push(running.stream.read_u8().await.unwrap());
    }
    let process = Path::new("/proc").join(String::from_utf8(pid).unwrap().trim());
    drop(running);
    tokio::task::spawn_blocking(move || wait_until("it ends", || !process.exists()))
        .await
        .unwrap();
}

/// The processor time of each of this process's threads of that name, in ticks of 10 ms.
fn ticks(name: &str) -> Vec<u64> {
    let threads = fs::read_dir("/proc/self/task").unwrap();
    threads
        // Others end meanwhile.
        .filter_map(|thread| fs::read_to_string(thread.unwrap().path().join("stat")).ok())
        .filter(|stat| stat.contains(&format!("({name})")))
        .map(|stat| {
            let (_, after) = stat.rsplit_once(')').unwrap();
            let fields: Vec<_> = after.split_whitespace().collect();
            fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()
        })
        .collect()
}

#[tokio::test]
async fn streams_that_wait_cost_no_processor_time() {
    let sshd = Sshd::start();
    let waiting = SshHost::new("waiting", connection(&sshd), Trust::KnownHosts, client(&sshd));
    let silent = waiting.start(&shell("read line")).await.unwrap();
    let unread = waiting.start(&Program::new("yes", [""; 0])).await.unwrap();
    let mut unreading = waiting
        .start(&shell("while sleep 1; do echo; done"))
        .await
        .unwrap();
    let clock = host(&sshd);
    let three_seconds = shell("sleep 3");
    // Whatever fits into the buffers on the way gets there first.
    let fill = async { unreading.stream.write_all(&vec![0; 10_000_000]).await };
    tokio::select! {
        written = fill => panic!("who reads this? {written:?}"),
        _ = run(&clock, &three_seconds, b"") => {}
    }
    let before = ticks("ssh-waiting");
    run(&clock, &three_seconds, b"").await;
    let after = ticks("ssh-waiting");
    assert_eq!((before.len(), after.len()), (3, 3));
    let used = after.iter().sum::<u64>() - before.iter().sum::<u64>();
    // A thread that does not sleep has some 300 of them.
    assert!(used < 30, "{used} ticks");
    drop((silent, unread, unreading));
}

#[tokio::test]
async fn who_comes_next_need_not_log_in_again() {
    let sshd = Sshd::start();
    let host = host(&sshd);
    for _ in 0..3 {
        run(&host, &shell("true"), b"").await;
    }
    assert_eq!(sshd.logins(), 1);
    // Two at once need two sessions.
    let (one, two) = (shell("read line"), shell("read line"));
    let (one, two) = (host.start(&one).await.unwrap(), host.start(&two).await.unwrap());
    assert_eq!(sshd.logins(), 2);
    drop((one, two));
}

#[tokio::test]
async fn a_key_that_nobody_knows_is_refused_with_what_makes_it_known() {
    let sshd = Sshd::start();
    fs::write(sshd.known_hosts(), "").unwrap();
    let error = refusal(&host(&sshd)).await;
    assert!(matches!(error, HostError::Unreachable { .. }), "{error:?}");
    let said = in_words(&error);
    let printed = Command::new("ssh-keygen")
        .arg("-lf")
        .arg(sshd.folder().join("host_ed25519.pub"))
        .output()
        .unwrap();
    let printed = String::from_utf8(printed.stdout).unwrap();
    let fingerprint = printed.split(' ').nth(1).unwrap();
    assert!(
        said.contains(&format!("is not known: it showed ssh-ed25519 {fingerprint}")),
        "{said}"
    );
    let file = sshd.known_hosts();
    let command = format!("ssh-keyscan -p {} 127.0.0.1 >> {}", sshd.port(), file.display());
    assert!(said.contains(&command), "{said}");

    let added = Command::new("sh").args(["-c", &command]).status().unwrap();
    assert!(added.success());
    run(&host(&sshd), &shell("true"), b"").await;
}

#[tokio::test]
async fn a_key_that_has_changed_is_refused() {
    let mut sshd = Sshd::start();
    let host = host(&sshd);
    run(&host, &shell("true"), b"").await;
    sshd.set_up_anew();
    let error = refusal(&host).await;
    let said = in_words(&error);
    assert!(said.contains("is not the one that is known"), "{said}");
    assert!(
        said.contains(&format!("-R '[127.0.0.1]:{}'", sshd.port())),
        "{said}"
    );
    assert_eq!(sshd.logins(), 1);
}

#[rstest::rstest]
#[case::of_that_name(None)]
#[case::of_any_name(Some("*"))]
#[tokio::test]
async fn a_key_that_was_revoked_is_refused_though_it_is_known(#[case] names: Option<&str>) {
    let sshd = Sshd::start();
    let line = sshd.known_hosts_line("host_ed25519");
    let (name, key) = line.split_once(' ').unwrap();
    let revoked = format!("@revoked {} {key}", names.unwrap_or(name));
    fs::write(sshd.known_hosts(), format!("{line}{revoked}")).unwrap();
    let said = in_words(&refusal(&host(&sshd)).await);
    assert!(said.contains("was revoked"), "{said}");
}

#[tokio::test]
async fn hashed_names_are_known() {
    let sshd = Sshd::start();
    let hashed = Command::new("ssh-keygen")
        .args(["-q", "-H", "-f"])
        .arg(sshd.known_hosts())
        .output()
        .unwrap();
    assert!(hashed.status.success(), "{hashed:?}");
    assert!(fs::read_to_string(sshd.known_hosts()).unwrap().starts_with("|1|"));
    run(&host(&sshd), &shell("true"), b"").await;
}

#[tokio::test]
async fn a_host_that_is_known_by_its_other_key_is_asked_for_that_one() {
    let sshd = Sshd::start();
    fs::write(sshd.known_hosts(), sshd.known_hosts_line("host_rsa")).unwrap();
    run(&host(&sshd), &shell("true"), b"").await;
}

#[tokio::test]
async fn a_machine_that_we_made_is_held_to_the_key_that_it_showed_first() {
    let mut sshd = Sshd::start();
    let connection = Ssh {
        known_hosts: None,
        ..connection(&sshd)
    };
    let host = SshHost::new("vm", connection, Trust::MadeByUs, client(&sshd));
    run(&host, &shell("true"), b"").await;
    sshd.restart();
    run(&host, &shell("true"), b"").await;
    sshd.set_up_anew();
    let said = in_words(&refusal(&host).await);
    assert!(said.contains("is not the one that is known"), "{said}");
}

#[tokio::test]
async fn a_key_that_the_host_does_not_know_is_refused_by_it_and_named() {
    let sshd = Sshd::start();
    let stranger = sshd.folder().join("stranger");
    make_key(&stranger, "ed25519", "");
    let connection = Ssh {
        identity: Some(stranger.clone()),
        ..connection(&sshd)
    };
    let error = refusal(&host_by(&sshd, connection)).await;
    let said = in_words(&error);
    assert!(
        said.contains(&format!(
            "does not let `{}` in; tried {}",
            user(),
            stranger.display()
        )),
        "{said}"
    );
    assert!(said.contains("authorized_keys"), "{said}");
}

#[tokio::test]
async fn a_key_with_a_passphrase_is_for_the_agent() {
    let sshd = Sshd::start();
    let key = sshd.folder().join("locked");
    make_key(&key, "ed25519", "a secret");
    let connection = Ssh {
        identity: Some(key.clone()),
        ..connection(&sshd)
    };
    let said = in_words(&refusal(&host_by(&sshd, connection)).await);
    assert!(
        said.contains(&format!("run `ssh-add {}` first", key.display())),
        "{said}"
    );
}

#[tokio::test]
async fn an_agents_key_is_taken_before_any_file() {
    let sshd = Sshd::start();
    let other = sshd.folder().join("other");
    make_key(&other, "ecdsa", "");
    let agent = Agent::with(&[&other, &sshd.identity()]);
    let connection = Ssh {
        identity: None,
        ..connection(&sshd)
    };
    let client = SshClient {
        agent: Some(agent.socket()),
        ..client(&sshd)
    };
    let host = SshHost::new("lab", connection, Trust::KnownHosts, client);
    run(&host, &shell("true"), b"").await;
}

#[tokio::test]
async fn a_host_behind_another_is_reached_through_it() {
    let (gate, lab) = (Sshd::start(), Sshd::start());
    // The gate's key and file are what the user's configuration has.
    let configuration = format!(
        "Host 127.0.0.1\n  IdentityFile {}\n  UserKnownHostsFile {}\n",
        gate.identity().display(),
        gate.known_hosts().display()
    );
    fs::write(lab.folder().join("ssh_config"), configuration).unwrap();
    let connection = Ssh {
        jump: Some(gate.address().parse().unwrap()),
        ..connection(&lab)
    };
    let host = host_by(&lab, connection);
    let data = vec![7; 3_000_000];
    let (output, _) = run(&host, &Program::new("cat", [""; 0]), &data).await;
    assert_eq!(output.len(), data.len());
    assert_eq!((gate.logins(), lab.logins()), (1, 1));

    gate.cut();
    run(&host, &shell("true"), b"").await;
    assert_eq!((gate.logins(), lab.logins()), (2, 2));
}

#[tokio::test]
async fn key_and_known_hosts_of_the_matrix_file_serve_on_the_way_too() {
    let (gate, lab) = (Sshd::start(), Sshd::start());
    gate.authorize(&lab.identity());
    let both = fs::read_to_string(gate.known_hosts()).unwrap() + &lab.known_hosts_line("host_ed25519");
    fs::write(lab.known_hosts(), both).unwrap();
    let connection = Ssh {
        jump: Some(gate.address().parse().unwrap()),
        ..connection(&lab)
    };
    run(&host_by(&lab, connection), &shell("true"), b"").await;
    assert_eq!((gate.logins(), lab.logins()), (1, 1));
}

#[tokio::test]
async fn a_name_of_the_users_configuration_is_understood() {
    let sshd = Sshd::start();
    let configuration = format!(
        "Host lab\n  HostName 127.0.0.1\n  Port {}\n  User {}\n  IdentityFile ~/identity\n  UserKnownHostsFile {}\n",
        sshd.port(),
        user(),
        sshd.known_hosts().display()
    );
    fs::write(sshd.folder().join("ssh_config"), configuration).unwrap();
    let connection = Ssh {
        address: "lab".parse().unwrap(),
        identity: None,
        jump: None,
        known_hosts: None,
    };
    let (output, _) = run(&host_by(&sshd, connection), &shell("echo here"), b"").await;
    assert_eq!(output, b"here\n");
}

#[tokio::test]
async fn the_workload_is_sent_once_and_again_when_it_is_damaged() {
    let sshd = Sshd::start();
    let host = host(&sshd);
    let deployed = host.deploy().await.unwrap();
    let state = sshd.folder().join("state");
    assert_eq!(deployed.environments, state.join("environments"));
    assert_eq!(deployed.sha256, workload_binary::sha256());
    assert_eq!(fs::read(&deployed.program).unwrap(), workload_binary::bytes());
    let (output, _) = run(&host, &Program::new(&deployed.program, ["--version"]), b"").await;
    assert!(output.starts_with(b"workload "), "{output:?}");

    let file = |path: &PathBuf| fs::metadata(path).unwrap().ino();
    let first = file(&deployed.program);
    assert_eq!(host.deploy().await.unwrap(), deployed);
    assert_eq!(file(&deployed.program), first, "it was sent again");

    fs::write(state.join("half"), b"half").unwrap();
    fs::rename(state.join("half"), &deployed.program).unwrap();
    host.deploy().await.unwrap();
    assert_eq!(fs::read(&deployed.program).unwrap(), workload_binary::bytes());
    assert_eq!(fs::read_dir(state.join("bin")).unwrap().count(), 1);
}

#[tokio::test]
async fn a_workload_that_cannot_be_put_there_is_refused_in_the_hosts_words() {
    let sshd = Sshd::start();
    fs::write(sshd.folder().join("state"), "a file in its place").unwrap();
    let error = host(&sshd).deploy().await.unwrap_err();
    assert!(matches!(error, HostError::Refused { .. }), "{error:?}");
    let said = in_words(&error);
    assert!(said.contains("mkdir"), "{said}");
}

/// Answers what it was told, in capitals, once it was all told; to so many who come.
fn shout(mut stream: impl std::io::Read + std::io::Write) {
    let mut said = String::new();
    stream.read_to_string(&mut said).unwrap();
    stream.write_all(said.to_uppercase().as_bytes()).unwrap();
}

#[tokio::test]
async fn sockets_of_the_host_can_be_connected_to() {
    let sshd = Sshd::start();
    let host = host(&sshd);
    let path = sshd.folder().join("service");
    let unix = UnixListener::bind(&path).unwrap();
    let tcp = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = tcp.local_addr().unwrap().port();
    let services = [
        thread::spawn(move || shout(unix.accept().unwrap().0)),
        thread::spawn(move || shout(tcp.accept().unwrap().0)),
    ];
    let address = |port| Listener::Tcp {
        host: "localhost".to_owned(),
        port,
    };
    for listener in [Listener::Unix(path), address(port)] {
        let stream = host.connect(&listener).await.unwrap();
        assert_eq!(exchange(stream, b"hello").await, b"HELLO");
    }
    for service in services {
        service.join().unwrap();
    }
    let logins = sshd.logins();
    for nobody in [Listener::Unix(sshd.folder().join("nobody")), address(port)] {
        let error = host.connect(&nobody).await.unwrap_err();
        assert!(matches!(error, HostError::Refused { .. }), "{error:?}");
    }
    assert!(sshd.logins() <= logins + 1, "{}", sshd.said());
}

#[tokio::test]
async fn a_forwarded_socket_is_as_good_as_the_hosts_own() {
    let sshd = Sshd::start();
    let path = sshd.folder().join("service");
    let unix = UnixListener::bind(&path).unwrap();
    let service = thread::spawn(move || {
        for _ in 0..2 {
            shout(unix.accept().unwrap().0);
        }
        drop(unix);
    });
    let host: Arc<dyn Host> = Arc::new(host(&sshd));
    let forward = Forward::open(Arc::clone(&host), Listener::Unix(path.clone())).unwrap();
    for _ in 0..2 {
        let stream = UnixStream::connect(forward.socket()).await.unwrap();
        assert_eq!(exchange(stream, b"hello").await, b"HELLO");
    }
    service.join().unwrap();
    assert!(forward.take_failure().is_none());

    let mut stream = UnixStream::connect(forward.socket()).await.unwrap();
    assert_eq!(stream.read_to_end(&mut Vec::new()).await.unwrap(), 0);
    let failure = forward.take_failure().unwrap();
    assert!(matches!(failure, HostError::Refused { .. }), "{failure:?}");
    let socket = forward.socket();
    drop(forward);
    assert!(!socket.exists());
}

#[tokio::test]
async fn an_engine_answers_through_a_forwarded_socket() {
    let sshd = Sshd::start();
    let engine = Listener::Unix("/var/run/docker.sock".into());
    let forward = Forward::open(Arc::new(host(&sshd)), engine).unwrap();
    let mut stream = UnixStream::connect(forward.socket()).await.unwrap();
    stream.write_all(b"GET /_ping HTTP/1.0\r\n\r\n").await.unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.0 200 OK"), "{answer}");
}

#[tokio::test]
async fn a_connection_that_ends_is_noticed_and_the_next_program_has_another() {
    let sshd = Sshd::start();
    let host = host(&sshd);
    // One lies idle, one is in use.
    let (one, two) = (
        host.start(&shell("read line")).await.unwrap(),
        host.start(&shell("read line")).await.unwrap(),
    );
    exchange(one.stream, b"").await;
    one.end.wait().await.unwrap();
    sshd.cut();
    exchange(two.stream, b"").await;
    let error = two.end.wait().await.unwrap_err();
    assert!(error.is_passing(), "{error:?}");
    run(&host, &shell("true"), b"").await;
    assert_eq!(sshd.logins(), 3);
}

#[tokio::test]
async fn a_host_that_says_nothing_more_is_noticed() {
    let sshd = Sshd::start();
    let beat = Duration::from_secs(2);
    let host = SshHost::with_beat("lab", connection(&sshd), Trust::KnownHosts, client(&sshd), beat);
    let mut running = host.start(&shell("echo there; read line")).await.unwrap();
    let mut line = [0; 6];
    running.stream.read_exact(&mut line).await.unwrap();
    sshd.freeze();
    assert_eq!(running.stream.read(&mut line).await.unwrap(), 0);
    let error = running.end.wait().await.unwrap_err();
    assert!(
        in_words(&error).contains("no sign of life"),
        "{}",
        in_words(&error)
    );
    run(&host, &shell("true"), b"").await;
}

#[tokio::test]
async fn a_silent_host_that_is_left_alone_for_a_while_is_not_given_up() {
    let sshd = Sshd::start();
    let beat = Duration::from_secs(2);
    let host = SshHost::with_beat("lab", connection(&sshd), Trust::KnownHosts, client(&sshd), beat);
    // Longer than four beats.
    let (output, exit) = run(&host, &shell("sleep 12; echo here"), b"").await;
    assert_eq!((output.as_slice(), exit.code), (b"here\n".as_slice(), Some(0)));
}

#[test]
fn dropping_never_waits_for_a_host_that_says_nothing() {
    let sshd = Sshd::start();
    let host = host(&sshd);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let running = runtime.block_on(async {
        run(&host, &shell("true"), b"").await;
        let one = host.start(&shell("read line")).await.unwrap();
        run(&host, &shell("true"), b"").await;
        one
    });
    sshd.freeze();
    let (tell, done) = mpsc::channel();
    thread::spawn(move || {
        drop(running);
        drop(host);
        drop(runtime);
        tell.send(()).unwrap();
    });
    // libssh2 would wait for ever, or for its ten seconds in each.
    done.recv_timeout(Duration::from_secs(9)).unwrap();
}

#[tokio::test]
async fn a_host_that_is_not_there_is_said_with_its_place() {
    let sshd = Sshd::start();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    drop(listener);
    let connection = Ssh {
        address: format!("127.0.0.1:{port}").parse().unwrap(),
        ..connection(&sshd)
    };
    let error = refusal(&host_by(&sshd, connection)).await;
    assert!(matches!(error, HostError::Unreachable { .. }), "{error:?}");
    let said = in_words(&error);
    assert!(
        said.contains(&format!("cannot connect to 127.0.0.1:{port}")),
        "{said}"
    );
}

#[tokio::test]
async fn a_server_that_accepts_and_says_nothing_is_given_up() {
    let sshd = Sshd::start();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let connection = Ssh {
        address: format!("127.0.0.1:{}", listener.local_addr().unwrap().port())
            .parse()
            .unwrap(),
        ..connection(&sshd)
    };
    let error = refusal(&host_by(&sshd, connection)).await;
    assert!(
        in_words(&error).contains("no SSH session with"),
        "{}",
        in_words(&error)
    );
}
