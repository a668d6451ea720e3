//! A detached workload and its agent, from the command line as a stranger would use it: real processes, real runs, and
//! everything killed that can be.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead, BufReader, Read as _, Write as _},
    os::unix::{fs::symlink, process::CommandExt as _},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::{Mutex, MutexGuard, PoisonError, mpsc},
    thread,
    time::Duration,
};

use machine_workload::workload_program;
use nix::{
    sys::{
        signal::{Signal, kill},
        stat::Mode,
    },
    unistd::{Pid, mkfifo},
};
use record::{
    detached::{Ended, Ending, Failure, Host, LeaseAnswer, Listed, Owner, Removed, Started, Stopping},
    progress::Progress,
    window::WindowRecord,
};
use serde::de::DeserializeOwned;
use serde_json::json;
use sha2::{Digest, Sha256};

/// One window of two periods, at the ordinary priority: others measure here too.
const SHORT: &str =
    r#"{"windows":1,"window":"2s","period":"1s","realtime":{"priority":0,"lock_memory":false}}"#;
/// One that does not end by itself while a test runs.
const LONG: &str =
    r#"{"windows":1,"window":"1h","period":"1s","realtime":{"priority":0,"lock_memory":false}}"#;
/// Longer than anything here takes.
const TIMEOUT: Duration = Duration::from_secs(120);

/// One real run at a time.
static MACHINE: Mutex<()> = Mutex::new(());

fn machine() -> MutexGuard<'static, ()> {
    MACHINE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn owner() -> Owner {
    Owner {
        provider: "native".to_owned(),
        run: "run-1".to_owned(),
        run_directory: "/runs/run-1".into(),
        scenario: "x86_64-debian-native".to_owned(),
        host: "here".to_owned(),
        windows: vec![1],
    }
}

fn request(settings: &str) -> String {
    let settings: serde_json::Value = serde_json::from_str(settings).unwrap();
    json!({"owner": owner(), "settings": settings}).to_string()
}

/// A root folder with its environments, all removed when it is dropped.
struct Agent {
    folder: tempfile::TempDir,
}

impl Drop for Agent {
    fn drop(&mut self) {
        let names = fs::read_dir(self.folder.path()).unwrap();
        for name in names.map(|entry| entry.unwrap().file_name().into_string().unwrap()) {
            let _ = self.ask("remove", &name, "");
        }
    }
}

impl Agent {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    fn environment(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn call(&self, verb: &str, environment: &str) -> Command {
        let mut command = Command::new(workload_program());
        command.args(["detached", verb, "--root"]).arg(self.folder.path());
        if !environment.is_empty() {
            command.args(["--environment", environment]);
        }
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    /// What came of a verb, with this on its standard input.
    fn ask(&self, verb: &str, environment: &str, input: &str) -> Output {
        let mut child = self.call(verb, environment).spawn().unwrap();
        // One that fails at once does not read it.
        let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
        child.wait_with_output().unwrap()
    }

    /// What a verb answers.
    fn told<T: DeserializeOwned>(&self, verb: &str, environment: &str, input: &str) -> T {
        let output = self.ask(verb, environment, input);
        let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{verb}: {complaint}");
        assert_eq!(output.stdout.iter().filter(|byte| **byte == b'\n').count(), 1);
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn start(&self, environment: &str, settings: &str) -> Started {
        self.told("start", environment, &request(settings))
    }

    fn list(&self) -> Listed {
        self.told("list", "", "")
    }

    fn ended(&self, environment: &str) -> Ending {
        self.told("ended", environment, "")
    }

    fn lines(&self, environment: &str) -> Vec<u8> {
        fs::read(self.environment(environment).join("lines.jsonl")).unwrap()
    }
}

/// `follow`, with its lines still to be read.
struct Follower {
    child: Child,
    lines: BufReader<std::process::ChildStdout>,
    read: Vec<u8>,
}

impl Follower {
    fn of(agent: &Agent, environment: &str, from: usize) -> Self {
        let mut call = agent.call("follow", environment);
        let mut child = call.args(["--from", &from.to_string()]).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap());
        Self {
            child,
            lines,
            read: Vec::new(),
        }
    }

    /// Reads up to a line of that kind.
    fn read_until(&mut self, wanted: impl Fn(&Progress) -> bool) {
        loop {
            let before = self.read.len();
            assert_ne!(
                self.lines.read_until(b'\n', &mut self.read).unwrap(),
                0,
                "it ended first"
            );
            if wanted(&serde_json::from_slice(&self.read[before..]).unwrap()) {
                return;
            }
        }
    }

    /// All it had to pass on, once it has ended in order.
    fn finish(mut self) -> Vec<u8> {
        self.lines.read_to_end(&mut self.read).unwrap();
        assert!(ends(&mut self.child).success());
        self.read
    }
}

/// Waits for a process that is to end by itself.
fn ends(child: &mut Child) -> std::process::ExitStatus {
    let pid = child.id();
    let (ended, wait) = mpsc::channel::<()>();
    let guard = thread::spawn(move || {
        if wait.recv_timeout(TIMEOUT) == Err(mpsc::RecvTimeoutError::Timeout) {
            send(pid, Signal::SIGKILL);
            panic!("it did not end by itself");
        }
    });
    let status = child.wait().unwrap();
    drop(ended);
    guard.join().unwrap();
    status
}

fn send(pid: u32, signal: Signal) {
    kill(Pid::from_raw(i32::try_from(pid).unwrap()), signal).unwrap();
}

/// The supervisor: the workload's parent while it lives.
fn parent(pid: u32) -> u32 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("PPid:"));
    line.unwrap().trim().parse().unwrap()
}

fn lives(pid: u32) -> bool {
    fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| !line.is_empty())
}

fn failure(output: &Output) -> Failure {
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(&text).unwrap()
}

/// The files of a stream, by their paths.
fn unpack(stream: &[u8]) -> BTreeMap<String, Vec<u8>> {
    let mut archive = tar::Archive::new(lz4_flex::frame::FrameDecoder::new(stream));
    let entries = archive.entries().unwrap().map(|entry| {
        let mut entry = entry.unwrap();
        assert_eq!(entry.header().entry_type(), tar::EntryType::Regular);
        let path = entry.path().unwrap().to_str().unwrap().to_owned();
        let mut content = Vec::new();
        entry.read_to_end(&mut content).unwrap();
        (path, content)
    });
    entries.collect()
}

fn collect(agent: &Agent, environment: &str, there: &serde_json::Value) -> BTreeMap<String, Vec<u8>> {
    let output = agent.ask("collect", environment, &there.to_string());
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    unpack(&output.stdout)
}

#[test]
fn a_workload_outlives_who_started_it_and_all_of_it_is_found_afterwards() {
    let _machine = machine();
    let agent = Agent::new();
    let Started { pid } = agent.start("e-1", SHORT);
    let [listed] = <[_; 1]>::try_from(agent.list().environments).unwrap();
    assert_eq!(
        (listed.environment.as_str(), listed.owner),
        ("e-1", Some(owner()))
    );

    let followed = Follower::of(&agent, "e-1", 0).finish();
    assert_eq!(followed, agent.lines("e-1"));
    let said: Vec<Progress> = followed
        .split_inclusive(|byte| *byte == b'\n')
        .map(|line| serde_json::from_slice(line).unwrap())
        .collect();
    assert_eq!(said[0], Progress::Started { pid });
    assert_eq!(*said.last().unwrap(), Progress::Finished, "{said:?}");
    let middle = followed.len() / 2;
    assert_eq!(Follower::of(&agent, "e-1", middle).finish(), followed[middle..]);
    assert_eq!(
        agent.ended("e-1"),
        Ending {
            running: false,
            ended: Some(Ended::Code(0)),
            last_words: String::new(),
        }
    );
    let listed = agent.list().environments;
    assert!(listed[0].started && !listed[0].running);

    let mut files = collect(&agent, "e-1", &json!({}));
    let record: WindowRecord = serde_json::from_slice(&files["window-1/window.json"]).unwrap();
    assert!(record.complete);
    assert_eq!(record.environment, "e-1");
    // Again, from the middle of each, as after a cut.
    let halves: BTreeMap<String, u64> = files
        .iter()
        .map(|(path, all)| (path.clone(), all.len() as u64 / 2))
        .collect();
    for (path, rest) in collect(&agent, "e-1", &json!(halves)) {
        let whole = ["environment.json", "progress.jsonl", "window-1/window.json"].contains(&path.as_str());
        let all = files.get_mut(&path).unwrap();
        all.truncate(if whole { 0 } else { all.len() / 2 });
        all.extend(rest);
    }
    assert_eq!(record.files.len(), 5);
    for file in &record.files {
        let content = &files[&format!("window-1/{}", file.name)];
        assert_eq!(
            file.sha256,
            format!("{:x}", Sha256::digest(content)),
            "{}",
            file.name
        );
    }

    assert_eq!(
        agent.told::<Removed>("remove", "e-1", ""),
        Removed { removed: true }
    );
    assert_eq!(
        agent.told::<Removed>("remove", "e-1", ""),
        Removed { removed: false }
    );
    assert_eq!(agent.list().environments, []);
}

#[test]
fn an_end_is_noticed_when_the_supervisor_was_killed_before() {
    let _machine = machine();
    let agent = Agent::new();
    let Started { pid } = agent.start("e-1", LONG);
    let mut follower = Follower::of(&agent, "e-1", 0);
    follower.read_until(|line| matches!(line, Progress::Measuring { .. }));
    send(parent(pid), Signal::SIGKILL);
    follower.read_until(|line| matches!(line, Progress::Health { .. }));
    assert!(agent.ended("e-1").running);
    assert_eq!(
        agent.told::<Stopping>("stop", "e-1", ""),
        Stopping { asked: true }
    );
    let followed = follower.finish();
    assert_eq!(followed, agent.lines("e-1"));
    let last = followed
        .strip_suffix(b"\n")
        .unwrap()
        .rsplit(|byte| *byte == b'\n')
        .next();
    assert_eq!(
        serde_json::from_slice::<Progress>(last.unwrap()).unwrap(),
        Progress::Stopped { window: 1 }
    );
    let ending = agent.ended("e-1");
    assert_eq!((ending.running, ending.ended), (false, None));
    assert_eq!(
        agent.told::<Stopping>("stop", "e-1", ""),
        Stopping { asked: false }
    );
}

#[test]
fn a_workload_that_was_killed_has_ended_by_that_signal() {
    let _machine = machine();
    let agent = Agent::new();
    let Started { pid } = agent.start("e-1", LONG);
    let mut follower = Follower::of(&agent, "e-1", 0);
    follower.read_until(|line| matches!(line, Progress::NetworkUp));
    send(pid, Signal::SIGKILL);
    assert_eq!(follower.finish(), agent.lines("e-1"));
    let ending = agent.ended("e-1");
    assert_eq!((ending.running, ending.ended), (false, Some(Ended::Signal(9))));
}

#[test]
fn a_follower_that_was_cut_is_continued_by_another_and_one_without_a_reader_ends() {
    let _machine = machine();
    let agent = Agent::new();
    agent.start("e-1", LONG);
    let mut first = Follower::of(&agent, "e-1", 0);
    first.read_until(|line| matches!(line, Progress::Measuring { .. }));
    first.child.kill().unwrap();
    first.child.wait().unwrap();
    let mut second = Follower::of(&agent, "e-1", first.read.len());
    second.read_until(|line| matches!(line, Progress::Health { .. }));

    let Follower { mut child, lines, .. } = Follower::of(&agent, "e-1", agent.lines("e-1").len());
    drop(lines);
    assert_eq!(ends(&mut child).code(), Some(1));

    agent.told::<Stopping>("stop", "e-1", "");
    let followed = [first.read, second.finish()].concat();
    assert_eq!(followed, agent.lines("e-1"));
    let ending = agent.ended("e-1");
    assert_eq!((ending.running, ending.ended), (false, Some(Ended::Code(0))));
}

#[test]
fn removing_ends_the_workload_and_its_supervisor() {
    let _machine = machine();
    let agent = Agent::new();
    let Started { pid } = agent.start("e-1", LONG);
    let supervisor = parent(pid);
    Follower::of(&agent, "e-1", 0).read_until(|line| matches!(line, Progress::NetworkUp));
    assert!(lives(pid) && lives(supervisor));
    let neighbour = agent.start("e-11", LONG);
    assert_eq!(
        agent.told::<Removed>("remove", "e-1", ""),
        Removed { removed: true }
    );
    assert!(!lives(pid) && !lives(supervisor));
    assert!(!agent.environment("e-1").exists());
    assert!(lives(neighbour.pid), "another whose name begins alike");
}

#[test]
fn a_workload_starts_though_nobody_hears_that_it_did() {
    let _machine = machine();
    let agent = Agent::new();
    let mut start = agent.call("start", "e-1").process_group(0).spawn().unwrap();
    drop(start.stdout.take());
    start
        .stdin
        .take()
        .unwrap()
        .write_all(request(LONG).as_bytes())
        .unwrap();
    ends(&mut start);
    Follower::of(&agent, "e-1", 0).read_until(|line| matches!(line, Progress::NetworkUp));
    assert!(agent.ended("e-1").running);
}

#[test]
fn of_many_starts_of_one_name_one_wins_and_the_others_leave_nothing() {
    let _machine = machine();
    let agent = Agent::new();
    let outputs: Vec<_> = thread::scope(|scope| {
        let starts: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| agent.ask("start", "e-1", &request(LONG))))
            .collect();
        starts.into_iter().map(|start| start.join().unwrap()).collect()
    });
    let (won, lost): (Vec<_>, Vec<_>) = outputs.iter().partition(|output| output.status.success());
    assert_eq!((won.len(), lost.len()), (1, 3));
    for output in lost {
        assert_eq!(output.status.code(), Some(1));
        let failure = failure(output);
        assert!(
            failure.error.contains("already an environment e-1"),
            "{failure:?}"
        );
        assert!(failure.hint.is_some());
    }
    let Started { pid } = serde_json::from_slice(&won[0].stdout).unwrap();
    assert!(lives(pid));
    assert_eq!(agent.list().environments.len(), 1);
    assert_eq!(fs::read_dir(agent.folder.path()).unwrap().count(), 1);
}

#[test]
fn what_a_workload_said_last_is_told_with_its_end() {
    let agent = Agent::new();
    let mut nothing_to_measure = owner();
    nothing_to_measure.windows = vec![1, 1];
    let request = json!({"owner": nothing_to_measure, "settings": {}}).to_string();
    agent.told::<Started>("start", "e-1", &request);
    Follower::of(&agent, "e-1", 0).finish();
    let ending = agent.ended("e-1");
    assert_eq!((ending.running, ending.ended), (false, Some(Ended::Code(2))));
    assert!(
        ending.last_words.contains("window 1 is listed twice"),
        "{ending:?}"
    );
}

#[rstest::rstest]
#[case::parent("..")]
#[case::path("e/../../x")]
#[case::option("-e")]
#[case::newline("e\nf")]
#[case::hidden(".e")]
fn a_hostile_name_is_a_wrong_call(
    #[case] name: &str,
    #[values("start", "follow", "ended", "stop", "remove", "collect")] verb: &str,
) {
    let agent = Agent::new();
    let name = format!("--environment={name}");
    let mut call = agent.call(verb, "");
    let mut child = call.arg(name).spawn().unwrap();
    drop(child.stdin.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(failure(&output).hint.is_some());
    assert_eq!(fs::read_dir(agent.folder.path()).unwrap().count(), 0);
}

#[rstest::rstest]
#[case::nothing(String::new(), "standard input cannot be read")]
#[case::without_owner(r#"{"settings":{}}"#.to_owned(), "owner")]
#[case::unknown_setting(json!({"owner": owner(), "settings": {"windwos": 1}}).to_string(), "windwos")]
#[case::endless(" ".repeat(100_000), "longer than")]
fn a_start_that_cannot_be_understood_leaves_nothing(#[case] input: String, #[case] says: &str) {
    let agent = Agent::new();
    let output = agent.ask("start", "e-1", &input);
    assert_eq!(output.status.code(), Some(2));
    let failure = failure(&output);
    assert!(failure.error.contains(says), "{failure:?}");
    assert_eq!(fs::read_dir(agent.folder.path()).unwrap().count(), 0);
}

#[rstest::rstest]
fn what_is_not_there_is_said_so(#[values("follow", "ended", "stop", "collect")] verb: &str) {
    let agent = Agent::new();
    let output = agent.ask(verb, "e-1", "{}");
    assert_eq!(output.status.code(), Some(1));
    assert!(failure(&output).error.contains("no environment e-1"));
}

#[rstest::rstest]
fn a_link_is_no_environment(#[values("follow", "ended", "stop", "collect")] verb: &str) {
    let (agent, elsewhere) = (Agent::new(), Agent::new());
    prepare(&elsewhere, "e-1", &[("window-1/control.csv", b"secret")]);
    symlink(elsewhere.environment("e-1"), agent.environment("e-1")).unwrap();
    let output = agent.ask(verb, "e-1", "{}");
    assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0));
    assert_eq!(agent.list().environments, []);
    assert_eq!(
        agent.told::<Removed>("remove", "e-1", ""),
        Removed { removed: true }
    );
    assert!(elsewhere.environment("e-1/data/window-1/control.csv").exists());
}

#[test]
fn nothing_is_followed_beyond_its_end() {
    let agent = Agent::new();
    prepare(&agent, "e-1", &[]);
    fs::write(agent.environment("e-1/lines.jsonl"), "{}\n").unwrap();
    assert_eq!(Follower::of(&agent, "e-1", 1).finish(), b"}\n");
    let follower = Follower::of(&agent, "e-1", 4);
    let output = follower.child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        failure(&output)
            .error
            .contains("has 3 bytes, and 4 are said to be there already")
    );
}

/// An environment that no workload ever had, with these data files.
fn prepare(agent: &Agent, environment: &str, files: &[(&str, &[u8])]) -> PathBuf {
    let folder = agent.environment(environment);
    let data = folder.join("data");
    fs::create_dir_all(&data).unwrap();
    fs::write(folder.join("owner.json"), serde_json::to_vec(&owner()).unwrap()).unwrap();
    for (path, content) in files {
        let path = data.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }
    data
}

/// Content that no compression makes shorter (xorshift64, Marsaglia 2003).
fn noise(bytes: usize) -> Vec<u8> {
    let mut state = 88_172_645_463_325_252_u64;
    let draw = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state.to_le_bytes()
    };
    std::iter::repeat_with(draw).flatten().take(bytes).collect()
}

#[test]
fn a_stream_that_was_cut_is_continued_and_has_every_byte_once() {
    let agent = Agent::new();
    let (log, capture) = (b"time,x\n1,2\n".repeat(100_000), noise(3_000_001));
    let files: [(&str, &[u8]); 5] = [
        ("environment.json", b"{}"),
        ("window-1/control.csv", &log),
        ("window-1/h1.pcap", &capture),
        ("window-1/empty.pcap", b""),
        ("window-1/window.json", b"{\"window\":1}"),
    ];
    prepare(&agent, "e-1", &files);
    let there = json!({
        "environment.json": 1, "window-1/control.csv": 777_777, "window-1/h1.pcap": capture.len(), "gone": 5
    });
    let rests: [(&str, &[u8]); 5] = [
        ("environment.json", b"{}"),
        ("window-1/control.csv", &log[777_777..]),
        ("window-1/h1.pcap", b""),
        ("window-1/empty.pcap", b""),
        ("window-1/window.json", b"{\"window\":1}"),
    ];
    let named = |files: [(&str, &[u8]); 5]| files.map(|(path, all)| (path.to_owned(), all.to_vec()));
    assert_eq!(collect(&agent, "e-1", &json!({})), named(files).into());
    assert_eq!(collect(&agent, "e-1", &there), named(rests).into());
}

#[test]
fn only_regular_files_two_levels_deep_are_sent() {
    let (agent, elsewhere) = (Agent::new(), tempfile::tempdir().unwrap());
    let secret = elsewhere.path().join("secret");
    fs::write(&secret, "secret").unwrap();
    let long = format!("window-1/{}", "x".repeat(150));
    let data = prepare(
        &agent,
        "e-1",
        &[
            ("network.txt", b"links"),
            ("window-1/control.csv", b"rows"),
            ("window-1/deeper/control.csv", b"no"),
            (&long, b"no"),
        ],
    );
    symlink(&secret, data.join("progress.jsonl")).unwrap();
    symlink(&secret, data.join("window-1/h1.pcap")).unwrap();
    symlink(elsewhere.path(), data.join("window-2")).unwrap();
    mkfifo(&data.join("window-1/sta1.pcap"), Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    let sent = collect(&agent, "e-1", &json!({}));
    let paths: Vec<_> = sent.keys().map(String::as_str).collect();
    assert_eq!(paths, ["network.txt", "window-1/control.csv"]);
}

#[test]
fn a_data_folder_that_leads_elsewhere_is_not_sent() {
    let (agent, elsewhere) = (Agent::new(), tempfile::tempdir().unwrap());
    fs::write(elsewhere.path().join("secret"), "secret").unwrap();
    let data = prepare(&agent, "e-1", &[]);
    fs::remove_dir(&data).unwrap();
    symlink(elsewhere.path(), &data).unwrap();
    let output = agent.ask("collect", "e-1", "{}");
    assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0));
    assert!(failure(&output).error.contains("data"));
}

/// Begins a collection that cannot go on, since nobody reads it yet, does something to the file meanwhile, and reads on.
fn collect_while(change: impl FnOnce(&Path)) -> (Vec<u8>, BTreeMap<String, Vec<u8>>) {
    let agent = Agent::new();
    let content = noise(4 << 20);
    let data = prepare(
        &agent,
        "e-1",
        &[
            ("window-1/control.csv", &content),
            ("window-1/window.json", b"{}"),
        ],
    );
    let mut child = agent.call("collect", "e-1").spawn().unwrap();
    child.stdin.take().unwrap().write_all(b"{}").unwrap();
    let mut out = child.stdout.take().unwrap();
    let mut stream = vec![0; 64 << 10];
    out.read_exact(&mut stream).unwrap();
    change(&data.join("window-1/control.csv"));
    out.read_to_end(&mut stream).unwrap();
    assert!(ends(&mut child).success());
    (content, unpack(&stream))
}

#[test]
fn a_file_that_grows_meanwhile_is_sent_as_long_as_it_was() {
    let (content, sent) = collect_while(|path| {
        let mut file = fs::OpenOptions::new().append(true).open(path).unwrap();
        file.write_all(b"more").unwrap();
    });
    assert_eq!(sent["window-1/control.csv"], content);
    assert_eq!(sent["window-1/window.json"], b"{}");
}

#[test]
fn a_file_that_shrinks_meanwhile_does_not_break_those_after_it() {
    let (content, sent) = collect_while(|path| {
        let file = fs::OpenOptions::new().write(true).open(path).unwrap();
        file.set_len(2 << 20).unwrap();
    });
    let shrunk = &sent["window-1/control.csv"];
    assert_eq!(shrunk.len(), content.len());
    assert_eq!(shrunk[..2 << 20], content[..2 << 20]);
    assert!(shrunk[3 << 20..].iter().all(|byte| *byte == 0));
    assert_eq!(sent["window-1/window.json"], b"{}");
}

#[test]
fn a_file_that_is_shorter_than_what_is_there_is_an_error_before_anything_is_sent() {
    let agent = Agent::new();
    prepare(&agent, "e-1", &[("window-1/control.csv", b"rows")]);
    let output = agent.ask("collect", "e-1", r#"{"window-1/control.csv":5}"#);
    assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0));
    let failure = failure(&output);
    assert!(failure.error.contains("has 4 bytes, and 5"), "{failure:?}");
    assert!(failure.hint.is_some());
}

#[test]
fn what_a_crash_left_is_listed_without_an_owner_and_can_be_removed() {
    let agent = Agent::new();
    prepare(&agent, "e-1.77.unfinished", &[]);
    fs::create_dir(agent.environment("e-2")).unwrap();
    fs::create_dir(agent.environment(".others")).unwrap();
    fs::write(agent.environment("file"), "").unwrap();
    let listed = agent.list().environments;
    let seen: Vec<_> = listed
        .iter()
        .map(|it| {
            (
                it.environment.as_str(),
                it.owner.is_some(),
                it.started,
                it.running,
            )
        })
        .collect();
    assert_eq!(
        seen,
        [
            ("e-1.77.unfinished", true, false, false),
            ("e-2", false, false, false)
        ]
    );
    assert_eq!(
        agent.told::<Removed>("remove", "e-2", ""),
        Removed { removed: true }
    );
    let ending = agent.ended("e-1.77.unfinished");
    assert_eq!((ending.running, ending.ended), (false, None));
}

#[test]
fn a_root_that_is_not_there_has_no_environments() {
    let agent = Agent::new();
    let program = agent.call("list", "").get_program().to_owned();
    let list = |root: &str| {
        Command::new(&program)
            .args(["detached", "list", "--root", root])
            .output()
            .unwrap()
    };
    let output = list("/nowhere/at/all");
    assert!(output.status.success());
    assert_eq!(
        serde_json::from_slice::<Listed>(&output.stdout)
            .unwrap()
            .environments,
        []
    );
    let output = list("relative");
    assert_eq!(output.status.code(), Some(2));
    assert!(failure(&output).error.contains("not absolute"));
}

#[test]
fn a_host_says_what_it_is_before_anything_is_there() {
    let agent = Agent::new();
    let program = agent.call("platform", "").get_program().to_owned();
    let mut call = Command::new(program);
    call.args(["detached", "platform", "--root"])
        .arg(agent.environment("not/there/yet"));
    let output = call.output().unwrap();
    assert!(output.status.success());
    let host: Host = serde_json::from_slice(&output.stdout).unwrap();
    assert!(!host.platform.machine.is_empty() && !host.platform.kernel.is_empty());
    assert_eq!(host.uid, nix::unistd::geteuid().as_raw());
    assert!(host.free_bytes > 0);
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap();
    let age = now - Duration::from_nanos(host.now_ns);
    assert!(age < TIMEOUT, "{age:?}");
    assert_eq!(fs::read_dir(agent.folder.path()).unwrap().count(), 0);
}

/// `lease`, asked for by someone with a token.
struct Lease {
    child: Child,
    input: Option<std::process::ChildStdin>,
    answers: BufReader<std::process::ChildStdout>,
}

impl Drop for Lease {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Lease {
    fn ask(path: &Path, token: &str) -> Self {
        Self::ask_with_beat(path, token, "5min")
    }

    fn ask_with_beat(path: &Path, token: &str, beat: &str) -> Self {
        let mut call = Agent::new().call("lease", "");
        let program = call.get_program().to_owned();
        call = Command::new(program);
        call.args(["detached", "lease", "--beat", beat, "--path"])
            .arg(path);
        call.stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = call.spawn().unwrap();
        let mut input = child.stdin.take().unwrap();
        let request = json!({"token": token, "holder": {"pid": 7, "who": token}});
        writeln!(input, "{request}").unwrap();
        let answers = BufReader::new(child.stdout.take().unwrap());
        Self {
            child,
            input: Some(input),
            answers,
        }
    }

    fn answer(&mut self) -> LeaseAnswer {
        let mut line = String::new();
        self.answers.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    fn is_granted(&mut self) {
        assert_eq!(self.answer(), LeaseAnswer::Granted { granted: true });
    }

    fn is_held_by(&mut self, token: &str) {
        let LeaseAnswer::Held { held: Some(holder) } = self.answer() else {
            panic!("it is not held, or nobody says by whom");
        };
        assert_eq!(
            json!(holder),
            json!({"pid": 7, "who": token}),
            "and not the token itself"
        );
    }
}

#[test]
fn a_lease_is_held_as_long_as_its_holder_is_connected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lease");
    let mut first = Lease::ask(&path, "a");
    first.is_granted();
    let mut second = Lease::ask(&path, "b");
    second.is_held_by("a");
    drop(first.input.take());
    assert!(ends(&mut first.child).success());
    second.is_granted();
    let mut third = Lease::ask(&path, "c");
    third.is_held_by("b");
    second.child.kill().unwrap();
    third.is_granted();
}

#[test]
fn who_comes_back_has_the_lease_before_those_who_queued_meanwhile() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lease");
    let mut cut = Lease::ask(&path, "a");
    cut.is_granted();
    let mut waiting: Vec<_> = ["b", "c"]
        .into_iter()
        .map(|token| {
            let mut lease = Lease::ask(&path, token);
            lease.is_held_by("a");
            lease
        })
        .collect();
    let mut back = Lease::ask(&path, "a");
    back.is_granted();
    assert!(!ends(&mut cut.child).success());
    Lease::ask(&path, "d").is_held_by("a");
    drop(back.input.take());
    assert!(ends(&mut back.child).success());
    // In whichever order.
    while let Some(mut next) = waiting.pop() {
        if waiting.is_empty() {
            next.is_granted();
        } else {
            drop(next);
        }
    }
}

#[test]
fn a_lease_ends_when_nothing_is_heard_of_its_holder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lease");
    let mut silent = Lease::ask_with_beat(&path, "a", "200ms");
    silent.is_granted();
    let mut next = Lease::ask(&path, "b");
    assert_eq!(ends(&mut silent.child).code(), Some(1));
    while next.answer() != (LeaseAnswer::Granted { granted: true }) {}
}

#[test]
fn a_lease_of_others_is_neither_taken_nor_ended() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lease");
    // As a program that knows nothing of tokens holds it; and as one lies that would have this test's process ended.
    for text in [
        json!({"pid": 7, "who": "x"}).to_string(),
        json!({"pid": 7, "who": "x", "lease-token": "a", "lease-process": std::process::id()}).to_string(),
    ] {
        fs::write(&path, text).unwrap();
        let file = fs::File::open(&path).unwrap();
        let lock = nix::fcntl::Flock::lock(file, nix::fcntl::FlockArg::LockExclusive).unwrap();
        let mut lease = Lease::ask(&path, "a");
        lease.is_held_by("x");
        drop(lock);
        lease.is_granted();
    }
    fs::write(&path, "not JSON").unwrap();
    let lock = nix::fcntl::Flock::lock(
        fs::File::open(&path).unwrap(),
        nix::fcntl::FlockArg::LockExclusive,
    )
    .unwrap();
    assert_eq!(Lease::ask(&path, "a").answer(), LeaseAnswer::Held { held: None });
    drop(lock);
}

#[test]
fn the_file_of_a_lease_is_open_to_all_users_and_no_link() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lease");
    Lease::ask(&path, "a").is_granted();
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o666);
    let link = folder.path().join("link");
    symlink(&path, &link).unwrap();
    let mut lease = Lease::ask(&link, "a");
    assert_eq!(ends(&mut lease.child).code(), Some(1));
}
