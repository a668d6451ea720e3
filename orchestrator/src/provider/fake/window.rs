//! A window as the fake platform writes it: the simulation's own steps with noise, in the very files that a workload
//! leaves. The function is [`write`].

use std::{
    fmt::Write as _,
    fs::{self, File},
    io::{self, BufWriter, Read as _, Write as _},
    path::Path,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use pcap_file::{
    DataLink, TsResolution,
    pcap::{PcapHeader, PcapWriter},
};
use record::{
    FORMAT,
    control_log::ControlRow,
    layout,
    settings::Settings,
    virtual_host::VirtualHost,
    window::{
        CaptureRecord, ConditionsRecord, FileRecord, LinkRecord, LoopRecord, LoopsRecord, NoticesRecord,
        OfExperiment, PassRecord, Verdict, WindowRecord,
    },
};
use sha2::{Digest as _, Sha256};
use simulation::closed_loop::{Platform, Simulation};

/// Which window of which environment.
#[derive(Debug, Clone, Copy)]
pub struct FakeWindow<'a> {
    /// The environment's name.
    pub environment: &'a str,
    /// What it measures.
    pub settings: &'a Settings,
    /// The window's number.
    pub window: u32,
    /// How many windows of the same run of the loop come before it.
    pub before: u64,
    /// How many of its steps are done.
    pub steps: u64,
    /// What is added to the errors.
    pub noise: Noise<'a>,
}

/// What is added to the mean error of each period, on each axis.
#[derive(Debug, Clone, Copy)]
pub struct Noise<'a> {
    /// What it depends on besides the window.
    pub seed: u64,
    /// The same.
    pub scenario: &'a str,
    /// Its mean, in metres.
    pub mean_m: f64,
    /// Its standard deviation, in metres.
    pub deviation_m: f64,
}

impl Noise<'_> {
    /// For each period of a window.
    fn of_periods(&self, window: u32, periods: u64) -> Vec<f64> {
        let digest = Sha256::digest(format!("{} {} {window}", self.seed, self.scenario));
        let mut seed = [0_u8; 16];
        seed.copy_from_slice(digest.get(..16).unwrap_or(&[0; 16]));
        let mut generator = oorandom::Rand64::new(u128::from_le_bytes(seed));
        // Uniform, of the wanted deviation.
        let half_width = self.deviation_m * 3_f64.sqrt();
        (0..periods)
            .map(|_| self.mean_m + half_width * (2.0 * generator.rand_float() - 1.0))
            .collect()
    }
}

/// Writes the files of a window into `folder`, the record last and only if asked for.
///
/// # Errors
/// What the file system says.
pub fn write(fake: &FakeWindow<'_>, folder: &Path, with_record: bool) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let mut control = BufWriter::new(File::create(folder.join(layout::CONTROL_LOG))?);
    writeln!(control, "{}", ControlRow::HEADER)?;
    let rows = rows(fake);
    for row in &rows {
        row.write_to(&mut control)?;
    }
    control.into_inner()?.sync_all()?;
    let mut names = vec![layout::CONTROL_LOG.to_owned()];
    if fake.settings.capture.enabled {
        for host in VirtualHost::OF_THE_BALL {
            let name = layout::capture(&host);
            write_capture(&folder.join(&name), fake.settings)?;
            names.push(name);
        }
    }
    if with_record {
        let files = names.into_iter().map(|name| describe(folder, name));
        let record = record(fake, &rows, files.collect::<io::Result<_>>()?);
        let text = serde_json::to_vec_pretty(&record)?;
        fs::write(folder.join(layout::WINDOW), text)?;
    }
    Ok(())
}

/// The window's part of the simulation. What is added lengthens the error as it is, so that each period's mean |e| grows
/// by just that.
fn rows(fake: &FakeWindow<'_>) -> Vec<ControlRow> {
    let settings = fake.settings;
    let per_period = settings.steps_per_period().max(1);
    let noise = fake.noise.of_periods(fake.window, settings.periods_per_window());
    // Two ends of a link each way.
    let platform = Platform::fixed(settings.network.delay.duration() * 2);
    let first = fake.before * settings.steps_per_window();
    Simulation::new(settings, &platform, 0)
        .zip(0_u64..)
        .skip(usize::try_from(first).unwrap_or(usize::MAX))
        .take(usize::try_from(fake.steps).unwrap_or(usize::MAX))
        .map(|(step, number)| {
            let period = usize::try_from((number - first) / per_period).unwrap_or_default();
            let added = noise.get(period).copied().unwrap_or_default();
            let mut row = step.row;
            row.x_m -= added.copysign(row.reference_x_m - row.x_m) * added.signum();
            row.y_m -= added.copysign(row.reference_y_m - row.y_m) * added.signum();
            row
        })
        .collect()
}

/// A capture on which no packet was seen.
fn write_capture(path: &Path, settings: &Settings) -> io::Result<()> {
    let header = PcapHeader {
        snaplen: u32::try_from(settings.capture.snaplen.get()).unwrap_or(u32::MAX),
        datalink: DataLink::ETHERNET,
        ts_resolution: TsResolution::NanoSecond,
        ..PcapHeader::default()
    };
    PcapWriter::with_header(File::create(path)?, header)
        .map(|_| ())
        .map_err(io::Error::other)
}

/// A file's length and hash, as they are on the disk.
fn describe(folder: &Path, name: String) -> io::Result<FileRecord> {
    let mut file = File::open(folder.join(&name))?;
    let mut hash = Sha256::new();
    let mut piece = vec![0_u8; 64 << 10];
    let mut bytes = 0;
    loop {
        let read = file.read(&mut piece)?;
        if read == 0 {
            break;
        }
        hash.update(piece.get(..read).unwrap_or_default());
        bytes += read as u64;
    }
    let mut sha256 = String::with_capacity(64);
    for byte in hash.finalize() {
        // Writing to a String cannot fail.
        let _ = write!(sha256, "{byte:02x}");
    }
    Ok(FileRecord {
        name,
        bytes,
        sha256,
        measured: None,
    })
}

fn record(fake: &FakeWindow<'_>, rows: &[ControlRow], files: Vec<FileRecord>) -> WindowRecord {
    let settings = fake.settings;
    let steps = rows.len() as u64;
    let step = settings.rate.step();
    let length = step * u32::try_from(steps).unwrap_or(u32::MAX);
    let started_ns = rows.first().map_or(0, |row| row.scheduled_ns);
    let ended_unix_ns = nanoseconds(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default());
    let complete = steps == settings.steps_per_window();
    let on_time = LoopRecord {
        steps,
        ..LoopRecord::default()
    };
    WindowRecord {
        format: FORMAT,
        window: fake.window,
        environment: fake.environment.to_owned(),
        starts_run: fake.before == 0,
        complete,
        started_unix_ns: ended_unix_ns - nanoseconds(length),
        ended_unix_ns,
        started_ns,
        ended_ns: started_ns + nanoseconds(length),
        of: OfExperiment::Loops(LoopsRecord {
            steps_expected: settings.steps_per_window(),
            steps_done: steps,
            controller: on_time,
            plant: on_time,
            stale_steps: 0,
            longest_gap_ns: nanoseconds(step),
            log_dropped: 0,
        }),
        clock_jump_ns: 0,
        cpu_share: 0.0,
        conditions: ConditionsRecord::default(),
        captures: if settings.capture.enabled {
            VirtualHost::OF_THE_BALL
                .map(|host| CaptureRecord {
                    host,
                    packets: 0,
                    dropped: 0,
                    tool: "builtin".into(),
                })
                .to_vec()
        } else {
            Vec::new()
        },
        network_seed: None,
        links: VirtualHost::OF_THE_BALL
            .map(|host| LinkRecord {
                host,
                up: PassRecord::default(),
                down: PassRecord::default(),
            })
            .to_vec(),
        notices: NoticesRecord::default(),
        releases: None,
        files,
        verdict: if complete {
            Verdict::Valid
        } else {
            Verdict::Invalid
        },
        reasons: if complete {
            Vec::new()
        } else {
            vec!["it was cut short".to_owned()]
        },
    }
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use record::quantity::TimeSpan;

    use super::*;

    fn settings() -> Settings {
        Settings {
            window: TimeSpan::from_secs(50),
            period: TimeSpan::from_secs(10),
            ..Settings::default()
        }
    }

    fn fake(settings: &Settings, mean_m: f64, before: u64) -> FakeWindow<'_> {
        FakeWindow {
            environment: "e-1",
            settings,
            window: 1,
            before,
            steps: settings.steps_per_window(),
            noise: Noise {
                seed: 1,
                scenario: "a",
                mean_m,
                deviation_m: 0.0,
            },
        }
    }

    fn mean_error_x(rows: &[ControlRow]) -> f64 {
        let sum: f64 = rows.iter().map(|row| (row.reference_x_m - row.x_m).abs()).sum();
        sum / rows.len() as f64
    }

    #[test]
    fn a_shift_lengthens_the_mean_error_by_itself() {
        let settings = settings();
        let plain = mean_error_x(&rows(&fake(&settings, 0.0, 1)));
        let shifted = mean_error_x(&rows(&fake(&settings, 0.01, 1)));
        assert!((shifted - plain - 0.01).abs() < 1e-12, "{plain} {shifted}");
    }

    #[test]
    fn windows_are_contiguous() {
        let settings = settings();
        let first = rows(&fake(&settings, 0.0, 0));
        let second = rows(&fake(&settings, 0.0, 1));
        assert_eq!(first.len() as u64, settings.steps_per_window());
        assert_eq!(second.first().unwrap().step, first.last().unwrap().step + 1);
    }

    #[test]
    fn the_same_seed_gives_the_same_noise_and_another_another() {
        let noise = |seed, scenario, window| {
            Noise {
                seed,
                scenario,
                mean_m: 0.0,
                deviation_m: 1.0,
            }
            .of_periods(window, 2000)
        };
        let sample = noise(1, "a", 1);
        assert_eq!(sample, noise(1, "a", 1));
        for other in [noise(2, "a", 1), noise(1, "b", 1), noise(1, "a", 2)] {
            assert_ne!(sample, other);
        }
        let variance = sample.iter().map(|value| value * value).sum::<f64>() / sample.len() as f64;
        assert!((variance - 1.0).abs() < 0.1, "{variance}");
    }

    #[test]
    fn the_record_describes_the_files_that_are_there() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings();
        write(&fake(&settings, 0.0, 0), folder.path(), true).unwrap();
        let record: WindowRecord =
            serde_json::from_slice(&fs::read(folder.path().join("window.json")).unwrap()).unwrap();
        assert_eq!(record.verdict, Verdict::Valid);
        assert_eq!(record.files.len(), 4);
        for file in record.files {
            let content = fs::read(folder.path().join(&file.name)).unwrap();
            assert_eq!(content.len() as u64, file.bytes);
            assert_eq!(format!("{:x}", Sha256::digest(&content)), file.sha256);
        }
    }
}
