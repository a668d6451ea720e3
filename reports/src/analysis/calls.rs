//! What the calls of a user's command came to, from the windows that count. The main type is [`Calls`].

use record::window::{CommandRecord, OfExperiment};

use crate::input::run::ScenarioRun;

/// Over the windows of one scenario that count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calls {
    /// How long a call took, mean, in seconds.
    pub mean_s: f64,
    /// How long the longest took, in seconds.
    pub longest_s: f64,
    /// Mean use of the processor by the command and all that it waited for, as a share of one core.
    pub cpu_share: f64,
    /// The largest memory that a process of a call had, in bytes.
    pub peak_memory_bytes: u64,
    /// Processes that were still there when the command had ended, and were ended.
    pub left_behind: u64,
}

impl Calls {
    /// Those of a scenario; none without a window that counts, and none of the ball on the plate.
    #[must_use]
    pub fn of(scenario: &ScenarioRun) -> Option<Self> {
        let calls: Vec<(f64, f64, CommandRecord)> = scenario
            .counted()
            .filter_map(|(_, record, _)| match &record.of {
                OfExperiment::Command { command } => {
                    let took_s = (record.ended_ns - record.started_ns) as f64 / 1e9;
                    Some((took_s, record.cpu_share, command.clone()))
                }
                OfExperiment::Loops(_) => None,
            })
            .collect();
        let mean = |of: fn(&(f64, f64, CommandRecord)) -> f64| {
            calls.iter().map(of).sum::<f64>() / calls.len() as f64
        };
        (!calls.is_empty()).then(|| Self {
            mean_s: mean(|call| call.0),
            longest_s: calls.iter().map(|call| call.0).fold(0.0, f64::max),
            cpu_share: mean(|call| call.1),
            peak_memory_bytes: calls
                .iter()
                .map(|call| call.2.peak_memory_bytes)
                .max()
                .unwrap_or_default(),
            left_behind: calls.iter().map(|call| call.2.left_behind).sum(),
        })
    }
}
