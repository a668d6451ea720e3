//! The same network in several ways: the paper's links by each backend in turn, in the guest in virtual time, so that
//! what is compared are the networks and not what else this machine does.
//!
//! `cargo bench -p tests --bench network_compare` takes all backends, `-- kernel mininet` those that it names. The first
//! is what the others are compared with. Prints the tables of `docs/network.md`; it is not a test and has no bound.

use std::fs;

use serde_json::{Value, json};
use tests::{Workplace, network_probe, virtual_time};

const PINGS: usize = 6000;
const PAIRS: usize = 6000;
const SECONDS: usize = 20;

/// A backend with settings of its own, and what has to be started for it.
struct Way {
    name: &'static str,
    settings: fn() -> Value,
    before: &'static str,
}

/// All ways to have the network. A new backend joins here by its name.
const WAYS: [Way; 4] = [
    Way {
        name: "kernel",
        settings: || json!({"network": {"backend": "kernel"}}),
        before: "",
    },
    Way {
        name: "kernel-without-offloads",
        settings: || json!({"network": {"backend": "kernel", "offloads": "none"}}),
        before: "",
    },
    Way {
        name: "userspace",
        settings: || json!({"network": {"backend": "userspace"}}),
        before: "modprobe tun",
    },
    Way {
        name: "mininet",
        settings: || json!({"network": {"backend": "mininet"}}),
        before: "ip link set lo up\n/usr/share/openvswitch/scripts/ovs-ctl start --system-id=random >/dev/null",
    },
];

/// Times in milliseconds and counts of one way.
struct Measured {
    name: &'static str,
    round_trip_ms: Vec<f64>,
    there_ms: Vec<f64>,
    back_ms: Vec<f64>,
    pairs: Value,
    throughput: Value,
}

fn main() {
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with('-'))
        .collect();
    let chosen: Vec<&Way> = WAYS
        .iter()
        .filter(|way| wanted.is_empty() || wanted.iter().any(|name| name == way.name))
        .collect();
    let measured: Vec<Measured> = chosen.into_iter().map(measure).collect();
    let Some((reference, others)) = measured.split_first() else {
        panic!("no backend is named {wanted:?}");
    };
    times(&measured, "round trip", |way| &way.round_trip_ms);
    times(&measured, "one way, sta1 to sta2", |way| &way.there_ms);
    times(&measured, "one way, sta2 to sta1", |way| &way.back_ms);
    counts(&measured);
    let workplace = Workplace::new();
    println!(
        "\n| against {} | mean round trip | KS of round trips | KS one way | loss one way | order |",
        reference.name
    );
    println!("|---|---|---|---|---|---|");
    for other in others {
        println!(
            "| {} | {:+.3} ms | {} | {} | p = {:.2} | p = {:.2} |",
            other.name,
            mean(&other.round_trip_ms) - mean(&reference.round_trip_ms),
            ks(&workplace, &reference.round_trip_ms, &other.round_trip_ms),
            ks(&workplace, &reference.there_ms, &other.there_ms),
            same_share(lost(reference), lost(other)),
            same_share(swapped(reference), swapped(other)),
        );
    }
}

fn measure(way: &Way) -> Measured {
    let settings = (way.settings)().to_string().replace('"', "\\\"");
    let result = virtual_time::run(
        &[network_probe()],
        &format!(
            "{}\n./network_probe \"{settings}\" --pings {PINGS} --pairs {PAIRS} --seconds {SECONDS} >$RESULT",
            way.before
        ),
    );
    let found: Value = serde_json::from_str(result.trim()).expect("the probe prints JSON");
    let times = |name: &str| -> Vec<f64> {
        let times = found["pings"][name].as_array().expect("a list of times");
        times
            .iter()
            .filter_map(Value::as_f64)
            .map(|ns| ns / 1e6)
            .collect()
    };
    Measured {
        name: way.name,
        round_trip_ms: times("round_trip_ns"),
        there_ms: times("there_ns"),
        back_ms: times("back_ns"),
        pairs: found["pairs"].clone(),
        throughput: found["throughput"].clone(),
    }
}

fn times(measured: &[Measured], what: &str, of: fn(&Measured) -> &Vec<f64>) {
    println!("\n| {what}, ms | n | mean | deviation | 1 % | 25 % | median | 75 % | 99 % | largest |");
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for way in measured {
        let mut sorted = of(way).clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        let mean = mean(&sorted);
        let squares: f64 = sorted.iter().map(|t| (t - mean).powi(2)).sum();
        println!(
            "| {} | {} | {mean:.3} | {:.3} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            way.name,
            sorted.len(),
            (squares / (sorted.len() - 1) as f64).sqrt(),
            at(0.01),
            at(0.25),
            at(0.5),
            at(0.75),
            at(0.99),
            at(1.0)
        );
    }
}

fn counts(measured: &[Measured]) {
    println!("\n| | lost one way | pairs that swapped | gap of a pair | TCP | full frames |");
    println!("|---|---|---|---|---|---|");
    for way in measured {
        let percent = |(part, whole): (f64, f64)| 100.0 * part / whole;
        let mbit = |name: &str| way.throughput[name].as_f64().unwrap_or(f64::NAN) / 1e6;
        println!(
            "| {} | {:.2} % | {:.1} % | {:.0} µs | {:.2} Mbit/s | {:.3} Mbit/s |",
            way.name,
            percent(lost(way)),
            percent(swapped(way)),
            way.pairs["gap_ns"].as_f64().unwrap_or(f64::NAN) / 1e3,
            mbit("tcp_bits_per_second"),
            mbit("flood_bits_per_second")
        );
    }
}

/// Packets lost on either way, of those sent.
fn lost(way: &Measured) -> (f64, f64) {
    let (there, back) = (way.there_ms.len(), way.back_ms.len());
    ((PINGS - there + there - back) as f64, (PINGS + there) as f64)
}

/// Pairs whose second came first, of those that came whole.
fn swapped(way: &Measured) -> (f64, f64) {
    let count = |name: &str| way.pairs[name].as_f64().unwrap_or(f64::NAN);
    (count("swapped"), count("whole"))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The product's own test: distance and p.
fn ks(workplace: &Workplace, x: &[f64], y: &[f64]) -> String {
    for (name, values) in [("x", x), ("y", y)] {
        let lines: Vec<String> = values.iter().map(f64::to_string).collect();
        fs::write(workplace.path().join(name), lines.join("\n")).expect("the folder can be written");
    }
    let test = workplace.json(&["ks", "x", "y"]);
    format!(
        "D = {:.3}, p = {:.2}",
        test["d"].as_f64().unwrap_or(f64::NAN),
        test["p"].as_f64().unwrap_or(f64::NAN)
    )
}

/// Two-sided p of two shares being the same: the z test with the pooled share (Fleiss, Levin and Paik, Statistical
/// Methods for Rates and Proportions, 3rd edition, section 3.1).
fn same_share((x, n): (f64, f64), (y, m): (f64, f64)) -> f64 {
    let pooled = (x + y) / (n + m);
    let z = (x / n - y / m).abs() / (pooled * (1.0 - pooled) * (1.0 / n + 1.0 / m)).sqrt();
    complementary_error(z / std::f64::consts::SQRT_2)
}

/// erfc by the rational approximation 7.1.26 of Abramowitz and Stegun, to 1.5e-7.
fn complementary_error(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let polynomial = [
        1.061_405_429,
        -1.453_152_027,
        1.421_413_741,
        -0.284_496_736,
        0.254_829_592,
    ]
    .iter()
    .fold(0.0, |sum, coefficient| (sum + coefficient) * t);
    polynomial * (-x * x).exp()
}
