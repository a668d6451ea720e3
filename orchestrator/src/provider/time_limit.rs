//! How long a job may take. Pure. The main type is [`TimeLimit`].
//!
//! A short limit lets a job begin earlier, in a gap before a larger one; a limit that is too short ends it in a window.

use std::time::Duration;

use record::settings::Settings;

/// A workload measures in real time; what is computed takes much less.
const COMPUTED_FASTER: u32 = 20;
/// What goes before the windows and after them on a slow node and a slow file system.
const AROUND: Duration = Duration::from_secs(600);

/// What one environment may take on a host, in minutes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimeLimit(pub u32);

/// Not even one window fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "a job may take {} min there, and one window takes {} with what goes before and after it",
    limit.0,
    humantime::format_duration(*window)
)]
pub struct WindowTooLong {
    /// The limit.
    limit: TimeLimit,
    /// The time that one takes.
    window: Duration,
}

impl WindowTooLong {
    /// What to do about it.
    pub const HINT: &str =
        "write a shorter `workload.window`, or a `partition` that allows more time: `sinfo -o '%P %l'`";
}

impl TimeLimit {
    /// How many windows fit into one environment. A quarter of a short limit goes to what is around them.
    ///
    /// # Errors
    /// When not even one does.
    pub fn most_windows(self, settings: &Settings) -> Result<usize, WindowTooLong> {
        let longest = Duration::from_secs(u64::from(self.0) * 60);
        let room = longest.saturating_sub(AROUND.min(longest / 4));
        let window = of_windows(settings, 1);
        // At most the number of windows of a matrix, and whole.
        let windows = (room.as_secs_f64() / window.as_secs_f64().max(1e-3))
            .floor()
            .min(1e9) as usize;
        match windows {
            0 => Err(WindowTooLong { limit: self, window }),
            some => Ok(some),
        }
    }
}

/// The time that so many windows take, with a twentieth for what is between them.
fn of_windows(settings: &Settings, windows: usize) -> Duration {
    let windows = u32::try_from(windows).unwrap_or(u32::MAX);
    let measured = settings
        .longest_window()
        .duration()
        .saturating_mul(windows)
        .mul_f64(1.05);
    match settings.simulation {
        Some(_) => measured / COMPUTED_FASTER,
        None => measured,
    }
}

/// What a job with these windows asks for in minutes, where it may ask for at most `longest`.
pub fn minutes(settings: &Settings, windows: usize, longest: Option<TimeLimit>) -> u32 {
    let wanted = of_windows(settings, windows).saturating_add(AROUND);
    let minutes = u32::try_from(wanted.as_secs().div_ceil(60)).unwrap_or(u32::MAX);
    longest.map_or(minutes, |longest| minutes.min(longest.0)).max(1)
}

#[cfg(test)]
mod tests {
    use record::{quantity::TimeSpan, settings::Dynamics};
    use rstest::rstest;

    use super::*;

    fn windows_of(seconds: u64) -> Settings {
        Settings {
            window: TimeSpan::from_secs(seconds),
            ..Settings::of(Dynamics::default())
        }
    }

    /// The paper's scenario is four windows of 6000 s: 24 000 s, with a twentieth 420 min, and ten minutes.
    #[rstest]
    #[case(6000, 4, None, 430)]
    #[case(6000, 4, Some(240), 240)]
    #[case(10, 1, None, 11)]
    #[case(10, 1, Some(1), 1)]
    fn a_job_asks_for_its_windows_and_what_is_around_them(
        #[case] window: u64,
        #[case] windows: usize,
        #[case] longest: Option<u32>,
        #[case] asks: u32,
    ) {
        assert_eq!(
            minutes(&windows_of(window), windows, longest.map(TimeLimit)),
            asks
        );
    }

    #[rstest]
    #[case(6000, 240, Some(2))]
    #[case(6000, 100, None)]
    #[case(10, 1, Some(4))]
    #[case(60, 1, None)]
    fn a_limit_divides_the_windows_among_jobs(
        #[case] window: u64,
        #[case] longest: u32,
        #[case] fit: Option<usize>,
    ) {
        assert_eq!(TimeLimit(longest).most_windows(&windows_of(window)).ok(), fit);
    }
}
