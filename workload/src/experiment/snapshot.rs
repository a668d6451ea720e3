//! What is read at each boundary between two windows, so that a window's own share is a difference. The main type is
//! [`Snapshot`].

use nix::unistd::Pid;
use record::window::{ConditionsRecord, LinkRecord, PassRecord, ReleaseRecord};

use super::conditions::Counters;
use crate::{
    network::{Network, release_lateness::ReleaseCounts},
    realtime::{monotonic_ns, unix_ns},
};

/// Clocks and counters at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// When, on the monotonic clock.
    pub monotonic_ns: i64,
    /// Wall clock minus monotonic clock.
    pub unix_offset_ns: i64,
    /// What the kernel counts of the machine and the process.
    pub counters: Counters,
    /// What went through the links.
    pub links: Vec<LinkRecord>,
    /// How late packets were let go, where an emulator does that.
    pub releases: Option<ReleaseCounts>,
}

impl Snapshot {
    /// Now. `processes` are those of the experiment, beside this one.
    #[must_use]
    pub fn take(network: Option<&dyn Network>, processes: &[Pid]) -> Self {
        Self {
            monotonic_ns: monotonic_ns(),
            unix_offset_ns: unix_offset_ns(),
            counters: Counters::read(processes),
            links: network.map(Network::links).unwrap_or_default(),
            releases: network.and_then(Network::release_lateness),
        }
    }

    /// In virtual time, where nothing is counted but what goes through the links.
    #[must_use]
    pub fn in_virtual_time(now_ns: i64, unix_offset_ns: i64, links: Vec<LinkRecord>) -> Self {
        Self {
            monotonic_ns: now_ns,
            unix_offset_ns,
            counters: Counters::default(),
            links,
            releases: None,
        }
    }

    /// The wall clock at a time on the monotonic clock, if it is not set meanwhile.
    #[must_use]
    pub fn unix_ns(&self, monotonic_ns: i64) -> i64 {
        monotonic_ns + self.unix_offset_ns
    }

    /// Share of one core that the workload used since `earlier`.
    #[must_use]
    pub fn cpu_share_since(&self, earlier: &Self) -> f64 {
        let used_ns = self.counters.own_cpu_ns - earlier.counters.own_cpu_ns;
        used_ns as f64 / self.elapsed_ns(earlier) as f64
    }

    /// What happened on the machine since `earlier`.
    #[must_use]
    pub fn conditions_since(&self, earlier: &Self) -> ConditionsRecord {
        self.counters.since(&earlier.counters, self.elapsed_ns(earlier))
    }

    /// The same where a command used that much of the processors' time meanwhile, which is not others'.
    #[must_use]
    pub fn conditions_beside(&self, earlier: &Self, cpu_ns: u64) -> ConditionsRecord {
        let mut now = self.counters.clone();
        now.own_cpu_ns += i64::try_from(cpu_ns).unwrap_or(i64::MAX);
        now.since(&earlier.counters, self.elapsed_ns(earlier))
    }

    fn elapsed_ns(&self, earlier: &Self) -> i64 {
        (self.monotonic_ns - earlier.monotonic_ns).max(1)
    }

    /// How late packets were let go since `earlier`.
    #[must_use]
    pub fn releases_since(&self, earlier: &Self) -> Option<ReleaseRecord> {
        Some(self.releases.as_ref()?.since(earlier.releases.as_ref()?))
    }

    /// What went through the links since `earlier`.
    #[must_use]
    pub fn links_since(&self, earlier: &Self) -> Vec<LinkRecord> {
        let pairs = self.links.iter().zip(&earlier.links);
        pairs
            .map(|(now, before)| LinkRecord {
                host: now.host,
                up: pass_since(&now.up, &before.up),
                down: pass_since(&now.down, &before.down),
            })
            .collect()
    }
}

/// Wall clock minus monotonic clock. Of several readings the quickest counts, as the process may be interrupted between
/// the two clocks.
#[must_use]
pub fn unix_offset_ns() -> i64 {
    let reading = |_| {
        let before_ns = monotonic_ns();
        let wall_ns = unix_ns();
        let took_ns = monotonic_ns() - before_ns;
        (took_ns, wall_ns - before_ns - took_ns / 2)
    };
    (0..5).map(reading).min().map_or(0, |(_, offset_ns)| offset_ns)
}

fn pass_since(now: &PassRecord, before: &PassRecord) -> PassRecord {
    let delivered = now.delivered.saturating_sub(before.delivered);
    let total = |pass: &PassRecord| Some(pass.lateness_mean_ns? * pass.delivered as f64);
    let mean = |now: f64, before: f64| match delivered {
        0 => 0.0,
        _ => (now - before) / delivered as f64,
    };
    PassRecord {
        offered: now.offered.saturating_sub(before.offered),
        lost: now.lost.saturating_sub(before.lost),
        overflowed: now
            .overflowed
            .zip(before.overflowed)
            .map(|(now, before)| now.saturating_sub(before)),
        delivered,
        lateness_mean_ns: total(now)
            .zip(total(before))
            .map(|(now, before)| mean(now, before)),
        lateness_max_of_run_ns: now.lateness_max_of_run_ns,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_windows_share_of_a_link_is_the_difference() {
        let pass = |offered, lost, mean| PassRecord {
            offered,
            lost,
            overflowed: Some(0),
            delivered: offered - lost,
            lateness_mean_ns: Some(mean),
            lateness_max_of_run_ns: Some(90),
        };
        let since = pass_since(&pass(300, 3, 20.0), &pass(100, 1, 10.0));
        assert_eq!((since.offered, since.lost, since.delivered), (200, 2, 198));
        let mean_ns = (297.0 * 20.0 - 99.0 * 10.0) / 198.0;
        assert!((since.lateness_mean_ns.unwrap() - mean_ns).abs() < 1e-9);
    }

    #[test]
    fn the_wall_clock_follows_from_the_monotonic_one() {
        let found_ns = monotonic_ns() + unix_offset_ns();
        assert!((unix_ns() - found_ns).abs() < 1_000_000_000);
    }
}
