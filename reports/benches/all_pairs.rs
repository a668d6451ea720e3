//! All pairs of a thousand windows of 60 values, compared exactly: against loops over SciPy's `ks_2samp` and R's `ks.test`,
//! and against merging the sorted windows, which is the least that a test one by one would take.
//!
//! `MATRIX_PEERS_PYTHON=$(reports/benches/prepare) cargo bench --profile dev --workspace --bench all_pairs`: in the profile
//! that users have. Prints medians and ratios; it is not a test and has no bound. docs/performance.md has the last figures.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // As in tests; and a benchmark prints.

use std::{env, fs, hint::black_box, io::Write as _, path::Path, process::Command, time::Duration};

use record::report_settings::ReportSettings;
use reports::analysis::{
    comparison::{compare, pairs_of},
    sample::Sample,
};
use statistics::ks::{self, Pool, Procedure};
use timing::{median, time};

mod timing;

const WINDOWS: usize = 1000;
const VALUES: usize = 60;
/// As many windows as have ten million pairs.
const MANY_WINDOWS: usize = 4473;
const ROUNDS: usize = 5;

fn main() {
    let windows = windows(WINDOWS, f64::from);
    let pairs = pairs_of(WINDOWS);
    let file = tempfile::NamedTempFile::new().unwrap();
    write(&windows, file.path());
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers");
    let python = env::var_os("MATRIX_PEERS_PYTHON").unwrap_or("python3".into());

    let (mut ours, mut one_core, mut merging) = (Vec::new(), Vec::new(), Vec::new());
    let (mut scipy, mut r) = (Vec::new(), Vec::new());
    let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for _ in 0..ROUNDS {
        ours.push(time(|| all_pairs(&windows)));
        one_core.push(time(|| single.install(|| all_pairs(&windows))));
        merging.push(time(|| merged(&windows)));
        scipy.push(peer(
            Command::new(&python).arg(folder.join("ks.py")),
            file.path(),
            &windows,
        ));
        r.push(peer(
            Command::new("Rscript").arg(folder.join("ks.R")),
            file.path(),
            &windows,
        ));
    }
    let tied = time(|| {
        all_pairs(&self::windows(WINDOWS, |value| {
            f64::from(value >> 22) * 4_194_304.0
        }))
    });

    println!("{pairs} exact tests of {VALUES} and {VALUES} values, medians of {ROUNDS} rounds");
    let ours = median(ours).as_secs_f64() / pairs as f64;
    let row = |name: &str, seconds: f64| {
        println!(
            "{name:<36} {:>12.1} ns a test {:>10.1} x",
            seconds * 1e9,
            seconds / ours
        );
    };
    row("all pairs", ours);
    row(
        "all pairs, one core",
        median(one_core).as_secs_f64() / pairs as f64,
    );
    row(
        "merging two sorted windows, one core",
        median(merging).as_secs_f64() / pairs as f64,
    );
    row(
        "all pairs, nearly all with ties",
        tied.as_secs_f64() / pairs as f64,
    );
    let looped = (WINDOWS - 1) as f64;
    row(
        "scipy.stats.ks_2samp, one core",
        median(scipy).as_secs_f64() / looped,
    );
    row("R's ks.test, one core", median(r).as_secs_f64() / looped);
    println!("most memory so far: {} MB", most_memory_mb());

    let listed = samples(&windows);
    let settings = ReportSettings::default();
    let list = time(|| black_box(compare(&listed, &settings)).unwrap().0.frame().height());
    println!(
        "listed as a report has them: {list:.1?}; most memory so far: {} MB",
        most_memory_mb()
    );
    let many = samples(&self::windows(MANY_WINDOWS, f64::from));
    let counted = time(|| black_box(compare(&many, &settings)).unwrap().1.len());
    println!(
        "{} counted, not listed: {counted:.1?}; most memory so far: {} MB",
        pairs_of(MANY_WINDOWS),
        most_memory_mb()
    );
}

/// How many pairs are rejected, to have used each p-value.
fn all_pairs(windows: &[Vec<f64>]) -> usize {
    let pool = Pool::of(windows).unwrap();
    let rejected = pool.pairs(Procedure::default(), |_, partners| {
        partners.filter(|(_, test)| test.p < 0.001).count()
    });
    black_box(rejected.into_iter().sum())
}

fn merged(windows: &[Vec<f64>]) -> usize {
    let mut sorted = windows.to_vec();
    sorted
        .iter_mut()
        .for_each(|window| window.sort_by(f64::total_cmp));
    let mut out = vec![0.0; 2 * VALUES];
    for (at, x) in sorted.iter().enumerate() {
        for y in sorted.iter().skip(at + 1) {
            merge(x, y, &mut out);
            black_box(&mut out);
        }
    }
    out.len()
}

fn merge(x: &[f64], y: &[f64], out: &mut [f64]) {
    let (mut x, mut y) = (x.iter().peekable(), y.iter().peekable());
    for place in out {
        let from_x = match (x.peek(), y.peek()) {
            (Some(a), Some(b)) => a <= b,
            (a, _) => a.is_some(),
        };
        let next = if from_x { x.next() } else { y.next() };
        *place = next.copied().unwrap_or_default();
    }
}

/// What a peer's loop over neighbouring windows took, after its p-values have been found to be ours.
fn peer(command: &mut Command, file: &Path, windows: &[Vec<f64>]) -> Duration {
    let output = command.arg(file).output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let text = String::from_utf8(output.stdout).unwrap();
    let mut numbers = text.lines().map(|line| line.trim().parse::<f64>().unwrap());
    let seconds = numbers.next().unwrap();
    for pair in windows.windows(2) {
        let (theirs, ours) = (numbers.next().unwrap(), ks::test(&pair[0], &pair[1]).unwrap().p);
        assert!((theirs - ours).abs() < 1e-9, "{theirs} {ours}");
    }
    Duration::from_secs_f64(seconds)
}

/// Windows that differ a little, from a fixed sequence; no two values of 32 bits are likely to be equal.
fn windows(count: usize, value: impl Fn(u32) -> f64) -> Vec<Vec<f64>> {
    let mut state = 88_172_645_463_325_252_u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u32
    };
    (0..count)
        .map(|window| {
            let shift = (window % 7) as f64 * 0.02;
            (0..VALUES)
                .map(|_| value(next()) / 4_294_967_296.0 + shift)
                .collect()
        })
        .collect()
}

fn samples(windows: &[Vec<f64>]) -> Vec<Sample> {
    let four_each = windows.iter().enumerate().map(|(at, values)| Sample {
        scenario: format!("{:04}", at / 4),
        window: (at % 4) as u32 + 1,
        first_value: 1,
        values: values.clone(),
    });
    four_each.collect()
}

fn write(windows: &[Vec<f64>], path: &Path) {
    let mut file = fs::File::create(path).unwrap();
    for window in windows {
        let line: Vec<String> = window.iter().map(f64::to_string).collect();
        writeln!(file, "{}", line.join(",")).unwrap();
    }
}

fn most_memory_mb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
}
