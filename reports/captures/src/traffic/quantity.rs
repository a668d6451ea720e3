//! What of the packets is compared: one value a period, as the tracking error has. The main type is [`Quantity`].

use super::PeriodTraffic;

/// One number of a period's packets in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quantity {
    /// Mean time from the sender's capture to the receiver's, in seconds (RFC 7679).
    OneWayDelay,
    /// Mean RTT, the time until a packet was acknowledged, in seconds; of packets that were sent once (Karn and Partridge, 1987).
    Rtt,
    /// Mean |D| of RFC 3550, section 6.4.1, in seconds: by how much the ways of neighbouring packets differ.
    Jitter,
    /// The longest time between two arrivals, in seconds: how long the receiver heard nothing new.
    LongestGap,
    /// Packets that did not arrive (RFC 7680).
    Lost,
    /// Packets that carried data that had been sent before.
    Retransmitted,
    /// Packets that arrived after one that was sent later (RFC 4737).
    Reordered,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::OneWayDelay,
        Self::Rtt,
        Self::Jitter,
        Self::LongestGap,
        Self::Lost,
        Self::Retransmitted,
        Self::Reordered,
    ];

    /// Its name in tables and files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OneWayDelay => "delay",
            Self::Rtt => "rtt",
            Self::Jitter => "jitter",
            Self::LongestGap => "gap",
            Self::Lost => "lost",
            Self::Retransmitted => "retransmitted",
            Self::Reordered => "reordered",
        }
    }

    /// Whether it is a time in seconds, and not a count.
    #[must_use]
    pub const fn is_time(self) -> bool {
        matches!(
            self,
            Self::OneWayDelay | Self::Rtt | Self::Jitter | Self::LongestGap
        )
    }

    /// That of a period; none where no packet says it.
    #[must_use]
    pub fn of(self, period: &PeriodTraffic) -> Option<f64> {
        let count = |count: u32| (period.sent > 0).then(|| f64::from(count));
        match self {
            Self::OneWayDelay => period.one_way_s,
            Self::Rtt => period.rtt_s,
            Self::Jitter => period.jitter_s,
            Self::LongestGap => period.longest_gap_s,
            Self::Lost => count(period.lost),
            Self::Retransmitted => count(period.retransmitted),
            Self::Reordered => count(period.reordered),
        }
    }
}
