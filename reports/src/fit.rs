//! What a platform did to the experiment, as figures that a simulated scenario can be put on. The function is [`fit`].
//!
//! ```text
//! control.csv, plant.csv ─► stalls, lateness of both loops and its correlation ┐
//!                                                                              ├─► PlatformModel, one a scenario
//! captures with the log  ─► the packets' time beside the links, reading         ┘
//! ```
//!
//! A stall is a time in which every tick of both loops begins half a step late or more. Its length is that of the latest tick in it, and a
//! quarter of a step, which is how long it is in the mean from its beginning to the first tick. What is less late is the loop's own.

use std::time::Duration;

use hdrhistogram::Histogram;
use record::{
    platform_model::{PlatformModel, Quantile, Quantiles, StallModel, TickLateness},
    quantity::{Fraction, TimeSpan},
    run_directory::{PlannedScenario, ReadError, RunDirectory, RunRecords, ScenarioState, read_environment},
    settings::Settings,
};
use simulation::virtual_time::tcp::CONGESTION_CONTROL;

use crate::{
    input::loop_logs::{LoggedWindow, LoopLogs, Row, logged_windows, of_the_ball, runs_of_the_loop},
    messages::{MessagesError, StateWay, state_ways},
};

/// The probabilities whose times are written, between the shortest and the longest.
const PROBABILITIES: [f64; 15] = [
    0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9999,
];
/// Times are told apart to one in a thousand.
const DIGITS: u8 = 3;
/// What takes longer counts as this long.
const LONGEST: Duration = Duration::from_secs(30);
/// Fewer ticks say nothing of their lateness.
const FEWEST_TICKS: u64 = 100;

/// The platform of a scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedPlatform {
    /// The scenario's letter.
    pub id: String,
    /// Its slug.
    pub slug: String,
    /// The figures.
    pub model: PlatformModel,
    /// Whether there were captures, without which nothing is known of what messages took beside the links.
    pub has_captures: bool,
    /// What could not be fitted, and why.
    pub remarks: Vec<String>,
}

/// Why there are no figures.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The run directory.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A log of a window.
    #[error("window {window} of {slug}: {reason}")]
    Log {
        /// The window.
        window: u32,
        /// The scenario.
        slug: String,
        /// What is wrong.
        reason: String,
    },
    /// A log or a capture.
    #[error("the messages of {slug} cannot be read")]
    Messages {
        /// The scenario.
        slug: String,
        /// Why.
        source: MessagesError,
    },
    /// There is nothing to fit.
    #[error("no scenario of {run} has logs of the ball on the plate")]
    NoLogs {
        /// The run.
        run: String,
    },
    /// There is nothing to fit in the windows that are wanted.
    #[error(
        "no scenario of {run} has a window {} with logs of the ball on the plate",
        either(wanted)
    )]
    NoSuchWindow {
        /// The run.
        run: String,
        /// Their numbers.
        wanted: Vec<u32>,
    },
}

fn either(numbers: &[u32]) -> String {
    let texts: Vec<String> = numbers.iter().map(u32::to_string).collect();
    texts.join(" or ")
}

impl FitError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read(error) => error.hint(),
            Self::Log { .. } => {
                "`matrix status RUN --verify` names the files that are not as they were written".to_owned()
            }
            Self::Messages { source, .. } => source.hint(),
            Self::NoLogs { .. } => "fit a run of the built-in experiment".to_owned(),
            Self::NoSuchWindow { .. } => "`matrix status RUN` lists the windows that there are".to_owned(),
        }
    }
}

/// Fits the platform of each scenario of a run. That of a simulated one is what it was put on, as far as it can be found again.
///
/// Only the windows of these numbers are looked at, or all if none is named.
///
/// # Errors
/// When the run cannot be read, or has nothing to fit.
pub fn fit(directory: &RunDirectory, wanted: &[u32]) -> Result<Vec<FittedPlatform>, FitError> {
    let records = RunRecords::read_unpruned(directory)?;
    let run = &records.manifest.run;
    let fitted = of_the_ball(&records, |planned, known| {
        of_scenario(directory, run, planned, known, wanted)
    })?;
    let fitted: Vec<FittedPlatform> = fitted.into_iter().flatten().collect();
    match (fitted.is_empty(), wanted) {
        (false, _) => Ok(fitted),
        (true, []) => Err(FitError::NoLogs { run: run.clone() }),
        (true, wanted) => Err(FitError::NoSuchWindow {
            run: run.clone(),
            wanted: wanted.to_vec(),
        }),
    }
}

/// The same of one scenario; none if it has no window.
///
/// # Errors
/// When a log or a capture of it cannot be read.
pub fn of_scenario(
    directory: &RunDirectory,
    run: &str,
    planned: &PlannedScenario,
    known: &ScenarioState,
    wanted: &[u32],
) -> Result<Option<FittedPlatform>, FitError> {
    let is_wanted = |window: u32| wanted.is_empty() || wanted.contains(&window);
    let mut windows = logged_windows(directory, planned, known)?;
    windows.retain(|(_, record)| is_wanted(record.window));
    if windows.is_empty() {
        return Ok(None);
    }
    let mut loops = Loops::of(&planned.settings);
    let mut ways = Ways::over(&planned.settings);
    // Each has a clock of its own.
    for windows in runs_of_the_loop(&windows) {
        let stalled = loops.read(windows).map_err(|(window, reason)| FitError::Log {
            window,
            slug: planned.slug.clone(),
            reason,
        })?;
        let is_one = |window: u32| windows.iter().any(|(_, record)| record.window == window);
        state_ways(directory, planned, known, is_one, |way| ways.add(&way, &stalled)).map_err(|source| {
            FitError::Messages {
                slug: planned.slug.clone(),
                source,
            }
        })?;
    }
    let mut remarks = Vec::from_iter(other_congestion_control(directory, planned, known));
    let median_ns = ways.of_packets.median_ns();
    let (stack, reading) = match median_ns {
        Some(median_ns) => (time(median_ns), ways.of_reading.quantiles()),
        None => {
            remarks.push(
                "no captures: what packets take beside the links, and reading, is left at nothing".to_owned(),
            );
            Default::default()
        }
    };
    if loops.controller.times.count < FEWEST_TICKS {
        remarks.push(format!(
            "{} ticks say little of how late ticks are",
            loops.controller.times.count
        ));
    }
    let numbers: Vec<String> = windows
        .iter()
        .map(|(_, record)| record.window.to_string())
        .collect();
    let model = PlatformModel {
        about: format!(
            "fitted to {}{}, windows {} of {run}",
            planned.slug,
            if planned.simulated { " (simulated)" } else { "" },
            numbers.join(", ")
        ),
        stalls: loops.stalls.model(&planned.settings, windows.len()),
        controller: loops.controller.model(),
        plant: loops.plant.model(),
        stack,
        reading,
    };
    Ok(Some(FittedPlatform {
        id: planned.id.clone(),
        slug: planned.slug.clone(),
        model,
        has_captures: median_ns.is_some(),
        remarks,
    }))
}

/// That the scenario's TCP is not the simulation's, which no figure of a platform can make up for.
fn other_congestion_control(
    directory: &RunDirectory,
    planned: &PlannedScenario,
    known: &ScenarioState,
) -> Option<String> {
    // A simulated scenario has the simulation's, whatever its machine has.
    if planned.simulated {
        return None;
    }
    let place = directory.environment(&planned.slug);
    let record = read_environment(&place, known.environment_sha256s()).ok()?;
    let measured = record.platform?.tcp_congestion_control()?.to_owned();
    (measured != CONGESTION_CONTROL).then(|| {
        format!(
            "TCP had the congestion control `{measured}`, and has `{CONGESTION_CONTROL}` in the simulation: after a loss, messages wait \
             differently; to measure with it, run `sysctl net.ipv4.tcp_congestion_control={CONGESTION_CONTROL}` first"
        )
    })
}

/// Both loops of a scenario.
struct Loops {
    step_ns: i64,
    controller: Lateness,
    plant: Lateness,
    stalls: StallTimes,
}

impl Loops {
    fn of(settings: &Settings) -> Self {
        let step_ns = nanoseconds(settings.rate.step());
        Self {
            step_ns,
            controller: Lateness::default(),
            plant: Lateness::default(),
            stalls: StallTimes::default(),
        }
    }

    /// Adds the windows of a run of the loop; when it stood still, or the window that cannot be read, and why.
    fn read(&mut self, windows: &[LoggedWindow]) -> Result<Stalled, (u32, String)> {
        let mut stalled = Stalled::default();
        let mut at = 0;
        self.controller.begin();
        self.plant.begin();
        for row in LoopLogs::of(windows) {
            let number = windows.get(at).map_or(0, |(_, record)| record.window);
            let (lateness, late_ns, began_ns) = match row.map_err(|reason| (number, reason))? {
                Row::Plant(row) => (
                    &mut self.plant,
                    row.actual_ns.saturating_sub(row.scheduled_ns),
                    row.actual_ns,
                ),
                Row::Control { window, row } => {
                    at = window;
                    (
                        &mut self.controller,
                        row.actual_ns.saturating_sub(row.scheduled_ns),
                        row.actual_ns,
                    )
                }
            };
            let late_ns = late_ns.max(0);
            match late_ns >= self.step_ns / 2 {
                true => {
                    self.stalls.add(late_ns, began_ns, self.step_ns);
                    // It began some time after the tick before.
                    stalled.add(began_ns - late_ns - self.step_ns, began_ns);
                    // What comes next does not follow on what is gone.
                    lateness.begin();
                }
                false => lateness.add(late_ns),
            }
        }
        self.stalls.end(self.step_ns);
        Ok(stalled)
    }
}

/// How late the ticks of a loop are, and how each depends on the one before it.
#[derive(Default)]
struct Lateness {
    times: Times,
    before: Option<f64>,
    /// Of pairs of successive ticks: how many, and sums of their logarithms, squares and product. A tick that repeats the one before it with
    /// some probability has that correlation in any function of its lateness, and logarithms are not ruled by the few that are very late.
    pairs: [f64; 6],
}

impl Lateness {
    fn begin(&mut self) {
        self.before = None;
    }

    fn add(&mut self, late_ns: i64) {
        self.times.add(late_ns);
        let now = (1.0 + late_ns as f64 / 1000.0).ln();
        if let Some(before) = self.before.replace(now) {
            let of_pair = [1.0, before, now, before * before, now * now, before * now];
            self.pairs
                .iter_mut()
                .zip(of_pair)
                .for_each(|(sum, value)| *sum += value);
        }
    }

    fn correlation(&self) -> f64 {
        let [n, x, y, xx, yy, xy] = self.pairs;
        let covariance = n * xy - x * y;
        let variances = (n * xx - x * x) * (n * yy - y * y);
        match variances > 0.0 {
            true => covariance / variances.sqrt(),
            false => 0.0,
        }
    }

    fn model(&self) -> TickLateness {
        // To a tenth of a percent, for a reader.
        let persistence = (self.correlation().clamp(0.0, 1.0) * 1000.0).round() / 10.0;
        TickLateness {
            late: self.times.quantiles(),
            persistence: Fraction::from_percent(persistence),
        }
    }
}

/// How long the machine stood still.
#[derive(Default)]
struct StallTimes {
    times: Times,
    /// Of the stall under way: its latest tick, and when its newest one began.
    under_way_ns: Option<(i64, i64)>,
}

impl StallTimes {
    /// A tick that began so late. Ticks that are caught up begin together once a stall is over, and are of one.
    fn add(&mut self, late_ns: i64, began_ns: i64, step_ns: i64) {
        let is_of_the_same = |newest_ns: i64| began_ns.saturating_sub(newest_ns) <= step_ns / 2;
        if self
            .under_way_ns
            .is_some_and(|(_, newest_ns)| !is_of_the_same(newest_ns))
        {
            self.end(step_ns);
        }
        let (latest_ns, newest_ns) = self.under_way_ns.get_or_insert((late_ns, began_ns));
        *latest_ns = late_ns.max(*latest_ns);
        *newest_ns = began_ns;
    }

    fn end(&mut self, step_ns: i64) {
        if let Some((latest_ns, _)) = self.under_way_ns.take() {
            self.times.add(latest_ns.saturating_add(step_ns / 4));
        }
    }

    fn model(&self, settings: &Settings, windows: usize) -> StallModel {
        let hours = settings.longest_window().as_secs_f64() * windows as f64 / 3600.0;
        let per_hour = self.times.count as f64 / hours.max(f64::MIN_POSITIVE);
        // At 250 Hz and more ticks could be late more often than a model draws stalls.
        let per_hour = per_hour.min(StallModel::MOST_PER_HOUR);
        StallModel {
            // To three digits, for a reader.
            per_hour: format!("{per_hour:.2e}").parse().unwrap_or(per_hour),
            length: self.times.quantiles(),
        }
    }
}

/// When the machine may have stood still in a run of the loop, by its clock: times in order, none of which overlap.
#[derive(Default)]
struct Stalled(Vec<(i64, i64)>);

impl Stalled {
    fn add(&mut self, from_ns: i64, to_ns: i64) {
        match self.0.last_mut().filter(|(_, end_ns)| from_ns <= *end_ns) {
            Some((begin_ns, end_ns)) => {
                *begin_ns = from_ns.min(*begin_ns);
                *end_ns = to_ns.max(*end_ns);
            }
            None => self.0.push((from_ns, to_ns)),
        }
    }

    fn has_any_of(&self, from_ns: i64, to_ns: i64) -> bool {
        let first = self.0.partition_point(|(_, end_ns)| *end_ns < from_ns);
        self.0.get(first).is_some_and(|(begin_ns, _)| *begin_ns <= to_ns)
    }
}

/// What states took on their way.
struct Ways {
    links_ns: i64,
    /// Beside the links.
    of_packets: Times,
    of_reading: Times,
}

impl Ways {
    /// Over the links of a scenario.
    fn over(settings: &Settings) -> Self {
        Self {
            links_ns: 2 * nanoseconds(settings.network.delay.duration()),
            of_packets: Times::default(),
            of_reading: Times::default(),
        }
    }

    fn add(&mut self, way: &StateWay, stalled: &Stalled) {
        if !way.is_undisturbed {
            return;
        }
        // The links may take a thousand times as long, and times are told apart to one in a thousand.
        self.of_packets.add(way.one_way_ns.saturating_sub(self.links_ns));
        // What waited for the end of a stall is the stall's, which the model has beside it.
        if let Some((there_ns, read_ns)) = way.read_ns
            && !stalled.has_any_of(there_ns, read_ns)
        {
            self.of_reading.add(read_ns.saturating_sub(there_ns));
        }
    }
}

/// Times, counted in memory of fixed size.
#[derive(Default)]
struct Times {
    histogram: Option<Histogram<u64>>,
    count: u64,
    shortest_ns: Option<i64>,
    longest_ns: i64,
}

impl Times {
    fn add(&mut self, ns: i64) {
        let ns = ns.clamp(0, nanoseconds(LONGEST));
        self.count += 1;
        self.shortest_ns = Some(self.shortest_ns.map_or(ns, |shortest_ns| shortest_ns.min(ns)));
        self.longest_ns = self.longest_ns.max(ns);
        if self.histogram.is_none() {
            // Never an error for a number of digits up to 5.
            self.histogram = Histogram::new_with_max(LONGEST.as_nanos() as u64, DIGITS).ok();
        }
        if let Some(histogram) = &mut self.histogram {
            histogram.saturating_record(u64::try_from(ns).unwrap_or(0));
        }
    }

    fn at_ns(&self, probability: f64) -> i64 {
        let found = self
            .histogram
            .as_ref()
            .map_or(0, |it| it.value_at_quantile(probability));
        let shortest_ns = self.shortest_ns.unwrap_or(0);
        i64::try_from(found)
            .unwrap_or(i64::MAX)
            .clamp(shortest_ns, self.longest_ns)
    }

    fn median_ns(&self) -> Option<i64> {
        (self.count > 0).then(|| self.at_ns(0.5))
    }

    /// The quantiles that so many times can have; without any, none.
    fn quantiles(&self) -> Quantiles {
        let Some(shortest_ns) = self.shortest_ns else {
            return Quantiles::default();
        };
        let can_be_told = |p: &f64| (1.0 - p) * self.count as f64 >= 1.0 && p * self.count as f64 >= 1.0;
        let between = PROBABILITIES.into_iter().filter(can_be_told);
        let points = between.map(|p| (p, self.at_ns(p)));
        let points = std::iter::once((0.0, shortest_ns))
            .chain(points)
            .chain([(1.0, self.longest_ns)]);
        Quantiles(points.map(|(p, ns)| Quantile(p, time(ns))).collect())
    }
}

/// To the tenth of a microsecond, for a reader.
fn time(ns: i64) -> TimeSpan {
    let rounded = u64::try_from(ns).unwrap_or(0).saturating_add(50) / 100 * 100;
    Duration::from_nanos(rounded).into()
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use std::{fs, path::Path};

    use serde_json::Value;

    use super::*;

    #[test]
    fn what_was_read_after_a_stall_is_no_reading_time() {
        let mut stalled = Stalled::default();
        // Two ticks of one stall, caught up together, and a stall by itself.
        stalled.add(100, 150);
        stalled.add(120, 151);
        stalled.add(300, 380);
        assert_eq!(stalled.0, [(100, 151), (300, 380)]);
        let mut settings = Settings::default();
        settings.network.delay = TimeSpan::from_millis(100);
        let mut ways = Ways::over(&settings);
        let read = |there_ns, read_ns| StateWay {
            one_way_ns: 200_000_020,
            read_ns: Some((there_ns, read_ns)),
            is_undisturbed: true,
        };
        for way in [
            read(10, 15),
            read(110, 152),
            read(90, 400),
            read(151, 160),
            read(379, 381),
        ] {
            ways.add(&way, &stalled);
        }
        assert_eq!((ways.of_packets.count, ways.of_reading.count), (5, 1));
        assert_eq!(ways.of_packets.median_ns(), Some(20));
        ways.add(&read(200, 204), &stalled);
        assert_eq!(ways.of_reading.longest_ns, 5);
    }

    #[test]
    fn a_congestion_control_that_the_simulation_does_not_have_is_remarked() {
        let recorded = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/recorded");
        let records = RunRecords::read_unpruned(&RunDirectory::new(recorded.clone())).unwrap();
        let planned = &records.plan.scenarios[0];
        let folder = tempfile::tempdir().unwrap();
        let copy = RunDirectory::new(folder.path());
        let (from, to) = (RunDirectory::new(recorded), copy.environment(&planned.slug));
        fs::create_dir_all(to.path().parent().unwrap()).unwrap();
        let text = fs::read_to_string(from.environment(&planned.slug).path()).unwrap();
        let remark = |control: Value| {
            let mut record: Value = serde_json::from_str(&text).unwrap();
            record["platform"]["tcp_congestion_control"] = control;
            fs::write(to.path(), record.to_string()).unwrap();
            other_congestion_control(&copy, planned, &ScenarioState::default())
        };
        assert!(remark("bbr".into()).unwrap().contains("congestion control `bbr`"));
        assert_eq!(remark("cubic".into()), None);
        assert_eq!(remark(Value::Null), None);
    }
}
