//! The userspace network and the captures on it, with real namespaces and TAP devices: as root, or as an ordinary user
//! where user namespaces are allowed. Where neither is, it fails.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

use std::{
    collections::{HashMap, HashSet},
    io::ErrorKind,
    net::{SocketAddr, UdpSocket},
    panic::resume_unwind,
    process::ExitCode,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use machine_workload::{
    control,
    real_network::{
        self, Packet, address, next_window, open, open_unimpaired, read_capture, unix_now_ns, within,
    },
};
use record::{
    quantity::{Bytes, Fraction},
    settings::{CaptureSettings, NetworkSettings},
    topology::address_in_the_ball,
    virtual_host::VirtualHost,
    window::{CaptureRecord, PassRecord},
};
use workload::{
    capture::Capture,
    network::{self, Network},
};

fn main() -> ExitCode {
    real_network::run([
        (
            "a_survey_finds_what_the_network_needs",
            a_survey_finds_what_the_network_needs,
        ),
        (
            "a_given_seed_is_the_one_that_is_used_and_told",
            a_given_seed_is_used_and_told,
        ),
        ("the_network_is_as_slow_and_lossy_as_the_settings_ask", || {
            on_time(slow_and_lossy_as_asked)
        }),
        (
            "a_network_carries_at_once_and_without_loss_until_it_is_impaired",
            || on_time(at_once_until_impaired),
        ),
        ("tcp_gets_most_of_the_bandwidth", tcp_gets_most_of_the_bandwidth),
        (
            "contiguous_windows_share_all_packets_and_end_in_a_quiet_network",
            contiguous_windows,
        ),
        (
            "a_capture_cuts_packets_and_keeps_their_length",
            a_capture_cuts_packets,
        ),
    ])
}

/// Round trips that are tried.
const PINGS: u64 = 3000;
/// From one to the next.
const PING_EVERY: Duration = Duration::from_millis(2);
/// Nothing is under way for longer than this, however the machine stumbles.
const LONGEST: Duration = Duration::from_secs(1);

/// A machine on which a loop of a high priority waits for longer than this can fail a test by itself.
const DISTURBED_NS: i64 = 5_000_000;
/// How often a test is tried on such a machine.
const TRIES: usize = 8;

/// Runs a test that measures times until it has passed or failed on a machine that was on time. What fails each time has failed.
fn on_time(test: fn()) {
    for tried in 1.. {
        let (outcome, control) = control::beside(test);
        let Err(panic) = outcome else { return };
        eprintln!("failed at try {tried}, beside {control:?}");
        if control.max_ns < DISTURBED_NS || tried == TRIES {
            resume_unwind(panic);
        }
    }
}

fn a_survey_finds_what_the_network_needs() {
    network::survey(&NetworkSettings::default()).unwrap();
}

fn a_given_seed_is_used_and_told() {
    let network = open(&NetworkSettings {
        seed: Some(7),
        ..NetworkSettings::default()
    });
    assert_eq!(network.seed(), Some(7));
}

fn slow_and_lossy_as_asked() {
    let folder = tempfile::tempdir().unwrap();
    let network = open(&NetworkSettings {
        seed: Some(7),
        ..NetworkSettings::default()
    });
    let captures = VirtualHost::OF_THE_BALL.map(|host| capture_of(&*network, host, 65_535));
    let files = VirtualHost::OF_THE_BALL.map(|host| folder.path().join(format!("{host}.pcap")));
    for (capture, file) in captures.iter().zip(&files) {
        capture.begin_window(file.clone(), unix_now_ns()).unwrap();
    }
    let pings = ping(&*network, PINGS);
    for capture in &captures {
        capture.end(unix_now_ns()).unwrap();
    }
    let captured = captures.each_ref().map(next_window);
    assert_eq!(network.failure(), None);

    round_trips_take_as_long_as_asked(&pings);
    losses_are_as_asked(&pings, &*network);
    captures_have_what_happened(&pings, &captured, &files.map(|file| read_capture(&file)));
}

fn at_once_until_impaired() {
    let network = open_unimpaired(&NetworkSettings {
        loss: Fraction::from_percent(30.0),
        seed: Some(7),
        ..NetworkSettings::default()
    });
    let before = ping(&*network, 100);
    assert_eq!(before.round_trips.len(), 100);
    let shortest = before.round_trips.values().min().unwrap();
    assert!(*shortest < Duration::from_millis(5), "{shortest:?}");
    network.impair().unwrap();
    let after = ping(&*network, 100);
    assert!(after.round_trips.len() < 60, "{}", after.round_trips.len());
    let shortest = after.round_trips.values().min().unwrap();
    assert!(*shortest > Duration::from_millis(36), "{shortest:?}");
}

fn round_trips_take_as_long_as_asked(pings: &Pings) {
    let times_ms = pings.round_trips.values().map(|time| time.as_secs_f64() * 1e3);
    let [lower, median, upper] = quartiles(times_ms);
    let spread = upper - lower;
    eprintln!(
        "round trip: median {median:.3} ms, between the quartiles {spread:.3} ms, n = {}",
        pings.round_trips.len()
    );
    assert!((median - 40.0).abs() < 1.0, "median round trip {median} ms");
    // Four uniform delays of ±1 ms: 1.613 ms.
    assert!((spread - 1.613).abs() < 0.4, "{spread} ms between the quartiles");
}

fn losses_are_as_asked(pings: &Pings, network: &dyn Network) {
    let echoed = pings.echoed.len() as u64;
    let returned = pings.round_trips.len() as u64;
    eprintln!("sent {PINGS}, echoed {echoed}, returned {returned}");
    assert_plausible("one way out", PINGS - echoed, PINGS, 0.0199);
    assert_plausible("one way back", echoed - returned, echoed, 0.0199);

    let links = network.links();
    let (sta1, sta2) = (&links[1], &links[2]);
    for (name, pass) in [
        ("sta1 up", sta1.up),
        ("sta2 down", sta2.down),
        ("sta2 up", sta2.up),
        ("sta1 down", sta1.down),
    ] {
        eprintln!("{name}: {pass:?}");
        assert_eq!(
            pass.offered,
            pass.lost + pass.overflowed.unwrap() + pass.delivered,
            "{name}: {pass:?}"
        );
        assert_eq!(pass.overflowed, Some(0));
        assert_plausible(name, pass.lost, pass.offered, 0.01);
    }
    // What the hosts saw is what the links counted.
    assert_eq!(sta1.up.offered, PINGS);
    assert_eq!(lost(&[sta1.up, sta2.down]), PINGS - echoed);
    assert_eq!(lost(&[sta2.up, sta1.down]), echoed - returned);
}

fn captures_have_what_happened(pings: &Pings, records: &[CaptureRecord; 3], packets: &[Vec<Packet>; 3]) {
    for (record, packets) in records.iter().zip(packets) {
        assert_eq!(record.dropped, 0, "{record:?}");
        assert_eq!(record.packets, packets.len() as u64, "{record:?}");
        for packet in packets {
            assert_eq!(packet.original_bytes, packet.bytes.len());
            assert_checksums_hold(packet);
        }
    }
    let [h1, sta1, sta2] = packets;
    let (out, back) = (
        (VirtualHost::STA1, VirtualHost::STA2),
        (VirtualHost::STA2, VirtualHost::STA1),
    );
    let (sent, echoed) = (stamps(sta1, out), stamps(sta2, out));
    assert_eq!(sent.len() as u64, PINGS);
    assert_eq!(echoed.keys().copied().collect::<HashSet<_>>(), pings.echoed);
    assert_eq!(stamps(sta2, back).len(), pings.echoed.len());
    assert_eq!(stamps(sta1, back).len(), pings.round_trips.len());
    // The switch learns where sta2 is from its first answer, 10 ms after it was sent; before that, h1 gets everything.
    let first_answer = stamps(sta2, back).into_values().min().unwrap();
    for number in stamps(h1, out).into_keys() {
        assert!(
            sent[&number] < first_answer + 50_000_000,
            "h1 saw packet {number} between the others, {} ns after the first answer",
            sent[&number] - first_answer
        );
    }
    assert_eq!(
        stamps(h1, back).len(),
        0,
        "where sta1 is was known from the start"
    );

    let one_way_ms = |from: &HashMap<u64, i64>, to: &HashMap<u64, i64>| {
        let [_, median, _] = quartiles(
            to.iter()
                .map(|(number, stamp)| (stamp - from[number]) as f64 / 1e6),
        );
        median
    };
    let (there, back_again) = (
        one_way_ms(&sent, &echoed),
        one_way_ms(&stamps(sta2, back), &stamps(sta1, back)),
    );
    eprintln!("one way: {there:.3} ms there, {back_again:.3} ms back");
    assert!((there - 20.0).abs() < 0.5 && (back_again - 20.0).abs() < 0.5);
}

fn tcp_gets_most_of_the_bandwidth() {
    let network = open(&NetworkSettings {
        loss: "0%".parse().unwrap(),
        seed: Some(7),
        ..NetworkSettings::default()
    });
    let server = within(&*network, VirtualHost::STA2, |address| {
        std::net::TcpListener::bind(address).unwrap()
    });
    let bytes = 4_000_000;
    let taken = thread::scope(|scope| {
        let receiving =
            scope.spawn(|| std::io::copy(&mut server.accept().unwrap().0, &mut std::io::sink()).unwrap());
        let begun = Instant::now();
        let client = within(&*network, VirtualHost::STA1, |_| {
            std::net::TcpStream::connect(address(VirtualHost::STA2)).unwrap()
        });
        std::io::Write::write_all(&mut &client, &vec![1; bytes]).unwrap();
        drop(client);
        assert_eq!(receiving.join().unwrap(), bytes as u64);
        begun.elapsed()
    });
    let mbit = bytes as f64 * 8.0 / taken.as_secs_f64() / 1e6;
    eprintln!("TCP: {mbit:.2} Mbit/s");
    // 1448 of each frame's 1514 bytes are TCP's: at most 9.56 Mbit/s; slow start and reordering take their share.
    assert!((4.0..9.57).contains(&mbit), "{mbit} Mbit/s");
}

fn contiguous_windows() {
    let folder = tempfile::tempdir().unwrap();
    let network = open(&NetworkSettings {
        seed: Some(7),
        ..NetworkSettings::default()
    });
    let capture = capture_of(&*network, VirtualHost::STA1, 65_535);
    let first_ns = unix_now_ns();
    let second_ns = first_ns + 300_000_000;
    let [first, second, never] = ["1", "2", "3"].map(|name| folder.path().join(name));
    capture.begin_window(first.clone(), first_ns).unwrap();
    capture.begin_window(second.clone(), second_ns).unwrap();
    capture
        .begin_window(never.clone(), first_ns + 3600 * 1_000_000_000)
        .unwrap();
    let pings = ping(&*network, 250);
    capture.end(unix_now_ns()).unwrap();

    // Nothing is sent any more: both windows are completed all the same.
    let records = [next_window(&capture), next_window(&capture)];
    let packets = [read_capture(&first), read_capture(&second)];
    for (record, packets) in records.iter().zip(&packets) {
        assert_eq!(record.packets, packets.len() as u64);
        assert!(!packets.is_empty());
    }
    assert_eq!(
        packets.iter().map(Vec::len).sum::<usize>(),
        250 + pings.round_trips.len()
    );
    assert!(
        packets[0]
            .iter()
            .all(|packet| (first_ns..second_ns).contains(&packet.stamp_unix_ns))
    );
    assert!(packets[1].iter().all(|packet| packet.stamp_unix_ns >= second_ns));
    assert!(!never.exists(), "a window that never began left a file");
}

fn a_capture_cuts_packets() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("sta1.pcap");
    let network = open(&NetworkSettings {
        seed: Some(7),
        ..NetworkSettings::default()
    });
    let capture = capture_of(&*network, VirtualHost::STA1, 96);
    capture.begin_window(file.clone(), unix_now_ns()).unwrap();
    let client = udp(&*network, VirtualHost::STA1);
    for _ in 0..5 {
        client.send_to(&[9; 1000], address(VirtualHost::STA2)).unwrap();
    }
    // Dropped in the middle of a window: what there is of it is completed, and ends the channel.
    let completed = {
        capture.end(unix_now_ns()).unwrap();
        next_window(&capture)
    };
    assert_eq!(completed.packets, 5);
    for packet in read_capture(&file) {
        assert_eq!(
            (packet.original_bytes, packet.bytes.len()),
            (14 + 20 + 8 + 1000, 96)
        );
    }
}

/// What became of the pings from sta1 to sta2.
struct Pings {
    /// The numbers that reached sta2.
    echoed: HashSet<u64>,
    /// The numbers that came back, and after how long.
    round_trips: HashMap<u64, Duration>,
}

/// Sends numbered datagrams at a fixed rate and has them sent back.
fn ping(network: &dyn Network, count: u64) -> Pings {
    let client = udp(network, VirtualHost::STA1);
    let server = udp(network, VirtualHost::STA2);
    let begun = Instant::now();
    let due = |number: u64| PING_EVERY * u32::try_from(number).unwrap();
    let all_sent = AtomicBool::new(false);
    let (echoed, returned) = thread::scope(|scope| {
        let echoing = scope.spawn(|| {
            receive_all(&server, &all_sent, |datagram, from| {
                server.send_to(datagram, from).unwrap();
            })
        });
        let returning = scope.spawn(|| receive_all(&client, &all_sent, |_, _| ()));
        for number in 0..count {
            thread::sleep(due(number).saturating_sub(begun.elapsed()));
            let mut datagram = [0; 16];
            datagram[..8].copy_from_slice(&number.to_be_bytes());
            datagram[8..].copy_from_slice(&(begun.elapsed().as_nanos() as u64).to_be_bytes());
            client.send_to(&datagram, address(VirtualHost::STA2)).unwrap();
        }
        all_sent.store(true, Ordering::Relaxed);
        (echoing.join().unwrap(), returning.join().unwrap())
    });
    let round_trip = |(number, sent_ns, received): (u64, u64, Instant)| {
        (
            number,
            (received - begun).saturating_sub(Duration::from_nanos(sent_ns)),
        )
    };
    Pings {
        echoed: echoed.into_iter().map(|(number, ..)| number).collect(),
        round_trips: returned.into_iter().map(round_trip).collect(),
    }
}

/// Receives until all was sent and nothing came for long since; each with its number and sender's time.
fn receive_all(
    socket: &UdpSocket,
    all_sent: &AtomicBool,
    mut then: impl FnMut(&[u8], SocketAddr),
) -> Vec<(u64, u64, Instant)> {
    socket.set_read_timeout(Some(LONGEST)).unwrap();
    let mut received = Vec::new();
    let mut datagram = [0; 16];
    loop {
        let last = all_sent.load(Ordering::Relaxed);
        match socket.recv_from(&mut datagram) {
            Ok((_, from)) => {
                let now = Instant::now();
                then(&datagram, from);
                let field = |at: usize| u64::from_be_bytes(datagram[at..at + 8].try_into().unwrap());
                received.push((field(0), field(8), now));
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock && last => return received,
            Err(error) if error.kind() == ErrorKind::WouldBlock => (),
            Err(error) => panic!("{error}"),
        }
    }
}

/// A capture on a host that keeps so much of each packet.
fn capture_of(network: &dyn Network, host: VirtualHost, snaplen: u64) -> Capture {
    let settings = CaptureSettings {
        snaplen: Bytes::new(snaplen),
        ..CaptureSettings::default()
    };
    real_network::capture(network, host, &settings)
}

fn udp(network: &dyn Network, host: VirtualHost) -> UdpSocket {
    within(network, host, |address| UdpSocket::bind(address).unwrap())
}

fn lost(passes: &[PassRecord]) -> u64 {
    passes.iter().map(|pass| pass.lost).sum()
}

/// The exact binomial test, two-sided at 0.1 %: the rate asked for lies in the 99.9 % interval of Clopper and Pearson
/// (Biometrika 26, 1934).
fn assert_plausible(what: &str, lost: u64, of: u64, rate: f64) {
    let at_most: f64 = (0..=lost).map(|k| binomial_probability(k, of, rate)).sum();
    let at_least = 1.0 - at_most + binomial_probability(lost, of, rate);
    eprintln!(
        "{what}: {lost} of {of} lost, {:.2} % for {:.2} %",
        100.0 * lost as f64 / of as f64,
        100.0 * rate
    );
    assert!(
        at_most > 0.0005 && at_least > 0.0005,
        "{what}: {lost} of {of} lost at a rate of {rate}"
    );
}

fn binomial_probability(k: u64, n: u64, p: f64) -> f64 {
    let log_choose: f64 = (1..=k).map(|i| ((n - k + i) as f64 / i as f64).ln()).sum();
    (log_choose + k as f64 * p.ln() + (n - k) as f64 * (-p).ln_1p()).exp()
}

/// In order, so that a moment in which the machine did something else is one value among many.
fn quartiles(values: impl Iterator<Item = f64>) -> [f64; 3] {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    [1, 2, 3].map(|quarter| values[values.len() * quarter / 4])
}

/// The numbers of the datagrams that went from one host to another, and when.
fn stamps(packets: &[Packet], (from, to): (VirtualHost, VirtualHost)) -> HashMap<u64, i64> {
    let between = |packet: &&Packet| {
        packet.bytes[26..30] == address_in_the_ball(from).octets()
            && packet.bytes[30..34] == address_in_the_ball(to).octets()
    };
    let number = |packet: &Packet| u64::from_be_bytes(packet.bytes[42..50].try_into().unwrap());
    packets
        .iter()
        .filter(between)
        .map(|packet| (number(packet), packet.stamp_unix_ns))
        .collect()
}

/// RFC 791 and RFC 768: the ones' complement sum over header or datagram, its checksum included, is all ones.
fn assert_checksums_hold(packet: &Packet) {
    assert_eq!(
        packet.bytes[12..14],
        [0x08, 0x00],
        "IPv4 and nothing else: {:02x?}",
        packet.bytes
    );
    let (header, datagram) = packet.bytes[14..].split_at(20);
    assert_eq!(header[9], 17, "UDP and nothing else");
    assert_eq!(ones_complement_sum(header), 0xffff);
    assert_ne!(datagram[6..8], [0, 0], "UDP has a checksum");
    let pseudo = [&header[12..20], &[0, 17], &datagram[4..6], datagram].concat();
    assert_eq!(ones_complement_sum(&pseudo), 0xffff);
}

fn ones_complement_sum(bytes: &[u8]) -> u32 {
    let sum: u32 = bytes
        .chunks(2)
        .map(|pair| u32::from(pair[0]) << 8 | u32::from(pair.get(1).copied().unwrap_or(0)))
        .sum();
    let folded = (sum & 0xffff) + (sum >> 16);
    (folded & 0xffff) + (folded >> 16)
}
