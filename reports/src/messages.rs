//! A row for every message of the experiment: when it was sent, on the wire, arrived and received, and what TCP had to
//! do for it. From the captures and control logs of a run directory; the function is [`write_messages`].
//!
//! ```text
//! sta1.pcap ┐ by stamp                                        ┌ report/messages/<slug>.csv
//!           ├─────────► Exchange ─► deliveries ─► with the ───┤                 <slug>.parquet
//! sta2.pcap ┘           a Flow each direction     control log └ TopicMessages: counts, delays
//! ```
//!
//! Everything is read once and as a stream. What is kept of a connection is what is under way, and of the tables a piece.

mod content;
mod crossings;
mod exchange;
mod flow;
mod frames;
mod log;
mod spans;
mod table;

use std::path::PathBuf;

use record::{
    run_directory::{
        NotWhole, PlannedScenario, ReadError, RunDirectory, RunRecords, ScenarioState, read_whole_record,
    },
    settings::Messages as MessageForm,
};
use serde::Serialize;

pub use self::table::TableError;
use captures::packets::{CaptureReadError, CapturedWindow, Stretch, Topic};

use self::{
    exchange::{Exchange, Ports},
    flow::Delivery,
    log::{Logged, LoggedMessages},
    table::{MessageRow, MessageTable},
};

/// How many of the messages that were not found are named.
const NAMED: usize = 10;

/// What the captures of a run say about its messages.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "matrix messages --json"))]
pub struct Messages {
    /// The run.
    pub run: String,
    /// The scenarios with captures, in letter order.
    pub scenarios: Vec<ScenarioMessages>,
}

/// One scenario's.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ScenarioMessages {
    /// Its letter.
    pub id: String,
    /// Its slug.
    pub slug: String,
    /// Numbers of the windows whose captures were read.
    pub windows: Vec<u32>,
    /// Both topics.
    pub topics: [TopicMessages; 2],
    /// The tables.
    pub files: [PathBuf; 2],
}

/// One topic's, over all windows of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TopicMessages {
    /// `state` or `command`.
    pub topic: &'static str,
    /// Messages in the control log: commands sent, states used.
    pub logged: u64,
    /// Those of them that are in the captures.
    pub found: u64,
    /// Numbers of the first that are not.
    pub missing: Vec<u64>,
    /// Messages in the captures, logged or not.
    pub sent: u64,
    /// Those of them that arrived before the captures ended.
    pub arrived: u64,
    /// Messages of which something was retransmitted.
    pub retransmitted: u64,
    /// Messages of which something arrived again.
    pub duplicated: u64,
    /// Messages of which something was reordered.
    pub reordered: u64,
    /// From the sender's wire to the receiver's, of those that arrived.
    pub one_way: Option<OneWayDelay>,
}

/// Delays, in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OneWayDelay {
    /// The shortest.
    pub min_ns: i64,
    /// Their mean.
    pub mean_ns: f64,
    /// The longest.
    pub max_ns: i64,
}

/// Why there is no table of messages.
#[derive(Debug, thiserror::Error)]
pub enum MessagesError {
    /// The run directory or a log.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A capture.
    #[error(transparent)]
    Capture(#[from] CaptureReadError),
    /// A table.
    #[error(transparent)]
    Write(#[from] TableError),
    /// There is nothing to read.
    #[error("{} has no window with captures", path.display())]
    NoCaptures {
        /// The run directory.
        path: PathBuf,
    },
    /// No scenario of that name.
    #[error("the run has no scenario `{asked}`")]
    NoSuchScenario {
        /// What was asked for.
        asked: String,
        /// What there is.
        known: Vec<String>,
    },
}

impl MessagesError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read(error) => error.hint(),
            Self::Capture(error) => error.hint().to_owned(),
            Self::Write(_) => {
                "see that the disk has room and that you may write to the run directory".to_owned()
            }
            Self::NoCaptures { .. } => {
                "measure with `capture: {enabled: true}` in the matrix file, which is the default".to_owned()
            }
            Self::NoSuchScenario { known, .. } => format!("write one of {}", known.join(", ")),
        }
    }
}

/// Reads the captures of the scenarios that are named by letter or slug, of all if none is, and writes their tables into
/// the run directory's `report/messages/`. A scenario without captures is left out.
///
/// # Errors
/// When the run directory, a log or a capture cannot be read, a table not written, or there is nothing to read.
pub fn write_messages(directory: &RunDirectory, wanted: &[String]) -> Result<Messages, MessagesError> {
    let RunRecords {
        manifest,
        plan,
        state,
        ..
    } = RunRecords::read_unpruned(directory)?;
    for asked in wanted {
        if !plan.scenarios.iter().any(|planned| planned.is_called(asked)) {
            return Err(MessagesError::NoSuchScenario {
                asked: asked.clone(),
                known: plan.scenarios.iter().map(|planned| planned.id.clone()).collect(),
            });
        }
    }
    let is_wanted =
        |planned: &&PlannedScenario| wanted.is_empty() || wanted.iter().any(|name| planned.is_called(name));
    let mut scenarios = Vec::new();
    for planned in plan.scenarios.iter().filter(is_wanted) {
        let windows = captured_windows(directory, planned, &state.scenario(&planned.slug), |_| true)?;
        if !windows.is_empty() {
            scenarios.push(write_scenario(directory, planned, windows)?);
        }
    }
    if scenarios.is_empty() {
        return Err(MessagesError::NoCaptures {
            path: directory.path().to_owned(),
        });
    }
    Ok(Messages {
        run: manifest.run,
        scenarios,
    })
}

/// Those wanted windows that are whole and have captures, whatever they are worth.
fn captured_windows(
    directory: &RunDirectory,
    planned: &PlannedScenario,
    known: &ScenarioState,
    is_wanted: impl Fn(u32) -> bool,
) -> Result<Vec<CapturedWindow>, ReadError> {
    let mut windows = Vec::new();
    for number in (1..=planned.settings.all_windows()).filter(|number| is_wanted(*number)) {
        let folder = directory.window(&planned.slug, number);
        let record = match read_whole_record(&folder, number, known.window_sha256(number)) {
            Ok(record) => record,
            // The report says so.
            Err(NotWhole::Broken(_)) => continue,
            Err(NotWhole::Replaced(error) | NotWhole::Unreadable(error)) => return Err(error),
        };
        let window = CapturedWindow { folder, record };
        if window.is_captured() {
            windows.push(window);
        }
    }
    Ok(windows)
}

fn write_scenario(
    directory: &RunDirectory,
    planned: &PlannedScenario,
    windows: Vec<CapturedWindow>,
) -> Result<ScenarioMessages, MessagesError> {
    let numbers = windows.iter().map(|window| window.record.window).collect();
    let mut table = MessageTable::create(&directory.report().join("messages"), &planned.slug)?;
    let topics = read_messages(planned, windows, &mut |row| Ok(table.push(row)?))?;
    Ok(ScenarioMessages {
        id: planned.id.clone(),
        slug: planned.slug.clone(),
        windows: numbers,
        topics,
        files: table.finish()?,
    })
}

/// Where the rows go.
type Sink<'a> = dyn FnMut(MessageRow) -> Result<(), MessagesError> + 'a;

/// Joins captures and logs, and hands on a row for each message.
fn read_messages(
    planned: &PlannedScenario,
    windows: Vec<CapturedWindow>,
    sink: &mut Sink<'_>,
) -> Result<[TopicMessages; 2], MessagesError> {
    let mut topics = Topic::ALL.map(TopicMessages::none);
    let messages = planned.settings.ros.messages;
    for stretch in Stretch::cut(windows) {
        let mut joining = Joining {
            stretch: &stretch,
            cursors: Topic::ALL.map(|topic| Cursor::new(topic, messages, &stretch)),
            sink: &mut *sink,
            topics: &mut topics,
        };
        joining.begin()?;
        read_packets(&stretch, messages, |ports, delivery| {
            joining.add(ports, &delivery)
        })?;
        joining.finish()?;
    }
    Ok(topics)
}

/// What a scenario's states took on their way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StateWay {
    /// From the plant's wire to the controller's, of its first packet that arrived.
    pub one_way_ns: i64,
    /// When all of it had arrived and when the controller had read it, by the clock of the control log; of states that a control step used.
    pub read_ns: Option<(i64, i64)>,
    /// Whether it was sent once, and nothing before it was missing when it arrived.
    pub is_undisturbed: bool,
}

/// Hands on what each state took on its way that arrived, in those wanted windows of a scenario that have captures.
///
/// # Errors
/// When a log or a capture cannot be read.
pub fn state_ways(
    directory: &RunDirectory,
    planned: &PlannedScenario,
    known: &ScenarioState,
    is_wanted: impl Fn(u32) -> bool,
    mut take: impl FnMut(StateWay),
) -> Result<(), MessagesError> {
    let windows = captured_windows(directory, planned, known, is_wanted)?;
    let mut sink = |row: MessageRow| {
        if row.ports.topic == Topic::State
            && let Some(one_way_ns) = row.one_way_ns
        {
            take(StateWay {
                one_way_ns,
                read_ns: row.in_order_ns.zip(row.received_ns),
                is_undisturbed: row.retransmissions == 0 && row.in_order_ns == row.wire_in_ns,
            });
        }
        Ok(())
    };
    read_messages(planned, windows, &mut sink).map(drop)
}

fn read_packets(
    stretch: &Stretch,
    messages: MessageForm,
    mut out: impl FnMut(Ports, Delivery) -> Result<(), MessagesError>,
) -> Result<(), MessagesError> {
    let mut exchange = Exchange::of(messages);
    let mut given = Vec::new();
    stretch.read(|host, packet, file| {
        exchange
            .take(host, packet, &mut |ports, delivery| given.push((ports, delivery)))
            .map_err(|too_much| file.has_too_much(too_much))?;
        given
            .drain(..)
            .try_for_each(|(ports, delivery)| out(ports, delivery))
    })?;
    exchange.finish(&mut |ports, delivery| given.push((ports, delivery)));
    given
        .into_iter()
        .try_for_each(|(ports, delivery)| out(ports, delivery))
}

/// Deliveries and the log become rows.
struct Joining<'a, 's> {
    stretch: &'a Stretch,
    cursors: [Cursor; 2],
    sink: &'a mut Sink<'s>,
    topics: &'a mut [TopicMessages; 2],
}

/// Where the log of one topic is.
struct Cursor {
    log: LoggedMessages,
    next: Option<Logged>,
}

impl Cursor {
    fn new(topic: Topic, messages: MessageForm, stretch: &Stretch) -> Self {
        let logs = stretch.windows.iter().map(CapturedWindow::log).collect();
        Self {
            log: LoggedMessages::new(topic, messages, logs),
            next: None,
        }
    }

    fn advance(&mut self) -> Result<(), ReadError> {
        self.next = self.log.next()?;
        Ok(())
    }
}

impl Joining<'_, '_> {
    fn begin(&mut self) -> Result<(), ReadError> {
        self.cursors.iter_mut().try_for_each(Cursor::advance)
    }

    fn add(&mut self, ports: Ports, delivery: &Delivery) -> Result<(), MessagesError> {
        let (cursor, topic) = match ports.topic {
            Topic::State => (&mut self.cursors[0], &mut self.topics[0]),
            Topic::Command => (&mut self.cursors[1], &mut self.topics[1]),
        };
        // Both are in the order in which the publisher sent them: what is passed over is in the log only.
        while let Some(passed) = cursor
            .next
            .filter(|logged| logged.label.stamp_ns < delivery.label.stamp_ns)
        {
            topic.miss(passed);
            cursor.advance()?;
        }
        let logged = cursor.next.filter(|logged| logged.label == delivery.label);
        if logged.is_some() {
            cursor.advance()?;
        }
        let own_clock = |unix_ns: Option<i64>| unix_ns.and_then(|ns| self.stretch.on_experiments_clock(ns));
        let window = self.stretch.window_at(delivery.label.stamp_ns);
        let row = MessageRow {
            window: window.map_or(0, |window| window.record.window),
            ports,
            label: delivery.label,
            wire_out_ns: own_clock(delivery.wire_out_unix_ns),
            wire_in_ns: own_clock(delivery.wire_in_unix_ns),
            in_order_ns: own_clock(delivery.in_order_unix_ns),
            received_ns: logged.and_then(|logged| logged.received_ns),
            one_way_ns: (delivery.wire_in_unix_ns)
                .zip(delivery.wire_out_unix_ns)
                .map(|(arrived, left)| arrived - left),
            retransmissions: delivery.retransmissions,
            duplicates: delivery.duplicates,
            reordered: delivery.reordered,
            logged: logged.is_some(),
        };
        topic.add(&row);
        (self.sink)(row)
    }

    fn finish(mut self) -> Result<(), ReadError> {
        for (cursor, topic) in self.cursors.iter_mut().zip(self.topics.iter_mut()) {
            while let Some(passed) = cursor.next {
                topic.miss(passed);
                cursor.advance()?;
            }
        }
        Ok(())
    }
}

impl TopicMessages {
    fn none(topic: Topic) -> Self {
        Self {
            topic: topic.name(),
            logged: 0,
            found: 0,
            missing: Vec::new(),
            sent: 0,
            arrived: 0,
            retransmitted: 0,
            duplicated: 0,
            reordered: 0,
            one_way: None,
        }
    }

    fn miss(&mut self, logged: Logged) {
        self.logged += 1;
        if self.missing.len() < NAMED {
            self.missing.push(logged.number);
        }
    }

    fn add(&mut self, row: &MessageRow) {
        self.logged += u64::from(row.logged);
        self.found += u64::from(row.logged);
        self.sent += 1;
        self.retransmitted += u64::from(row.retransmissions > 0);
        self.duplicated += u64::from(row.duplicates > 0);
        self.reordered += u64::from(row.reordered);
        self.arrived += u64::from(row.wire_in_ns.is_some());
        if let Some(delay_ns) = row.one_way_ns {
            let so_far = self.one_way.unwrap_or(OneWayDelay {
                min_ns: delay_ns,
                mean_ns: 0.0,
                max_ns: delay_ns,
            });
            self.one_way = Some(OneWayDelay {
                min_ns: so_far.min_ns.min(delay_ns),
                mean_ns: so_far.mean_ns + (delay_ns as f64 - so_far.mean_ns) / self.arrived as f64,
                max_ns: so_far.max_ns.max(delay_ns),
            });
        }
    }
}
