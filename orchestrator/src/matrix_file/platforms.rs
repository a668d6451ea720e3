//! Files of platforms that simulated scenarios are on: `SLUG.yaml` of a folder. The main type is [`PlatformFiles`].

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use record::{platform_model::PlatformModel, run_directory::PlanRecord};

/// How the name of a file ends.
const EXTENSION: &str = "yaml";
/// A file is no longer: the longest distribution has some 20 kB.
const LONGEST: u64 = 256 << 10;

/// The files of a folder.
#[derive(Debug, Clone, PartialEq)]
pub struct PlatformFiles {
    folder: PathBuf,
    models: BTreeMap<String, PlatformModel>,
}

/// A folder of platforms cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlatformFileError {
    /// It cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The folder or file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// There are more than a matrix has scenarios.
    #[error("{} has more than {} files", folder.display(), PlanRecord::MOST_SCENARIOS)]
    Many {
        /// The folder.
        folder: PathBuf,
    },
    /// It is no description of a platform.
    #[error("{} describes no platform", path.display())]
    Form {
        /// The file.
        path: PathBuf,
        /// Where, and what is wrong.
        source: serde_yaml::Error,
    },
    /// A figure is one that no platform has.
    #[error("{}: {field}: {what}", path.display())]
    Figure {
        /// The file.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// What is wrong.
        what: String,
        /// What to write.
        hint: &'static str,
    },
}

impl PlatformFileError {
    /// What to do about it, where something can be said.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Figure { hint, .. } => Some((*hint).to_owned()),
            Self::Form { .. } => Some("docs/twin.md has an example of each field".to_owned()),
            Self::Read { .. } | Self::Many { .. } => None,
        }
    }
}

impl PlatformFiles {
    /// Reads all files of a folder whose names end with `.yaml`.
    ///
    /// # Errors
    /// The first that is no platform.
    pub fn read(folder: &Path) -> Result<Self, PlatformFileError> {
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| PlatformFileError::Read { path, source }
        };
        let mut models = BTreeMap::new();
        for entry in fs::read_dir(folder).map_err(failed(folder))? {
            let path = entry.map_err(failed(folder))?.path();
            let is_one = path.extension().is_some_and(|extension| extension == EXTENSION);
            let Some(slug) = path.file_stem().and_then(|stem| stem.to_str()).filter(|_| is_one) else {
                continue;
            };
            if models.len() == PlanRecord::MOST_SCENARIOS {
                return Err(PlatformFileError::Many {
                    folder: folder.to_owned(),
                });
            }
            models.insert(slug.to_owned(), read(&path)?);
        }
        Ok(Self {
            folder: folder.to_owned(),
            models,
        })
    }

    /// The platform of a scenario.
    #[must_use]
    pub fn of(&self, slug: &str) -> Option<&PlatformModel> {
        self.models.get(slug)
    }

    /// Where the platform of a scenario is, or would be.
    #[must_use]
    pub fn path(&self, slug: &str) -> PathBuf {
        self.folder.join(format!("{slug}.{EXTENSION}"))
    }
}

fn read(path: &Path) -> Result<PlatformModel, PlatformFileError> {
    let failed = |source| PlatformFileError::Read {
        path: path.to_owned(),
        source,
    };
    let file = File::open(path).map_err(failed)?;
    if !file.metadata().map_err(failed)?.is_file() {
        return Err(failed(io::Error::other("it is no file")));
    }
    let mut text = String::new();
    file.take(LONGEST + 1).read_to_string(&mut text).map_err(failed)?;
    if text.len() as u64 > LONGEST {
        return Err(failed(io::Error::other(format!(
            "it has more than {LONGEST} bytes"
        ))));
    }
    let model: PlatformModel = serde_yaml::from_str(&text).map_err(|source| PlatformFileError::Form {
        path: path.to_owned(),
        source,
    })?;
    match model.problems().into_iter().next() {
        None => Ok(model),
        Some((field, what, hint)) => Err(PlatformFileError::Figure {
            path: path.to_owned(),
            field,
            what,
            hint,
        }),
    }
}

#[cfg(test)]
mod tests {
    use record::causes::with_causes;
    use rstest::rstest;

    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    #[test]
    fn a_file_is_of_the_scenario_that_its_name_says() {
        let folder = folder(&[
            (
                "docker.yaml",
                "about: fitted\nstack: 90us\nplant: {late: [[0, 1us], [1, 2ms]]}\n",
            ),
            ("README.md", "no platform"),
        ]);
        let files = PlatformFiles::read(folder.path()).unwrap();
        assert_eq!(files.of("docker").unwrap().stack.to_string(), "90us");
        assert_eq!(files.of("native"), None);
        assert_eq!(files.path("native"), folder.path().join("native.yaml"));
    }

    #[rstest]
    #[case("latness: 3ms", "unknown field `latness`")]
    #[case("stack: 3", "has no unit")]
    #[case("stack: [", "describes no platform")]
    #[case("reading: [[0, 3us], [1, 1us]]", "reading: the quantiles do not ascend")]
    #[case("reading: [[.nan, 3us], [1, 4us]]", "NaN is no probability")]
    #[case(
        "stalls: {per_hour: .inf, length: [[0, 1ms], [1, 1ms]]}",
        "stand still inf times an hour"
    )]
    fn a_file_that_is_no_platform_is_told_with_its_name(#[case] text: &str, #[case] words: &str) {
        let folder = folder(&[("docker.yaml", text)]);
        let error = PlatformFiles::read(folder.path()).unwrap_err();
        let told = with_causes(&error);
        assert!(told.contains("docker.yaml") && told.contains(words), "{told}");
    }

    #[test]
    fn a_file_that_never_ends_and_a_folder_that_is_none_are_errors() {
        let folder = folder(&[("long.yaml", &"#".repeat(300_000))]);
        let told = with_causes(&PlatformFiles::read(folder.path()).unwrap_err());
        assert!(told.ends_with("it has more than 262144 bytes"), "{told}");
        let told = with_causes(&PlatformFiles::read(&folder.path().join("none")).unwrap_err());
        assert!(told.contains("No such file"), "{told}");
    }
}
