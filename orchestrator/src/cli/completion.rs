//! What a shell completes in the command line that is being written: profiles and scenarios of the matrix file, scenarios
//! of a run, run directories, other paths. [`crate::main_with`] answers the shell with them.
//!
//! The shell's script, which `matrix completions` prints, starts `matrix` with [`VARIABLE`] in the environment and the
//! command line behind `--`. Nothing is written, no host is asked, and what is wrong or takes long completes nothing.

use std::{
    env,
    ffi::{OsStr, OsString},
    path::Path,
    sync::{OnceLock, mpsc},
    thread,
    time::Duration,
};

use clap::ValueHint;
use clap_complete::{
    ArgValueCandidates, ArgValueCompleter, CompletionCandidate, PathCompleter, engine::ValueCompleter as _,
};
use record::run_directory::{FORMAT, PlanRecord, PlannedScenario, RunDirectory, read_record};

use crate::{
    cli::run_argument::{RUNS, is_run, newest_run, run_named},
    matrix_file::MatrixFile,
    preparation::{self, PlanRequest},
    provider::Catalogue,
    run::recorded::newest_first,
};

/// The variable of the environment that holds the name of the shell that asks.
pub const VARIABLE: &str = "MATRIX_COMPLETE";

/// The definition of the command line, which has these completions in it: whoever answers a shell sets it.
pub static COMMAND_LINE: OnceLock<fn() -> clap::Command> = OnceLock::new();

/// Longer nobody waits for a completion: the file may be a pipe, or lie on a disk that does not answer.
const TIMEOUT: Duration = Duration::from_secs(1);

/// The matrix file where the command line names none.
const FILE: &str = "matrix.yaml";

/// The profiles of the matrix file.
#[must_use]
pub fn profiles() -> ArgValueCandidates {
    candidates(|line| profiles_of_file(&line))
}

/// The scenarios of the matrix file, by letter and by slug.
#[must_use]
pub fn scenarios_of_file() -> ArgValueCandidates {
    candidates(|line| scenarios_planned(&line))
}

/// The scenarios of the run that is the command's first argument.
#[must_use]
pub fn scenarios_of_run() -> ArgValueCandidates {
    candidates(|line| scenarios_recorded(&run_named(&line.first?)?))
}

/// The scenarios of the run that `--run` names, or of the newest in `runs/`.
#[must_use]
pub fn scenarios_to_enter() -> ArgValueCandidates {
    candidates(|line| scenarios_recorded(&line.run.and_then(|run| run_named(&run)).or_else(newest_run)?))
}

/// The run directories in `runs/`, the newest first, and other folders where none of these fits.
#[must_use]
pub fn runs() -> ArgValueCompleter {
    ArgValueCompleter::new(|current: &OsStr| {
        let current = current.to_owned();
        in_time(move || {
            let runs = runs_in(Path::new(RUNS), &current);
            Some(match runs.is_empty() {
                true => plain_paths(&PathCompleter::dir(), &current),
                false => runs,
            })
        })
    })
}

/// The command line with a completion for each path that has none of these: clap's own proposes whatever a folder has in it.
#[must_use]
pub fn with_paths(command: clap::Command) -> clap::Command {
    let with_path = |argument: clap::Arg| {
        let is_path = argument.get_value_hint() != ValueHint::Unknown;
        match is_path && argument.get::<ArgValueCompleter>().is_none() {
            true => argument.add(ArgValueCompleter::new(|current: &OsStr| {
                let current = current.to_owned();
                in_time(move || Some(plain_paths(&PathCompleter::any(), &current)))
            })),
            false => argument,
        }
    };
    command.mut_args(with_path).mut_subcommands(with_paths)
}

/// Of the paths that begin so, those that are one word to every shell.
fn plain_paths(paths: &PathCompleter, current: &OsStr) -> Vec<CompletionCandidate> {
    let mut found = paths.complete(current);
    found.retain(|path| {
        // The user's own folder, which only the user can have written there.
        let path = path.get_value().to_str();
        path.is_some_and(|path| is_plain(path.strip_prefix("~/").unwrap_or(path)))
    });
    found
}

fn candidates(find: fn(Line) -> Option<Vec<CompletionCandidate>>) -> ArgValueCandidates {
    ArgValueCandidates::new(move || in_time(move || find(Line::of_the_shell())))
}

/// What is found in time, nothing otherwise.
fn in_time(
    find: impl FnOnce() -> Option<Vec<CompletionCandidate>> + Send + 'static,
) -> Vec<CompletionCandidate> {
    let (sender, receiver) = mpsc::channel();
    let found = thread::Builder::new()
        .spawn(move || sender.send(find()))
        .ok()
        .and_then(|_| receiver.recv_timeout(TIMEOUT).ok());
    found.flatten().unwrap_or_default()
}

/// What of a command line decides what can be completed in it.
#[derive(Debug, Default, PartialEq)]
struct Line {
    /// The command's first argument that belongs to no option.
    first: Option<OsString>,
    profile: Option<String>,
    run: Option<OsString>,
}

impl Line {
    fn of_the_shell() -> Self {
        Self::of(env::args_os().skip_while(|word| word != "--").skip(1))
    }

    /// Of its words, the program's name first. clap's own parser ends at the first mistake, and an unfinished line is full of
    /// them.
    fn of(words: impl Iterator<Item = OsString>) -> Self {
        let mut line = Self::default();
        // bash makes three words of `--profile=quick`.
        let mut words = words.skip(1).filter(|word| word != "=");
        let Some(program) = COMMAND_LINE.get().map(|define| define()) else {
            return line;
        };
        let Some(command) = words.next().and_then(|name| program.find_subcommand(name)) else {
            return line;
        };
        while let Some(word) = words.next() {
            let Some(option) = word.to_str().filter(|word| word.starts_with('-')) else {
                line.first.get_or_insert(word);
                continue;
            };
            let option = option.trim_start_matches('-');
            let (name, value) = match option.split_once('=') {
                Some((name, value)) => (name, Some(OsString::from(value))),
                None => (option, None),
            };
            let takes_value = command.get_arguments().any(|argument| {
                let former = argument.get_all_aliases().unwrap_or_default();
                (argument.get_long() == Some(name) || former.contains(&name))
                    && argument.get_action().takes_values()
            });
            let value = match takes_value {
                true => value.or_else(|| words.next()),
                false => None,
            };
            match name {
                "profile" => line.profile = value.and_then(|value| value.into_string().ok()),
                "run" => line.run = value,
                _ => {}
            }
        }
        line
    }

    fn file(&self) -> &Path {
        self.first.as_ref().map_or(Path::new(FILE), Path::new)
    }
}

fn profiles_of_file(line: &Line) -> Option<Vec<CompletionCandidate>> {
    let file = MatrixFile::read(line.file(), None, Catalogue::default()).ok()?;
    let names = file.profiles.into_iter().filter(|name| is_plain(name));
    Some(names.map(CompletionCandidate::new).collect())
}

fn scenarios_planned(line: &Line) -> Option<Vec<CompletionCandidate>> {
    let request = PlanRequest {
        profile: line.profile.as_deref(),
        ..PlanRequest::new(line.file())
    };
    let plan = preparation::prepare_offline(&request, Catalogue::default()).ok()?;
    Some(named(&plan.record.scenarios))
}

fn scenarios_recorded(run: &Path) -> Option<Vec<CompletionCandidate>> {
    let plan: PlanRecord = read_record(&RunDirectory::new(run).plan(), FORMAT).ok()?;
    Some(named(&plan.scenarios))
}

/// Letters and slugs, each described by the other.
fn named(scenarios: &[PlannedScenario]) -> Vec<CompletionCandidate> {
    let names = scenarios.iter().map(|it| (&it.id, &it.slug));
    let names = names.filter(|(letter, slug)| is_plain(letter) && is_plain(slug));
    let candidate = |name: &String, help: &String| CompletionCandidate::new(name).help(Some(help.into()));
    names
        .flat_map(|(letter, slug)| [candidate(letter, slug), candidate(slug, letter)])
        .collect()
}

fn runs_in(folder: &Path, current: &OsStr) -> Vec<CompletionCandidate> {
    let Some(current) = current.to_str() else {
        return Vec::new();
    };
    let fits = |name: &&str| name.starts_with(current) && is_plain(name);
    let runs = newest_first(folder).into_iter().filter(|run| is_run(run));
    runs.filter_map(|run| Some(CompletionCandidate::new(run.to_str().filter(fits)?)))
        .collect()
}

/// Whether it is one word to every shell. The file may be somebody else's, and its names come into the user's command line.
fn is_plain(name: &str) -> bool {
    let plain = |it: char| it.is_ascii_alphanumeric() || "/._-+,@%".contains(it);
    !name.is_empty() && !name.starts_with('-') && name.chars().all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(words: &str) -> Line {
        let _ = COMMAND_LINE.set(<crate::cli::arguments::Arguments as clap::CommandFactory>::command);
        Line::of(words.split(' ').map(OsString::from))
    }

    fn values(found: Option<Vec<CompletionCandidate>>) -> Vec<String> {
        let found = found.unwrap_or_default();
        let value = |it: &CompletionCandidate| it.get_value().to_str().unwrap().to_owned();
        found.iter().map(value).collect()
    }

    #[rstest::rstest]
    #[case::nothing("matrix", None, None)]
    #[case::no_command("matrix nothing my.yaml", None, None)]
    #[case::file_first("matrix run my.yaml --profile quick --only ", Some("my.yaml"), Some("quick"))]
    #[case::file_last(
        "matrix plan --only a --profile quick my.yaml",
        Some("my.yaml"),
        Some("quick")
    )]
    #[case::in_one_word("matrix run --profile=quick my.yaml", Some("my.yaml"), Some("quick"))]
    #[case::in_the_words_of_bash("matrix run --profile = quick my.yaml", Some("my.yaml"), Some("quick"))]
    #[case::value_still_missing("matrix run my.yaml --profile", Some("my.yaml"), None)]
    #[case::former_options("matrix plan --spread 1mm my.yaml", Some("my.yaml"), None)]
    #[case::unknown_options("matrix run -x --y my.yaml", Some("my.yaml"), None)]
    fn an_unfinished_command_line_names_its_file_and_its_profile(
        #[case] words: &str,
        #[case] first: Option<&str>,
        #[case] profile: Option<&str>,
    ) {
        let line = line(words);
        let first = first.map(OsString::from);
        assert_eq!((line.first, line.profile.as_deref()), (first, profile));
    }

    #[test]
    fn the_run_of_a_shell_is_that_of_its_option() {
        let line = line("matrix shell a --run runs/one");
        assert_eq!(line.run.as_deref(), Some(OsStr::new("runs/one")));
    }

    #[test]
    fn a_name_that_a_shell_would_do_something_with_is_not_proposed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("m.yaml");
        let text = "matrix: {}\nprofiles:\n  quick: {}\n  $(reboot): {}\n  two words: {}\n";
        std::fs::write(&file, text).unwrap();
        let line = Line {
            first: Some(file.into_os_string()),
            ..Line::default()
        };
        assert_eq!(values(profiles_of_file(&line)), ["quick"]);
    }

    #[test]
    fn a_path_that_a_shell_would_do_something_with_is_not_proposed_for_any_argument() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "received$(touch${IFS}PWNED)",
            "two words",
            "-rf",
            "a;b",
            "`c`",
            "new\nline",
            "plain",
        ] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
            std::fs::write(folder.path().join(format!("{name}.yaml")), "").unwrap();
        }
        std::fs::create_dir(folder.path().join("it's")).unwrap();
        std::fs::write(folder.path().join("it's/plain"), "").unwrap();
        let command = with_paths(<crate::cli::arguments::Arguments as clap::CommandFactory>::command());
        let of = |it: &clap::Command| it.get_arguments().cloned().collect::<Vec<_>>();
        let arguments = command.get_subcommands().flat_map(of).chain(of(&command));
        let mut paths = 0;
        for argument in arguments.filter(|it| it.get_value_hint() != ValueHint::Unknown) {
            let completer = argument.get::<ArgValueCompleter>().expect("clap completes it");
            let beginning_with = |text: &str| {
                let found = completer.complete(folder.path().join(text).as_os_str());
                let name = |path: &String| {
                    path.trim_start_matches(folder.path().to_str().unwrap())
                        .to_owned()
                };
                values(Some(found)).iter().map(name).collect::<Vec<_>>()
            };
            let all = beginning_with("");
            assert!(all.contains(&"/plain/".to_owned()), "{argument}: {all:?}");
            assert!(all.iter().all(|path| is_plain(path)), "{argument}: {all:?}");
            assert_eq!(beginning_with("it's/"), Vec::<String>::new(), "{argument}");
            paths += 1;
        }
        assert!(paths > 20, "{paths}");
    }

    #[test]
    fn what_is_not_there_or_wrong_completes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let line = |path: &Path| Line {
            first: Some(path.as_os_str().to_owned()),
            ..Line::default()
        };
        let (nothing, wrong) = (folder.path().join("nothing"), folder.path().join("m.yaml"));
        std::fs::write(&wrong, "matirx: [").unwrap();
        for path in [folder.path(), nothing.as_path(), wrong.as_path()] {
            assert_eq!(profiles_of_file(&line(path)), None);
            assert_eq!(scenarios_planned(&line(path)), None);
            assert_eq!(scenarios_recorded(path), None);
        }
        assert!(runs_in(&nothing, OsStr::new("")).is_empty());
    }

    #[test]
    fn what_takes_long_completes_nothing() {
        let found = in_time(|| {
            thread::sleep(4 * TIMEOUT);
            Some(vec![CompletionCandidate::new("late")])
        });
        assert!(found.is_empty(), "{found:?}");
    }

    #[test]
    fn run_directories_come_newest_first_and_other_folders_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        for run in ["20260101-000000-1", "20260102-000000-1", "notes"] {
            std::fs::create_dir(folder.path().join(run)).unwrap();
        }
        for run in ["20260101-000000-1", "20260102-000000-1"] {
            std::fs::write(folder.path().join(run).join("manifest.json"), "{}").unwrap();
        }
        let names = |current: &str| -> Vec<_> {
            let current = folder.path().join(current);
            let found = values(Some(runs_in(folder.path(), current.as_os_str())));
            let name = |run: &String| run.rsplit('/').next().unwrap().to_owned();
            found.iter().map(name).collect()
        };
        assert_eq!(names(""), ["20260102-000000-1", "20260101-000000-1"]);
        assert_eq!(names("20260101"), ["20260101-000000-1"]);
        assert_eq!(names("n"), Vec::<String>::new());
    }
}
