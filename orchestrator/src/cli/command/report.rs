//! `matrix report RUN…`: tables and figures, at any time, from run directories alone.

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use record::{
    exit::matrix::Exit,
    limits,
    report_settings::ReportSettings,
    run_directory::{Place, PlannedScenario, ReadError, RunDirectory},
};
use reports::{
    Layout, Run,
    analysis::{
        combination::{Repeated, combine},
        other_ways::{other_positions, other_ways},
    },
    explain::{Effort, Source, explain_pairs},
    redaction::Redaction,
    replay::replay,
};

use crate::{
    cli::{
        command::options::OutputArguments,
        completion,
        run_argument::run_argument,
        session::{self, Carried},
        terminal::{self, CommandError},
    },
    escaping,
    matrix_file::{Diagnostics, ReportOption},
};

/// What it takes.
#[derive(Debug, Default, Args)]
pub struct ReportArguments {
    /// The run directory. Several of the same experiment are reported as one matrix.
    #[arg(required = true, value_name = "RUN", value_parser = run_argument(), add = completion::runs())]
    runs: Vec<PathBuf>,
    /// Where the report goes: a folder that is not there yet, or has a report in it. The run directory's `report` when left
    /// out; of several runs it must be given.
    #[arg(long = "output", value_name = "DIR")]
    into: Option<PathBuf>,
    /// Have what several runs measured of the same scenario as scenarios of their own, by an axis `run`.
    #[arg(long)]
    by_run: bool,
    /// Put other names in the place of those of hosts and users, and leave command lines out.
    #[arg(long)]
    redact: bool,
    /// With `--redact`: another name to go. May be repeated.
    #[arg(long, value_name = "NAME", requires = "redact")]
    also: Vec<String>,
    /// Another level than the matrix file's.
    #[arg(long)]
    alpha: Option<String>,
    /// Another metric than the matrix file's: mean-abs-sum, mean-abs-x, mean-abs-y, mean-distance, root-mean-square.
    #[arg(long)]
    metric: Option<String>,
    /// The positions that the error is of: received (by the controller), true-position (by the plant's log).
    #[arg(long, value_name = "POSITIONS")]
    error: Option<String>,
    /// Another way to p-values than the matrix file's: exact, asymptotic, paper.
    #[arg(long)]
    method: Option<String>,
    /// Another number of first periods to leave out than the matrix file's.
    #[arg(long, value_name = "N")]
    discard_periods: Option<String>,
    /// What to do about windows that warm up for longer: flag, cut.
    #[arg(long, value_name = "WHAT")]
    warm_up: Option<String>,
    /// Another baseline than the matrix file's: the axis values of the scenarios that the others are compared with, such as
    /// `{virtualization: native}`.
    #[arg(long, value_name = "VALUES", alias = "control")]
    baseline: Option<String>,
    /// Another family than the matrix file's: all, against-baseline, same-platform, or pairs such as `[[a, b]]`.
    #[arg(long)]
    family: Option<String>,
    /// Other pairs to draw than the matrix file's, and of which windows: `[[b, h], [d/1, f/2]]`. As all of these it is spelt
    /// as the matrix file spells it.
    #[arg(long, value_name = "PAIRS")]
    figures: Option<String>,
    /// What the figures are to stand in, which sets their width and the size of their letters.
    #[arg(long = "for", value_name = "LAYOUT", default_value = Layout::default().name(), value_parser = layout())]
    layout: Layout,
    /// Print every table, and not the conclusion and the scenarios alone.
    #[arg(long, conflicts_with = "json")]
    full: bool,
    /// Say of every pair that differs what its difference comes from, as `matrix explain` does. Takes some 30 s.
    #[arg(long, conflicts_with = "redact")]
    explain: bool,
    /// Check each window against itself, as `matrix replay` does. Takes a second or two for each 1000 s of a scenario.
    #[arg(long, conflicts_with = "redact")]
    replay: bool,
    /// Add a table of what would be found by each other method and metric, with the first period kept or left out, and by the other
    /// positions. Takes some ten times as long.
    #[arg(long, conflicts_with = "redact")]
    sensitivity: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

fn layout() -> impl TypedValueParser<Value = Layout> {
    let named = |name: String| Layout::ALL.into_iter().find(|layout| layout.name() == name);
    PossibleValuesParser::new(Layout::ALL.map(Layout::name)).map(move |name| named(name).unwrap_or_default())
}

impl ReportArguments {
    /// What is asked to differ in how samples are taken and compared.
    fn of_samples(&self) -> [(ReportOption, &Option<String>); 6] {
        [
            (ReportOption::ALPHA, &self.alpha),
            (ReportOption::METRIC, &self.metric),
            (ReportOption::ERROR, &self.error),
            (ReportOption::METHOD, &self.method),
            (ReportOption::DISCARD_PERIODS, &self.discard_periods),
            (ReportOption::WARM_UP, &self.warm_up),
        ]
    }

    /// What is asked to differ in which scenarios are compared. It names those of the whole, where several runs make one.
    fn of_scenarios(&self) -> [(ReportOption, &Option<String>); 3] {
        [
            (ReportOption::BASELINE, &self.baseline),
            (ReportOption::FAMILY, &self.family),
            (ReportOption::FIGURES, &self.figures),
        ]
    }

    /// The run's settings with these in their place.
    fn settings<'a>(
        &self,
        run: &Run,
        options: impl IntoIterator<Item = (ReportOption, &'a Option<String>)>,
    ) -> Result<ReportSettings, CommandError> {
        let scenarios: Vec<PlannedScenario> = run.scenarios.iter().map(|it| it.planned.clone()).collect();
        let mut settings = run.manifest.report.clone();
        let mut warnings = Diagnostics::new();
        let mut wrong = Diagnostics::new();
        let given = options.into_iter();
        let given = given.filter_map(|(option, text)| Some((option, text.as_deref()?)));
        let mut experiments = run
            .scenarios
            .iter()
            .filter_map(|it| it.planned.settings.experiment.as_ref());
        let experiment = experiments.next();
        for (option, text) in given {
            if let Some(experiment) = experiment.filter(|_| option.is_of_the_ball()) {
                return Err(self::wrong(
                    format!(
                        "`{}` is of the ball on the plate, and this run measured {}",
                        option.name(),
                        experiment.name
                    ),
                    "leave it out",
                ));
            }
            match option.apply(text, &settings, &scenarios) {
                Ok((with_it, odd)) => {
                    settings = with_it;
                    warnings.extend(odd);
                }
                Err(found) => wrong.extend(found),
            }
        }
        if wrong.has_errors() {
            return Err(CommandError::of_mistakes(wrong));
        }
        if !warnings.is_empty() && !self.output.quiet {
            terminal::print_diagnostics(&warnings);
        }
        Ok(settings)
    }
}

/// Makes and prints the report.
///
/// # Errors
/// When a run directory cannot be read, runs do not fit together or the report folder cannot be written.
pub fn execute(arguments: &ReportArguments) -> Result<Exit, CommandError> {
    let directories: Vec<RunDirectory> = arguments.runs.iter().map(RunDirectory::new).collect();
    let only = match directories.as_slice() {
        [only] => Some(only),
        _ if arguments.explain || arguments.replay || arguments.sensitivity => {
            return Err(wrong(
                "`--explain`, `--replay` and `--sensitivity` are of one run directory".to_owned(),
                "leave them out, or give one run directory alone",
            ));
        }
        _ => None,
    };
    let mut run = read(arguments, &directories)?;
    if let Some(folder) = &arguments.into {
        ensure_may_hold_a_report(folder)?;
        run.report_folder = Place::root(folder);
    }
    let options: Vec<_> = arguments
        .of_samples()
        .into_iter()
        .chain(arguments.of_scenarios())
        .collect();
    let asks_for_more = !options.is_empty() || arguments.explain || arguments.replay || arguments.sensitivity;
    let settings = arguments.settings(&run, options)?;
    let mut report = reports::analyse(&run, reports::input::traffic::read(&run), &settings);
    if let Some(directory) = only {
        if arguments.explain {
            let source = Source::of(directory, &run).map_err(|error| unreadable(&error))?;
            report.causes = explain_pairs(&source, report.differing_pairs(), Effort::default());
        }
        if arguments.replay {
            let replayed = replay(directory)
                .map_err(|error| CommandError::new(Exit::Wrong, &error, Some(error.hint())))?;
            report.replays = replayed.scenarios;
        }
        if arguments.sensitivity {
            // A run without the plant's log has no true positions, and its table has no such row.
            let other = reports::load_from(directory, Some(other_positions(run.error))).ok();
            report.other_ways = other_ways(&report, &run, other.as_ref());
        }
    }
    reports::write(&run, &report, arguments.layout)
        .map_err(|error| CommandError::new(Exit::Infrastructure, &error, Some(error.hint().to_owned())))?;
    let page = report.present();
    match (arguments.output.json, arguments.full) {
        (true, _) => terminal::json(&page.json()),
        (_, true) => terminal::result(&page.markdown()),
        _ => {
            let full = match only.filter(|_| !asks_for_more && arguments.into.is_none()) {
                Some(run) => format!("`matrix report {} --full`", escaping::pasted(run.path())),
                None => "the same command with `--full`".to_owned(),
            };
            terminal::result(&format!(
                "{}\nAll tables, figures and numbers: {}\nThe tables here: {full}\n",
                page.summary(),
                run.report_folder.join("report.html")
            ));
        }
    }
    Ok(match report.has_unexpected() {
        true => Exit::NotAsExpected,
        false => Exit::Done,
    })
}

/// The run that is to be reported, put together where there are several, with the settings that it is to be reported by.
fn read(arguments: &ReportArguments, directories: &[RunDirectory]) -> Result<Run, CommandError> {
    if arguments.runs.len() > 1 && arguments.into.is_none() {
        return Err(wrong(
            "several runs have no report folder in common".to_owned(),
            "say where their report goes: `--output DIR`",
        ));
    }
    ensure_all_can_be_open(directories)?;
    // Before anything else: logs are read for it.
    let error = match &arguments.error {
        None => None,
        Some(text) => Some(
            ReportOption::ERROR
                .apply(text, &ReportSettings::default(), &[])
                .map_err(CommandError::of_mistakes)?
                .0
                .error,
        ),
    };
    let load = |directory: &RunDirectory| {
        let mut run = reports::load_from(directory, error).map_err(|error| unreadable(&error))?;
        // What the call says settles what several runs declared otherwise.
        if arguments.runs.len() > 1 {
            run.manifest.report = arguments.settings(&run, arguments.of_samples())?;
        }
        Ok(run)
    };
    let mut runs: Vec<Run> = directories
        .iter()
        .map(load)
        .collect::<Result<_, CommandError>>()?;
    let redaction = match arguments.redact {
        true => Some(redaction(directories, &arguments.also)?),
        false => None,
    };
    let repeated = match arguments.by_run {
        true => Repeated::Distinguished,
        false => Repeated::Refused,
    };
    let run = match (runs.pop(), runs.is_empty()) {
        (Some(only), true) => only,
        (last, _) => {
            runs.extend(last);
            combine(runs, repeated)
                .map_err(|misfits| CommandError::new(Exit::Wrong, &misfits, misfits.hint()))?
        }
    };
    match redaction {
        None => Ok(run),
        Some(redaction) => run
            .redacted(&redaction)
            .map_err(|error| word_of_the_format(&error)),
    }
}

/// A folder of somebody else's is never written into: what a report does not have is removed there.
fn ensure_may_hold_a_report(folder: &Path) -> Result<(), CommandError> {
    let is_empty = || fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if !folder.exists() || is_empty() || reports::is_report_folder(&Place::root(folder)) {
        return Ok(());
    }
    Err(wrong(
        format!("{} is there and has no report of matrix in it", folder.display()),
        "name a folder that is not there yet",
    ))
}

fn wrong(what: String, hint: &str) -> CommandError {
    CommandError {
        what: what.into(),
        hint: Some(hint.to_owned()),
        exit: Exit::Wrong,
    }
}

/// What is to be replaced in runs, the same names in all of them.
///
/// # Errors
/// When one cannot be read.
pub(super) fn redaction(runs: &[RunDirectory], also: &[String]) -> Result<Redaction, CommandError> {
    Redaction::of(runs, also).map_err(|error| unreadable(&error))
}

/// Each of several run directories is open until the command is done with all of them.
///
/// # Errors
/// When this process may not open so many files.
pub(super) fn ensure_all_can_be_open(directories: &[RunDirectory]) -> Result<(), CommandError> {
    limits::ensure_open_files(limits::OPEN_FILES + directories.len() as u64)
        .map_err(|error| CommandError::new(Exit::Infrastructure, &error, Some(error.hint())))
}

/// A redacted run that cannot be read any more.
pub(super) fn word_of_the_format(error: &dyn Error) -> CommandError {
    let hint = "a name that was replaced is a word of the run directory's own: give it without `--also`, or rename the host";
    CommandError::new(Exit::Wrong, error, Some(hint.to_owned()))
}

/// The report at the end of a run, with what there is; keeps the run's exit code unless that is success. If jobs are left in their queues, how to
/// follow them.
///
/// # Errors
/// When the report cannot be made.
pub fn after_run(
    directory: &RunDirectory,
    carried: Carried,
    output: OutputArguments,
) -> Result<Exit, CommandError> {
    let exit = match carried {
        Carried::Out(exit) => exit,
        Carried::Left(jobs) => {
            session::print_left(directory.path(), jobs);
            return Ok(Exit::Done);
        }
    };
    let reported = execute(&ReportArguments {
        runs: vec![directory.path().to_owned()],
        output,
        ..ReportArguments::default()
    })?;
    if !output.quiet {
        terminal::print_note(&format!("run directory: {}", directory.path().display()));
        if exit != Exit::Done {
            terminal::print_note(&session::how_to_go_on(directory.path()));
        }
    }
    // How the run itself ended says more.
    Ok(match exit {
        Exit::Done => reported,
        exit => exit,
    })
}

/// A run directory that cannot be read.
pub(super) fn unreadable(error: &ReadError) -> CommandError {
    CommandError::new(Exit::Wrong, error, Some(error.hint()))
}
