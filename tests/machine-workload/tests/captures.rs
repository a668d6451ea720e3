//! Captures on a real network against the tools that others read and make captures with: tshark and tcpdump. As root;
//! where a tool is missing, it fails and says how to install it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream, UdpSocket},
    path::Path,
    process::{Child, Command, ExitCode, Stdio},
    thread,
    time::{Duration, Instant},
};

use machine_workload::real_network::{
    self, PORT, Packet, address, capture, next_window, read_capture, unix_now_ns, within,
};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use record::{
    settings::{CaptureSettings, CaptureTool, NetworkSettings},
    virtual_host::VirtualHost,
};
use workload::{
    capture::{Capture, CaptureError},
    network::Network,
};

fn main() -> ExitCode {
    real_network::run([
        (
            "tshark_and_tcpdump_read_every_packet_and_find_nothing_wrong",
            read_by_the_tools,
        ),
        (
            "tcpdump_beside_a_capture_sees_the_same_packets",
            tcpdump_beside_it,
        ),
        (
            "captures_by_tcpdump_itself_have_every_packet_in_its_window",
            by_tcpdump_itself,
        ),
        ("a_filter_keeps_what_it_names_with_either_tool", filtered),
        (
            "an_expression_that_tcpdump_does_not_know_is_refused_in_its_words",
            refused,
        ),
    ])
}

fn read_by_the_tools() {
    let folder = tempfile::tempdir().unwrap();
    let network = open();
    let captures = VirtualHost::OF_THE_BALL.map(|host| capture(&*network, host, &CaptureSettings::default()));
    let files = VirtualHost::OF_THE_BALL.map(|host| folder.path().join(format!("{host}.pcap")));
    for (capture, file) in captures.iter().zip(&files) {
        capture.begin_window(file.clone(), unix_now_ns()).unwrap();
    }
    talk(&*network);
    for (capture, file) in captures.iter().zip(&files) {
        capture.end(unix_now_ns()).unwrap();
        let record = next_window(capture);
        let file = file.to_str().unwrap();
        let rows = tool(
            "tshark",
            &[&["-r", file], &AS_WE_MEAN_IT[..], &FIELDS[..]].concat(),
        );
        assert_eq!(rows.lines().count() as u64, record.packets, "{}", record.host);
        for row in rows.lines() {
            let [number, malformed, checksums @ ..] = &row.split('\t').collect::<Vec<_>>()[..] else {
                panic!("{row}");
            };
            assert_eq!(*malformed, "", "packet {number}");
            // 1 is good; a packet has no TCP or no UDP. The kernel did not leave them to the device.
            assert!(checksums.iter().all(|status| ["", "1"].contains(status)), "{row}");
            assert!(checksums.contains(&"1"), "{row}");
        }
        let lines = tool(
            "tcpdump",
            &["-r", file, "-nn", "-tt", "--time-stamp-precision=nano"],
        );
        assert_eq!(lines.lines().count() as u64, record.packets, "{}", record.host);
        if record.host != VirtualHost::H1 {
            assert!(record.packets > 200, "{record:?}");
        }
    }
}

fn tcpdump_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let [ours, theirs] = ["ours.pcap", "theirs.pcap"].map(|name| folder.path().join(name));
    let network = open();
    let capture = capture(&*network, VirtualHost::STA1, &CaptureSettings::default());
    capture.begin_window(ours.clone(), unix_now_ns()).unwrap();
    let tcpdump = within(&*network, VirtualHost::STA1, |_| RunningTcpdump::start(&theirs));
    talk(&*network);
    let ended_ns = unix_now_ns();
    capture.end(ended_ns).unwrap();
    let record = next_window(&capture);
    tcpdump.end();
    let [ours, mut theirs] = [ours, theirs].map(|file| read_capture(&file));
    // The connection's last words come after the window.
    theirs.retain(|packet| packet.stamp_unix_ns < ended_ns);
    assert_eq!(record.packets as usize, ours.len());
    let furthest = assert_same(&ours, &theirs);
    eprintln!("{} packets, stamps differ by at most {furthest} ns", ours.len());
}

fn by_tcpdump_itself() {
    let folder = tempfile::tempdir().unwrap();
    let network = open();
    let settings = CaptureSettings {
        tool: CaptureTool::Tcpdump,
        ..CaptureSettings::default()
    };
    let captures = [CaptureSettings::default(), settings]
        .map(|settings| capture(&*network, VirtualHost::STA1, &settings));
    let began_ns = unix_now_ns();
    // In the midst of what is said.
    let boundary_ns = began_ns + 700_000_000;
    for (number, capture) in captures.iter().enumerate() {
        let file = |window: u32| folder.path().join(format!("{number}-{window}.pcap"));
        capture.begin_window(file(1), began_ns).unwrap();
        capture.begin_window(file(2), boundary_ns).unwrap();
    }
    talk(&*network);
    for capture in &captures {
        capture.end(unix_now_ns()).unwrap();
    }
    let [ours, theirs] = captures
        .each_ref()
        .map(|capture| [next_window(capture), next_window(capture)]);
    for window in [1, 2] {
        let [ours, theirs] =
            [0, 1].map(|number| read_capture(&folder.path().join(format!("{number}-{window}.pcap"))));
        assert!(ours.len() > 50, "window {window}: {} packets", ours.len());
        assert_same(&ours, &theirs);
    }
    assert!(
        ours.iter()
            .all(|record| record.tool == "builtin" && record.dropped == 0)
    );
    assert!(
        theirs
            .iter()
            .all(|record| record.tool.contains("tcpdump version") && record.dropped == 0),
        "{theirs:?}"
    );
}

fn filtered() {
    let folder = tempfile::tempdir().unwrap();
    let network = open();
    let tools = [CaptureTool::Builtin, CaptureTool::Tcpdump];
    let captures = tools.map(|tool| {
        let settings = CaptureSettings {
            tool,
            filter: Some(format!("udp and dst port {PORT}")),
            snaplen: record::quantity::Bytes::new(96),
            ..CaptureSettings::default()
        };
        capture(&*network, VirtualHost::STA2, &settings)
    });
    let files = tools.map(|tool| folder.path().join(format!("{tool:?}.pcap")));
    for (capture, file) in captures.iter().zip(&files) {
        capture.begin_window(file.clone(), unix_now_ns()).unwrap();
    }
    talk(&*network);
    let [ours, theirs] = [0, 1].map(|index| {
        captures[index].end(unix_now_ns()).unwrap();
        next_window(&captures[index]);
        read_capture(&files[index])
    });
    // Links lose none of them in this test.
    assert_eq!(ours.len(), usize::try_from(DATAGRAMS).unwrap());
    assert!(
        ours.iter()
            .all(|packet| packet.bytes.len() == 96 && packet.original_bytes == 14 + 20 + 8 + 200)
    );
    assert_same(&ours, &theirs);
}

fn refused() {
    let network = open();
    for tool in [CaptureTool::Builtin, CaptureTool::Tcpdump] {
        let settings = CaptureSettings {
            tool,
            filter: Some("udp prt 1".to_owned()),
            ..CaptureSettings::default()
        };
        let error = Capture::start(&*network, VirtualHost::STA1, &settings).unwrap_err();
        let said = match error {
            CaptureError::Filter { said, .. } | CaptureError::ToolEnded { said, .. } => said,
            other => panic!("{other:?}"),
        };
        assert!(said.contains("syntax error"), "{said}");
    }
}

/// Checksums are checked, and our bytes are nobody's protocol: tshark would guess one by the port that the kernel chose.
const AS_WE_MEAN_IT: [&str; 10] = [
    "-d",
    "tcp.port==4711,data",
    "-d",
    "udp.port==4711,data",
    "-o",
    "ip.check_checksum:TRUE",
    "-o",
    "tcp.check_checksum:TRUE",
    "-o",
    "udp.check_checksum:TRUE",
];

/// One line a packet.
const FIELDS: [&str; 12] = [
    "-T",
    "fields",
    "-e",
    "frame.number",
    "-e",
    "_ws.malformed",
    "-e",
    "ip.checksum.status",
    "-e",
    "tcp.checksum.status",
    "-e",
    "udp.checksum.status",
];

const DATAGRAMS: u32 = 100;

/// One and a half seconds of small messages both ways over TCP, datagrams, and a larger piece.
fn talk(network: &dyn Network) {
    let server = within(network, VirtualHost::STA2, |address| {
        TcpListener::bind(address).unwrap()
    });
    let datagrams = within(network, VirtualHost::STA2, |address| {
        UdpSocket::bind(address).unwrap()
    });
    let begun = Instant::now();
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut stream = server.accept().unwrap().0;
            let mut message = [0; 250];
            for _ in 0..DATAGRAMS {
                stream.read_exact(&mut message).unwrap();
                stream.write_all(&message[..100]).unwrap();
            }
            std::io::copy(&mut stream, &mut std::io::sink()).unwrap();
        });
        let client = within(network, VirtualHost::STA1, |_| {
            TcpStream::connect(address(VirtualHost::STA2)).unwrap()
        });
        let sender = within(network, VirtualHost::STA1, |_| {
            UdpSocket::bind(address(VirtualHost::STA1)).unwrap()
        });
        client.set_nodelay(true).unwrap();
        for number in 0..DATAGRAMS {
            thread::sleep((Duration::from_millis(12) * number).saturating_sub(begun.elapsed()));
            (&client).write_all(&[7; 250]).unwrap();
            sender.send_to(&[9; 200], address(VirtualHost::STA2)).unwrap();
        }
        let mut answers = vec![0; 100 * DATAGRAMS as usize];
        (&client).read_exact(&mut answers).unwrap();
        (&client).write_all(&vec![5; 200_000]).unwrap();
    });
    // The datagrams, of which nobody reads any, have come too by now: the stream behind them has.
    drop(datagrams);
}

/// Compares two captures packet by packet; the largest difference of stamps, which two sockets take from one packet.
///
/// A packet that leaves and one that arrives are given to the sockets by two processors at once, so that one socket can have
/// them in the other's reverse order: both captures are compared in the order of the stamps.
fn assert_same(ours: &[Packet], theirs: &[Packet]) -> i64 {
    assert_eq!(ours.len(), theirs.len());
    let [ours, theirs] = [ours, theirs].map(|packets| {
        let mut packets: Vec<_> = packets.iter().collect();
        packets.sort_by_key(|packet| (packet.stamp_unix_ns, &packet.bytes));
        packets
    });
    let mut furthest = 0;
    for (number, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
        assert_eq!(ours.original_bytes, theirs.original_bytes, "packet {number}");
        assert_eq!(ours.bytes, theirs.bytes, "packet {number}");
        furthest = furthest.max((ours.stamp_unix_ns - theirs.stamp_unix_ns).abs());
    }
    assert!(
        furthest <= LARGEST_DIFFERENCE_NS,
        "stamps differ by {furthest} ns"
    );
    furthest
}

/// The kernel stamps a packet once, for all sockets.
const LARGEST_DIFFERENCE_NS: i64 = 0;

/// A tcpdump that writes its own file.
struct RunningTcpdump(Child);

impl RunningTcpdump {
    fn start(file: &Path) -> Self {
        let mut child = Command::new("tcpdump")
            .args([
                "-i",
                "sta1-eth0",
                "-Z",
                "root",
                "-U",
                "--immediate-mode",
                "--time-stamp-precision=nano",
                "-w",
            ])
            .arg(file)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("tcpdump: {error}; apt-get install tcpdump"));
        let mut line = String::new();
        BufReader::new(child.stderr.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        assert!(line.contains("listening on"), "{line}");
        Self(child)
    }

    fn end(mut self) {
        kill(Pid::from_raw(self.0.id().try_into().unwrap()), Signal::SIGINT).unwrap();
        self.0.wait().unwrap();
    }
}

fn tool(name: &str, arguments: &[&str]) -> String {
    let output = Command::new(name)
        .args(arguments)
        .output()
        .unwrap_or_else(|error| panic!("{name}: {error}; apt-get install --no-install-recommends {name}"));
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// One that loses nothing.
fn open() -> Box<dyn Network> {
    real_network::open(&NetworkSettings {
        loss: "0%".parse().unwrap(),
        seed: Some(7),
        ..NetworkSettings::default()
    })
}
