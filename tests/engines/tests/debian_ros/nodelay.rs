//! TCP_NODELAY on the wire, at the paper's round trip of 40 ms: who asks for it gets each message at once; for who does
//! not, Nagle's algorithm (RFC 896) holds messages until those before are acknowledged, and sends them together.

use std::{collections::BTreeMap, fs::File, path::Path};

use pcap_file::pcap::PcapReader;
use record::progress::Progress;
use rstest::rstest;
use simulation::ros::float64_multi_array::Encoder;
use tempfile::TempDir;

use crate::stage::{Stage, machine};

/// A message on every 20 ms, and 40 ms to an acknowledgement; no losses, whose repair would look the same.
const SETTINGS: &str =
    r#""dynamics":"robust","windows":1,"window":"10s","period":"1s","network":{"jitter":"0ms","loss":"0%"}"#;

/// What was sent to one subscriber.
#[derive(Debug, Default)]
struct Flow {
    /// Messages in each segment that has any; the connection's header is none.
    segments: Vec<usize>,
    /// How many of them were sent while others had not been acknowledged.
    unacknowledged_before: usize,
    /// Known once the first of each has been seen.
    next_sequence: Option<u32>,
    acknowledged: Option<u32>,
}

impl Flow {
    fn add(&mut self, segment: &Segment, sends: bool) {
        if !sends {
            self.acknowledged = Some(segment.acknowledges);
            return;
        }
        if segment.payload == 0 || segment.is_syn {
            return;
        }
        // The header that answers the subscriber's is no whole number of messages, nor are its parts.
        let message_bytes = state_bytes();
        if segment.payload.is_multiple_of(message_bytes) {
            self.segments.push(segment.payload / message_bytes);
            let outstanding = self.next_sequence.zip(self.acknowledged);
            self.unacknowledged_before += usize::from(outstanding.is_some_and(|(next, known)| next != known));
        }
        self.next_sequence = Some(segment.sequence.wrapping_add(segment.payload as u32));
    }

    fn messages_per_segment(&self) -> f64 {
        self.segments.iter().sum::<usize>() as f64 / self.segments.len() as f64
    }

    fn share_sent_before_an_acknowledgement(&self) -> f64 {
        self.unacknowledged_before as f64 / self.segments.len() as f64
    }
}

/// What one TCP segment is: Ethernet, IPv4 and TCP headers taken apart (RFC 791, RFC 9293).
struct Segment {
    from: ([u8; 4], u16),
    to: ([u8; 4], u16),
    sequence: u32,
    acknowledges: u32,
    payload: usize,
    is_syn: bool,
}

impl Segment {
    fn parse(frame: &[u8]) -> Option<Self> {
        let ip = frame.get(14..)?;
        if frame[12..14] != [8, 0] || ip[9] != 6 {
            return None;
        }
        let head = usize::from(ip[0] & 15) * 4;
        let total = usize::from(u16::from_be_bytes([ip[2], ip[3]]));
        let tcp = &ip[head..total];
        let short = |at: usize| u16::from_be_bytes([tcp[at], tcp[at + 1]]);
        let long = |at: usize| u32::from_be_bytes([tcp[at], tcp[at + 1], tcp[at + 2], tcp[at + 3]]);
        let address = |at: usize| [ip[at], ip[at + 1], ip[at + 2], ip[at + 3]];
        Some(Self {
            from: (address(12), short(0)),
            to: (address(16), short(2)),
            sequence: long(4),
            acknowledges: long(8),
            payload: tcp.len() - usize::from(tcp[12] >> 4) * 4,
            is_syn: tcp[13] & 2 != 0,
        })
    }
}

/// A state on the wire, with the length before it.
fn state_bytes() -> usize {
    const FIELDS: &str = "seq stamp_s x_m x_rate_m_s angle_x_rad angle_x_rate_rad_s y_m y_rate_m_s angle_y_rad angle_y_rate_rad_s";
    let fields: Vec<&str> = FIELDS.split(' ').collect();
    let fields: [&str; 10] = fields.try_into().unwrap();
    4 + Encoder::new(fields).encode(&[0.0; 10]).len()
}

/// What the plant sent to our controller and to each listener, as its own host saw it leave.
fn flows(capture: &Path, listeners: &BTreeMap<String, u16>) -> BTreeMap<String, Flow> {
    const PLANT: [u8; 4] = [10, 0, 0, 3];
    const CONTROLLER: [u8; 4] = [10, 0, 0, 2];
    let mut segments = Vec::new();
    let mut reader = PcapReader::new(File::open(capture).unwrap()).unwrap();
    while let Some(packet) = reader.next_packet() {
        segments.extend(Segment::parse(&packet.unwrap().data));
    }
    // The plant has one port for all its subscribers.
    let is_listener = |port: u16| listeners.values().any(|known| *known == port);
    let to_listener = segments
        .iter()
        .find(|segment| segment.from.0 == PLANT && is_listener(segment.to.1));
    let topic = to_listener.unwrap().from;
    let mut flows: BTreeMap<String, Flow> = BTreeMap::new();
    for segment in segments {
        let (sends, peer) = match (segment.from == topic, segment.to == topic) {
            (true, _) => (true, segment.to),
            (_, true) => (false, segment.from),
            _ => continue,
        };
        let listener = listeners.iter().find(|(_, port)| **port == peer.1);
        let name = match listener {
            Some((name, _)) => name.clone(),
            None if peer.0 == CONTROLLER => "/controller".to_owned(),
            None => continue,
        };
        flows.entry(name).or_default().add(&segment, sends);
    }
    flows
}

/// Who subscribed to the plant's states while it was being measured, and from which port.
fn listeners(said: &[Progress]) -> BTreeMap<String, u16> {
    let texts = said.iter().filter_map(|progress| match progress {
        Progress::Notice { text, .. } => text.strip_suffix(" subscribed to /state"),
        _ => None,
    });
    texts
        .map(|text| {
            let (name, address) = text.split_once(" at ").unwrap();
            (
                name.to_owned(),
                address.rsplit_once(':').unwrap().1.parse().unwrap(),
            )
        })
        .collect()
}

#[rstest]
#[case::with_it_set(true)]
#[case::without_it_set(false)]
fn the_wire_shows_tcp_nodelay_as_each_subscriber_asked(#[case] ours_asks: bool) {
    let _machine = machine();
    let data = TempDir::new().unwrap();
    let settings = format!(r#"{{{SETTINGS},"ros":{{"tcp_nodelay":{ours_asks}}}}}"#);
    let mut stage = Stage::run(&settings, "1", data.path());
    let _asks = stage.node("h1", "listener.py", &["asks", "nodelay"]);
    let _does_not = stage.node("h1", "listener.py", &["does_not"]);
    stage.wait_for(|progress| matches!(progress, Progress::Finished));

    let flows = flows(&data.path().join("window-1/sta2.pcap"), &listeners(&stage.said));
    for (name, asked) in [("/controller", ours_asks), ("/asks", true), ("/does_not", false)] {
        let flow = &flows[name];
        let together = flow.messages_per_segment();
        let early = flow.share_sent_before_an_acknowledgement();
        assert!(flow.segments.len() > 50, "{name}: {flow:?}");
        if asked {
            assert!(together < 1.05 && early > 0.9, "{name}: {together} {early}");
        } else {
            assert!(together > 1.9 && early < 0.01, "{name}: {together} {early}");
        }
    }
}
