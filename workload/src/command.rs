//! A command of the user's as the experiment: it is run once for each window, and what it writes is the window's sample
//! (docs/your-experiment.md). The main type is [`Command`].
//!
//! ```text
//! WORK/files/    the experiment's files, in which its commands run
//! WORK/output/   the window's folder while its command runs; what the metrics are read from goes into DATA/window-N
//! ```

mod call;
mod collection;
mod continuous;
mod cuts;
mod emulation;
mod nodes;
mod output;
mod program;

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use record::{
    experiment::{Argument, CommandExperiment, Values, WindowValues},
    layout,
    platform::{RealtimeGrant, RosMasterRecord},
    progress::Progress,
    settings::{
        Settings,
        validity::{self, Expectation},
    },
    window::{CaptureRecord, CommandRecord, NoticesRecord, OfExperiment, Verdict, WindowRecord},
};

use self::{
    call::{Bounds, Call, Outcome},
    collection::{OUTPUT, collect, keep_output, write_error},
    emulation::Emulation,
    nodes::NodesCall,
    program::{Printed, Program},
};
pub use crate::command_error::CommandError;
use crate::{
    descendants::Descendants,
    experiment::{
        Ending, Experiment, ExperimentError, KnownPlatform, Reporter, Request, snapshot::Snapshot,
        window_folder::WindowFolder,
    },
    network,
    realtime::monotonic_ns,
    removal::remove_all,
    virtual_hosts,
};

/// How often it is looked whether a rehearsal is to end.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A command that is run for each window.
pub struct Command;

impl Experiment for Command {
    /// A command has the rights that its user gave to `matrix` or to the container, neither more nor fewer. Nodes have those that
    /// the ball on the plate has, since an emulated network is needed for them.
    fn begin(&self, settings: &Settings) -> Result<(), ExperimentError> {
        match settings.network_in_use() {
            Some(_) => Ok(network::become_namespace_root()?),
            None => Ok(()),
        }
    }

    fn run(
        &self,
        request: &Request,
        reporter: &Reporter,
        stop: &Arc<AtomicBool>,
    ) -> Result<Ending, ExperimentError> {
        let (Some(experiment), Some(work)) = (&request.settings.experiment, &request.work) else {
            return Err(CommandError::NoWork.into());
        };
        let emulation = request
            .settings
            .network_in_use()
            .map(|_| Emulation::open(&request.settings, reporter));
        let emulation = emulation.transpose()?;
        // Before any program of the user's is started.
        let descendants = Descendants::begin()?;
        let master = request.settings.master_in_use();
        let master = move || {
            master.map(|program| RosMasterRecord {
                program,
                version: virtual_hosts::version_of_master(program),
            })
        };
        let platform = KnownPlatform::look(&request.data, RealtimeGrant::default(), Arc::new(master))?;
        let place = Place::make(work)?;
        let runs = Runs {
            request,
            experiment,
            place: &place,
            emulation: emulation.as_ref(),
            reporter,
            descendants: &descendants,
            stop,
            began_ns: monotonic_ns(),
        };
        let ending = runs.with_hooks();
        if let Some(emulation) = &emulation {
            emulation.keep_transcript(&request.data)?;
        }
        let ending = ending?;
        let changes = platform.finish()?;
        if !changes.is_empty() {
            reporter.say(&Progress::PlatformChanged { changes });
        }
        Ok(ending)
    }
}

/// The network of a command's nodes, up until `stop` is set.
///
/// # Errors
/// If the platform lacks something.
pub fn rehearse(settings: &Settings, reporter: &Reporter, stop: &AtomicBool) -> Result<(), ExperimentError> {
    // Nobody reads what captures have.
    let mut settings = settings.clone();
    settings.capture.enabled = false;
    let _emulation = Emulation::open(&settings, reporter)?;
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(LOOK_EVERY);
    }
    Ok(())
}

/// Where commands run and write.
struct Place {
    work: PathBuf,
    files: PathBuf,
    output: PathBuf,
    /// The output folder as an argument has it.
    output_text: String,
}

impl Place {
    fn make(work: &Path) -> Result<Self, ExperimentError> {
        let files = work.join(layout::FILES);
        let output = work.join(layout::OUTPUT);
        fs::create_dir_all(&files).map_err(write_error(&files))?;
        let absolute = std::path::absolute(&output).map_err(write_error(&output))?;
        let output_text = absolute.to_str().map(str::to_owned);
        Ok(Self {
            work: work.to_owned(),
            files,
            output_text: output_text.ok_or(CommandError::NoText { path: absolute })?,
            output,
        })
    }

    /// Empties the output folder. Whatever a command made of it, and however deep, is below it.
    fn empty(&self) -> Result<(), ExperimentError> {
        match remove_all(&self.output) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            // A command that made a file of it, or a link.
            Err(error) if error.kind() == io::ErrorKind::NotADirectory => {
                fs::remove_file(&self.output).map_err(write_error(&self.output))?;
            }
            removed => removed.map_err(write_error(&self.output))?,
        }
        fs::create_dir(&self.output).map_err(write_error(&self.output))
    }
}

/// The calls of one environment.
struct Runs<'a> {
    request: &'a Request,
    experiment: &'a CommandExperiment,
    place: &'a Place,
    emulation: Option<&'a Emulation>,
    reporter: &'a Reporter,
    descendants: &'a Descendants,
    stop: &'a AtomicBool,
    began_ns: i64,
}

impl Runs<'_> {
    fn call<'b>(&'b self, command: &[Argument], window: Option<u32>, stop: &'b AtomicBool) -> Call<'b> {
        let values = Values {
            parameters: &self.experiment.parameters,
            topology: None,
            window: window.map(|number| self.values_of(number)),
        };
        Call {
            program: Program {
                arguments: command.iter().map(|it| it.filled(values)).collect(),
                folder: self.place.files.clone(),
                work: self.place.work.clone(),
                environment: Vec::new(),
                sought: None,
            },
            bounds: Bounds {
                stop,
                ..self.bounds()
            },
            descendants: self.descendants,
        }
    }

    fn values_of(&self, window: u32) -> WindowValues<'_> {
        WindowValues {
            number: window,
            folder: &self.place.output_text,
        }
    }

    fn bounds(&self) -> Bounds<'_> {
        Bounds {
            began: Instant::now(),
            timeout: self.experiment.window.timeout.duration(),
            stop: self.stop,
            folder: &self.place.files,
        }
    }

    /// Runs a command that comes before or after the windows, if there is one. Whether it was interrupted.
    fn hook(
        &self,
        hook: &'static str,
        command: &[Argument],
        stop: &AtomicBool,
    ) -> Result<bool, ExperimentError> {
        if command.is_empty() {
            return Ok(false);
        }
        self.place.empty()?;
        let call = self.call(command, None, stop);
        let ended = call.run(|_| self.reporter.say(&Progress::Preparing))?;
        let folder = self.request.data.join(hook);
        fs::create_dir(&folder).map_err(write_error(&folder))?;
        keep_output(&folder, &OUTPUT, &ended.printed)?;
        match ended.outcome {
            Outcome::Exited(0) => Ok(false),
            Outcome::Stopped => Ok(true),
            outcome => Err(CommandError::Hook {
                hook,
                how: outcome.in_words(call.bounds.timeout),
                last_words: ended.printed.last_words(),
            }
            .into()),
        }
    }

    /// The commands before and after the windows, and the windows between them.
    fn with_hooks(&self) -> Result<Ending, ExperimentError> {
        let window = self.request.windows.first().copied().unwrap_or(1);
        let measured = match self.hook(layout::PREPARE, &self.experiment.prepare, self.stop) {
            Ok(false) if self.experiment.window.continuous => self.all_of_one_call(),
            Ok(false) => self.all(),
            Ok(true) => Ok(Ending::Stopped { window }),
            Err(error) => Err(error),
        };
        // Whatever became of the windows, and of the wish to stop.
        let restored = self.hook(layout::RESTORE, &self.experiment.restore, &AtomicBool::new(false));
        let ending = measured?;
        restored?;
        Ok(ending)
    }

    fn all(&self) -> Result<Ending, ExperimentError> {
        for (position, number) in self.request.windows.iter().copied().enumerate() {
            let folder = WindowFolder::create(&self.request.data, number)?;
            let record = self.window(number, position == 0, &folder)?;
            if let Some(ending) = self.seal(&folder, record)? {
                return Ok(ending);
            }
        }
        Ok(Ending::Finished)
    }

    /// Completes a window and tells of it. How the run ends with it, if so.
    fn seal(&self, folder: &WindowFolder, record: WindowRecord) -> Result<Option<Ending>, ExperimentError> {
        let number = record.window;
        let (is_complete, verdict, reason) = (record.complete, record.verdict, record.invalid_for());
        folder.seal(record)?;
        if !is_complete {
            return Ok(Some(Ending::Stopped { window: number }));
        }
        self.reporter.say(&Progress::WindowComplete {
            window: number,
            verdict,
            reason: reason.clone(),
        });
        match reason.filter(|_| self.experiment.fail_fast) {
            None => Ok(None),
            Some(reason) => Err(CommandError::FailFast {
                window: number,
                reason,
            }
            .into()),
        }
    }

    /// Runs a window, and keeps what it measured.
    fn window(
        &self,
        number: u32,
        starts_run: bool,
        folder: &WindowFolder,
    ) -> Result<WindowRecord, ExperimentError> {
        self.place.empty()?;
        if starts_run {
            self.reporter.say(&Progress::Measuring { window: number });
        }
        let network = self.emulation.map(Emulation::network);
        let began = Snapshot::take(network, &[]);
        let measured = match self.emulation {
            None => self.run_command(number, folder),
            Some(emulation) => self.run_nodes(emulation, number, folder),
        }?;
        let after = Snapshot::take(network, &[]);
        let mut reasons = measured.reasons.clone();
        if measured.outcome == Outcome::Exited(0) {
            reasons.extend(collect(self.experiment, &self.place.output, folder.path())?);
        }
        Ok(self.record(number, starts_run, (&began, &after), measured, reasons))
    }

    fn say_running(&self, window: u32, elapsed: Duration) {
        self.reporter.say(&Progress::Running {
            window,
            elapsed_ms: u64::try_from(elapsed.as_millis()).unwrap_or(u64::MAX),
        });
    }

    fn run_command(&self, number: u32, folder: &WindowFolder) -> Result<Measured, ExperimentError> {
        let call = self.call(&self.experiment.run, Some(number), self.stop);
        let ended = call.run(|elapsed| self.say_running(number, elapsed));
        let ended = ended.inspect_err(|_| folder.clone().withdraw())?;
        keep_output(folder.path(), &OUTPUT, &ended.printed)?;
        ended.check_not_killed(number)?;
        let mut reasons = Vec::new();
        // Of an exit code the verdict says so.
        if ended.outcome.exit_code().is_none() {
            reasons.push(format!(
                "the command {}",
                ended.outcome.in_words(call.bounds.timeout)
            ));
        }
        if ended.outcome != Outcome::Exited(0) {
            reasons.extend(ended.printed.said_last());
        }
        Ok(Measured {
            outcome: ended.outcome,
            reasons,
            command: ended.record(),
            captures: Vec::new(),
            notices: NoticesRecord::default(),
        })
    }

    fn run_nodes(
        &self,
        emulation: &Emulation,
        number: u32,
        folder: &WindowFolder,
    ) -> Result<Measured, ExperimentError> {
        let bounds = self.bounds();
        let call = NodesCall {
            experiment: self.experiment,
            emulation,
            folder: &self.place.files,
            work: &self.place.work,
            window: self.values_of(number),
            bounds,
        };
        emulation.begin_captures(folder)?;
        let ended = call.run(|elapsed| self.say_running(number, elapsed));
        // Also of nodes that could not be started.
        let captured = emulation.end_captures(folder)?;
        let ended = ended?;
        for (node, printed) in self.experiment.nodes.iter().zip(&ended.printed) {
            keep_output(folder.path(), &layout::printed_by(&node.name), printed)?;
        }
        let (captures, failures) = captured;
        let mut notices = NoticesRecord::default();
        emulation.take_notices(self.reporter, &mut notices);
        let mut reasons = ended.reasons(number, bounds.timeout)?;
        reasons.extend(failures);
        let sum = |of: fn(&Printed) -> u64| ended.printed.iter().map(of).sum();
        let outcome = ended.outcome();
        Ok(Measured {
            outcome,
            reasons,
            command: CommandRecord {
                exit_code: outcome.exit_code(),
                cpu_ns: ended.usage.cpu_ns,
                peak_memory_bytes: ended.usage.peak_memory_bytes,
                stdout_bytes: sum(|printed| printed.stdout.bytes),
                stderr_bytes: sum(|printed| printed.stderr.bytes),
                left_behind: ended.left_behind,
                nodes: ended.nodes,
            },
            captures,
            notices,
        })
    }

    fn record(
        &self,
        number: u32,
        starts_run: bool,
        (began, after): (&Snapshot, &Snapshot),
        measured: Measured,
        reasons: Vec<String>,
    ) -> WindowRecord {
        let elapsed_ns = (after.monotonic_ns - began.monotonic_ns).max(1);
        let cpu_ns = measured.command.cpu_ns;
        let mut record = WindowRecord {
            format: record::FORMAT,
            window: number,
            environment: self.request.environment.clone(),
            starts_run,
            complete: measured.outcome != Outcome::Stopped,
            started_unix_ns: began.unix_ns(began.monotonic_ns),
            ended_unix_ns: after.unix_ns(after.monotonic_ns),
            started_ns: began.monotonic_ns - self.began_ns,
            ended_ns: after.monotonic_ns - self.began_ns,
            of: OfExperiment::Command {
                command: measured.command,
            },
            clock_jump_ns: after.unix_offset_ns - began.unix_offset_ns,
            cpu_share: cpu_ns as f64 / elapsed_ns as f64,
            conditions: after.conditions_beside(began, cpu_ns),
            captures: measured.captures,
            network_seed: self.emulation.and_then(|it| it.network().seed()),
            links: after.links_since(began),
            notices: measured.notices,
            releases: after.releases_since(began),
            files: Vec::new(),
            verdict: Verdict::Valid,
            reasons: Vec::new(),
        };
        let expected = Expectation {
            step_ns: 0,
            steps_per_period: 0,
            captures: self.emulation.map_or(0, Emulation::captures),
            limits: &self.request.settings.validity,
        };
        (record.verdict, record.reasons) = validity::judge(&record, &expected);
        if !reasons.is_empty() {
            record.verdict = Verdict::Invalid;
            record.reasons.extend(reasons);
        }
        record
    }
}

/// What a window of a command or of nodes came to.
struct Measured {
    outcome: Outcome,
    /// Why it does not count, as far as its numbers do not say so.
    reasons: Vec<String>,
    command: CommandRecord,
    captures: Vec<CaptureRecord>,
    notices: NoticesRecord,
}
