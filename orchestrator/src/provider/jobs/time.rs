//! How long a job may take. Pure.
//!
//! A short limit lets a job begin earlier, in a gap before a larger one; a limit that is too short ends it in a window.

use std::time::Duration;

use record::settings::Settings;

/// A workload measures in real time; what is computed takes much less.
const COMPUTED_FASTER: u32 = 20;
/// What goes before the windows and after them on a slow node and a slow file system.
const AROUND: Duration = Duration::from_secs(600);

/// The time that so many windows take, with a twentieth for what is between them.
pub fn of_windows(settings: &Settings, windows: usize) -> Duration {
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
pub fn minutes(settings: &Settings, windows: usize, longest: Option<u32>) -> u32 {
    let wanted = of_windows(settings, windows).saturating_add(AROUND);
    let minutes = u32::try_from(wanted.as_secs().div_ceil(60)).unwrap_or(u32::MAX);
    longest.map_or(minutes, |longest| minutes.min(longest)).max(1)
}

/// How many windows fit into a job of so many minutes; none if not even one does. A quarter of a short job goes to what is around
/// them.
pub fn most_windows(settings: &Settings, longest: u32) -> Option<usize> {
    let longest = Duration::from_secs(u64::from(longest) * 60);
    let room = longest.saturating_sub(AROUND.min(longest / 4));
    let one = of_windows(settings, 1).as_secs_f64().max(1e-3);
    // At most the number of windows of a matrix, and whole.
    let windows = (room.as_secs_f64() / one).floor().min(1e9) as usize;
    (windows > 0).then_some(windows)
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
        assert_eq!(minutes(&windows_of(window), windows, longest), asks);
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
        assert_eq!(most_windows(&windows_of(window), longest), fit);
    }
}
