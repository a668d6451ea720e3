//! The paper's network, for real: Mininet, Open vSwitch and its OpenFlow controller in a guest that has the kernel for it.

use std::{
    process::{Child, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use serde_json::Value;
use tests::{Guest, Ran, matrix_binary, workload_binary};

/// Far more than anything here takes; it only ends a hopeless wait, and leaves Mininet its own timeout.
const HOPELESS: Duration = Duration::from_secs(420);
/// What the names of our bridges and interfaces begin with.
const OURS: &str = "mx";

/// Each test has the guest for itself, with Open vSwitch running in it.
struct Turn {
    guest: &'static Guest,
    _turn: MutexGuard<'static, ()>,
}

fn turn() -> Turn {
    static ONE: Mutex<()> = Mutex::new(());
    let turn = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let guest = Guest::shared();
    guest.put(workload_binary(), "/root/workload");
    guest.expect(&["systemctl", "start", "openvswitch-switch"]);
    Turn { guest, _turn: turn }
}

impl Turn {
    /// A workload with Mininet's network, as `matrix` starts one: with an empty environment.
    fn workload<'a>(&self, data: &'a str, window: &str, windows: &'a str) -> Vec<String> {
        let settings = format!(
            r#"{{"dynamics": "robust", "windows": 2, "window": "{window}", "period": "5s", "network": {{"backend": "mininet"}}}}"#
        );
        [
            "env",
            "-i",
            "/root/workload",
            "run",
            "--environment",
            data,
            "--settings",
            &settings,
            "--data",
        ]
        .into_iter()
        .chain([data, "--windows", windows])
        .map(str::to_owned)
        .collect()
    }

    fn run(&self, command: &[String]) -> Ran {
        self.guest
            .run(&command.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// Starts a workload whose connection may end before it.
    fn start(&self, command: &[String]) -> Child {
        self.guest
            .command(&command.iter().map(String::as_str).collect::<Vec<_>>())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("ssh starts")
    }

    /// What a shell in the guest prints.
    fn shell(&self, line: &str) -> String {
        self.guest.run(&["sh", "-c", line]).out
    }

    /// Waits until a shell's line succeeds; every look is a command over SSH.
    fn wait_until(&self, what: &str, line: &str) {
        let deadline = Instant::now() + HOPELESS;
        while self.guest.run(&["sh", "-c", line]).code != Some(0) {
            assert!(
                Instant::now() < deadline,
                "{what} did not come to pass\n{}",
                self.shell("ovs-vsctl show; ip -br link; ps ax; cat /root/*/progress.jsonl")
            );
        }
    }

    fn wait_for_measuring(&self, data: &str) {
        self.wait_until("measuring", &format!("grep -q measuring {data}/progress.jsonl"));
    }

    /// The process that its data folder names.
    fn pid(&self, data: &str) -> String {
        let progress = self
            .guest
            .expect(&["head", "-n1", &format!("{data}/progress.jsonl")]);
        let started: Value = serde_json::from_str(&progress).expect("progress is JSON");
        started["pid"].to_string()
    }

    /// Our bridges and interfaces and the processes of Mininet, one a line.
    fn left(&self) -> String {
        self.shell(&format!(
            "ovs-vsctl --bare --columns=name list Bridge | grep ^{OURS}; ip -br link | grep ^{OURS}; \
             ps -eo args | grep -E '[m]ininet:|[o]vs-testcontroller|[n]etwork.py'; ls /tmp | grep {OURS}"
        ))
    }

    fn wait_until_nothing_is_left(&self) {
        let deadline = Instant::now() + HOPELESS;
        loop {
            let left = self.left();
            if left.is_empty() {
                return;
            }
            assert!(Instant::now() < deadline, "left behind:\n{left}");
        }
    }
}

/// Answers each datagram with itself, and how long those of a peer take there and back.
const ECHO: &str = "import socket\ns = socket.socket(type=socket.SOCK_DGRAM)\ns.bind(('', 5000))\nprint('up', flush=True)\n\
    while True: s.sendto(*s.recvfrom(100))";
const PING: &str = "import socket, sys, time\ns = socket.socket(type=socket.SOCK_DGRAM)\ns.connect((sys.argv[1], 5000))\n\
    with open(sys.argv[2] + '/rtt.csv', 'w') as f:\n print('rtt_ms', file=f)\n for _ in range(20):\n  \
    t = time.monotonic(); s.send(b'x'); s.recv(100); print(1000 * (time.monotonic() - t), file=f)";

#[test]
fn nodes_on_a_tree_of_switches_meet_the_same_links_in_mininets_network_and_in_the_kernels() {
    let turn = turn();
    for backend in ["mininet", "kernel"] {
        let settings = serde_json::json!({
            "network": {
                "backend": backend, "delay": "1ms", "jitter": "0ms", "loss": "0%",
                "hosts": {"robot": {"switch": "s3"}, "other": {}, "base": {"delay": "5ms"}},
                "switches": {"s1": {}, "s2": {"delay": "3ms"}, "s3": {"switch": "s2", "delay": "4ms"}},
            },
            "experiment": {
                "name": "ping",
                "nodes": [
                    {"name": "echo", "host": "base", "run": ["python3", "-c", ECHO], "ready": {"line": "up"}, "background": true},
                    {"name": "ping", "host": "robot", "run": ["python3", "-c", PING, "{hosts.base.address}", "{window.folder}"]},
                ],
                "metrics": [{"name": "rtt", "unit": "ms", "from": "rtt.csv", "column": "rtt_ms"}],
            },
        })
        .to_string();
        let data = format!("/root/tree-{backend}");
        let work = format!("{data}-work");
        let ran = turn.guest.run(&[
            "/root/workload",
            "run",
            "--environment",
            "tree",
            "--settings",
            &settings,
            "--data",
            &data,
            "--work",
            &work,
            "--windows",
            "1",
        ]);
        assert_eq!(ran.code, Some(0), "{backend}: {}{}", ran.out, ran.err);
        assert_eq!(turn.left(), "", "{backend}: nothing is left");
        let read = |file: &str| turn.guest.expect(&["cat", &format!("{data}/window-1/{file}")]);
        let record: Value = serde_json::from_str(&read("window.json")).unwrap();
        assert_eq!(record["command"]["exit_code"], 0, "{backend}: {record:#}");
        let round_trips = read("rtt.csv");
        let round_trips: Vec<f64> = round_trips
            .lines()
            .skip(1)
            .map(|line| line.parse().unwrap())
            .collect();
        assert_eq!(round_trips.len(), 20);
        let least = 2.0 * (1.0 + 4.0 + 3.0 + 5.0);
        assert!(
            round_trips.iter().all(|ms| *ms >= least),
            "{backend}: {round_trips:?}"
        );
        let quickest = round_trips.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(quickest < 2.0 * least, "{backend}: {round_trips:?}");
        let links = record["links"].as_array().unwrap();
        let names: Vec<&str> = links.iter().map(|link| link["host"].as_str().unwrap()).collect();
        assert_eq!(names, ["robot", "other", "base", "s2", "s3"]);
        for at in [0, 3, 4] {
            assert!(
                links[at]["up"]["delivered"].as_u64() >= Some(20),
                "{backend}: {:#}",
                links[at]
            );
            assert!(
                links[at]["down"]["delivered"].as_u64() >= Some(20),
                "{backend}: {:#}",
                links[at]
            );
        }
    }
}

#[test]
fn two_windows_on_mininets_network_and_what_it_was_is_written_down() {
    let turn = turn();
    let ran = turn.run(&turn.workload("/root/two", "10s", "1,2"));
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert_eq!(turn.left(), "", "it is waited for until all is gone");

    let text = turn.guest.expect(&["cat", "/root/two/network.txt"]);
    for (line, times) in [
        // Both ends of three links, told once and looked at twice.
        (" root handle 5:0 htb default 1\n", 6),
        ("rate 10.000000Mbit burst 15k\n", 6),
        ("handle 10: netem delay 10ms 1ms loss 1.00000 limit 1000\n", 6),
        (
            "class htb 5:1 root leaf 10: prio 0 rate 10Mbit ceil 10Mbit burst 15Kb cburst 1600b",
            12,
        ),
        (
            "qdisc netem 10: parent 5:1 limit 1000 delay 10ms  1ms loss 1%",
            12,
        ),
        ("is_connected: true", 2),
        ("fail_mode: secure", 2),
        ("# mn --version\n2.3.0\n", 1),
        ("ovs-vswitchd (Open vSwitch) 3.", 1),
        ("ovs-testcontroller (Open vSwitch) 3.", 1),
    ] {
        assert_eq!(text.matches(line).count(), times, "{line:?} in\n{text}");
    }
    // The controller installed flows for the states and for the commands: both directions of sta1 and sta2.
    for (source, destination) in [("10.0.0.2", "10.0.0.3"), ("10.0.0.3", "10.0.0.2")] {
        let flow = format!("nw_src={source},nw_dst={destination}");
        let flows = text
            .lines()
            .filter(|line| line.contains("tcp,") && line.contains(&flow));
        assert!(
            flows.clone().any(|line| line.contains("actions=output:")),
            "no flow {flow} in\n{text}"
        );
    }

    for window in ["window-1", "window-2"] {
        let record = turn
            .guest
            .expect(&["cat", &format!("/root/two/{window}/window.json")]);
        let record: Value = serde_json::from_str(&record).expect("the record is JSON");
        assert_eq!(record["complete"], true, "{record}");
        assert_eq!(record["network_seed"], Value::Null);
        // On an emulated processor steps are late; then the window says so.
        let reasons = record["reasons"].as_array().expect("reasons are listed");
        assert_eq!(record["verdict"] == "valid", reasons.is_empty(), "{record}");
        let links = record["links"].as_array().expect("links are listed");
        assert_eq!(links.len(), 3, "{record}");
        for link in &links[1..] {
            for pass in ["up", "down"] {
                // 500 messages and their acknowledgements go each way; captures are on, so that none is unaccounted for.
                assert!(link[pass]["offered"].as_u64() > Some(500), "{record}");
                assert!(link[pass]["delivered"].as_u64() > Some(450), "{record}");
            }
        }
        let capture = format!("/root/two/{window}/sta1.pcap");
        assert!(!turn.guest.expect(&["tcpdump", "-nr", &capture, "tcp"]).is_empty());
        assert_eq!(
            turn.guest.expect(&["tcpdump", "-nr", &capture, "not tcp"]),
            "",
            "neither IPv6 nor ARP is on the links"
        );
    }
}

#[test]
fn a_round_trip_takes_40_ms_and_packets_are_lost_as_asked() {
    const PINGS: u32 = 400;
    let turn = turn();
    let mut workload = turn.start(&turn.workload("/root/ping", "600s", "1"));
    turn.wait_for_measuring("/root/ping");
    let said = turn.shell(&format!(
        "nsenter -t $(pgrep -f 'mininet:h1$') -n ping -q -i 0.05 -c {PINGS} 10.0.0.3"
    ));
    turn.guest.expect(&["kill", &turn.pid("/root/ping")]);
    workload.wait().expect("ssh ends");
    turn.wait_until_nothing_is_left();

    // `400 packets transmitted, 384 received, 4% packet loss, time 20123ms`, `rtt min/avg/max/mdev = 38.1/…`
    let number = |text: &str| text.parse::<f64>().expect("a number");
    let received = said
        .split(" received")
        .next()
        .and_then(|text| text.rsplit(' ').next());
    let lost = f64::from(PINGS) - received.map(number).expect("ping counts");
    let times = said.split("mdev = ").nth(1).expect("ping measures");
    let times: Vec<f64> = times.split([' ', '/']).take(4).map(number).collect();
    let (shortest, mean) = (times[0], times[1]);
    // Four passes of at least 9 ms. What an emulated processor adds to the mean depends on the machine's load.
    assert!((36.0..45.0).contains(&shortest), "{said}");
    assert!(mean > 39.0, "{said}");
    // Four passes of 1 %: 3.94 % of 400. The interval leaves out one in a million on either side (binomial).
    assert!((1.0..=37.0).contains(&lost), "{said}");
}

#[test]
fn two_networks_on_one_machine_do_not_meet() {
    let turn = turn();
    let mut first = turn.start(&turn.workload("/root/first", "10s", "1"));
    let ran = turn.run(&turn.workload("/root/second", "10s", "1"));
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    first.wait().expect("ssh ends");
    turn.wait_until_nothing_is_left();
    for data in ["/root/first", "/root/second"] {
        let progress = turn.guest.expect(&["cat", &format!("{data}/progress.jsonl")]);
        assert!(progress.contains("\"finished\""), "{progress}");
    }
}

#[test]
fn nothing_is_left_of_a_workload_that_was_killed() {
    let turn = turn();
    let mut workload = turn.start(&turn.workload("/root/killed", "600s", "1"));
    turn.wait_for_measuring("/root/killed");
    assert!(turn.left().contains("mininet:sta2"), "{}", turn.left());
    turn.guest.expect(&["kill", "-9", &turn.pid("/root/killed")]);
    workload.wait().expect("ssh ends");
    turn.wait_until_nothing_is_left();
}

#[test]
fn a_workload_whose_mininet_was_killed_fails_and_leaves_nothing() {
    let turn = turn();
    let mut workload = turn.start(&turn.workload("/root/bereft", "600s", "1"));
    turn.wait_for_measuring("/root/bereft");
    turn.guest.expect(&["pkill", "-9", "-f", "network.py"]);
    workload.wait().expect("ssh ends");
    let progress = turn.guest.expect(&["tail", "-n1", "/root/bereft/progress.jsonl"]);
    assert!(
        progress.contains("the program that holds Mininet's network has ended"),
        "{progress}"
    );
    turn.wait_until_nothing_is_left();
}

#[test]
fn what_is_left_when_all_was_killed_goes_with_the_next_network_and_others_bridges_stay() {
    let turn = turn();
    // Bridges of others: one of another Mininet, and one whose name is like ours.
    turn.guest.expect(&[
        "ovs-vsctl",
        "--may-exist",
        "add-br",
        "s1",
        "--",
        "--may-exist",
        "add-br",
        "mxtheirs",
    ]);
    let mut workload = turn.start(&turn.workload("/root/all", "600s", "1"));
    turn.wait_for_measuring("/root/all");
    turn.guest
        .expect(&["pkill", "-9", "-f", "network.py|/root/workload"]);
    workload.wait().expect("ssh ends");
    let bridges = "ovs-vsctl list-br | grep '^mx' | grep -v mxtheirs";
    turn.wait_until(
        "the end of all processes and interfaces",
        "! ps -eo args | grep -qE '[m]ininet:|[o]vs-testcontroller' && ! ip -br link | grep -q '^mx.*-eth'",
    );
    let left = turn.shell(bridges);
    assert_eq!(left.lines().count(), 1, "the bridge is Open vSwitch's: {left}");

    let ran = turn.run(&turn.workload("/root/next", "5s", "1"));
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert_eq!(turn.shell(bridges), "");
    assert_eq!(turn.shell("ovs-vsctl list-br"), "mxtheirs\ns1\n");
    turn.guest
        .expect(&["ovs-vsctl", "del-br", "s1", "--", "del-br", "mxtheirs"]);
}

/// The `matrix` command in the guest, in a new folder that has a matrix file with Mininet's network.
struct Matrix<'a> {
    turn: &'a Turn,
    folder: String,
}

impl<'a> Matrix<'a> {
    fn new(turn: &'a Turn, name: &str, window: &str) -> Self {
        let folder = format!("/root/{name}");
        // It is linked to the C library of the machine that built it, which must not be newer than the guest's.
        if turn.guest.run(&["test", "-e", "/root/matrix"]).code != Some(0) {
            turn.guest.put(matrix_binary(), "/root/matrix");
        }
        turn.guest.expect(&["/root/matrix", "--version"]);
        let file = format!(
            "matrix:\n  virtualization: [native]\n\
             workload:\n  dynamics: robust\n  windows: 1\n  window: {window}\n  period: 5s\n  network: {{backend: mininet}}\n"
        );
        turn.guest.expect(&[
            "sh",
            "-c",
            "mkdir \"$0\" && printf %s \"$1\" >\"$0/m.yaml\"",
            &folder,
            &file,
        ]);
        Self { turn, folder }
    }

    /// As the guest's shell is told of it.
    fn line(&self, arguments: &str) -> String {
        let folder = &self.folder;
        format!("cd {folder} && MATRIX_STATE_DIR={folder}/state exec /root/matrix {arguments}")
    }

    fn run(&self, arguments: &str) -> Ran {
        self.turn.guest.run(&["sh", "-c", &self.line(arguments)])
    }

    /// A file of the one scenario of the one run.
    fn file(&self, name: &str) -> String {
        let path = format!("{}/runs/*/scenarios/*/{name}", self.folder);
        self.turn.guest.expect(&["sh", "-c", &format!("cat {path}")])
    }
}

#[test]
fn matrix_run_measures_on_mininets_network_and_the_run_directory_tells_of_it() {
    let turn = turn();
    let matrix = Matrix::new(&turn, "whole", "10s");
    let plan = matrix.run("plan m.yaml");
    assert_eq!(plan.code, Some(0), "{plan:?}");
    let ran = matrix.run("run m.yaml");
    let record: Value = serde_json::from_str(&matrix.file("window-1/window.json")).expect("it is JSON");
    assert_eq!(record["complete"], true, "{record}");
    // On an emulated processor steps are late and the window may not count: it is measured all the same.
    assert_eq!(ran.code, Some(0), "{ran:?}\n{record}");
    let text = matrix.file("network.txt");
    for part in [
        "# ovs-vsctl show\n",
        "# ovs-ofctl dump-flows ",
        "is_connected: true",
        "nw_src=10.0.0.3,nw_dst=10.0.0.2",
        "qdisc netem 10: parent 5:1 limit 1000 delay 10ms  1ms loss 1%",
    ] {
        assert!(text.contains(part), "{part:?} is missing in\n{text}");
    }
    assert_eq!(turn.left(), "");
    let clean = matrix.run("clean");
    assert_eq!(clean.code, Some(0), "{clean:?}");
    assert!(!clean.out.contains("bridge"), "{clean:?}");
}

#[test]
fn matrix_clean_removes_the_bridge_of_a_run_that_was_killed_with_all_its_processes() {
    let turn = turn();
    let matrix = Matrix::new(&turn, "cut", "600s");
    let mut running = turn.start(&["sh", "-c", &matrix.line("run m.yaml")].map(str::to_owned));
    turn.wait_until(
        "measuring",
        "grep -q measuring /root/cut/state/environments/*/data/progress.jsonl",
    );
    // The one that would resume it, the workload, and the program that holds the network.
    turn.guest.expect(&[
        "pkill",
        "-9",
        "-f",
        "^/root/matrix run|--environment matrix-|network.py",
    ]);
    running.wait().expect("ssh ends");
    turn.wait_until(
        "the end of all processes",
        "! ps -eo args | grep -qE '[m]ininet:|[o]vs-testcontroller'",
    );
    let bridge = turn.shell(&format!("ovs-vsctl list-br | grep ^{OURS}"));
    assert_eq!(
        bridge.lines().count(),
        1,
        "the bridge is Open vSwitch's: {bridge}"
    );

    let dry = matrix.run("clean --dry-run");
    assert_eq!(dry.code, Some(0), "{dry:?}");
    assert!(dry.out.contains(bridge.trim()), "{dry:?}");
    assert_eq!(turn.shell("ovs-vsctl list-br"), bridge, "it was only listed");
    let clean = matrix.run("clean");
    assert_eq!(clean.code, Some(0), "{clean:?}");
    assert!(clean.out.contains(bridge.trim()), "{clean:?}");
    assert_eq!(turn.shell("ovs-vsctl list-br"), "");
    assert_eq!(turn.left(), "");
}

#[test]
fn what_is_missing_is_said_before_a_run() {
    let turn = turn();
    let check = |turn: &Turn| -> Value {
        let settings = r#"{"network": {"backend": "mininet"}}"#;
        let said = turn
            .guest
            .expect(&["env", "-i", "/root/workload", "check", "--settings", settings]);
        let check: Value = serde_json::from_str(&said).expect("the check is JSON");
        check["checks"][0].clone()
    };
    assert_eq!(check(&turn)["available"], true);

    turn.guest.expect(&["systemctl", "stop", "openvswitch-switch"]);
    let stopped = check(&turn);
    assert_eq!(stopped["available"], false, "{stopped}");
    assert!(
        stopped["reason"]
            .to_string()
            .contains("Open vSwitch does not answer"),
        "{stopped}"
    );
    assert!(
        stopped["fix"]
            .to_string()
            .contains("systemctl start openvswitch-switch"),
        "{stopped}"
    );

    let mnexec = "/usr/bin/mnexec";
    turn.guest.expect(&["mv", mnexec, "/root/mnexec"]);
    let missing = check(&turn);
    turn.guest.expect(&["mv", "/root/mnexec", mnexec]);
    assert!(
        missing["reason"].to_string().contains("mnexec is not installed"),
        "{missing}"
    );
    assert!(
        missing["fix"].to_string().contains("apt-get install mininet"),
        "{missing}"
    );
}
