//! Opens a network of the settings' backend and measures it from inside, with nothing but sockets: round trips, one-way
//! delays, losses, reordering and throughput between `sta1` and `sta2`. Prints one line of JSON.
//!
//! ```sh
//! network_probe '{"network": {"backend": "kernel"}}' --pings 3000 --pairs 2000 --tcp-seconds 10 --flood-seconds 3
//! ```
//!
//! How far it is goes to standard error, a line a measurement. All threads and both hosts are of this process, so that
//! there is one clock.

#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "its result is what it prints"
)]

use std::{
    error::Error,
    io::{ErrorKind, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream, UdpSocket},
    thread,
    time::Duration,
};

use clap::Parser;
use record::{
    settings::{RealtimeSettings, Settings},
    topology::address_in_the_ball,
    virtual_host::VirtualHost,
    window::LinkRecord,
};
use serde::Serialize;
use workload::{
    network::{self, Network},
    realtime::{enter_realtime, monotonic_ns, sleep_until},
};

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

const PORT: u16 = 4711;
/// Nothing is under way for longer than this: the paper's link holds at most 1000 packets of 1.2 ms.
const LONGEST: Duration = Duration::from_secs(3);
/// A ping's payload, as `ping` has it.
const PING_BYTES: usize = 56;
/// A full frame of 1514 bytes.
const FULL_BYTES: usize = 1472;
/// How much faster than the link the flood is.
const FLOOD_FACTOR: f64 = 1.2;
/// What TCP and the flood do first is left out of their rates.
const WARM_UP_NS: i64 = SECOND_NS;
const SECOND_NS: i64 = 1_000_000_000;

#[derive(Debug, Parser)]
struct Call {
    /// The workload's settings, as JSON.
    settings: String,
    /// Round trips.
    #[arg(long, default_value_t = 3000)]
    pings: usize,
    /// From one round trip to the next, in microseconds.
    #[arg(long, default_value_t = 10_000)]
    every_us: u64,
    /// Pairs of packets, back to back.
    #[arg(long, default_value_t = 2000)]
    pairs: usize,
    /// How long TCP's throughput is measured; 0 for not at all.
    #[arg(long, default_value_t = 0)]
    tcp_seconds: usize,
    /// How long the throughput of full frames is measured; 0 for not at all.
    #[arg(long, default_value_t = 0)]
    flood_seconds: u64,
}

/// What was found.
#[derive(Debug, Serialize)]
struct Found {
    pings: Pings,
    pairs: Pairs,
    /// Bits of payload that one TCP connection carried in each second; it always has something to send.
    tcp_bits_per_second: Vec<f64>,
    /// Ethernet frames of 1514 bytes, more of them than the link carries; headers count.
    flood_bits_per_second: Option<f64>,
    links: Vec<LinkRecord>,
    transcript: Option<String>,
}

/// Round trips from `sta1` to `sta2`, nanoseconds.
#[derive(Debug, Serialize)]
struct Pings {
    sent: usize,
    there_ns: Vec<i64>,
    back_ns: Vec<i64>,
    round_trip_ns: Vec<i64>,
}

/// Packets sent two at once.
#[derive(Debug, Default, Serialize)]
struct Pairs {
    sent: usize,
    /// Of which both came.
    whole: usize,
    /// Of those, the second came first.
    swapped: usize,
    /// Mean time from the first's sending to the second's.
    gap_ns: f64,
}

fn main() -> Outcome<()> {
    network::become_namespace_root()?;
    let call = Call::parse();
    let settings: Settings = serde_json::from_str(&call.settings)?;
    if let Some(problem) = settings.problems().into_iter().next() {
        return Err(format!("{}: {}; {}", problem.path, problem.message, problem.hint).into());
    }
    let network = network::open(&settings.network, 85)?;
    network.impair()?;
    let network = &*network;
    tell("the network is up");
    let pings = ping(network, call.pings, Duration::from_micros(call.every_us))?;
    tell(&format!("{} round trips", call.pings));
    let pairs = send_pairs(network, call.pairs, Duration::from_micros(call.every_us))?;
    tell(&format!("{} pairs", call.pairs));
    let links = network.links();
    let mut tcp_bits_per_second = Vec::new();
    if call.tcp_seconds > 0 {
        tcp_bits_per_second = tcp(network, call.tcp_seconds)?;
        tell(&format!("{} s of TCP", call.tcp_seconds));
    }
    let mut flood_bits_per_second = None;
    if call.flood_seconds > 0 {
        let bandwidth = settings.network.bandwidth.bits_per_second() as f64;
        flood_bits_per_second = Some(flood(network, call.flood_seconds, bandwidth)?);
        tell(&format!("{} s of full frames", call.flood_seconds));
    }
    let found = Found {
        pings,
        pairs,
        tcp_bits_per_second,
        flood_bits_per_second,
        links,
        transcript: network.transcript(),
    };
    println!("{}", serde_json::to_string(&found)?);
    network.failure().map_or(Ok(()), |failure| Err(failure.into()))
}

fn tell(what: &str) {
    eprintln!("network_probe: {what}");
}

/// Runs two halves of a measurement, each in its host and as urgent as a control loop. The far one is ready, with its
/// socket, before the near one begins.
fn between<S: Send, F: Send, N: Send>(
    network: &dyn Network,
    open: impl FnOnce() -> Outcome<S> + Send,
    far: impl FnOnce(S) -> Outcome<F> + Send,
    near: impl FnOnce() -> Outcome<N> + Send,
) -> Outcome<(F, N)> {
    let (ready, is_ready) = std::sync::mpsc::channel();
    let far = move || -> Outcome<F> {
        network.enter(VirtualHost::STA2)?;
        be_urgent();
        let socket = open()?;
        ready.send(())?;
        far(socket)
    };
    let near = move || -> Outcome<N> {
        is_ready.recv()?;
        network.enter(VirtualHost::STA1)?;
        be_urgent();
        near()
    };
    thread::scope(|scope| {
        let far = scope.spawn(far);
        let near = scope.spawn(near);
        let (far, near) = (far.join(), near.join());
        Ok((
            far.map_err(|_| "the far half panicked")??,
            near.map_err(|_| "the near half panicked")??,
        ))
    })
}

fn address(host: VirtualHost) -> SocketAddr {
    (address_in_the_ball(host), PORT).into()
}

fn udp(host: VirtualHost) -> Outcome<UdpSocket> {
    let socket = UdpSocket::bind(address(host))?;
    socket.set_read_timeout(Some(LONGEST))?;
    Ok(socket)
}

/// The next datagram with the time it came; none once nothing comes any more.
fn receive(socket: &UdpSocket, buffer: &mut [u8]) -> Outcome<Option<(usize, SocketAddr, i64)>> {
    match socket.recv_from(buffer) {
        Ok((bytes, from)) => Ok(Some((bytes, from, monotonic_ns()))),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

fn put(packet: &mut [u8], at: usize, number: i64) {
    if let Some(field) = packet.get_mut(at..at + 8) {
        field.copy_from_slice(&number.to_be_bytes());
    }
}

fn get(packet: &[u8], at: usize) -> i64 {
    let field = packet.get(at..).and_then(|rest| rest.first_chunk());
    field.map_or(0, |field| i64::from_be_bytes(*field))
}

/// Measures as the control loops do, where that is granted.
fn be_urgent() {
    let _granted = enter_realtime(&RealtimeSettings::default());
}

fn nanoseconds(span: Duration) -> i64 {
    i64::try_from(span.as_nanos()).unwrap_or(i64::MAX)
}

fn ping(network: &dyn Network, count: usize, every: Duration) -> Outcome<Pings> {
    // Sent at 8, sent back at 16.
    let echo = |socket: UdpSocket| {
        let mut packet = [0; PING_BYTES];
        let mut there_ns = Vec::with_capacity(count);
        while let Some((_, from, now_ns)) = receive(&socket, &mut packet)? {
            there_ns.push(now_ns - get(&packet, 8));
            put(&mut packet, 16, monotonic_ns());
            socket.send_to(&packet, from)?;
        }
        Ok(there_ns)
    };
    let send = || {
        let socket = udp(VirtualHost::STA1)?;
        let sender = socket.try_clone()?;
        let sending = thread::spawn(move || -> Outcome<()> {
            be_urgent();
            let begin_ns = monotonic_ns();
            for number in 0..count {
                let number = i64::try_from(number)?;
                sleep_until(begin_ns + number * nanoseconds(every));
                let mut packet = [0; PING_BYTES];
                put(&mut packet, 0, number);
                put(&mut packet, 8, monotonic_ns());
                sender.send_to(&packet, address(VirtualHost::STA2))?;
            }
            Ok(())
        });
        let mut packet = [0; PING_BYTES];
        let (mut back_ns, mut round_trip_ns) = (Vec::with_capacity(count), Vec::with_capacity(count));
        while let Some((_, _, now_ns)) = receive(&socket, &mut packet)? {
            back_ns.push(now_ns - get(&packet, 16));
            round_trip_ns.push(now_ns - get(&packet, 8));
        }
        sending.join().map_err(|_| "the sender panicked")??;
        Ok((back_ns, round_trip_ns))
    };
    let (there_ns, (back_ns, round_trip_ns)) = between(network, || udp(VirtualHost::STA2), echo, send)?;
    Ok(Pings {
        sent: count,
        there_ns,
        back_ns,
        round_trip_ns,
    })
}

fn send_pairs(network: &dyn Network, count: usize, every: Duration) -> Outcome<Pairs> {
    let take = |socket: UdpSocket| {
        let mut packet = [0; PING_BYTES];
        let mut came = vec![[None::<usize>; 2]; count];
        let mut position = 0;
        while receive(&socket, &mut packet)?.is_some() {
            let (pair, which) = (
                usize::try_from(get(&packet, 0))?,
                usize::try_from(get(&packet, 8))?,
            );
            if let Some(place) = came.get_mut(pair).and_then(|pair| pair.get_mut(which)) {
                *place = Some(position);
            }
            position += 1;
        }
        Ok(came)
    };
    let send = || {
        let socket = udp(VirtualHost::STA1)?;
        let begin_ns = monotonic_ns();
        let mut gaps_ns = 0.0;
        for pair in 0..count {
            let pair = i64::try_from(pair)?;
            sleep_until(begin_ns + pair * nanoseconds(every));
            let mut packet = [0; PING_BYTES];
            put(&mut packet, 0, pair);
            let first_ns = monotonic_ns();
            socket.send_to(&packet, address(VirtualHost::STA2))?;
            put(&mut packet, 8, 1);
            gaps_ns += (monotonic_ns() - first_ns) as f64;
            socket.send_to(&packet, address(VirtualHost::STA2))?;
        }
        Ok(gaps_ns / count.max(1) as f64)
    };
    let (came, gap_ns) = between(network, || udp(VirtualHost::STA2), take, send)?;
    let whole: Vec<(usize, usize)> = came
        .into_iter()
        .filter_map(|[first, second]| Some((first?, second?)))
        .collect();
    Ok(Pairs {
        sent: count,
        whole: whole.len(),
        swapped: whole.iter().filter(|(first, second)| second < first).count(),
        gap_ns,
    })
}

/// Payload that arrived in each second from the end of the warm-up on.
fn tcp(network: &dyn Network, seconds: usize) -> Outcome<Vec<f64>> {
    let (connected, is_connected) = std::sync::mpsc::channel();
    let take = move |listener: TcpListener| {
        // Accepting has no end where nobody connects; why not, the other half says.
        if is_connected.recv().is_err() {
            return Ok(Vec::new());
        }
        let (mut stream, _) = listener.accept()?;
        let mut buffer = vec![0; 1 << 16];
        let begin_ns = monotonic_ns() + WARM_UP_NS;
        let mut bits = vec![0.0; seconds];
        loop {
            let bytes = stream.read(&mut buffer)?;
            if bytes == 0 {
                return Err("the sender of TCP ended early".into());
            }
            let second = (monotonic_ns() - begin_ns).div_euclid(SECOND_NS);
            // Negative is the warm-up.
            if let Ok(second) = usize::try_from(second) {
                match bits.get_mut(second) {
                    Some(bits) => *bits += bytes as f64 * 8.0,
                    None => return Ok(bits),
                }
            }
        }
    };
    let send = move || {
        let mut stream = TcpStream::connect(address(VirtualHost::STA2))?;
        connected.send(())?;
        let buffer = vec![0; 1 << 16];
        // Until the other side has had enough.
        while stream.write(&buffer).is_ok() {}
        Ok(())
    };
    let open = || Ok(TcpListener::bind(address(VirtualHost::STA2))?);
    Ok(between(network, open, take, send)?.0)
}

/// Full frames that arrived from the end of the warm-up to the end of sending.
fn flood(network: &dyn Network, seconds: u64, bits_per_second: f64) -> Outcome<f64> {
    // What Ethernet, IP and UDP add.
    let frame_bits = (FULL_BYTES + 42) as f64 * 8.0;
    let every_ns = frame_bits * 1e9 / (bits_per_second * FLOOD_FACTOR);
    let end_ns = WARM_UP_NS + nanoseconds(Duration::from_secs(seconds));
    let count = (end_ns as f64 / every_ns) as i64;
    let take = |socket: UdpSocket| {
        let mut packet = [0; FULL_BYTES];
        let (mut begin_ns, mut counted) = (None, 0_u64);
        let (mut first_ns, mut last_ns) = (0, 0);
        while let Some((_, _, now_ns)) = receive(&socket, &mut packet)? {
            let since_ns = now_ns - *begin_ns.get_or_insert(now_ns);
            if since_ns < WARM_UP_NS || since_ns > end_ns {
                continue;
            }
            if counted == 0 {
                first_ns = now_ns;
            }
            last_ns = now_ns;
            counted += 1;
        }
        Ok(counted.saturating_sub(1) as f64 * frame_bits * 1e9 / (last_ns - first_ns).max(1) as f64)
    };
    let send = || {
        let socket = UdpSocket::bind(address(VirtualHost::STA1))?;
        let begin_ns = monotonic_ns();
        for number in 0..count {
            sleep_until(begin_ns + (number as f64 * every_ns) as i64);
            socket.send_to(&[0; FULL_BYTES], address(VirtualHost::STA2))?;
        }
        Ok(())
    };
    Ok(between(network, || udp(VirtualHost::STA2), take, send)?.0)
}
