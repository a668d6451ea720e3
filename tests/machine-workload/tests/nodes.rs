//! Programs on the hosts of an emulated network, as an experiment's nodes: the real binary, real namespaces, real packets.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::{
    fs,
    path::PathBuf,
    process::{Command, ExitStatus, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
};

use machine_workload::workload_program;
use record::{
    platform::SurveyRecord,
    settings::{Settings, ValiditySettings},
    window::{CommandRecord, OfExperiment, Verdict, WindowRecord},
};
use serde_json::{Value, json};
use tempfile::TempDir;

/// They measure times, so that they run one after the other.
static MACHINE: Mutex<()> = Mutex::new(());

/// Answers each datagram with itself. Perl is part of every Debian.
const ECHO: &str = "use IO::Socket::INET; $| = 1; \
    $s = IO::Socket::INET->new(LocalPort => 5000, Proto => 'udp') or die $!; print \"echo is up\\n\"; \
    while (defined $s->recv($m, 100)) { $s->send($m) }";

/// How long each of twenty datagrams takes (and `date`, since the smallest Perl has no finer clock) to the host in its first argument and back, into the folder in its second.
const PING: &str = "use IO::Socket::INET; sub now { `date +%s%N` / 1e6 } \
    $s = IO::Socket::INET->new(PeerAddr => $ARGV[0], PeerPort => 5000, Proto => 'udp') or die $!; \
    open F, '>', $ARGV[1].'/rtt.csv'; print F \"rtt_ms\\n\"; \
    for (1..20) { $t = now(); $s->send('x'); $s->recv($m, 100); printf F \"%.3f\\n\", now() - $t }";

/// Takes connections and says nothing.
const LISTEN: &str = "use IO::Socket::INET; $s = IO::Socket::INET->new(LocalPort => 6000, Listen => 5, ReuseAddr => 1) or die $!; \
    sleep 1000";

/// Tells the ROS master of a publisher, a moment after it was started.
const ADVERTISE: &str = "use IO::Socket::INET; select undef, undef, undef, 0.3; \
    ($host, $port) = $ENV{ROS_MASTER_URI} =~ m{//([0-9.]+):([0-9]+)}; \
    $s = IO::Socket::INET->new(PeerAddr => $host, PeerPort => $port) or die $!; \
    $p = join '', map { \"<param><value><string>$_</string></value></param>\" } \
        '/talker', '/state', 'std_msgs/String', \"http://$ENV{ROS_IP}:9/\"; \
    $b = \"<?xml version='1.0'?><methodCall><methodName>registerPublisher</methodName><params>$p</params></methodCall>\"; \
    print $s \"POST /RPC2 HTTP/1.1\\r\\nHost: m\\r\\nContent-Type: text/xml\\r\\nContent-Length: \".length($b).\"\\r\\n\\r\\n$b\"; \
    $s->flush; <$s>; sleep 1000";

fn perl(script: &str) -> Vec<String> {
    let script = script.replace('{', "{{").replace('}', "}}");
    ["perl", "-e", &script].map(str::to_owned).to_vec()
}

fn perl_with(script: &str, arguments: &[&str]) -> Vec<String> {
    let mut command = perl(script);
    command.extend(arguments.iter().map(ToString::to_string));
    command
}

struct Place {
    folder: TempDir,
    settings: Value,
    _alone: MutexGuard<'static, ()>,
}

/// No window is suspect for what else happens on the machine: other tests run beside these, and hypervisors take time.
fn whatever_the_machine_does() -> Value {
    let never = json!({"suspect": "never", "invalid": "never"});
    ValiditySettings::CONDITIONS
        .iter()
        .map(|rule| ((*rule).to_owned(), never.clone()))
        .collect()
}

impl Place {
    fn new(nodes: Value) -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            settings: json!({
                "validity": whatever_the_machine_does(),
                "network": {"loss": "0%", "jitter": "0ms", "delay": "1ms"},
                "experiment": {
                    "name": "ping",
                    "nodes": nodes,
                    "window": {"timeout": "20s"},
                    "metrics": [{"name": "rtt", "unit": "ms", "from": "rtt.csv", "column": "rtt_ms"}],
                },
            }),
            _alone: MACHINE.lock().unwrap_or_else(PoisonError::into_inner),
        }
    }

    fn echo_and_ping() -> Self {
        Self::new(json!([
            {"name": "echo", "host": "sta2", "run": perl(ECHO), "ready": {"line": "echo is up"}, "background": true},
            {"name": "ping", "host": "sta1", "run": perl_with(PING, &["{hosts.sta2.address}", "{window.folder}"])},
        ]))
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    fn command(&self, windows: &str) -> Command {
        let settings: Settings = serde_json::from_value(self.settings.clone()).unwrap();
        assert_eq!(settings.problems(), []);
        fs::create_dir_all(self.data()).unwrap();
        let mut command = Command::new(workload_program());
        command
            .args([
                "run",
                "--environment",
                "test",
                "--settings",
                &self.settings.to_string(),
            ])
            .args(["--windows", windows, "--data"])
            .arg(self.data())
            .arg("--work")
            .arg(self.folder.path().join("work"))
            .stdout(Stdio::null());
        command
    }

    fn run(&self, windows: &str) -> ExitStatus {
        self.command(windows).status().unwrap()
    }

    fn text(&self, path: &str) -> String {
        String::from_utf8_lossy(&fs::read(self.data().join(path)).unwrap()).into_owned()
    }

    fn record(&self, window: u32) -> (WindowRecord, CommandRecord) {
        let record: WindowRecord =
            serde_json::from_str(&self.text(&format!("window-{window}/window.json"))).unwrap();
        record.check().unwrap();
        match &record.of {
            OfExperiment::Command { command } => (record.clone(), command.clone()),
            OfExperiment::Loops(_) => panic!("{record:?}"),
        }
    }

    /// Why the one window does not count.
    fn reasons(&self) -> Vec<String> {
        assert!(self.run("1").success());
        let (record, _) = self.record(1);
        assert_eq!(record.verdict, Verdict::Invalid);
        record.reasons
    }

    fn round_trips_ms(&self, window: u32) -> Vec<f64> {
        let text = self.text(&format!("window-{window}/rtt.csv"));
        text.lines().skip(1).map(|line| line.parse().unwrap()).collect()
    }
}

#[test]
fn nodes_meet_on_the_emulated_network_in_each_window() {
    let place = Place::echo_and_ping();
    assert!(place.run("1,2").success());
    for window in [1, 2] {
        let (record, command) = place.record(window);
        assert_ne!(record.verdict, Verdict::Invalid, "{:?}", record.reasons);
        assert_eq!(command.exit_code, Some(0));
        let [echo, ping] = command.nodes.as_slice() else {
            panic!("{command:?}")
        };
        // The one in the background was asked to end.
        assert_eq!(
            (echo.name.name(), echo.exit_code, echo.signal),
            ("echo", None, Some(15))
        );
        assert_eq!(
            (ping.host.name(), ping.exit_code, ping.signal),
            ("sta1", Some(0), None)
        );
        assert!(ping.ready_after_ns >= echo.ready_after_ns && echo.ready_after_ns > Some(0));
        // Each way two passes of 1 ms.
        let round_trips = place.round_trips_ms(window);
        assert_eq!(round_trips.len(), 20);
        assert!(round_trips.iter().all(|ms| *ms >= 4.0), "{round_trips:?}");
        let files: Vec<&str> = record.files.iter().map(|file| file.name.as_str()).collect();
        let expected = [
            "echo.stderr.txt",
            "echo.stdout.txt",
            "h1.pcap",
            "ping.stderr.txt",
            "ping.stdout.txt",
            "rtt.csv",
            "sta1.pcap",
            "sta2.pcap",
        ];
        assert_eq!(files, expected);
        assert_eq!(
            place.text(&format!("window-{window}/echo.stdout.txt")),
            "echo is up\n"
        );
        let carried: Vec<(String, u64)> = record
            .links
            .iter()
            .map(|it| (it.host.to_string(), it.up.delivered))
            .collect();
        assert_eq!(
            carried,
            [
                ("h1".to_owned(), 0),
                ("sta1".to_owned(), 20),
                ("sta2".to_owned(), 20)
            ]
        );
        let captured: Vec<u64> = record.captures.iter().map(|it| it.packets).collect();
        // The switch does not know the first datagram's way yet, and h1 hears it too.
        assert_eq!(captured, [u64::from(window == 1), 40, 40]);
    }
    let survey: SurveyRecord = serde_json::from_str(&place.text("environment.json")).unwrap();
    assert!(
        !survey
            .before
            .privileges
            .as_ref()
            .unwrap()
            .capabilities
            .iter()
            .any(|it| it == "SYS_ADMIN")
    );
}

#[test]
fn each_link_and_each_switch_on_the_way_delays() {
    let mut place = Place::echo_and_ping();
    place.settings["network"] = json!({
        "delay": "1ms", "jitter": "0ms", "loss": "0%",
        "hosts": {"sta1": {"switch": "s3"}, "other": {}, "sta2": {"delay": "5ms"}},
        "switches": {"s1": {}, "s2": {"delay": "3ms"}, "s3": {"switch": "s2", "delay": "4ms"}},
    });
    assert!(place.run("1").success());
    let (record, _) = place.record(1);
    assert_ne!(record.verdict, Verdict::Invalid, "{:?}", record.reasons);
    let least = 2.0 * (1.0 + 4.0 + 3.0 + 5.0);
    let round_trips = place.round_trips_ms(1);
    let quickest = round_trips.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(quickest >= least && quickest < least + 5.0, "{round_trips:?}");
    let carried: Vec<(String, u64)> = record
        .links
        .iter()
        .map(|it| (it.host.to_string(), it.up.delivered))
        .collect();
    let of = |name: &str| carried.iter().find(|(host, _)| host == name).unwrap().1;
    assert_eq!(carried.len(), 5);
    assert_eq!((of("sta1"), of("s3"), of("s2")), (20, 20, 20), "{carried:?}");
}

#[test]
fn a_node_is_ready_when_its_port_listens_and_when_the_master_knows_its_topic() {
    let touch = json!([
        "sh",
        "-c",
        "test -n \"$ROS_MASTER_URI\" && printf 'rtt_ms\\n1\\n' >\"$1/rtt.csv\"",
        "sh",
        "{window.folder}"
    ]);
    let mut place = Place::new(json!([
        {"name": "server", "host": "sta2", "run": perl(LISTEN), "ready": {"port": 6000}, "background": true},
        {"name": "talker", "host": "h1", "run": perl(ADVERTISE), "ready": {"topic": "/state"}, "background": true},
        {"name": "last", "host": "sta1", "run": touch},
    ]));
    place.settings["experiment"]["ros_master"] = json!({"host": "sta1"});
    // The master of the second window knows nothing of the first.
    assert!(place.run("1,2").success());
    for window in [1, 2] {
        let (record, command) = place.record(window);
        assert_ne!(record.verdict, Verdict::Invalid, "{:?}", record.reasons);
        assert!(command.nodes[1].ready_after_ns > Some(300_000_000), "{command:?}");
    }
}

#[test]
fn a_node_that_fails_ends_the_window_and_is_named_with_its_last_words() {
    let place = Place::new(json!([
        {"name": "good", "host": "h1", "run": ["sleep", "1000"], "background": true},
        {"name": "bad", "host": "sta1", "run": ["sh", "-c", "echo no joy >&2; exit 3"]},
    ]));
    assert_eq!(
        place.reasons(),
        ["node `bad` ended with exit code 3", "it printed last: no joy"]
    );
    assert_eq!(place.text("window-1/bad.stderr.txt"), "no joy\n");
}

#[test]
fn a_node_in_the_background_that_ends_is_missed() {
    let place = Place::new(json!([
        {"name": "short", "host": "h1", "run": ["true"], "background": true},
        {"name": "long", "host": "sta1", "run": ["sleep", "1000"]},
    ]));
    assert_eq!(
        place.reasons(),
        ["node `short` ended with exit code 0 before the window was over"]
    );
}

#[test]
fn a_node_that_is_never_ready_is_named_with_what_was_waited_for() {
    let mut place = Place::new(json!([
        {"name": "quick", "host": "h1", "run": ["true"]},
        {"name": "mute", "host": "h1", "run": ["sleep", "1000"], "ready": {"line": "hello"}},
        {"name": "later", "host": "sta1", "run": ["true"]},
    ]));
    place.settings["experiment"]["window"] = json!({"timeout": "1s"});
    let reasons = place.reasons();
    assert_eq!(
        reasons,
        [
            "the window was ended since it took longer than 1 s",
            "it waited for node `mute` to print `hello`"
        ]
    );
    // Also of those that were not started.
    assert_eq!(place.text("window-1/later.stdout.txt"), "");
}

#[test]
fn a_node_that_ends_before_it_is_ready_is_not_waited_for() {
    let place = Place::new(json!([
        {"name": "hasty", "host": "h1", "run": ["true"], "ready": {"port": 1}},
    ]));
    assert_eq!(
        place.reasons(),
        ["node `hasty` ended with exit code 0 before it was ready"]
    );
}

#[test]
fn what_nodes_leave_behind_ends_with_their_window() {
    let place = Place::new(json!([
        {"name": "parent", "host": "sta1", "run": [
            "sh", "-c",
            "setsid sh -c 'trap \"\" TERM; echo $$ >\"$0/child\"; while :; do sleep 1; done' \"$1\" & \
             while ! test -s \"$1/child\"; do :; done; printf 'rtt_ms\\n1\\n' >\"$1/rtt.csv\"; cp \"$1/child\" \"$1/../child\"",
            "sh", "{window.folder}",
        ]},
    ]));
    assert!(place.run("1").success());
    let (record, command) = place.record(1);
    assert_ne!(record.verdict, Verdict::Invalid, "{:?}", record.reasons);
    assert!(command.left_behind >= 1);
    let child = fs::read_to_string(place.folder.path().join("work/child")).unwrap();
    assert!(!PathBuf::from(format!("/proc/{}", child.trim())).exists());
}

#[test]
fn a_program_that_is_not_there_is_named() {
    let place = Place::new(json!([{"name": "none", "host": "h1", "run": ["no-such-program"]}]));
    let output = place.command("1").stderr(Stdio::piped()).output().unwrap();
    assert!(!output.status.success());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("`no-such-program` cannot be started"), "{said}");
}
