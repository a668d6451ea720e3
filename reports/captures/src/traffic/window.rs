//! What became of the packets of one window. The main type is [`WindowTraffic`].

use record::window::WindowRecord;

use super::{
    direction::Passing,
    period::{PeriodTally, PeriodTraffic},
    quantity::Quantity,
    spread::{Spread, SpreadTally},
};
use crate::packets::Topic;

/// More periods than this no window has: a record that lies is not believed.
const MOST_PERIODS: usize = 1 << 20;

/// One window.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowTraffic {
    /// Its number, from 1.
    pub window: u32,
    /// Packets that the kernel dropped before they were captured, at both hosts: as many may be taken for lost or stray.
    pub dropped: u64,
    /// In the order of [`Topic::ALL`].
    pub directions: [DirectionTraffic; 2],
}

/// One direction of one window.
#[derive(Debug, Clone, PartialEq)]
pub struct DirectionTraffic {
    /// What the packets carry: `state` from plant to controller, `command` back.
    pub topic: Topic,
    /// Each period's, in order.
    pub periods: Vec<PeriodTraffic>,
    /// Packets that arrived without having been seen to leave.
    pub strays: u64,
    /// From the sender's capture to the receiver's.
    pub one_way: Option<Spread>,
    /// RTT: from when a packet left until it was acknowledged, at the sender's capture.
    pub rtt: Option<Spread>,
    /// By how much the way of a packet was longer or shorter than that of the one that arrived before.
    pub jitter: Option<Spread>,
    /// Between two arrivals.
    pub gap: Option<Spread>,
}

impl DirectionTraffic {
    /// The sum over all periods.
    #[must_use]
    pub fn total(&self, count: impl Fn(&PeriodTraffic) -> u32) -> u64 {
        self.periods.iter().map(|period| u64::from(count(period))).sum()
    }
}

impl WindowTraffic {
    /// One direction.
    #[must_use]
    pub fn direction(&self, topic: Topic) -> &DirectionTraffic {
        let [state, command] = &self.directions;
        match topic {
            Topic::State => state,
            Topic::Command => command,
        }
    }

    /// The values of the periods from the first that counts (from 1), of which the packets say it.
    #[must_use]
    pub fn values(&self, topic: Topic, quantity: Quantity, first_period: u32) -> Vec<f64> {
        let periods = self.direction(topic).periods.iter();
        let counted = periods.skip(first_period.saturating_sub(1) as usize);
        counted.filter_map(|period| quantity.of(period)).collect()
    }
}

/// A window that is being counted.
#[derive(Debug)]
pub(super) struct WindowTally {
    window: u32,
    dropped: u64,
    period_ns: i64,
    directions: [DirectionTally; 2],
}

#[derive(Debug, Clone)]
struct DirectionTally {
    periods: Vec<PeriodTally>,
    strays: u64,
    one_way: SpreadTally,
    rtt: SpreadTally,
    jitter: SpreadTally,
    gap: SpreadTally,
}

impl WindowTally {
    pub fn new(record: &WindowRecord, period_ns: i64) -> Self {
        let length_ns = record.ended_ns.saturating_sub(record.started_ns);
        // The end of the last step is a little off the last period's.
        let periods = length_ns.saturating_add(period_ns / 2) / period_ns.max(1);
        let direction = DirectionTally {
            periods: vec![PeriodTally::default(); usize::try_from(periods).unwrap_or(0).min(MOST_PERIODS)],
            strays: 0,
            one_way: SpreadTally::default(),
            rtt: SpreadTally::default(),
            jitter: SpreadTally::default(),
            gap: SpreadTally::default(),
        };
        Self {
            window: record.window,
            dropped: record.captures.iter().map(|capture| capture.dropped).sum(),
            period_ns: period_ns.max(1),
            directions: [direction.clone(), direction],
        }
    }

    /// What happened to a packet that was sent so long after the window began.
    pub fn count(&mut self, topic: Topic, since_ns: i64, passing: &Passing) {
        let [state, command] = &mut self.directions;
        let direction = match topic {
            Topic::State => state,
            Topic::Command => command,
        };
        let period = usize::try_from(since_ns.div_euclid(self.period_ns)).ok();
        let Some(period) = period.and_then(|period| direction.periods.get_mut(period)) else {
            return;
        };
        period.count(passing);
        match *passing {
            Passing::Arrived {
                one_way_ns,
                jitter_ns,
                gap_ns,
                ..
            } => {
                direction.one_way.add(one_way_ns);
                if let Some(jitter_ns) = jitter_ns {
                    direction.jitter.add(jitter_ns);
                }
                if let Some(gap_ns) = gap_ns {
                    direction.gap.add(gap_ns);
                }
            }
            Passing::Acknowledged { took_ns, .. } => direction.rtt.add(took_ns),
            Passing::Stray { .. } => direction.strays += 1,
            Passing::Sent { .. } | Passing::Lost { .. } => {}
        }
    }

    pub fn finish(self) -> WindowTraffic {
        let [state, command] = self.directions;
        WindowTraffic {
            window: self.window,
            dropped: self.dropped,
            directions: [state.finish(Topic::State), command.finish(Topic::Command)],
        }
    }
}

impl DirectionTally {
    fn finish(self, topic: Topic) -> DirectionTraffic {
        DirectionTraffic {
            topic,
            periods: self.periods.into_iter().map(PeriodTally::finish).collect(),
            strays: self.strays,
            one_way: self.one_way.finish(),
            rtt: self.rtt.finish(),
            jitter: self.jitter.finish(),
            gap: self.gap.finish(),
        }
    }
}
