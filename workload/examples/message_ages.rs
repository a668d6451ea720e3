//! How old small messages are when they are read over TCP: measured with this machine's kernel on a network of the settings'
//! backend, and in virtual time, and whether the two can be told apart. Prints one line of JSON.
//!
//! ```sh
//! message_ages '{"network": {"seed": 1}}' --seconds 300 --stack-us 90
//! ```
//!
//! Four connections each way between `sta1` and `sta2`, or as many as `--pairs` says, out of step, with a message each 20 ms. What
//! is too close together
//! is not independent: every 25th message is compared. What the hosts' kernels and the emulator add to the links' delays
//! (`--stack-us`) is what the median is of the same call on links without any: `'{"network": {"delay": "0 ms", "jitter":
//! "0 ms", "loss": "0 %"}}'`.

#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "its result is what it prints"
)]

use std::{
    collections::BTreeMap,
    error::Error,
    ffi::OsString,
    fs,
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    process,
    sync::{Barrier, mpsc},
    thread,
    time::Instant,
};

use clap::Parser;
use nix::sys::socket::{setsockopt, sockopt};
use record::{
    settings::{RealtimeSettings, Settings},
    topology::address_in_the_ball,
    virtual_host::VirtualHost,
};
use serde::Serialize;
use simulation::virtual_time::{
    exchange::{Conditions, Exchange, Peer},
    tcp::Counts,
};
use workload::{
    network::{self, Network},
    realtime::{enter_realtime, monotonic_ns, sleep_until},
};

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;
/// What happened how often in a second of a connection.
type Rates = BTreeMap<&'static str, f64>;

const FIRST_PORT: u16 = 4711;
const SECOND_NS: i64 = 1_000_000_000;
/// The first messages are acknowledged quickly, on a window that nothing was lost in.
const WARM_UP_NS: i64 = 5 * SECOND_NS;
const THINNED_TO_EACH: usize = 25;
const QUANTILES: [f64; 7] = [0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99];

#[derive(Debug, Parser)]
struct Call {
    /// The workload's settings, as JSON.
    settings: String,
    /// How long messages are sent.
    #[arg(long, default_value_t = 120)]
    seconds: i64,
    /// Bytes of a message, its length before it included.
    #[arg(long, default_value_t = 66)]
    bytes: u64,
    /// From one message to the next, in microseconds.
    #[arg(long, default_value_t = 20_000)]
    every_us: i64,
    /// Switches Nagle off.
    #[arg(long)]
    nodelay: bool,
    /// The kernel's congestion control.
    #[arg(long, default_value = "cubic")]
    congestion: OsString,
    /// What the hosts add to the links' delays in virtual time, in microseconds.
    #[arg(long, default_value_t = 0)]
    stack_us: i64,
    /// How many connections each way. They share the links when they are measured, and each pair has them alone in virtual time: where
    /// bandwidth is tight, give 1.
    #[arg(long, default_value_t = 4)]
    pairs: usize,
    /// How many simulations as long as the measurement.
    #[arg(long, default_value_t = 10)]
    times: i64,
}

/// What was found.
#[derive(Debug, Serialize)]
struct Found {
    measured: Ages,
    simulated: Ages,
    /// The mean age in each of the simulations, in order.
    simulated_means_ms: Vec<f64>,
    /// The largest distance of the two distributions, of so many and so many messages, and how probable a larger one is
    /// if they are the same.
    ks: f64,
    compared: [usize; 2],
    p: f64,
    /// What the hosts' kernels counted, and the same in virtual time, a second of a connection.
    kernel: Rates,
    twin: Rates,
    /// How much faster than real time one exchange was simulated.
    times_real_time: f64,
    load: String,
}

/// How old messages were.
#[derive(Debug, Serialize)]
struct Ages {
    messages: usize,
    mean_ms: f64,
    quantiles_ms: [f64; 7],
    /// Shares of messages older than 70, 100, 200, 300 and 400 ms.
    older: [f64; 5],
    longest_ms: f64,
}

fn main() -> Outcome<()> {
    network::become_namespace_root()?;
    let call = Call::parse();
    let settings: Settings = serde_json::from_str(&call.settings)?;
    if let Some(problem) = settings.problems().into_iter().next() {
        return Err(format!("{}: {}; {}", problem.path, problem.message, problem.hint).into());
    }
    let (measured, kernel) = measure(&call, &settings)?;
    let begun = Instant::now();
    let Simulated {
        ages: simulated,
        mut means_ms,
        twin,
    } = simulate(&call, &settings);
    means_ms.sort_by(f64::total_cmp);
    let simulated_s = (call.times * call.seconds) as f64 * call.pairs as f64;
    let times_real_time = simulated_s / begun.elapsed().as_secs_f64();
    let (thinned, virtual_thinned) = (thin(&measured), thin(&simulated));
    let ks = distance(&thinned, &virtual_thinned);
    let found = Found {
        ks,
        compared: [thinned.len(), virtual_thinned.len()],
        p: probability(ks, thinned.len(), virtual_thinned.len()),
        measured: ages(measured.concat()),
        simulated: ages(simulated.concat()),
        kernel,
        twin,
        simulated_means_ms: means_ms,
        times_real_time,
        load: fs::read_to_string("/proc/loadavg")?.trim().to_owned(),
    };
    println!("{}", serde_json::to_string(&found)?);
    Ok(())
}

/// The ages of each connection's messages, in nanoseconds, and what the kernel counted.
fn measure(call: &Call, settings: &Settings) -> Outcome<(Vec<Vec<i64>>, Rates)> {
    let network = network::open(&settings.network, 85)?;
    network.impair()?;
    let network = &*network;
    let everybody = &Barrier::new(4 * call.pairs + 1);
    let before = counters(network)?;
    let ages = thread::scope(|scope| {
        let mut readers = Vec::new();
        let mut writers = Vec::new();
        for number in 0..2 * call.pairs {
            let [to, from] = if number % 2 == 0 {
                [VirtualHost::STA1, VirtualHost::STA2]
            } else {
                [VirtualHost::STA2, VirtualHost::STA1]
            };
            let offset = i64::try_from(number).unwrap_or(0) * call.every_us * 1000 / (2 * call.pairs as i64);
            let address: SocketAddr = (address_in_the_ball(from), FIRST_PORT + u16::try_from(number)?).into();
            let (listens, is_listening) = mpsc::channel();
            // As in ROS, the publisher listens and the subscriber connects.
            writers.push(
                scope.spawn(move || or_exit(write(network, from, address, call, offset, listens, everybody))),
            );
            readers.push(
                scope.spawn(move || or_exit(read(network, to, address, call, is_listening, everybody))),
            );
        }
        everybody.wait();
        eprintln!("message_ages: connected");
        for writer in writers {
            writer.join().map_err(|_| "a writer panicked")?;
        }
        let ages = readers
            .into_iter()
            .map(|reader| reader.join().map_err(|_| "a reader panicked".into()));
        ages.collect::<Outcome<Vec<_>>>()
    })?;
    let after = counters(network)?;
    let streams = call.seconds as f64 * 2.0 * call.pairs as f64;
    let kernel = after
        .into_iter()
        .map(|(name, count)| (name, (count - before.get(name).copied().unwrap_or(0.0)) / streams))
        .collect();
    network
        .failure()
        .map_or(Ok((ages, kernel)), |failure| Err(failure.into()))
}

/// A connection that fails ends all: the others would wait for it for ever.
fn or_exit<T>(outcome: Outcome<T>) -> T {
    outcome.unwrap_or_else(|error| {
        eprintln!("message_ages: {error}");
        process::exit(1)
    })
}

fn write(
    network: &dyn Network,
    host: VirtualHost,
    address: SocketAddr,
    call: &Call,
    offset_ns: i64,
    listens: mpsc::Sender<()>,
    everybody: &Barrier,
) -> Outcome<()> {
    network.enter(host)?;
    let _granted = enter_realtime(&RealtimeSettings::default());
    let listener = TcpListener::bind(address)?;
    setsockopt(&listener, sockopt::TcpCongestion, &call.congestion)?;
    listens.send(())?;
    let (mut stream, _) = listener.accept()?;
    stream.set_nodelay(call.nodelay)?;
    everybody.wait();
    let begin_ns = monotonic_ns() + SECOND_NS / 10 + offset_ns;
    let mut message = vec![0; usize::try_from(call.bytes)?];
    for number in 0..call.seconds * 1_000_000 / call.every_us {
        sleep_until(begin_ns + number * call.every_us * 1000);
        if let Some(stamp) = message.first_chunk_mut() {
            *stamp = monotonic_ns().to_be_bytes();
        }
        stream.write_all(&message)?;
    }
    Ok(())
}

fn read(
    network: &dyn Network,
    host: VirtualHost,
    address: SocketAddr,
    call: &Call,
    is_listening: mpsc::Receiver<()>,
    everybody: &Barrier,
) -> Outcome<Vec<i64>> {
    network.enter(host)?;
    let _granted = enter_realtime(&RealtimeSettings::default());
    is_listening.recv()?;
    let mut stream = TcpStream::connect(address)?;
    everybody.wait();
    let begin_ns = monotonic_ns() + WARM_UP_NS;
    let length = usize::try_from(call.bytes)?;
    let (mut buffer, mut filled) = (vec![0; 1 << 16], 0);
    let mut ages_ns = Vec::new();
    loop {
        let count = stream.read(buffer.get_mut(filled..).unwrap_or_default())?;
        let now_ns = monotonic_ns();
        if count == 0 {
            return Ok(ages_ns);
        }
        filled += count;
        let whole = filled / length * length;
        for message in buffer.get(..whole).unwrap_or_default().chunks(length) {
            let sent_ns = message
                .first_chunk()
                .map_or(0, |stamp| i64::from_be_bytes(*stamp));
            if sent_ns >= begin_ns {
                ages_ns.push(now_ns - sent_ns);
            }
        }
        buffer.copy_within(whole..filled, 0);
        filled -= whole;
    }
}

/// What was simulated.
struct Simulated {
    ages: Vec<Vec<i64>>,
    means_ms: Vec<f64>,
    twin: Rates,
}

/// The same in virtual time, as often as asked for.
fn simulate(call: &Call, settings: &Settings) -> Simulated {
    let mut all = Vec::new();
    let mut means_ms = Vec::new();
    let mut counted = Counts::default();
    for part in 0..call.times {
        let mut part_ages = Vec::new();
        for pair in 0..call.pairs as i64 {
            let seed = (part * call.pairs as i64 + pair + 1).unsigned_abs();
            let (ages_ns, counts) = simulate_pair(call, settings, seed);
            part_ages.extend(ages_ns);
            counted = counts.into_iter().fold(counted, sum);
        }
        means_ms.push(ages(part_ages.concat()).mean_ms);
        all.extend(part_ages);
    }
    let streams = (call.times * call.seconds) as f64 * 2.0 * call.pairs as f64;
    let twin = [
        (
            "sent again",
            counted.fast + counted.after_timeout + counted.probes_again,
        ),
        ("fast", counted.fast),
        ("after a timeout", counted.after_timeout - counted.timeouts),
        ("probes", counted.probes),
        ("timeouts", counted.timeouts),
    ];
    let twin = twin.map(|(name, count)| (name, count as f64 / streams));
    Simulated {
        ages: all,
        means_ms,
        twin: twin.into(),
    }
}

/// Two connections, one each way and out of step as when measured.
fn simulate_pair(call: &Call, settings: &Settings, seed: u64) -> ([Vec<i64>; 2], [Counts; 2]) {
    let conditions = Conditions {
        nagle: !call.nodelay,
        stack_ns: call.stack_us * 1000,
        ..Conditions::of(&settings.network)
    };
    let mut exchange = Exchange::new(&conditions, seed);
    let mut ages_ns = [Vec::new(), Vec::new()];
    let mut take = |exchange: &mut Exchange<()>, until_ns| {
        while let Some(read) = exchange.advance(until_ns) {
            if read.sent_ns >= WARM_UP_NS {
                ages_ns[read.to.index()].push(read.at_ns - read.sent_ns);
            }
        }
    };
    for number in 0..call.seconds * 1_000_000 / call.every_us {
        for (position, from) in Peer::ALL.into_iter().enumerate() {
            let now_ns = (number * 8 + position as i64) * call.every_us * 1000 / 8;
            take(&mut exchange, now_ns);
            exchange.send(now_ns, from, (), call.bytes);
        }
    }
    take(&mut exchange, i64::MAX);
    (ages_ns, exchange.counts())
}

fn sum(one: Counts, other: Counts) -> Counts {
    Counts {
        sent: one.sent + other.sent,
        fast: one.fast + other.fast,
        probes: one.probes + other.probes,
        probes_again: one.probes_again + other.probes_again,
        timeouts: one.timeouts + other.timeouts,
        after_timeout: one.after_timeout + other.after_timeout,
        undone: one.undone + other.undone,
    }
}

/// What the two hosts' kernels count (`nstat`), summed.
fn counters(network: &dyn Network) -> Outcome<Rates> {
    const NAMES: [(&str, &str); 5] = [
        ("RetransSegs", "sent again"),
        ("TCPFastRetrans", "fast"),
        ("TCPSlowStartRetrans", "after a timeout"),
        ("TCPLossProbes", "probes"),
        ("TCPTimeouts", "timeouts"),
    ];
    let mut counts = BTreeMap::new();
    for host in [VirtualHost::STA1, VirtualHost::STA2] {
        let read = || -> Outcome<String> {
            network.enter(host)?;
            let paths = ["/proc/thread-self/net/netstat", "/proc/thread-self/net/snmp"];
            Ok(paths
                .map(fs::read_to_string)
                .into_iter()
                .collect::<Result<Vec<_>, _>>()?
                .concat())
        };
        let text =
            thread::scope(|scope| scope.spawn(read).join()).map_err(|_| "reading counters panicked")??;
        let lines: Vec<&str> = text.lines().collect();
        for pair in lines.chunks(2) {
            let [names, values] = pair else { continue };
            for (name, value) in names.split_whitespace().zip(values.split_whitespace()) {
                if let Some((_, ours)) = NAMES.iter().find(|(theirs, _)| *theirs == name) {
                    *counts.entry(*ours).or_insert(0.0) += value.parse::<f64>().unwrap_or(0.0);
                }
            }
        }
    }
    Ok(counts)
}

fn thin(connections: &[Vec<i64>]) -> Vec<i64> {
    let mut thinned: Vec<i64> = connections
        .iter()
        .flat_map(|ages_ns| ages_ns.iter().step_by(THINNED_TO_EACH).copied())
        .collect();
    thinned.sort_unstable();
    thinned
}

fn ages(mut ages_ns: Vec<i64>) -> Ages {
    ages_ns.sort_unstable();
    let in_ms = |ns: i64| (ns as f64 / 1e4).round() / 100.0;
    let count = ages_ns.len();
    let at = |share: f64| ages_ns.get((share * count as f64) as usize).copied().unwrap_or(0);
    let above = |ms: i64| {
        let below = ages_ns.partition_point(|age_ns| *age_ns <= ms * 1_000_000);
        (count - below) as f64 / count.max(1) as f64
    };
    Ages {
        messages: count,
        mean_ms: in_ms(ages_ns.iter().sum::<i64>() / i64::try_from(count.max(1)).unwrap_or(1)),
        quantiles_ms: QUANTILES.map(|share| in_ms(at(share))),
        older: [70, 100, 200, 300, 400].map(above),
        longest_ms: in_ms(ages_ns.last().copied().unwrap_or(0)),
    }
}

/// Kolmogorov's and Smirnov's, of sorted samples.
fn distance(one: &[i64], other: &[i64]) -> f64 {
    let share = |sorted: &[i64], value: i64| {
        sorted.partition_point(|age_ns| *age_ns <= value) as f64 / sorted.len().max(1) as f64
    };
    one.iter()
        .chain(other)
        .map(|value| (share(one, *value) - share(other, *value)).abs())
        .fold(0.0, f64::max)
}

/// Of a larger distance, for large samples (Kolmogorov's distribution).
fn probability(distance: f64, one: usize, other: usize) -> f64 {
    let (one, other) = (one as f64, other as f64);
    let scaled = distance * (one * other / (one + other)).sqrt();
    let term =
        |k: i32| (-2.0 * f64::from(k * k) * scaled * scaled).exp() * if k % 2 == 1 { 2.0 } else { -2.0 };
    (1..=100).map(term).sum::<f64>().clamp(0.0, 1.0)
}
