//! Room on disks for the windows to come, looked at before an environment is made. The main function is [`windows_take`].

use std::io;

use record::{experiment::CommandExperiment, limits, settings::Settings};

/// What a control step leaves on the disk of its host: a line of the log (297 bytes measured) and the packets of a state
/// and a command on three virtual hosts (1 245 bytes), with a little more for retransmissions. In the run directory
/// captures are compressed, but are there as they came while they are.
const BYTES_PER_STEP: u64 = 1_700;
/// What a command leaves: what it printed, of which a megabyte is kept of either stream, and what it measured, which only it knows.
const BYTES_PER_CALL: u64 = 4 << 20;
/// Records, and what the file system takes for itself.
const BYTES_PER_WINDOW: u64 = 256 << 10;

/// About how many bytes so many windows take on a disk.
#[must_use]
pub fn windows_take(settings: &Settings, windows: usize) -> u64 {
    let window = match settings.experiment {
        Some(_) => BYTES_PER_CALL,
        None => settings.steps_per_window().saturating_mul(BYTES_PER_STEP),
    };
    window
        .saturating_add(BYTES_PER_WINDOW)
        .saturating_mul(windows as u64)
}

/// More than so many windows ever leave in a data folder, whatever is sent again and however much is said of it.
#[must_use]
pub fn windows_take_at_most(settings: &Settings, windows: usize) -> u64 {
    const TIMES: u64 = 20;
    const BESIDE_WINDOWS: u64 = 1 << 30;
    let measured = settings.experiment.as_ref().map_or(0, |experiment| {
        let ours = experiment.files_of_matrix(&settings.network.topology()).len();
        let files = (experiment.measured_files().len() + ours).saturating_mul(windows) as u64;
        files.saturating_mul(CommandExperiment::LONGEST_FILE)
    });
    windows_take(settings, windows)
        .saturating_mul(TIMES)
        .saturating_add(BESIDE_WINDOWS)
        .saturating_add(measured)
}

/// What to do about a run directory that could not be read or written.
#[must_use]
pub fn hint(error: &io::Error) -> String {
    let first = limits::room_hint(error).unwrap_or(match error.kind() {
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "see that you may write to the run directory and all that is in it"
        }
        _ => "see that the run directory's disk is sound and can be read and written",
    });
    format!("{first}, and `matrix resume`")
}

/// Bytes in words, in decimal units as `df -H` and disks have them.
#[must_use]
pub fn in_words(bytes: u64) -> String {
    let units = [
        ("TB", 1_000_000_000_000_u64),
        ("GB", 1_000_000_000),
        ("MB", 1_000_000),
    ];
    for (unit, size) in units {
        if bytes >= size {
            return format!("{:.1} {unit}", bytes as f64 / size as f64);
        }
    }
    format!("{} kB", bytes / 1000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(999, "0 kB")]
    #[case(262_144, "262 kB")]
    #[case(2_041_048_576, "2.0 GB")]
    #[case(1_500_000_000_000, "1.5 TB")]
    fn bytes_are_said_in_the_unit_that_fits(#[case] bytes: u64, #[case] words: &str) {
        assert_eq!(in_words(bytes), words);
    }

    #[rstest::rstest]
    #[case(io::ErrorKind::StorageFull, "make room")]
    #[case(io::ErrorKind::FileTooLarge, "ulimit -f")]
    #[case(io::ErrorKind::PermissionDenied, "may write")]
    #[case(io::ErrorKind::Other, "can be read")]
    fn room_is_to_be_made_only_where_there_is_none(#[case] kind: io::ErrorKind, #[case] words: &str) {
        assert!(hint(&kind.into()).contains(words));
    }

    #[test]
    fn the_papers_four_windows_take_two_gigabytes() {
        let bytes = windows_take(&Settings::default(), 4);
        assert!((2_000_000_000..2_100_000_000).contains(&bytes), "{bytes}");
    }
}
