//! What became of the packets between controller and plant, window by window: delays, RTT, jitter, gaps, lost,
//! retransmitted and reordered packets. From the captures of both hosts, which one clock stamps. The main type is
//! [`Traffic`]; [`read`] reads a scenario's.
//!
//! ```text
//! sta1.pcap ┐ by stamp                                                           of each window, topic and period:
//!           ├─────────► Direction: what left is found where it arrived ─ Passing ─► means, counts, distributions
//! sta2.pcap ┘           a Connection each: what is acknowledged, and when
//! ```
//!
//! A packet here is a TCP segment with some of the stream in it. It is known again at the other capture by its ports,
//! place, length, TCP's clock and IP's number, so that a retransmitted packet is another one than the first.
//! Captures are read once and as a stream: what is held is what is under way, of each window its periods and curves, and a
//! histogram of fixed size for each distribution of the windows of the last minute. A window that has more under way, or more
//! connections, than any experiment is left out as one whose captures cannot be read.

mod connection;
mod direction;
mod period;
mod quantity;
mod spread;
mod window;

use std::collections::{BTreeMap, VecDeque};

use self::{
    direction::{Directions, Passing},
    spread::LONGEST_NS,
    window::WindowTally,
};
pub use self::{
    period::PeriodTraffic,
    quantity::Quantity,
    spread::{Spread, together},
    window::{DirectionTraffic, WindowTraffic},
};
use record::quantity::TimeSpan;

use crate::packets::{CaptureReadError, CapturedWindow, Segment, Stretch, Topic};

/// What the captures of a run say, by the scenarios' letters.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Traffic {
    /// Those with captures.
    pub scenarios: BTreeMap<String, ScenarioTraffic>,
}

/// What the captures of a scenario say.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScenarioTraffic {
    /// The windows that count and whose captures could be read, in order.
    pub windows: Vec<WindowTraffic>,
    /// Windows whose captures cannot be used, and why.
    pub unreadable: Vec<(u32, String)>,
}

impl ScenarioTraffic {
    /// One direction of each window.
    pub fn directions(&self, topic: Topic) -> impl Iterator<Item = &DirectionTraffic> {
        self.windows.iter().map(move |window| window.direction(topic))
    }

    /// How a time spread in one direction, window by window.
    #[must_use]
    pub fn spreads(&self, topic: Topic, of: impl Fn(&DirectionTraffic) -> Option<&Spread>) -> Vec<&Spread> {
        self.directions(topic).filter_map(of).collect()
    }
}

/// Reads the captures of a scenario's windows, whose periods have that length. A capture that cannot be used takes its
/// window out and no other.
#[must_use]
pub fn read(windows: Vec<CapturedWindow>, period: TimeSpan) -> ScenarioTraffic {
    let period_ns = i64::try_from(period.as_nanos()).unwrap_or(i64::MAX);
    let mut traffic = ScenarioTraffic::default();
    let mut stretches = Stretch::cut(windows);
    // From behind: what a stretch without one of its windows leaves is read next.
    stretches.reverse();
    while let Some(stretch) = stretches.pop() {
        match read_stretch(&stretch, period_ns) {
            Ok(windows) => traffic.windows.extend(windows),
            Err(error) => {
                // The scenario and the window say in which folder: where that is on this machine is nobody's business.
                let file = error.path.file_name().unwrap_or_default().display();
                let reason = format!("{file} cannot be used: {}", error.source);
                let at_fault = stretch.window_of(&error.path);
                traffic.unreadable.extend(at_fault.map(|window| (window, reason)));
                let [before, after] = stretch.without(&error.path);
                stretches.extend([after, before].into_iter().flatten());
            }
        }
    }
    traffic
}

fn read_stretch(stretch: &Stretch, period_ns: i64) -> Result<Vec<WindowTraffic>, CaptureReadError> {
    let mut directions = Directions::default();
    let mut windows = Windows::of(stretch, period_ns);
    stretch.read(|host, packet, file| {
        windows.finish_before(packet.stamp_unix_ns.saturating_sub(LONGEST_NS));
        if let Some(segment) = Segment::parse(packet) {
            let followed = directions.take(host, &segment, packet.stamp_unix_ns, &mut |topic, passing| {
                windows.count(topic, &passing);
            });
            followed.map_err(|too_much| file.has_too_much(too_much))?;
        }
        Ok::<_, CaptureReadError>(())
    })?;
    directions.finish(&mut |topic, passing| windows.count(topic, &passing));
    Ok(windows.finish())
}

/// The windows of a stretch. Histograms are large: a window has them for as long as a packet can still be about it, so that
/// a night of a thousand windows takes no more memory than one of ten.
struct Windows<'a> {
    stretch: &'a Stretch,
    /// The first ones.
    finished: Vec<WindowTraffic>,
    /// Those after them.
    counted: VecDeque<WindowTally>,
}

impl<'a> Windows<'a> {
    fn of(stretch: &'a Stretch, period_ns: i64) -> Self {
        let records = stretch.windows.iter().map(|window| &window.record);
        Self {
            stretch,
            finished: Vec::with_capacity(stretch.windows.len()),
            counted: records
                .map(|record| WindowTally::new(record, period_ns))
                .collect(),
        }
    }

    fn count(&mut self, topic: Topic, passing: &Passing) {
        if let Some((window, since_ns)) = self.stretch.place_of(passing.at_unix_ns())
            && let Some(place) = window.checked_sub(self.finished.len())
            && let Some(tally) = self.counted.get_mut(place)
        {
            tally.count(topic, since_ns, passing);
        }
    }

    /// Finishes the windows that had ended by then.
    fn finish_before(&mut self, unix_ns: i64) {
        while let Some(window) = self.stretch.windows.get(self.finished.len())
            && window.record.ended_unix_ns < unix_ns
            && let Some(tally) = self.counted.pop_front()
        {
            self.finished.push(tally.finish());
        }
    }

    fn finish(self) -> Vec<WindowTraffic> {
        let counted = self.counted.into_iter().map(WindowTally::finish);
        self.finished.into_iter().chain(counted).collect()
    }
}
