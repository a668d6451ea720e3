//! What the userspace network's emulator carries: packets a second of its one thread, and how well it holds a rate.
//!
//! `cargo bench -p workload --bench emulator`, as root or where user namespaces are allowed. It is not a test and has no
//! bound; docs/performance.md has the last figures.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

use std::{
    fs,
    net::{SocketAddr, UdpSocket},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use record::{
    quantity::{BitRate, Fraction, TimeSpan},
    settings::NetworkSettings,
    topology::address_in_the_ball,
    virtual_host::VirtualHost,
};
use workload::network::{self, Network};

/// How long each flood lasts.
const FLOOD: Duration = Duration::from_secs(5);
/// A flood's first packets fill the queue and empty the token bucket.
const LEAD: Duration = Duration::from_secs(1);
/// Ethernet, IPv4 and UDP headers.
const HEADERS: usize = 14 + 20 + 8;
const PORT: u16 = 4711;

fn main() {
    // While this is the only thread.
    network::become_namespace_root().expect("a user namespace can be had");
    packets();
    rate();
}

/// Small packets without a limit of the rate: what one thread carries from host to host.
fn packets() {
    let flood = flood(
        &NetworkSettings {
            bandwidth: BitRate::from_mbit(100_000),
            limit_packets: 100_000,
            ..NetworkSettings::default()
        },
        64 - HEADERS,
    );
    println!(
        "{:>9.0} packets a second delivered, {:>9.0} in each second of the emulator's own CPU time",
        flood.packets / flood.seconds,
        flood.packets / flood.emulator_cpu_s,
    );
}

/// Full packets at more than the rate: what comes out is the rate.
fn rate() {
    let asked = NetworkSettings {
        loss: Fraction::from_percent(0.0),
        jitter: TimeSpan::from_millis(0),
        ..NetworkSettings::default()
    };
    let bits_per_second = asked.bandwidth.bits_per_second() as f64;
    let payload = 1500 - 28;
    let flood = flood(&asked, payload);
    let carried = flood.packets * ((payload + HEADERS) * 8) as f64 / flood.seconds;
    println!(
        "{:>9.3} Mbit/s carried for {:.0} asked: {:+.2} %",
        carried / 1e6,
        bits_per_second / 1e6,
        (carried / bits_per_second - 1.0) * 100.0,
    );
}

struct Flood {
    packets: f64,
    seconds: f64,
    emulator_cpu_s: f64,
}

/// Sends from sta1 to sta2 as fast as the socket takes it and counts what arrives in [`FLOOD`].
fn flood(settings: &NetworkSettings, payload: usize) -> Flood {
    let network = network::open(settings, 85).expect("the network can be had");
    network.impair().expect("the links can be impaired");
    let (sender, receiver) = (
        udp(&*network, VirtualHost::STA1),
        udp(&*network, VirtualHost::STA2),
    );
    receiver.set_read_timeout(Some(FLOOD)).unwrap();
    let stop = AtomicBool::new(false);
    let datagram = vec![0; payload];
    thread::scope(|scope| {
        scope.spawn(|| {
            while !stop.load(Ordering::Relaxed) {
                let _ = sender.send_to(&datagram, address(VirtualHost::STA2));
            }
        });
        receive_for(&receiver, LEAD);
        let cpu_before_s = emulator_cpu_s();
        let delivered_before = delivered(&*network);
        let begun = Instant::now();
        receive_for(&receiver, FLOOD);
        let flood = Flood {
            packets: (delivered(&*network) - delivered_before) as f64,
            seconds: begun.elapsed().as_secs_f64(),
            emulator_cpu_s: emulator_cpu_s() - cpu_before_s,
        };
        stop.store(true, Ordering::Relaxed);
        flood
    })
}

/// Takes what comes, so that the emulator does not deliver into a full socket.
fn receive_for(socket: &UdpSocket, duration: Duration) {
    let mut buffer = [0; 2048];
    let begun = Instant::now();
    while begun.elapsed() < duration {
        socket.recv(&mut buffer).expect("packets keep coming");
    }
}

fn delivered(network: &dyn Network) -> u64 {
    network.links()[2].down.delivered
}

/// The CPU time that the emulator's thread has used (proc(5), `schedstat`: its first number, in nanoseconds).
fn emulator_cpu_s() -> f64 {
    let tasks = fs::read_dir("/proc/self/task").unwrap();
    let emulator = tasks
        .map(|task| task.unwrap().path())
        .find(|task| fs::read_to_string(task.join("comm")).is_ok_and(|name| name.trim() == "emulator"))
        .expect("the emulator runs");
    let text = fs::read_to_string(emulator.join("schedstat")).unwrap();
    let ns: u64 = text.split_whitespace().next().unwrap().parse().unwrap();
    ns as f64 / 1e9
}

fn udp(network: &dyn Network, host: VirtualHost) -> UdpSocket {
    thread::scope(|scope| {
        let opening = scope.spawn(|| {
            network.enter(host).unwrap();
            UdpSocket::bind(address(host)).unwrap()
        });
        opening.join().unwrap()
    })
}

fn address(host: VirtualHost) -> SocketAddr {
    SocketAddr::from((address_in_the_ball(host), PORT))
}
