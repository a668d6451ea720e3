//! The watch over nights beside what others use, on the same made-up nights and on public series whose changes are known: Apache Otava,
//! Mozilla's Perfherder, PELT and a CUSUM. The first three answer through `peers.py`.

use std::{
    error::Error,
    io::Write as _,
    process::{Command, Stdio},
    thread,
};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statistics::{
    nights::{Change, Cusum, Nights, YEAR, observed, with_change},
    public_series::{self, PublicSeries},
    watch::{Night, watch},
};

/// The watch's level is that of one of nine series that have 0.01 a night together. The others have no such setting.
const SERIES: u64 = 9;
const LEVEL: f64 = 0.01 / SERIES as f64;
/// Nights before the first that is judged, from which a CUSUM learns.
const BEFORE: usize = 60;
const AFTER: usize = 100;
/// Years of nine series, and histories with a change.
const YEARS: u64 = 10;
const HISTORIES: u64 = 200;
/// A place is right if it is so near to the truth.
const NEAR: usize = 2;

const STEADY: [Nights; 5] = [
    Nights::Normal,
    Nights::HeavyTails,
    Nights::Autoregression(0.3),
    Nights::Autoregression(0.5),
    Nights::Weekends(2.0),
];
const CHANGES: [Change; 6] = [
    Change::Jump(1.0),
    Change::Jump(2.0),
    Change::Jump(3.0),
    Change::Jump(5.0),
    Change::Slope(0.05),
    Change::Slope(0.1),
];

/// A series, and the first night that is judged.
#[derive(Serialize)]
struct Question {
    values: Vec<f64>,
    from: usize,
    /// The same as the watch has them.
    #[serde(skip)]
    nights: Vec<Night>,
}

impl Question {
    /// Of nights that are made up.
    fn of_nights(values: Vec<f64>, seed: u64) -> Self {
        Self {
            nights: observed(&values, LEVEL, seed),
            values,
            from: BEFORE,
        }
    }

    /// Of values that are a year or a month apart. A CUSUM learns from the first 20 of them, as they are few.
    fn of_public_series(series: &PublicSeries) -> Self {
        let night = |value: &f64| Night {
            value: *value,
            level: 0.01,
            weekday: None,
            is_known_change: false,
        };
        Self {
            nights: series.values.iter().map(night).collect(),
            values: series.values.clone(),
            from: 20,
        }
    }
}

/// A change: the night in which it was told, and the first night with it.
#[derive(Clone, Copy, Deserialize)]
struct Told(usize, usize);

/// As `peers.py` answers.
#[derive(Deserialize)]
struct Answer {
    otava: Vec<Told>,
    perfherder: Vec<Told>,
    pelt: Vec<Told>,
}

/// What each method tells of one series, in the order of [`METHODS`].
type OfMethods = [Vec<Told>; 5];

const METHODS: [&str; 5] = ["matrix", "CUSUM", "Otava", "Perfherder", "PELT"];

/// Prints the tables, in some minutes, if there is a Python with the peers.
pub fn print() {
    let Some(python) = std::env::var_os("MATRIX_PEERS_PYTHON") else {
        println!("not compared: set MATRIX_PEERS_PYTHON=$(reports/examples/referee/prepare)\n");
        return;
    };
    let ask = |questions: &[Question]| {
        ask(&python, questions).unwrap_or_else(|error| {
            eprintln!("{}: {error}", python.display());
            std::process::exit(1);
        })
    };
    years(&ask);
    changes(&ask);
    public(&ask);
}

type Ask<'a> = &'a dyn Fn(&[Question]) -> Vec<OfMethods>;

fn years(ask: Ask<'_>) {
    println!(
        "| changes told in a year, nine series | {} |",
        METHODS.join(" | ")
    );
    println!("|---|{}", "---:|".repeat(METHODS.len()));
    for nights in STEADY {
        let seeds = 40_000..40_000 + YEARS * SERIES;
        let question = |seed| Question::of_nights(nights.values(BEFORE + YEAR, seed), seed);
        let questions: Vec<_> = seeds.map(question).collect();
        let answers = ask(&questions);
        let told = |method: usize| {
            let all: usize = answers.iter().filter_map(|it| it.get(method)).map(Vec::len).sum();
            format!("{:.1}", all as f64 / YEARS as f64)
        };
        row(&nights.name(), told);
    }
}

fn changes(ask: Ask<'_>) {
    println!("\n| change after 60 normal nights | {} |", METHODS.join(" | "));
    println!("|---|{}", "---|".repeat(METHODS.len()));
    for change in CHANGES {
        let seeds = 60_000..60_000 + HISTORIES;
        let values = |seed| with_change(Nights::Normal, change, BEFORE, AFTER, seed);
        let questions: Vec<_> = seeds
            .map(|seed| Question::of_nights(values(seed), seed))
            .collect();
        let answers = ask(&questions);
        let told = |method: usize| {
            let of_method = answers.iter().filter_map(|it| it.get(method));
            let first: Vec<Option<Told>> = of_method.map(|told| told.first().copied()).collect();
            let share = |is_one: &dyn Fn(&Told) -> bool| {
                let count = first.iter().flatten().filter(|told| is_one(told)).count();
                100.0 * count as f64 / HISTORIES as f64
            };
            let within = |nights: usize| share(&|told| told.0 < BEFORE + nights);
            let mut delays: Vec<usize> = first
                .iter()
                .map(|told| told.map_or(usize::MAX, |told| told.0 - BEFORE))
                .collect();
            delays.sort_unstable();
            let median = delays.get(delays.len() / 2).filter(|delay| **delay != usize::MAX);
            let median = median.map_or("never".to_owned(), ToString::to_string);
            let place = match change {
                Change::Jump(_) => {
                    let near = share(&|told| told.1.abs_diff(BEFORE) <= NEAR);
                    format!("; place {near:.0} %")
                }
                Change::Slope(_) => String::new(),
            };
            format!(
                "{:.0} {:.0} {:.0} %, {median}{place}",
                within(5),
                within(10),
                within(20)
            )
        };
        row(&format!("{change:?}"), told);
    }
}

fn public(ask: Ask<'_>) {
    println!("\n| public series: known changes | {} |", METHODS.join(" | "));
    println!("|---|{}", "---|".repeat(METHODS.len()));
    let all: Vec<PublicSeries> = public_series::all();
    let answers = ask(&all.iter().map(Question::of_public_series).collect::<Vec<_>>());
    for (series, answer) in all.iter().zip(&answers) {
        let told = |method: usize| {
            let of_method = answer.get(method).into_iter().flatten();
            let places: Vec<String> = of_method.map(|told| series.label(told.1)).collect();
            match places.is_empty() {
                true => "none".to_owned(),
                false => places.join(", "),
            }
        };
        row(&format!("{}: {}", series.name, series.known), told);
    }
}

fn row(name: &str, cell: impl Fn(usize) -> String) {
    let cells: Vec<String> = (0..METHODS.len()).map(cell).collect();
    println!("| {name} | {} |", cells.join(" | "));
}

/// What each method tells of each series.
fn ask(python: &std::ffi::OsStr, questions: &[Question]) -> Result<Vec<OfMethods>, Box<dyn Error>> {
    let lines: Result<Vec<String>, _> = questions.iter().map(serde_json::to_string).collect();
    let lines = lines?.join("\n");
    let program = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/referee/peers.py");
    let mut peers = Command::new(python)
        .arg(program)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut input = peers.stdin.take().ok_or("no standard input")?;
    let writer = thread::spawn(move || input.write_all(lines.as_bytes()));
    let output = peers.wait_with_output()?;
    writer.join().map_err(|_| "the writer panicked")??;
    if !output.status.success() {
        return Err(format!("peers.py: {}", output.status).into());
    }
    let answers: Result<Vec<Answer>, _> = output
        .stdout
        .split(|byte| *byte == b'\n')
        .filter(|line| !line.is_empty())
        .map(serde_json::from_slice)
        .collect();
    let answers = answers?;
    if answers.len() != questions.len() {
        return Err(format!("{} answers to {} series", answers.len(), questions.len()).into());
    }
    let of_methods = |(question, answer): (&Question, Answer)| {
        let own = watch(&question.nights).changes;
        let own = own.iter().map(|change| Told(change.told, change.at));
        let own = own.filter(|told| told.0 >= question.from).collect();
        let chart = Cusum::OF_INDEPENDENT_NIGHTS.alarms(&question.values, question.from);
        let chart = chart.iter().map(|alarm| Told(alarm.told, alarm.at)).collect();
        [own, chart, answer.otava, answer.perfherder, answer.pelt]
    };
    Ok(questions.par_iter().zip(answers).map(of_methods).collect())
}
