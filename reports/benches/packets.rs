//! The packets of one long window: delays, RTT, jitter, lost and retransmitted packets, from both captures as they are
//! stored, against what `tshark -T fields` takes to read the same two files and look for the same.
//!
//! `cargo bench --profile dev --workspace --bench packets`, in the profile that users have; needs tshark. Prints medians; it is
//! not a test and has no bound. docs/performance.md has the last figures.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // As in tests, whose run directories these are.

use std::{
    fs,
    hint::black_box,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use etherparse::{PacketBuilder, TcpOptionElement};
use pcap_file::{
    DataLink, Endianness, TsResolution,
    pcap::{PcapHeader, PcapPacket, PcapWriter},
};
use record::{
    topology::address_in_the_ball,
    virtual_host::VirtualHost,
    window::{CaptureRecord, FileRecord, MeasuredFile},
};
use sha2::{Digest, Sha256};
use synthetic::{Scenario, Synthetic};
use timing::{median, time};

#[path = "../tests/reports/synthetic.rs"]
mod synthetic;
mod timing;

const STEPS: u64 = 300_000;
const STEP_NS: u64 = 20_000_000;
const DELAY_NS: u64 = 20_000_000;
/// One packet in so many is lost, and retransmitted.
const LOST_EVERY: u64 = 50;
const ROUNDS: usize = 3;
const SLUG: &str = "a-a-native";
/// What stands for the same quantities.
const FIELDS: [&str; 10] = [
    "frame.time_epoch",
    "ip.src",
    "ip.dst",
    "ip.id",
    "tcp.stream",
    "tcp.seq",
    "tcp.len",
    "tcp.options.timestamp.tsval",
    "tcp.analysis.ack_rtt",
    "tcp.analysis.retransmission",
];

fn main() {
    let synthetic = Synthetic::new(&[Scenario::measured(SLUG, &[0.1])]);
    let folder = synthetic.directory.window(SLUG, 1).path();
    let captures = write_captures(&synthetic, &folder);
    let run = reports::load(synthetic.directory.path()).unwrap();
    let traffic = reports::input::traffic::read(&run);
    let [state, _] = &traffic.scenarios["a"].windows[0].directions;
    let lost = state.total(|period| period.lost);
    assert_eq!(
        lost,
        state.total(|period| period.retransmitted),
        "as they were made"
    );

    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        ours.push(time(|| reports::input::traffic::read(&run)));
        theirs.push(time(|| captures.iter().for_each(|capture| tshark(capture))));
    }
    let packets: u64 = run.scenarios[0]
        .counted()
        .map(|(_, record, _)| record.captures.iter().map(|capture| capture.packets).sum::<u64>())
        .sum();
    let (ours, theirs) = (median(ours).as_secs_f64(), median(theirs).as_secs_f64());
    println!("{packets} packets in two captures of one window, {lost} lost; medians of {ROUNDS} rounds");
    let row = |name: &str, took: f64| {
        println!(
            "{name:<24} {took:>8.2} s {:>12.0} packets/s {:>8.1} x",
            packets as f64 / took,
            took / ours
        );
    };
    row("matrix", ours);
    row("tshark -T fields", theirs);
}

/// Both hosts' captures, compressed as the workload leaves them, and their places in the window's record.
fn write_captures(synthetic: &Synthetic, folder: &Path) -> Vec<PathBuf> {
    let mut seen = [Vec::new(), Vec::new()];
    let mut numbers = [0_u16; 2];
    let mut send = |from: usize, step: u64, at_ns: u64, is_lost: bool| {
        numbers[from] = numbers[from].wrapping_add(1);
        let frame = frame(from, step, at_ns, numbers[from]);
        seen[from].push((at_ns, frame.clone()));
        if !is_lost {
            seen[1 - from].push((at_ns + DELAY_NS, frame));
        }
    };
    for step in 1..=STEPS {
        for from in [0, 1] {
            let at_ns = step * STEP_NS + from as u64 * STEP_NS / 2;
            let is_lost = step % LOST_EVERY == 0;
            send(from, step, at_ns, is_lost);
            if is_lost {
                send(from, step, at_ns + 3 * STEP_NS + 1_000_000, false);
            }
        }
    }
    let hosts = [VirtualHost::STA1, VirtualHost::STA2];
    let mut paths = Vec::new();
    let mut records = Vec::new();
    for (host, mut packets) in hosts.into_iter().zip(seen) {
        packets.sort_by_key(|(at_ns, _)| *at_ns);
        let name = format!("{host}.pcap.zst");
        let path = folder.join(&name);
        let plain = pcap(&packets);
        let packed = zstd::encode_all(&*plain, 3).unwrap();
        fs::write(&path, &packed).unwrap();
        let file = FileRecord {
            name,
            bytes: packed.len() as u64,
            sha256: format!("{:x}", Sha256::digest(&packed)),
            measured: Some(MeasuredFile {
                bytes: plain.len() as u64,
                sha256: format!("{:x}", Sha256::digest(&plain)),
            }),
        };
        records.push((host, packets.len() as u64, file));
        paths.push(path);
    }
    synthetic.edit_window(SLUG, 1, |record| {
        record.ended_ns = (STEPS * STEP_NS) as i64;
        record.ended_unix_ns = record.ended_ns;
        for (host, packets, file) in records {
            record.captures.push(CaptureRecord {
                host,
                packets,
                dropped: 0,
                tool: "builtin".to_owned(),
            });
            record.files.push(file);
        }
    });
    paths
}

/// A message of the experiment's size, as Linux sends it.
fn frame(from: usize, step: u64, at_ns: u64, number: u16) -> Vec<u8> {
    const PAYLOAD: usize = 211;
    let hosts = [VirtualHost::STA1, VirtualHost::STA2];
    let (sender, receiver) = (hosts[from], hosts[1 - from]);
    let mut ip = etherparse::Ipv4Header::new(
        0,
        64,
        etherparse::IpNumber::TCP,
        address_in_the_ball(sender).octets(),
        address_in_the_ball(receiver).octets(),
    )
    .unwrap();
    ip.identification = number;
    let acknowledged = step.saturating_sub(1) * PAYLOAD as u64;
    let options = [TcpOptionElement::Timestamp((at_ns / 1_000_000) as u32, 0)];
    let mut bytes = Vec::new();
    PacketBuilder::ethernet2([0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 2])
        .ip(etherparse::IpHeaders::Ipv4(
            ip,
            etherparse::Ipv4Extensions::default(),
        ))
        .tcp(
            4000 + from as u16,
            4001 - from as u16,
            (step * PAYLOAD as u64) as u32,
            1024,
        )
        .ack(acknowledged as u32)
        .options(&options)
        .unwrap()
        .write(&mut bytes, &[step as u8; PAYLOAD])
        .unwrap();
    bytes
}

fn pcap(packets: &[(u64, Vec<u8>)]) -> Vec<u8> {
    let header = PcapHeader {
        version_major: 2,
        version_minor: 4,
        ts_correction: 0,
        ts_accuracy: 0,
        snaplen: 65_535,
        datalink: DataLink::ETHERNET,
        ts_resolution: TsResolution::NanoSecond,
        endianness: Endianness::Little,
    };
    let mut writer = PcapWriter::with_header(Vec::new(), header).unwrap();
    for (at_ns, bytes) in packets {
        let packet = PcapPacket::new(Duration::from_nanos(*at_ns), bytes.len() as u32, bytes);
        writer.write_packet(&packet).unwrap();
    }
    writer.into_writer()
}

fn tshark(capture: &Path) {
    let mut command = Command::new("tshark");
    command.arg("-r").arg(capture).args(["-T", "fields"]);
    FIELDS.iter().for_each(|field| {
        command.args(["-e", field]);
    });
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    black_box(output.stdout);
}
