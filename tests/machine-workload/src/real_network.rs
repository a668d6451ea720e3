//! What the tests on a real network share: how they are run, hosts to do something on, captures and their packets. As
//! root, or as an ordinary user where user namespaces are allowed. Where neither is, they fail.

use std::{
    fs::File,
    net::SocketAddr,
    path::Path,
    process::ExitCode,
    thread,
    time::{Duration, SystemTime},
};

use libtest_mimic::{Arguments, Failed, Trial};
use pcap_file::{TsResolution, pcap::PcapReader};
use record::{
    causes::with_causes,
    settings::{CaptureSettings, NetworkSettings},
    topology::address_in_the_ball,
    virtual_host::VirtualHost,
    window::CaptureRecord,
};
use workload::{
    capture::{Capture, CapturedWindow},
    network::{self, Network},
};

/// Where the hosts of a test meet.
pub const PORT: u16 = 4711;
/// For a window to be on the disk; only hopeless waits are ended by it.
const TIMEOUT: Duration = Duration::from_secs(20);

/// Runs tests, by their names. An ordinary user must enter a user namespace before any thread starts, so each of these
/// programs has its own `main`, and this is what it does.
pub fn run<const N: usize>(tests: [(&str, fn()); N]) -> ExitCode {
    if let Err(error) = network::become_namespace_root() {
        eprintln!("{}\nhint: {:?}", with_causes(&error), error.hint());
        return ExitCode::FAILURE;
    }
    let trial = |(name, test): (&str, fn())| {
        Trial::test(name, move || {
            test();
            Ok::<_, Failed>(())
        })
    };
    let mut arguments = Arguments::from_args();
    // One after the other: they measure times.
    arguments.test_threads = Some(1);
    libtest_mimic::run(&arguments, tests.map(trial).into()).exit_code()
}

/// A network whose links are as the settings ask.
pub fn open(settings: &NetworkSettings) -> Box<dyn Network> {
    let network = open_unimpaired(settings);
    network.impair().unwrap();
    network
}

/// One that carries at once and without loss.
pub fn open_unimpaired(settings: &NetworkSettings) -> Box<dyn Network> {
    network::open(settings, 85).unwrap_or_else(|error| panic!("{error:?}, hint: {:?}", error.hint()))
}

/// Where a host of a test listens.
pub fn address(host: VirtualHost) -> SocketAddr {
    SocketAddr::from((address_in_the_ball(host), PORT))
}

/// Does something on a host, whose address it is given.
pub fn within<T: Send>(
    network: &dyn Network,
    host: VirtualHost,
    what: impl FnOnce(SocketAddr) -> T + Send,
) -> T {
    thread::scope(|scope| {
        let doing = scope.spawn(|| {
            network.enter(host).unwrap();
            what(address(host))
        });
        doing.join().unwrap()
    })
}

/// The wall clock, nanoseconds since 1970.
pub fn unix_now_ns() -> i64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    since.as_nanos() as i64
}

/// A capture on a host, which must start.
pub fn capture(network: &dyn Network, host: VirtualHost, settings: &CaptureSettings) -> Capture {
    Capture::start(network, host, settings)
        .unwrap_or_else(|error| panic!("{error:?}, hint: {:?}", error.hint()))
}

/// The next window of a capture that is on the disk.
pub fn next_window(capture: &Capture) -> CaptureRecord {
    let CapturedWindow { outcome, .. } = capture.completed().recv_timeout(TIMEOUT).unwrap();
    outcome.unwrap()
}

/// A packet of a capture.
pub struct Packet {
    /// When it was captured: the wall clock, nanoseconds since 1970.
    pub stamp_unix_ns: i64,
    /// Its length on the wire.
    pub original_bytes: usize,
    /// What was kept of it.
    pub bytes: Vec<u8>,
}

/// The packets of a nanosecond pcap file.
pub fn read_capture(file: &Path) -> Vec<Packet> {
    let mut reader = PcapReader::new(File::open(file).unwrap()).unwrap();
    assert_eq!(reader.header().ts_resolution, TsResolution::NanoSecond);
    let mut packets = Vec::new();
    while let Some(packet) = reader.next_raw_packet() {
        let packet = packet.unwrap();
        packets.push(Packet {
            stamp_unix_ns: i64::from(packet.ts_sec) * 1_000_000_000 + i64::from(packet.ts_frac),
            original_bytes: packet.orig_len as usize,
            bytes: packet.data.into_owned(),
        });
    }
    packets
}
