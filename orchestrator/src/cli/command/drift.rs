//! `matrix drift`: whether what is measured night after night has changed.

use std::{
    collections::{BTreeMap, BTreeSet},
    env, fs, io,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use clap::Args;
use record::{
    causes::with_causes,
    exit::matrix::Exit,
    quantity::Length,
    run_directory::{Kind, Place, ReadError, RunDirectory},
};
use reports::{
    drift::{
        self, Acknowledgements, Drift, Finding, Metric, Night, Settings, Verdict, contrasts::NightContrasts,
    },
    explain::{Effort, Found, Source, explain},
};

use crate::{
    cli::{
        command::{options::OutputArguments, report::unreadable},
        completion,
        run_argument::run_argument,
        terminal::{self, CommandError},
    },
    matrix_file::{self, Diagnostics},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct DriftArguments {
    /// A folder of run directories: the newest is judged against all before it.
    #[arg(required_unless_present = "candidate", conflicts_with_all = ["candidate", "baseline"])]
    history: Option<PathBuf>,
    /// Run directories that are known to be good.
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "candidate", value_parser = run_argument(), add = completion::runs())]
    baseline: Vec<PathBuf>,
    /// The run directory that is judged against them.
    #[arg(long, value_name = "RUN", requires = "baseline", value_parser = run_argument(), add = completion::runs())]
    candidate: Option<PathBuf>,
    /// The probability, each night, of a false finding among all scenarios and metrics.
    #[arg(long, value_name = "P", default_value_t = 0.01, value_parser = probability)]
    alpha: f64,
    /// A change of the tracking error that is smaller does not matter; else `report.equivalence_margin` of the newest run.
    #[arg(long, value_name = "LENGTH", alias = "matters")]
    equivalence_margin: Option<Length>,
    /// A YAML file of changes that are known; else `drift.yaml` in the folder of run directories, if there is one.
    #[arg(long, value_name = "FILE")]
    acknowledged: Option<PathBuf>,
    /// The newest run must be no older than that, such as `12h`: else nothing is known of tonight, which is too little data.
    #[arg(long, value_name = "TIME", alias = "within", value_parser = humantime::parse_duration)]
    max_age: Option<Duration>,
    /// Compare every two scenarios of the same experiment, too, with the night as a block.
    #[arg(long, requires = "history")]
    between_scenarios: bool,
    /// Write the history of each scenario and metric there, as a page for a browser.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write JUnit's XML there.
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Write the JSON body of a webhook there.
    #[arg(long, value_name = "FILE")]
    webhook: Option<PathBuf>,
    /// Print annotations for GitHub's actions, and append a summary to the file of `GITHUB_STEP_SUMMARY`.
    #[arg(long, conflicts_with = "json")]
    github: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

fn probability(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|alpha| *alpha > 0.0 && *alpha < 1.0)
        .ok_or_else(|| "give a number between 0 and 1, such as 0.01".to_owned())
}

/// The name of the file with what is known, in a folder of run directories.
const KNOWN: &str = "drift.yaml";

/// Judges and prints.
///
/// # Errors
/// When a run directory or the file of what is known cannot be read, or a file not be written.
pub fn execute(arguments: &DriftArguments) -> Result<Exit, CommandError> {
    // Reading a year of runs takes a while.
    let begun = SystemTime::now();
    let chosen = match &arguments.history {
        Some(history) => Chosen::of_history(history)?,
        None => Chosen::to_compare(&arguments.baseline, arguments.candidate.as_ref())?,
    };
    ensure_each_is_given_once(&chosen.nights)?;
    let mut settings = chosen.settings(arguments.acknowledged.as_deref())?;
    settings.alpha = arguments.alpha;
    let asked = arguments
        .equivalence_margin
        .map(|margin| (Metric::TrackingError, margin.metres()));
    settings.equivalence_margins.extend(asked);
    let Chosen {
        nights,
        directories,
        judge,
        left_out,
        ..
    } = chosen;
    let newest = nights.last();
    let mut found = judge(&nights, &settings);
    found.remarks.extend(left_out.remarks);
    if let Some(reason) = left_out.newest {
        found = found.without_the_night(&reason);
    }
    let newest = newest.map(|night| night.created.as_str());
    let mut found = match arguments.max_age {
        Some(max_age) if is_older(newest, begun, max_age) => found.without_the_night(&format!(
            "the newest run is of {}, more than {} ago",
            newest.unwrap_or_default(),
            humantime::format_duration(max_age)
        )),
        _ => found,
    };
    found.explain(|scenario, runs, asked| {
        explained(&directories, scenario, runs, Effort::default().divided(asked))
    });
    found.find_reports(|run| {
        let report = directories
            .get(run)?
            .to_reopen()
            .ok()?
            .report()
            .join("report.html");
        matches!(report.kind(), Ok(Some(Kind::File))).then(|| report.path())
    });
    let contrasts = arguments
        .between_scenarios
        .then(|| NightContrasts::of(&nights, settings.alpha, settings.seed));
    if let Some(path) = &arguments.html {
        fs::write(path, found.page(&nights)).map_err(|error| unwritable(path, &error))?;
    }
    tell(arguments, &nights, &found, contrasts.as_ref())?;
    Ok(match found.verdict() {
        Verdict::NoDrift { .. } => Exit::Done,
        Verdict::Drift => Exit::Drift,
        Verdict::Invalid { .. } => Exit::InvalidMeasurement,
        Verdict::TooLittle { .. } => Exit::TooLittleData,
    })
}

/// The nights that are judged, and how.
struct Chosen {
    /// The one that is judged is the last.
    nights: Vec<Night>,
    /// The run directory of each, by the run's name. None is held open.
    directories: BTreeMap<String, RunDirectory>,
    judge: fn(&[Night], &Settings) -> Drift,
    /// The file of what is known, beside the run directories. It may have come with them.
    beside: Option<Place>,
    left_out: LeftOut,
}

/// Run directories of a history that cannot be read.
#[derive(Default)]
struct LeftOut {
    remarks: Vec<String>,
    /// Why the newest is one of them.
    newest: Option<String>,
}

impl Chosen {
    /// One run that was killed as it began must not end every night's check: what cannot be read is left out and said, and if it
    /// is the newest, nothing is known of tonight.
    fn of_history(folder: &Path) -> Result<Self, CommandError> {
        let (mut nights, mut directories) = (Vec::new(), BTreeMap::new());
        let mut left_out = LeftOut::default();
        let history = Place::root(folder);
        for run in runs_in(&history)? {
            left_out.newest = None;
            // It is open from here to the end of the loop.
            match night(&RunDirectory::found(&run)) {
                Ok((night, directory)) => {
                    directories.insert(night.run.clone(), directory);
                    nights.push(night);
                }
                Err(error) => {
                    let what = format!("{run} cannot be read: {}", with_causes(&error));
                    left_out
                        .remarks
                        .push(format!("left out: {what}; {}", error.hint()));
                    left_out.newest = Some(format!("the newest run {what}"));
                }
            }
        }
        Ok(Self {
            nights: in_order(nights),
            directories,
            judge: drift::history::judge,
            beside: Some(history.join(KNOWN)).filter(Place::exists),
            left_out,
        })
    }

    /// What is declared and known: in this file, or in the one beside the run directories.
    fn settings(&self, acknowledged: Option<&Path>) -> Result<Settings, CommandError> {
        Ok(Settings {
            equivalence_margins: self.nights.last().map(Night::margins).unwrap_or_default(),
            acknowledgements: match (acknowledged, &self.beside) {
                (Some(path), _) => known(path, matrix_file::text_within_limits(path))?,
                (None, Some(place)) => known(&place.path(), matrix_file::text_at(place))?,
                (None, None) => Acknowledgements::default(),
            },
            ..Settings::default()
        })
    }

    fn to_compare(baseline: &[PathBuf], candidate: Option<&PathBuf>) -> Result<Self, CommandError> {
        let mut directories = BTreeMap::new();
        let mut nights = in_order(read(baseline, &mut directories)?);
        nights.extend(read(candidate, &mut directories)?);
        Ok(Self {
            nights,
            directories,
            judge: drift::baseline::judge,
            beside: None,
            left_out: LeftOut::default(),
        })
    }
}

/// A folder of run directories, for `matrix prune`.
pub(super) struct History {
    /// Each night with its run directory, the earliest first. None is held open.
    pub(super) nights: Vec<(Night, RunDirectory)>,
    /// The names of the runs between which something changed that nobody has acknowledged.
    pub(super) told_of: BTreeSet<String>,
    /// Run directories that cannot be read, and why.
    pub(super) unreadable: Vec<String>,
}

impl History {
    /// Reads and judges it.
    ///
    /// # Errors
    /// As [`execute`].
    pub(super) fn read(folder: &Path) -> Result<Self, CommandError> {
        let mut chosen = Chosen::of_history(folder)?;
        ensure_each_is_given_once(&chosen.nights)?;
        let found = (chosen.judge)(&chosen.nights, &chosen.settings(None)?);
        let findings = found
            .judgements
            .into_iter()
            .flat_map(|judgement| judgement.findings);
        let open = findings.filter(Finding::is_news);
        let directories = &mut chosen.directories;
        let with_directory = |night: Night| {
            let directory = directories.remove(&night.run)?;
            Some((night, directory))
        };
        Ok(Self {
            nights: chosen.nights.into_iter().filter_map(with_directory).collect(),
            told_of: open.flat_map(|finding| [finding.before, finding.since]).collect(),
            unreadable: chosen.left_out.remarks,
        })
    }
}

/// What a change of a scenario's tracking error from one run to another comes from.
fn explained(
    directories: &BTreeMap<String, RunDirectory>,
    scenario: &str,
    runs: [&str; 2],
    effort: Effort,
) -> Found {
    // Of each judged run there is one.
    let directory = |run: &str| match directories.get(run) {
        Some(directory) => reopened(directory),
        None => Ok(RunDirectory::new("")),
    };
    let attempt = || {
        let (before, since) = (directory(runs[0])?, directory(runs[1])?);
        let run_before = reports::load_from(&before, None)?;
        let run_since = reports::load_from(&since, None)?;
        let sides = [Source::of(&before, &run_before)?, Source::of(&since, &run_since)?];
        explain(sides.each_ref().map(|side| (side, scenario)), effort)
    };
    Found::of(attempt())
}

/// A run that is there twice would say that nights differ less than they do, and of itself that nothing changed.
fn ensure_each_is_given_once(nights: &[Night]) -> Result<(), CommandError> {
    let mut seen = BTreeSet::new();
    match nights.iter().find(|night| !seen.insert(&night.run)) {
        None => Ok(()),
        Some(twice) => Err(CommandError {
            what: format!("the run {} is there twice", twice.run).into(),
            hint: Some(
                "give each run once, and none both as baseline and as candidate; of copies in a history remove all but one"
                    .to_owned(),
            ),
            exit: Exit::Wrong,
        }),
    }
}

/// Whether a run was asked for longer ago than that. One of the future was not.
fn is_older(created: Option<&str>, now: SystemTime, than: Duration) -> bool {
    let created = created.and_then(|created| humantime::parse_rfc3339(created).ok());
    created.is_none_or(|created| now.duration_since(created).is_ok_and(|age| age > than))
}

/// The run directories of a folder, by name. Other things may lie there, and `latest`, the link to one of them.
fn runs_in(history: &Place) -> Result<Vec<Place>, CommandError> {
    let mut runs = history.entries().map_err(|error| {
        wrong(
            history.base(),
            &error,
            "give the folder with the run directories, such as `runs`",
        )
    })?;
    runs.retain(|(place, kind)| *kind == Kind::Folder && place.join("manifest.json").exists());
    match runs.is_empty() {
        true => Err(CommandError {
            what: format!("{history} has no run directory in it").into(),
            hint: Some("give the folder with the run directories, such as `runs`".to_owned()),
            exit: Exit::Wrong,
        }),
        false => Ok(runs.into_iter().map(|(place, _)| place).collect()),
    }
}

fn read<'a>(
    runs: impl IntoIterator<Item = &'a PathBuf>,
    directories: &mut BTreeMap<String, RunDirectory>,
) -> Result<Vec<Night>, CommandError> {
    runs.into_iter()
        .map(|path| {
            let (night, directory) = night(&RunDirectory::new(path)).map_err(|error| unreadable(&error))?;
            directories.insert(night.run.clone(), directory);
            Ok(night)
        })
        .collect()
}

/// The night of a run directory, and the directory for a later look, which must find the same one.
fn night(directory: &RunDirectory) -> Result<(Night, RunDirectory), ReadError> {
    let night = drift::digest::night_in(directory)?;
    Ok((night, reopened(directory)?))
}

fn reopened(directory: &RunDirectory) -> Result<RunDirectory, ReadError> {
    directory.to_reopen().map_err(|source| ReadError::Io {
        path: directory.path().to_owned(),
        source,
    })
}

fn in_order(mut nights: Vec<Night>) -> Vec<Night> {
    nights.sort_by(|a, b| a.created.cmp(&b.created));
    nights
}

/// Reads a file of changes that are known.
pub(crate) fn acknowledgements(text: &str) -> Result<Acknowledgements, serde_yaml::Error> {
    serde_yaml::from_str(text)
}

/// What a file with this text says is known.
fn known(path: &Path, text: Result<String, Diagnostics>) -> Result<Acknowledgements, CommandError> {
    const HINT: &str = "docs/drift.md says what stands in it";
    let text = text.map_err(CommandError::of_mistakes)?;
    let known = acknowledgements(&text).map_err(|error| wrong(path, &error, HINT))?;
    match known.problems().first() {
        Some(problem) => Err(CommandError {
            what: format!("{}: {problem}", path.display()).into(),
            hint: Some(HINT.to_owned()),
            exit: Exit::Wrong,
        }),
        None => Ok(known),
    }
}

fn wrong(path: &Path, error: &dyn std::error::Error, hint: &str) -> CommandError {
    CommandError {
        what: format!("{}: {error}", path.display()).into(),
        hint: Some(hint.to_owned()),
        exit: Exit::Wrong,
    }
}

fn tell(
    arguments: &DriftArguments,
    nights: &[Night],
    found: &Drift,
    contrasts: Option<&NightContrasts>,
) -> Result<(), CommandError> {
    let write = |path: &Option<PathBuf>, text: String| match path {
        Some(path) => fs::write(path, text).map_err(|error| unwritable(path, &error)),
        None => Ok(()),
    };
    write(&arguments.junit, found.junit())?;
    write(&arguments.webhook, format!("{:#}\n", found.webhook()))?;
    if arguments.github {
        terminal::verbatim(&found.github_annotations());
        if let Some(path) = env::var_os("GITHUB_STEP_SUMMARY").map(PathBuf::from) {
            append(&path, &found.github_summary()).map_err(|error| unwritable(&path, &error))?;
        }
    } else if arguments.output.json {
        let mut document = found.json();
        document.between_scenarios = contrasts.map(NightContrasts::json);
        document.series = Some(drift::series_for_programs(nights));
        terminal::json(&document);
    } else {
        let contrasts = contrasts.map(NightContrasts::text).unwrap_or_default();
        terminal::result(&format!("{}{contrasts}", found.text()));
    }
    Ok(())
}

fn append(path: &Path, text: &str) -> io::Result<()> {
    let mut file = fs::OpenOptions::new().append(true).create(true).open(path)?;
    io::Write::write_all(&mut file, text.as_bytes())
}

fn unwritable(path: &Path, error: &io::Error) -> CommandError {
    CommandError {
        what: format!("{} cannot be written: {error}", path.display()).into(),
        hint: Some("see that its folder is there and has room".to_owned()),
        exit: Exit::Infrastructure,
    }
}

#[cfg(test)]
mod tests {
    use std::{os::unix::fs::symlink, process::Command};

    use clap::FromArgMatches as _;

    use super::*;
    use crate::workload_binary::start;

    /// What `matrix drift` says of a history of one run whose `drift.yaml` is made so.
    fn refusal(make: impl FnOnce(&Path)) -> String {
        let folder = tempfile::tempdir().unwrap();
        let history = folder.path().join("history");
        fs::create_dir(&history).unwrap();
        copy_of_recorded(&history.join("run"));
        make(&history.join(KNOWN));
        let command = DriftArguments::augment_args(clap::Command::new("drift"));
        let words = command.get_matches_from(["drift".as_ref(), history.as_os_str()]);
        let error = execute(&DriftArguments::from_arg_matches(&words).unwrap()).unwrap_err();
        serde_json::to_string(&error.to_json()).unwrap()
    }

    /// A copy of a run that was recorded.
    fn copy_of_recorded(to: &Path) {
        let recorded = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/recorded");
        let mut copy = Command::new("cp");
        copy.args(["-r", recorded]).arg(to);
        assert!(start(|| copy.status()).unwrap().success());
    }

    #[test]
    fn a_run_that_is_exchanged_after_it_was_read_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (history, victim) = (folder.path().join("history"), folder.path().join("victim"));
        fs::create_dir(&history).unwrap();
        copy_of_recorded(&history.join("run"));
        copy_of_recorded(&victim);
        for with_a_link in [true, false] {
            let (_, directory) = History::read(&history).unwrap().nights.pop().unwrap();
            let away = folder.path().join("away");
            fs::rename(history.join("run"), &away).unwrap();
            match with_a_link {
                true => symlink(&victim, history.join("run")).unwrap(),
                false => fs::rename(&victim, history.join("run")).unwrap(),
            }
            assert!(reports::load_from(&directory, None).is_err());
            assert!(directory.manifest().remove_file().is_err());
            assert!(history.join("run/manifest.json").exists());
            if with_a_link {
                fs::remove_file(history.join("run")).unwrap();
                fs::rename(&away, history.join("run")).unwrap();
                reports::load_from(&directory, None).unwrap();
            }
        }
    }

    #[test]
    fn a_history_holds_no_run_directory_open() {
        let folder = tempfile::tempdir().unwrap();
        let real = folder.path().canonicalize().unwrap();
        for run in ["a", "b", "c"] {
            copy_of_recorded(&real.join(run));
        }
        let history = Place::root(&real);
        let runs = runs_in(&history).unwrap();
        let kept: Vec<_> = runs
            .iter()
            .map(|run| night(&RunDirectory::found(run)).unwrap())
            .collect();
        let handles = fs::read_dir("/proc/self/fd").unwrap().flatten();
        let into = handles.filter(|entry| fs::read_link(entry.path()).is_ok_and(|to| to.starts_with(&real)));
        assert_eq!((kept.len(), into.count()), (3, 1));
    }

    #[test]
    fn a_file_of_known_changes_that_came_as_a_link_is_not_read() {
        let secret = tempfile::NamedTempFile::new().unwrap();
        fs::write(secret.path(), "mine: [and, nobody's").unwrap();
        let told = refusal(|known| symlink(secret.path(), known).unwrap());
        assert!(told.contains("a link, a device"), "{told}");
        assert!(!told.contains("nobody"), "{told}");
    }

    #[test]
    fn a_file_of_known_changes_that_came_as_a_fifo_is_not_waited_for() {
        let told = refusal(|known| {
            let made = start(|| Command::new("mkfifo").arg(known).status());
            assert!(made.unwrap().success());
        });
        assert!(told.contains("a FIFO"), "{told}");
    }
}
