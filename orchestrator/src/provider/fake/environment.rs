//! A fake environment: a workload that gets on whenever it is asked for its next line. The main type is
//! [`FakeEnvironment`].
//!
//! What it says is a script, fixed by the windows it is to measure ([`script`]); how far it is, is how many lines its
//! file has.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
    time::Duration,
};

use async_trait::async_trait;
use record::{
    FORMAT, layout, platform::PlatformRecord, progress::Progress, run_directory::fact, window::Verdict,
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use tokio::time::Instant;

use super::{
    FakeSettings, Fault, FaultPoint,
    window::{self, FakeWindow, Noise},
};
use crate::provider::{
    Ended, Environment, EnvironmentRequest, ProviderError,
    data_folder::{self, Allowance},
    environment_directory::EnvironmentDirectory,
    lines::Lines,
};

/// How the workload ended, on the disk.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct End {
    success: bool,
    how: String,
}

/// The environment.
#[derive(Debug)]
pub struct FakeEnvironment {
    directory: EnvironmentDirectory,
    request: EnvironmentRequest,
    settings: FakeSettings,
    fault: Option<Fault>,
    /// Lines of an earlier process's time that were not taken yet, the last first.
    earlier: Vec<Progress>,
    /// How many lines the file has.
    said: usize,
    /// Of the window under way, in this process.
    window_began: Option<Instant>,
    end: Option<End>,
    ran: bool,
}

/// As the workload does, which says how it is each second.
const HEALTH_EVERY: Duration = Duration::from_secs(1);

/// All that the workload does and says if nothing happens, in order.
fn script(windows: &[u32]) -> Vec<Progress> {
    let first = windows.first().copied().unwrap_or(1);
    let start = [
        Progress::Started { pid: 1 },
        Progress::NetworkUp,
        Progress::Connected,
        Progress::Measuring { window: first },
    ];
    let measured = windows.iter().map(|window| Progress::WindowComplete {
        window: *window,
        verdict: Verdict::Valid,
        reason: None,
    });
    start
        .into_iter()
        .chain(measured)
        .chain([Progress::Finished])
        .collect()
}

impl FakeEnvironment {
    /// Starts the workload in a folder that was just made.
    pub fn create(
        directory: EnvironmentDirectory,
        request: &EnvironmentRequest,
        settings: &FakeSettings,
    ) -> Result<Self, ProviderError> {
        write(directory.lines(), b"")?;
        let platform = serde_json::to_vec_pretty(&platform()).unwrap_or_default();
        write(directory.data().join(layout::ENVIRONMENT), &platform)?;
        Self::find(directory, request, settings)
    }

    /// Takes it up from where it was.
    pub fn find(
        directory: EnvironmentDirectory,
        request: &EnvironmentRequest,
        settings: &FakeSettings,
    ) -> Result<Self, ProviderError> {
        let mut lines = Lines::default();
        lines.push(&read(directory.lines())?);
        let mut earlier = Vec::new();
        while let Some(line) = lines.next_line()? {
            earlier.push(line);
        }
        let said = earlier.len();
        earlier.reverse();
        let end: Option<End> = fs::read(directory.path().join("end.json"))
            .ok()
            .and_then(|text| serde_json::from_slice(&text).ok());
        Ok(Self {
            fault: settings.fault(&request.scenario, &request.environment),
            ran: end.is_none(),
            directory,
            request: request.clone(),
            settings: settings.clone(),
            earlier,
            said,
            window_began: None,
            end,
        })
    }

    /// The fault that is played in this window, if one is.
    fn fault_in(&self, window: u32) -> Option<FaultPoint> {
        let fault = self.fault?;
        let when = fault.window.or(self.request.windows.first().copied());
        (when == Some(window)).then_some(fault.at)
    }

    /// The next thing on the script.
    async fn get_on(&mut self) -> Result<Option<Progress>, ProviderError> {
        let Some(next) = script(&self.request.windows).into_iter().nth(self.said) else {
            self.end(Ended::by_exit_code(0))?;
            return Ok(None);
        };
        if let Progress::WindowComplete { window, .. } = next {
            return self.measure(window, next).await;
        }
        self.say(next).map(Some)
    }

    /// A window, or what is to go wrong in it.
    async fn measure(&mut self, window: u32, done: Progress) -> Result<Option<Progress>, ProviderError> {
        let whole = self.request.settings.steps_per_window();
        // Cancelled here, nothing has happened yet: the window goes on with the next call.
        let begun = *self.window_began.get_or_insert_with(Instant::now);
        let left = self
            .settings
            .window_takes
            .duration()
            .saturating_sub(begun.elapsed());
        tokio::time::sleep(left.min(HEALTH_EVERY)).await;
        if left > HEALTH_EVERY {
            return Ok(Some(Progress::Health {
                window,
                steps_done: 0,
                steps_expected: whole,
                missed_deadlines: 0,
                worst_lateness_ns: 0,
            }));
        }
        self.window_began = None;
        match self.fault_in(window) {
            Some(FaultPoint::Measure) => {
                self.write_window(window, whole / 2, true)?;
                let line = self.say(Progress::Failed {
                    reason: "the fake platform was told to let the experiment fail".to_owned(),
                    hint: None,
                    platform: false,
                })?;
                self.end(Ended::by_exit_code(1))?;
                Ok(Some(line))
            }
            Some(FaultPoint::Kill) => {
                self.write_window(window, whole / 2, false)?;
                self.end(Ended::by_signal(9))?;
                Ok(None)
            }
            Some(FaultPoint::Disconnect) if !self.directory.path().join("disconnected").exists() => {
                write(self.directory.path().join("disconnected"), b"")?;
                Err(ProviderError::Disconnected {
                    platform: "the fake platform".to_owned(),
                    action: "following the workload's lines".to_owned(),
                    source: io::Error::from(io::ErrorKind::ConnectionReset).into(),
                })
            }
            _ => {
                self.write_window(window, whole, true)?;
                self.say(done).map(Some)
            }
        }
    }

    fn write_window(&self, number: u32, steps: u64, with_record: bool) -> Result<(), ProviderError> {
        let before = self
            .request
            .windows
            .iter()
            .take_while(|window| **window != number);
        let fake = FakeWindow {
            environment: &self.request.environment,
            settings: &self.request.settings,
            window: number,
            before: before.count() as u64,
            steps,
            noise: Noise {
                seed: self.settings.seed,
                scenario: &self.request.scenario,
                mean_m: self.settings.shift_m(&self.request.scenario),
                deviation_m: self.settings.noise_m,
            },
        };
        let folder = self.directory.data().join(layout::window_folder(number));
        window::write(&fake, &folder, with_record).map_err(|source| ProviderError::File {
            action: "write",
            path: folder,
            source,
        })
    }

    fn say(&mut self, line: Progress) -> Result<Progress, ProviderError> {
        let mut text = serde_json::to_vec(&line).unwrap_or_default();
        text.push(b'\n');
        for path in [
            self.directory.lines(),
            self.directory.data().join(layout::PROGRESS),
        ] {
            append(path, &text)?;
        }
        self.said += 1;
        Ok(line)
    }

    fn end(&mut self, ended: Ended) -> Result<(), ProviderError> {
        let end = End {
            success: ended.success,
            how: ended.how,
        };
        let text = serde_json::to_vec(&end).unwrap_or_default();
        write(self.directory.path().join("end.json"), &text)?;
        self.end = Some(end);
        Ok(())
    }

    fn must_have_ended(&self) -> Result<&End, ProviderError> {
        self.end
            .as_ref()
            .filter(|_| self.earlier.is_empty())
            .ok_or(ProviderError::OutOfOrder {
                reason: "an environment was collected before its workload had ended and all its lines were read",
            })
    }

    fn play(&self, at: FaultPoint) -> Result<(), ProviderError> {
        if self.fault.is_some_and(|fault| fault.at == at) {
            return Err(ProviderError::Played { at: at.name() });
        }
        Ok(())
    }
}

#[async_trait]
impl Environment for FakeEnvironment {
    fn facts(&self) -> Map<String, Value> {
        let mut facts = Map::new();
        facts.insert(fact::PROVIDER.to_owned(), json!(super::NAME));
        facts.insert("seed".to_owned(), json!(self.settings.seed));
        facts
    }

    fn running(&self) -> bool {
        self.ran
    }

    async fn next_progress(&mut self) -> Result<Option<Progress>, ProviderError> {
        if let Some(line) = self.earlier.pop() {
            return Ok(Some(line));
        }
        if self.end.is_some() {
            return Ok(None);
        }
        self.get_on().await
    }

    async fn stop(&mut self) -> Result<(), ProviderError> {
        if self.end.is_some() {
            return Ok(());
        }
        // The window under way is the first whose completion was not said.
        let under_way = script(&self.request.windows)
            .into_iter()
            .skip(self.said)
            .find_map(|line| match line {
                Progress::WindowComplete { window, .. } => Some(window),
                _ => None,
            });
        if let Some(window) = under_way {
            self.write_window(window, self.request.settings.steps_per_window() / 2, true)?;
            let line = self.say(Progress::Stopped { window })?;
            self.earlier.insert(0, line);
        }
        self.end(Ended::by_exit_code(0))
    }

    async fn ended(&mut self) -> Result<Ended, ProviderError> {
        while self.next_progress().await?.is_some() {}
        self.must_have_ended().map(|end| Ended {
            success: end.success,
            ..Ended::failed(&end.how)
        })
    }

    async fn collect(&mut self, into: &Path) -> Result<(), ProviderError> {
        self.must_have_ended()?;
        self.play(FaultPoint::Collect)?;
        if fs::read_dir(into).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(ProviderError::OutOfOrder {
                reason: "an environment was collected into a folder that is not empty",
            });
        }
        data_folder::copy(&self.directory.data(), into, &Allowance::of(&self.request))
    }

    async fn discard(self: Box<Self>) -> Result<(), ProviderError> {
        self.play(FaultPoint::Discard)?;
        if !self.directory.path().exists() {
            return Err(ProviderError::OutOfOrder {
                reason: "an environment was discarded twice",
            });
        }
        self.directory.remove()
    }
}

/// Nothing but what is known of nothing.
fn platform() -> PlatformRecord {
    PlatformRecord {
        format: FORMAT,
        machine: "fake".to_owned(),
        os: "fake".to_owned(),
        kernel: "fake".to_owned(),
        kernel_build: "fake".to_owned(),
        kernel_command_line: None,
        hostname: "fake".to_owned(),
        cpu_model: None,
        cpus_allowed: 1,
        cpu_governor: None,
        clock_source: Some("virtual".to_owned()),
        clock_resolution_ns: 1,
        memory_total_bytes: None,
        memory_available_bytes: None,
        load_1min: None,
        hypervisor: None,
        workload_version: env!("CARGO_PKG_VERSION").to_owned(),
        ..PlatformRecord::default()
    }
}

fn write(path: PathBuf, content: &[u8]) -> Result<(), ProviderError> {
    fs::write(&path, content).map_err(|source| ProviderError::File {
        action: "write",
        path,
        source,
    })
}

fn append(path: PathBuf, content: &[u8]) -> Result<(), ProviderError> {
    let file = fs::OpenOptions::new().append(true).create(true).open(&path);
    file.and_then(|mut file| file.write_all(content))
        .map_err(|source| ProviderError::File {
            action: "write",
            path,
            source,
        })
}

fn read(path: PathBuf) -> Result<Vec<u8>, ProviderError> {
    fs::read(&path).map_err(|source| ProviderError::File {
        action: "read",
        path,
        source,
    })
}
