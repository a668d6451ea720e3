//! The packets of a recorded run against those that tshark sees in the same captures.

use std::{collections::HashMap, path::Path, process::Command};

use captures::{packets::Topic, traffic::WindowTraffic};
use record::{run_directory::RunDirectory, topology::address_in_the_ball};
use reports::input::traffic;

/// What tshark says of a packet with data.
#[derive(Debug)]
struct Seen {
    at_s: f64,
    source: String,
    is_retransmitted: bool,
}

/// The packets with data in a capture, by what tells them apart.
fn seen_by_tshark(capture: &Path) -> HashMap<[String; 3], Seen> {
    let fields = [
        "ip.id",
        "tcp.seq_raw",
        "tcp.options.timestamp.tsval",
        "frame.time_epoch",
        "ip.src",
        "tcp.analysis.retransmission",
        "tcp.analysis.out_of_order",
        "tcp.analysis.fast_retransmission",
    ];
    let mut command = Command::new("tshark");
    command
        .arg("-r")
        .arg(capture)
        .args(["-Y", "tcp.len > 0", "-T", "fields"]);
    fields.iter().for_each(|field| {
        command.args(["-e", field]);
    });
    let output = command.output().expect("tests/prepare installs tshark");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let text = String::from_utf8(output.stdout).unwrap();
    let packet = |line: &str| {
        let columns: Vec<&str> = line.split('\t').collect();
        let seen = Seen {
            at_s: columns[3].parse().unwrap(),
            source: columns[4].to_owned(),
            is_retransmitted: columns[5..].iter().any(|flag| !flag.is_empty()),
        };
        ([0, 1, 2].map(|key| columns[key].to_owned()), seen)
    };
    text.lines().map(packet).collect()
}

#[test]
fn the_packets_are_those_that_tshark_sees() {
    let directory = RunDirectory::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/recorded"));
    let run = reports::load(directory.path()).unwrap();
    let found = traffic::read(&run);
    let mut compared = 0;
    for scenario in &run.scenarios {
        let Some(of_it) = found.scenarios.get(&scenario.planned.id) else {
            continue;
        };
        for ((number, record, _), traffic) in scenario.counted().zip(&of_it.windows) {
            // The files of the first window begin before it does, and packets cross from one into the next.
            let [began_s, ended_s] = [record.started_unix_ns, record.ended_unix_ns].map(|ns| ns as f64 / 1e9);
            let folder = directory.window(&scenario.planned.slug, number).path();
            for topic in Topic::ALL {
                let [sent, arrived] = [topic.sender(), topic.receiver()]
                    .map(|host| seen_by_tshark(&folder.join(format!("{host}.pcap.zst"))));
                let from_it = sent
                    .iter()
                    .filter(|(_, seen)| seen.source == address_in_the_ball(topic.sender()).to_string());
                let within: Vec<_> = from_it
                    .filter(|(_, seen)| (began_s..ended_s).contains(&seen.at_s))
                    .collect();
                compare(traffic, topic, &within, &arrived, ended_s);
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 12, "two scenarios, three windows, two directions");
}

fn compare(
    found: &WindowTraffic,
    topic: Topic,
    sent: &[(&[String; 3], &Seen)],
    arrived: &HashMap<[String; 3], Seen>,
    ended_s: f64,
) {
    let direction = found.direction(topic);
    assert_eq!(direction.total(|period| period.sent), sent.len() as u64);
    let retransmitted = sent.iter().filter(|(_, seen)| seen.is_retransmitted).count() as u64;
    assert_eq!(direction.total(|period| period.retransmitted), retransmitted);
    // What was sent just before the end is in the next window's file.
    let settled = sent.iter().filter(|(_, seen)| seen.at_s < ended_s - 1.0);
    let (there, gone): (Vec<_>, Vec<_>) = settled.copied().partition(|(key, _)| arrived.contains_key(*key));
    let late = sent.len() - there.len() - gone.len();
    let lost = direction.total(|period| period.lost);
    assert!(
        (gone.len() as u64..=(gone.len() + late) as u64).contains(&lost),
        "{lost} {}",
        gone.len()
    );
    // Mean delays, over what has arrived within the file: the same up to the packets at its end.
    let delays: Vec<f64> = sent
        .iter()
        .filter_map(|(key, seen)| Some(arrived.get(*key)?.at_s - seen.at_s))
        .collect();
    let spread = direction.one_way.as_ref().unwrap();
    let shortest_s = delays.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(
        (spread.min_s - shortest_s).abs() < 1e-6,
        "{} {shortest_s}",
        spread.min_s
    );
    assert!(
        spread.count.abs_diff(delays.len() as u64) <= 3,
        "{} {}",
        spread.count,
        delays.len()
    );
    let mean_s = delays.iter().sum::<f64>() / delays.len() as f64;
    assert!(
        (spread.mean_s - mean_s).abs() < 2e-5,
        "{} {mean_s}",
        spread.mean_s
    );
}
