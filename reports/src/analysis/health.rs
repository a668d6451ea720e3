//! How well a scenario's platform held the schedule of the experiment, from its windows that count. The main type is
//! [`Health`].

use record::window::{LoopRecord, ReleaseRecord};

use crate::input::run::ScenarioRun;

/// Sums and means over the windows of one scenario that count; shares are from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Health {
    /// Mean use of the processor by the workload, as a share of one core.
    pub cpu_share: f64,
    /// Share of the steps of both loops that began more than a tenth of a step late.
    pub late_share: f64,
    /// Steps of both loops that began a whole step late or more.
    pub missed_deadlines: u64,
    /// Ticks of both loops that were lost, since others before them had not ended.
    pub lost_ticks: u64,
    /// Share of control steps that had no newer state than the step before.
    pub stale_share: f64,
    /// Mean age of the state when it was used, in seconds; none if none ever arrived.
    pub state_age_s: Option<f64>,
    /// The latest start of a step of either loop after it was due, in nanoseconds.
    pub worst_lateness_ns: i64,
    /// Packets that the kernel dropped before a capture had read them.
    pub capture_dropped: u64,
    /// How late the network emulator let packets go; none without one. Packets are the sum and the mean is theirs, the
    /// percentiles and the maximum are those of the worst window.
    pub releases: Option<ReleaseRecord>,
}

impl Health {
    /// That of a scenario; none without a window that counts, and none of a command.
    #[must_use]
    pub fn of(scenario: &ScenarioRun) -> Option<Self> {
        let windows: Vec<_> = scenario.counted().collect();
        // A command has no schedule of ours.
        if !windows.iter().any(|(_, record, _)| record.loops().is_some()) {
            return None;
        }
        let loops: Vec<&LoopRecord> = windows
            .iter()
            .filter_map(|(_, record, _)| record.loops())
            .flat_map(|done| [&done.controller, &done.plant])
            .collect();
        let ages: Vec<f64> = windows
            .iter()
            .filter_map(|(_, _, data)| data.trace()?.mean_state_age_s)
            .collect();
        let done = || windows.iter().filter_map(|(_, record, _)| record.loops());
        let stale = done().map(|done| done.stale_steps).sum();
        let control_steps = done().map(|done| done.steps_done).sum();
        Some(Self {
            cpu_share: windows.iter().map(|(_, record, _)| record.cpu_share).sum::<f64>()
                / windows.len() as f64,
            late_share: share(
                loops.iter().map(|l| l.late_steps).sum(),
                loops.iter().map(|l| l.steps).sum(),
            ),
            missed_deadlines: loops.iter().map(|l| l.missed_deadlines).sum(),
            lost_ticks: loops.iter().map(|l| l.lost_ticks).sum(),
            stale_share: share(stale, control_steps),
            state_age_s: (!ages.is_empty()).then(|| ages.iter().sum::<f64>() / ages.len() as f64),
            worst_lateness_ns: loops.iter().map(|l| l.lateness_max_ns).max().unwrap_or_default(),
            capture_dropped: windows
                .iter()
                .flat_map(|(_, record, _)| &record.captures)
                .map(|capture| capture.dropped)
                .sum(),
            releases: windows
                .iter()
                .filter_map(|(_, record, _)| record.releases)
                .reduce(worse),
        })
    }
}

/// Both windows' releases together.
fn worse(one: ReleaseRecord, other: ReleaseRecord) -> ReleaseRecord {
    let released = one.released + other.released;
    let total_ns = |of: ReleaseRecord| of.lateness_mean_ns * of.released as f64;
    ReleaseRecord {
        released,
        lateness_mean_ns: (total_ns(one) + total_ns(other)) / released.max(1) as f64,
        lateness_p99_ns: one.lateness_p99_ns.max(other.lateness_p99_ns),
        lateness_p999_ns: one.lateness_p999_ns.max(other.lateness_p999_ns),
        lateness_max_ns: one.lateness_max_ns.max(other.lateness_max_ns),
    }
}

fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 {
        0.0
    } else {
        part as f64 / whole as f64
    }
}
