//! What became of the packets of one period: what stands beside the period's tracking error. The main type is
//! [`PeriodTraffic`].

use super::direction::Passing;

/// One direction's packets of one period, by when they were sent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PeriodTraffic {
    /// Packets that left.
    pub sent: u32,
    /// Those that carried data that had been sent before.
    pub retransmitted: u32,
    /// Those that did not arrive.
    pub lost: u32,
    /// Those that arrived after one that was sent later.
    pub reordered: u32,
    /// From one capture to the other, mean in seconds.
    pub one_way_s: Option<f64>,
    /// Until they were acknowledged, mean in seconds.
    pub rtt_s: Option<f64>,
    /// By how much that differs from the packet that arrived before, mean in seconds.
    pub jitter_s: Option<f64>,
    /// The longest time between two arrivals, in seconds.
    pub longest_gap_s: Option<f64>,
}

/// A period that is being counted.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PeriodTally {
    counts: PeriodTraffic,
    one_way: Mean,
    rtt: Mean,
    jitter: Mean,
    longest_gap_ns: Option<i64>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum_ns: i64,
    count: u32,
}

impl Mean {
    fn add(&mut self, ns: i64) {
        self.sum_ns = self.sum_ns.saturating_add(ns);
        self.count += 1;
    }

    fn seconds(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum_ns as f64 / f64::from(self.count) / 1e9)
    }
}

impl PeriodTally {
    pub fn count(&mut self, passing: &Passing) {
        match *passing {
            Passing::Sent { is_retransmitted, .. } => {
                self.counts.sent += 1;
                self.counts.retransmitted += u32::from(is_retransmitted);
            }
            Passing::Lost { .. } => self.counts.lost += 1,
            Passing::Arrived {
                one_way_ns,
                is_reordered,
                jitter_ns,
                gap_ns,
                ..
            } => {
                self.counts.reordered += u32::from(is_reordered);
                self.one_way.add(one_way_ns);
                if let Some(jitter_ns) = jitter_ns {
                    self.jitter.add(jitter_ns);
                }
                self.longest_gap_ns = self.longest_gap_ns.max(gap_ns);
            }
            Passing::Acknowledged { took_ns, .. } => self.rtt.add(took_ns),
            Passing::Stray { .. } => {}
        }
    }

    pub fn finish(self) -> PeriodTraffic {
        PeriodTraffic {
            one_way_s: self.one_way.seconds(),
            rtt_s: self.rtt.seconds(),
            jitter_s: self.jitter.seconds(),
            longest_gap_s: self.longest_gap_ns.map(|ns| ns as f64 / 1e9),
            ..self.counts
        }
    }
}
