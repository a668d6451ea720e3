//! Files of platforms that simulated scenarios are on: `SLUG.yaml` of a folder. The main types are [`PlatformFiles`] and
//! [`PlatformReader`].
//!
//! The folder may be somebody else's: only the files of scenarios are read, none through a link, and all of them together are bounded.

use std::{
    fs, io,
    path::{Component, Path, PathBuf},
    sync::Arc,
};

use record::{
    causes::with_causes,
    platform_model::PlatformModel,
    run_directory::{Kind, Place},
};

use super::{
    decode,
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span},
    typing, yaml,
};

/// How the name of a file ends.
const EXTENSION: &str = "yaml";
/// A file is no longer: the longest distribution has some 20 kB.
const LONGEST: u64 = 256 << 10;
/// All of a plan's are no longer: a thousand scenarios with four distributions of some hundred quantiles each have 10 MB.
const LONGEST_TOGETHER: u64 = 16 << 20;
/// The option that names a folder.
const OPTION: &str = "--platforms";

/// The files of a folder.
#[derive(Debug, Clone, PartialEq)]
pub struct PlatformFiles {
    folder: Place,
    named: Named,
}

/// Where a person named the folder.
#[derive(Debug, Clone, PartialEq)]
struct Named {
    source: Arc<Source>,
    span: Span,
}

impl Named {
    fn error(&self, message: impl Into<String>) -> Diagnostic {
        Diagnostic::error(&self.source, Code::InvalidValue, self.span, message)
    }
}

impl PlatformFiles {
    /// Those of a folder below the folder of a matrix file, which names it at a place of its text.
    ///
    /// # Errors
    /// When there is no such folder, or a link is on the way to it.
    pub(super) fn below(
        above: &Path,
        folder: &Path,
        source: &Arc<Source>,
        span: Span,
    ) -> Result<Self, Diagnostics> {
        let named = Named {
            source: Arc::clone(source),
            span,
        };
        let path = way_down(folder).ok_or_else(|| outside(source, span, folder))?;
        let place = Place::root(above).join(&path);
        let what = match place.kind() {
            // The matrix file's folder itself.
            _ if path.as_os_str().is_empty() => None,
            Ok(Some(Kind::Folder)) => None,
            Ok(Some(Kind::File)) => Some("is a file, and not a folder".to_owned()),
            Ok(Some(Kind::Other)) => Some("is a link, and not a folder".to_owned()),
            Ok(None) => Some("is not beside the matrix file".to_owned()),
            Err(error) => Some(format!("cannot be entered: {}", with_causes(&error))),
        };
        match what {
            None => Ok(Self { folder: place, named }),
            Some(what) => Err(named
                .error(format!("`{}` {what}", folder.display()))
                .help("name a folder by its path from the matrix file, without links on the way")
                .into()),
        }
    }

    /// Those of a folder that a person named on the command line, wherever it is.
    ///
    /// # Errors
    /// When there is no such folder.
    pub(super) fn named_by_option(folder: &Path) -> Result<Self, Diagnostics> {
        let files = Self {
            folder: Place::root(folder),
            named: option(folder),
        };
        let what = match fs::metadata(folder) {
            Ok(about) if about.is_dir() => return Ok(files),
            Ok(_) => "it is no folder".to_owned(),
            Err(error) => with_causes(&error),
        };
        let message = format!("cannot read `{}`: {what}", folder.display());
        let error = files.named.error(message);
        Err(error.help("name a folder that `matrix fit` wrote").into())
    }

    /// That a folder was named and no scenario is computed, so that none is on a platform of it.
    #[must_use]
    pub(crate) fn in_vain(folder: &Path) -> Diagnostics {
        let error = option(folder).error("no scenario is computed, so none is on a platform of a file");
        error
            .help("add `--simulated`, which computes all scenarios, or leave `--platforms` out")
            .into()
    }

    /// Reads them for the scenarios of one plan.
    #[must_use]
    pub const fn reader(&self) -> PlatformReader<'_> {
        PlatformReader {
            files: self,
            left: LONGEST_TOGETHER,
        }
    }
}

/// What is wrong with a folder that a matrix file names: one below its own is right, as the files of an experiment are.
pub(super) fn problem(source: &Arc<Source>, span: Span, folder: &Path) -> Option<Diagnostic> {
    way_down(folder).is_none().then(|| outside(source, span, folder))
}

fn outside(source: &Arc<Source>, span: Span, folder: &Path) -> Diagnostic {
    let message = format!(
        "`{}` is not below the folder of the matrix file",
        folder.display()
    );
    Diagnostic::error(source, Code::InvalidValue, span, message)
        .help("copy or move it there and name it by its path from there, or name it with `--platforms`")
}

/// A path without what leads up or to another root; none of one that has that.
fn way_down(path: &Path) -> Option<PathBuf> {
    path.components()
        .filter(|part| *part != Component::CurDir)
        .map(|part| match part {
            Component::Normal(name) => Some(name),
            _ => None,
        })
        .collect()
}

fn option(folder: &Path) -> Named {
    let folder = folder.display().to_string();
    Named {
        span: Span {
            start: 0,
            end: folder.len(),
        },
        source: Arc::new(Source::new(OPTION, folder)),
    }
}

/// Reads files of platforms, no more than anybody needs.
#[derive(Debug)]
pub struct PlatformReader<'a> {
    files: &'a PlatformFiles,
    /// So many bytes more are read.
    left: u64,
}

impl PlatformReader<'_> {
    /// The platform of a scenario.
    ///
    /// # Errors
    /// When there is no file for it, and all that is wrong with the file, at its place in the file.
    pub fn read(&mut self, slug: &str) -> Result<PlatformModel, Diagnostics> {
        let named = &self.files.named;
        let place = self.files.folder.join(format!("{slug}.{EXTENSION}"));
        let name = place.to_string();
        let bytes = place
            .read(LONGEST)
            .map_err(|error| unreadable(named, slug, &name, &error))?;
        self.left = self.left.checked_sub(bytes.len() as u64).ok_or_else(|| {
            let most = LONGEST_TOGETHER >> 20;
            let message = format!("the files of the platforms are longer than {most} MiB together");
            let error = named.error(message);
            error.help("describe each distribution by fewer quantiles: a hundred are plenty")
        })?;
        platform(&name, &bytes)
    }
}

/// The platform that a file with this name and these bytes describes.
pub(crate) fn platform(name: &str, bytes: &[u8]) -> Result<PlatformModel, Diagnostics> {
    let source = Arc::new(decode(name, bytes)?);
    let tree = yaml::parse(&source).map_err(say_what_nothing_is)?;
    let model: PlatformModel = typing::read(&source, &tree)?;
    let mut found = Diagnostics::new();
    for (path, what, hint) in model.problems() {
        let span = tree.locate(path).unwrap_or(tree.span);
        let error = Diagnostic::error(&source, Code::InvalidValue, span, format!("`{path}`: {what}"));
        found.push(error.help(hint));
    }
    found.unless_errors(model).map(|(model, _)| model)
}

fn unreadable(named: &Named, slug: &str, name: &str, error: &io::Error) -> Diagnostics {
    let (message, help) = match error.kind() {
        io::ErrorKind::NotFound => (
            format!("there is no platform for `{slug}`: {name}"),
            "write the file, or `{}` into it for the ideal platform",
        ),
        io::ErrorKind::FileTooLarge => (
            format!("{name} is longer than {} KiB", LONGEST >> 10),
            "describe each distribution by fewer quantiles: a hundred are plenty",
        ),
        _ => (
            format!("cannot read {name}: {}", with_causes(error)),
            "put a regular file there that you may read",
        ),
    };
    named.error(message).help(help).into()
}

/// A file with nothing in it was seldom meant as a platform, and has no `matrix:` to begin with.
fn say_what_nothing_is(found: Diagnostics) -> Diagnostics {
    let mut said = Diagnostics::new();
    for diagnostic in found {
        said.push(match diagnostic.code {
            Code::Empty => {
                diagnostic.help("write `{}` for the ideal platform, or figures as in docs/twin.md")
            }
            _ => diagnostic,
        });
    }
    said
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use rstest::rstest;
    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    fn read(folder: &Path, slug: &str) -> Result<PlatformModel, String> {
        let files = PlatformFiles::named_by_option(folder).map_err(|found| told(&found))?;
        files.reader().read(slug).map_err(|found| told(&found))
    }

    fn told(found: &Diagnostics) -> String {
        found.render(&annotate_snippets::Renderer::plain())
    }

    fn below(above: &Path, folder: &str) -> Result<PlatformFiles, String> {
        let source = Arc::new(Source::new("m.yaml", folder));
        PlatformFiles::below(above, Path::new(folder), &source, Span::default()).map_err(|found| told(&found))
    }

    #[test]
    fn a_file_is_of_the_scenario_that_its_name_says() {
        let folder = folder(&[
            (
                "docker.yaml",
                "about: fitted\nstack: 90us\nplant: {late: [[0, 1us], [1, 2ms]]}\n",
            ),
            ("ideal.yaml", "{}"),
        ]);
        assert_eq!(read(folder.path(), "docker").unwrap().stack.to_string(), "90us");
        assert_eq!(read(folder.path(), "ideal"), Ok(PlatformModel::default()));
        let told = read(folder.path(), "native").unwrap_err();
        assert!(
            told.contains("no platform for `native`") && told.contains("native.yaml"),
            "{told}"
        );
    }

    #[rstest]
    #[case(
        "stack: 3us\nlatness: 3ms",
        "docker.yaml:2:1",
        "there is no key `latness` here"
    )]
    #[case("controller: {lat: []}", "docker.yaml:1:14", "did you mean `late`?")]
    #[case("stack: 3", "docker.yaml:1:8", "has no unit")]
    #[case("stack: [", "docker.yaml:1:", "not-yaml")]
    #[case("", "docker.yaml:1:1", "write `{}` for the ideal platform")]
    #[case("# later\n", "docker.yaml:1:1", "there is nothing in the file")]
    #[case("just words", "docker.yaml:1:1", "keys with values belong here")]
    #[case("stack: 1us\nstack: 2us", "docker.yaml:2:1", "twice")]
    #[case(
        "reading: [3us]",
        "docker.yaml:1:11",
        "a pair of a probability and a time, such as `[0.5, 60us]` belongs here, not the text `3us`"
    )]
    #[case(
        "reading: [[0.5]]",
        "docker.yaml:1:11",
        "write a pair of a probability and a time"
    )]
    #[case(
        "reading: [[0, 3us], [1, 1us]]",
        "docker.yaml:1:1",
        "the quantiles do not ascend"
    )]
    #[case(
        "reading: [[.nan, 3us], [1, 4us]]",
        "docker.yaml:1:1",
        "NaN is no probability"
    )]
    #[case(
        "stack: 1us\nstalls: {per_hour: .inf, length: [[0, 1ms], [1, 1ms]]}",
        "docker.yaml:2:20",
        "stand still inf times an hour"
    )]
    fn a_mistake_is_told_with_its_place_in_the_file(
        #[case] text: &str,
        #[case] place: &str,
        #[case] words: &str,
    ) {
        let folder = folder(&[("docker.yaml", text)]);
        let told = read(folder.path(), "docker").unwrap_err();
        assert!(told.contains(place) && told.contains(words), "{told}");
        assert!(!told.contains("struct") && !told.contains("tuple"), "{told}");
    }

    #[test]
    fn a_file_that_never_ends_and_a_folder_that_is_none_are_errors() {
        let folder = folder(&[("long.yaml", &"#".repeat(300_000))]);
        let told = read(folder.path(), "long").unwrap_err();
        assert!(told.contains("long.yaml is longer than 256 KiB"), "{told}");
        let told = read(&folder.path().join("none"), "long").unwrap_err();
        assert!(
            told.contains("No such file") && told.contains("--platforms"),
            "{told}"
        );
    }

    #[test]
    fn a_file_as_deep_as_no_platform_is_refused() {
        let deep = format!("{}{}", "[".repeat(100), "]".repeat(100));
        let folder = folder(&[("deep.yaml", &deep)]);
        let told = read(folder.path(), "deep").unwrap_err();
        assert!(told.contains("deep.yaml:1:65"), "{told}");
    }

    #[test]
    fn a_fifo_is_not_waited_for() {
        let folder = folder(&[]);
        let fifo = folder.path().join("x.yaml");
        mknodat(CWD, &fifo, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let told = read(folder.path(), "x").unwrap_err();
        assert!(told.contains("a link, a device, a socket or a FIFO"), "{told}");
    }

    #[test]
    fn nothing_is_read_through_a_link_and_nothing_of_it_is_told() {
        let elsewhere = folder(&[("secret", "topsecret"), ("x.yaml", "topsecret")]);
        let folder = folder(&[]);
        symlink(elsewhere.path().join("secret"), folder.path().join("x.yaml")).unwrap();
        let told = read(folder.path(), "x").unwrap_err();
        assert!(told.contains("a link") && !told.contains("topsecret"), "{told}");
        symlink(elsewhere.path(), folder.path().join("away")).unwrap();
        let told = below(folder.path(), "away").unwrap_err();
        assert!(told.contains("`away` is a link"), "{told}");
        assert!(below(folder.path(), "away/further").is_err());
    }

    #[test]
    fn a_matrix_file_names_folders_below_its_own_alone() {
        let folder = folder(&[]);
        fs::create_dir_all(folder.path().join("a/b")).unwrap();
        for path in ["a", "a/b", "./a/", "."] {
            assert!(below(folder.path(), path).is_ok(), "{path}");
        }
        for path in ["..", "a/../..", "/tmp", "a/../a"] {
            let told = below(folder.path(), path).unwrap_err();
            assert!(
                told.contains("is not below the folder of the matrix file"),
                "{told}"
            );
        }
        let told = below(folder.path(), "none").unwrap_err();
        assert!(told.contains("`none` is not beside the matrix file"), "{told}");
    }

    #[test]
    fn files_that_no_scenario_has_are_not_looked_at() {
        let folder = folder(&[("docker.yaml", "{}"), ("other.yaml", "no platform")]);
        assert_eq!(read(folder.path(), "docker"), Ok(PlatformModel::default()));
    }

    #[test]
    fn all_files_together_are_bounded() {
        let long = format!("{{}} #{}", "x".repeat(200_000));
        let folder = folder(&[("docker.yaml", &long)]);
        let files = PlatformFiles::named_by_option(folder.path()).unwrap();
        let mut reader = files.reader();
        let read = (0..100).map(|_| reader.read("docker"));
        let wrong: Vec<_> = read.filter_map(Result::err).collect();
        assert_eq!(wrong.len(), 100 - (16 << 20) / long.len());
        assert!(told(&wrong[0]).contains("longer than 16 MiB together"));
    }
}
