//! The `workload` binary: what is deployed into an environment.
//!
//! Its exit codes are those of [`Exit`]; the last line of progress says which and why.

use std::{
    borrow::Cow,
    ffi::OsString,
    io::{self, Write},
    os::unix::process::ExitStatusExt as _,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use clap::{Args, Parser, Subcommand, builder::PossibleValuesParser};
use nix::sys::signal::{SigSet, Signal};
use record::{
    call::{Check, Detached, Rehearse, Run, Shell},
    causes::with_causes,
    exit::workload::Exit,
    limits,
    progress::{Part, Progress},
    settings::{Dynamics, Settings},
    topology,
    virtual_host::VirtualHost,
};
use workload::{
    ball_on_plate::{self, Program},
    capabilities::spawn_after_drop,
    check, detached, enter,
    experiment::{Ending, ExperimentError, Reporter, Request},
    experiments, network, shell, virtual_hosts,
};

/// One networked control experiment, in one environment.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Call {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Measure windows. Says where it is as lines of JSON; SIGTERM ends it in order.
    Run(Run),
    /// Say whether this place can run the experiment, as JSON.
    Check(Check),
    /// Run network, ROS master and nodes without measuring, until SIGTERM or Ctrl-C: for ROS's tools and your own nodes. Of a
    /// command, run its network.
    Rehearse(Rehearse),
    /// Rehearse the experiment and run a program in one of its virtual hosts: `workload shell h1`, `workload shell sta1 ping 10.0.0.1`.
    Shell(Shell),
    /// One node of a workload that runs: what the workload starts in a virtual host where each node is a process.
    #[command(hide = true)]
    Node(Node),
    /// Run a program inside a virtual host of a workload that runs: `workload enter $(pidof workload) h1 rostopic list`.
    Enter(Enter),
    /// Keep a workload that goes on by itself: start it, follow it, bring its data, remove it.
    #[command(subcommand)]
    Detached(Detached),
}

#[derive(Debug, Args)]
struct Node {
    #[arg(value_parser = PossibleValuesParser::new(Program::ALL.map(Program::name)))]
    program: String,
    /// The settings, as JSON.
    #[arg(long)]
    settings: String,
}

#[derive(Debug, Args)]
struct Enter {
    /// Process number of the workload.
    pid: u32,
    /// One of its virtual hosts, such as `h1`.
    host: VirtualHost,
    /// The program.
    program: OsString,
    /// Its arguments.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// Why there is nothing to measure.
#[derive(Debug, thiserror::Error)]
enum WrongCall {
    #[error("the settings cannot be read")]
    Unreadable(#[from] serde_json::Error),
    #[error("{path}: {message}")]
    Problem {
        path: Cow<'static, str>,
        message: String,
        hint: String,
    },
    #[error("window {0} is listed twice")]
    Twice(u32),
}

impl WrongCall {
    fn hint(&self) -> Option<String> {
        match self {
            Self::Unreadable(_) => None,
            Self::Problem { hint, .. } => Some(hint.clone()),
            Self::Twice(_) => Some("list each window once".into()),
        }
    }
}

fn main() -> ExitCode {
    match Call::parse().command {
        Command::Run(call) => run(call),
        Command::Check(call) => check(&call),
        Command::Rehearse(call) => rehearse(&call),
        Command::Shell(call) => shell(&call),
        Command::Node(call) => node(&call),
        Command::Enter(call) => enter(&call),
        Command::Detached(call) => {
            limits::fail_at_the_longest_file();
            detached::run(&call)
        }
    }
}

fn run(call: Run) -> ExitCode {
    let (data, ends_with_input) = (call.data.clone(), call.ends_with_input);
    let request = request(call);
    // While this is the only thread: the kernel asks for that, and the threads to come inherit the blocked signals.
    let begun = request
        .as_ref()
        .map(|request| experiments::of(&request.settings).begin(&request.settings));
    let begun = begun.unwrap_or(Ok(()));
    let ends = block_signals();
    let made = std::fs::create_dir_all(&data);
    let reporter = Reporter::start(Some(&data.join("progress.jsonl")));
    reporter.say(&Progress::Started {
        pid: std::process::id(),
    });
    let exit = match request {
        Err(wrong) => report_wrong_call(&reporter, &wrong),
        Ok(request) => {
            let stop = Arc::new(AtomicBool::new(false));
            let path = request.data.clone();
            let outcome = made
                .map_err(|source| ExperimentError::Write { path, source })
                .and_then(|()| Ok(limits::check()?))
                .and(begun)
                .and_then(|()| set_when_told(ends, &stop))
                .and_then(|()| match ends_with_input {
                    true => set_when_input_ends(&stop),
                    false => Ok(()),
                })
                .and_then(|()| experiments::of(&request.settings).run(&request, &reporter, &stop));
            report_outcome(&reporter, outcome)
        }
    };
    reporter.finish();
    exit.into()
}

fn request(call: Run) -> Result<Request, WrongCall> {
    let settings = read_settings(&call.settings)?;
    let mut seen = std::collections::BTreeSet::new();
    if let Some(twice) = call.windows.iter().find(|window| !seen.insert(**window)) {
        return Err(WrongCall::Twice(*twice));
    }
    Ok(Request {
        environment: call.environment,
        settings,
        data: call.data,
        windows: call.windows,
        work: call.work,
    })
}

fn read_settings(json: &str) -> Result<Settings, WrongCall> {
    let settings = Settings::from_json(serde_json::from_str(json)?, Dynamics::default())?;
    match settings.problems().into_iter().next() {
        Some(problem) => Err(WrongCall::Problem {
            path: problem.path,
            message: problem.message,
            hint: problem.hint,
        }),
        None => Ok(settings),
    }
}

fn report_outcome(reporter: &Reporter, outcome: Result<Ending, ExperimentError>) -> Exit {
    match outcome {
        Ok(Ending::Finished) => {
            reporter.say(&Progress::Finished);
            Exit::Done
        }
        Ok(Ending::Stopped { window }) => {
            reporter.say(&Progress::Stopped { window });
            Exit::Done
        }
        Err(error) => {
            let platform = error.is_of_platform();
            report_failure(reporter, with_causes(&error), error.hint(), platform);
            Exit::Failed
        }
    }
}

fn report_wrong_call(reporter: &Reporter, wrong: &WrongCall) -> Exit {
    report_failure(reporter, with_causes(wrong), wrong.hint(), false);
    Exit::WrongCall
}

fn report_failure(reporter: &Reporter, reason: String, hint: Option<String>, platform: bool) {
    complain(&reason, hint.as_deref());
    reporter.say(&Progress::Failed {
        reason,
        hint,
        platform,
    });
}

/// For who reads standard error; nothing depends on it.
fn complain(reason: &str, hint: Option<&str>) {
    let hint = hint.map(|hint| format!("\nhint: {hint}")).unwrap_or_default();
    let _ = writeln!(io::stderr(), "error: {reason}{hint}");
}

fn check(call: &Check) -> ExitCode {
    let settings = match read_settings(&call.settings) {
        Ok(settings) => settings,
        Err(wrong) => {
            complain(&with_causes(&wrong), wrong.hint().as_deref());
            return Exit::WrongCall.into();
        }
    };
    let namespace_root = network::become_namespace_root();
    let found = check::check(&settings, namespace_root);
    // Plain data can always be written as JSON.
    let text = serde_json::to_string(&found).unwrap_or_default();
    match writeln!(io::stdout(), "{text}") {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => Exit::Failed.into(),
    }
}

fn rehearse(call: &Rehearse) -> ExitCode {
    let namespace_root = network::become_namespace_root();
    let ends = block_signals();
    let reporter = Reporter::start(None);
    reporter.say(&Progress::Started {
        pid: std::process::id(),
    });
    let without: Vec<_> = Part::ALL
        .into_iter()
        .filter(|part| call.without.iter().any(|name| name == part.name()))
        .collect();
    let exit = match read_settings(&call.settings) {
        Err(wrong) => report_wrong_call(&reporter, &wrong),
        Ok(settings) => {
            let stop = Arc::new(AtomicBool::new(false));
            let outcome = namespace_root
                .map_err(ExperimentError::from)
                .and_then(|()| set_when_told(ends, &stop))
                .and_then(|()| experiments::rehearse(&settings, &without, &reporter, &stop));
            report_outcome(&reporter, outcome.map(|()| Ending::Finished))
        }
    };
    reporter.finish();
    exit.into()
}

fn shell(call: &Shell) -> ExitCode {
    // Ctrl-C is for the program that runs in the host.
    let _ = SigSet::from_iter([Signal::SIGINT]).thread_block();
    let outcome = match read_settings(&call.settings) {
        Ok(settings) => shell::run(call, &settings),
        Err(wrong) => {
            complain(&with_causes(&wrong), wrong.hint().as_deref());
            return Exit::WrongCall.into();
        }
    };
    match outcome {
        // As a shell says it of a program that a signal has ended.
        Ok(ended) => ended
            .code()
            .or_else(|| Some(128 + ended.signal()?))
            .and_then(|code| u8::try_from(code).ok())
            .map_or_else(|| Exit::Failed.into(), ExitCode::from),
        Err(error) => {
            complain(&with_causes(&error), error.hint());
            Exit::Failed.into()
        }
    }
}

/// It ends with its input, and not by a signal that is meant for the workload.
fn node(call: &Node) -> ExitCode {
    let _ = block_signals();
    let program = Program::ALL
        .into_iter()
        .find(|program| program.name() == call.program);
    match (program, read_settings(&call.settings)) {
        (Some(program), Ok(settings)) if ball_on_plate::serve(program, &settings) => ExitCode::SUCCESS,
        (Some(_), Ok(_)) => Exit::Failed.into(),
        (None, _) => Exit::WrongCall.into(),
        (_, Err(wrong)) => {
            complain(&with_causes(&wrong), wrong.hint().as_deref());
            Exit::WrongCall.into()
        }
    }
}

fn enter(call: &Enter) -> ExitCode {
    let error = enter::exec(
        call.pid,
        call.host,
        &virtual_hosts::uri(topology::address(0)),
        &call.program,
        &call.arguments,
    );
    complain(&with_causes(&error), Some(error.hint()));
    Exit::Failed.into()
}

/// Blocks the signals that end a process for all threads to come. SIGHUP stays blocked for ever: the run outlives the
/// terminal or connection that started it. Rust's runtime ignores SIGPIPE already.
fn block_signals() -> SigSet {
    let ends = SigSet::from_iter([Signal::SIGTERM, Signal::SIGINT]);
    let mut blocked = ends;
    blocked.add(Signal::SIGHUP);
    limits::fail_at_the_longest_file();
    // It fails for an invalid argument only.
    let _ = blocked.thread_block();
    ends
}

/// Sets `stop` when one of the signals comes.
fn set_when_told(ends: SigSet, stop: &Arc<AtomicBool>) -> Result<(), ExperimentError> {
    set_after("signals", stop, move || {
        let _ = ends.wait();
    })
}

/// Sets `stop` when nobody holds standard input open any more.
fn set_when_input_ends(stop: &Arc<AtomicBool>) -> Result<(), ExperimentError> {
    set_after("input", stop, || {
        let _ = io::copy(&mut io::stdin(), &mut io::sink());
    })
}

/// Sets `stop` when that returns, which a thread of its own waits for.
fn set_after(
    name: &'static str,
    stop: &Arc<AtomicBool>,
    returns: impl FnOnce() + Send + 'static,
) -> Result<(), ExperimentError> {
    let stop = Arc::clone(stop);
    let watcher = spawn_after_drop(name, move || {
        returns();
        stop.store(true, Ordering::Relaxed);
    });
    watcher.map_err(|source| ExperimentError::Thread {
        name: name.into(),
        source,
    })
}
