//! Reading the files of a run directory, with errors that say which file, where in it, and what to do. The main type
//! is [`ReadError`].

use std::{io, path::PathBuf};

use serde::{Deserialize, de::DeserializeOwned};
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::{EnvironmentRecord, FORMAT, Manifest, Place, PlanRecord, log::LogError};
use crate::{
    escaping::{is_unseen, visible},
    layout,
    window::{Impossible, WindowRecord},
};

/// Why a run directory cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// Nothing is there.
    #[error("there is no run directory at {}", path.display())]
    NotFound {
        /// Where.
        path: PathBuf,
    },
    /// It is something else: a file, or a folder without a manifest.
    #[error("{} is not a run directory: {why}", path.display())]
    NotARunDirectory {
        /// Where.
        path: PathBuf,
        /// How it can be told.
        why: &'static str,
    },
    /// One of the files that are written before the first measurement is missing.
    #[error("the run directory is half-written: {} is missing", path.display())]
    HalfWritten {
        /// The file.
        path: PathBuf,
    },
    /// `matrix prune` removed what was measured.
    #[error("{} was pruned: its logs and captures are gone", path.display())]
    Pruned {
        /// The run directory.
        path: PathBuf,
    },
    /// Written by a newer version.
    #[error("{} has format {found}, and this version of matrix knows formats up to {known}", path.display())]
    FutureFormat {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: u64,
        /// The newest one that is known.
        known: u32,
    },
    /// Not the JSON that belongs there.
    #[error("{} cannot be understood", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What and where.
        source: serde_json::Error,
    },
    /// Not as it was written.
    #[error("{} is damaged: {how}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// By what it is known.
        how: String,
    },
    /// JSON with a number that nothing has.
    #[error("{} cannot be what matrix wrote", path.display())]
    Impossible {
        /// The file.
        path: PathBuf,
        /// What no run of `matrix` has.
        source: Impossible,
    },
    /// A line in the midst of the journal that is no event.
    #[error("line {line} of {} is not an event", path.display())]
    Journal {
        /// The journal.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        source: serde_json::Error,
    },
    /// The log of a window that counts.
    #[error("{} cannot be used", path.display())]
    Log {
        /// The log.
        path: PathBuf,
        /// What is wrong, and where.
        source: LogError,
    },
    /// A window without the log that the error is asked of.
    #[error("there is no {}, so the true error is not known", path.display())]
    NoTruth {
        /// The log that is not there.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("{} cannot be read", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl ReadError {
    pub(super) fn io(place: &Place, source: io::Error) -> Self {
        let path = place.path();
        match source.kind() {
            io::ErrorKind::NotFound => Self::HalfWritten { path },
            _ => Self::Io { path, source },
        }
    }

    pub(super) fn impossible(place: &Place, source: Impossible) -> Self {
        let path = place.path();
        Self::Impossible { path, source }
    }

    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::NotFound { .. } => {
                "give the folder that `matrix run` printed, such as `runs/2026-11-21T04-00-00Z`".into()
            }
            Self::NotARunDirectory { .. } => {
                "give the folder that has manifest.json, plan.json and events.jsonl in it".into()
            }
            Self::HalfWritten { .. } => {
                "nothing had been measured when it was left: start again with `matrix run`, and delete it"
                    .into()
            }
            Self::Pruned { .. } => {
                "its records and its report, `report/report.html`, are as they were, and `matrix drift` goes on using its night; for more, restore the run from a copy"
                    .into()
            }
            Self::FutureFormat { .. } => "use the version of matrix that wrote it, or a later one".into(),
            Self::Json { .. } => {
                "matrix writes this file whole: restore it from a copy, or measure again with `matrix run`"
                    .into()
            }
            Self::Damaged { .. } => {
                "it was changed after matrix wrote it, by a person or by the disk: restore it from a copy".into()
            }
            Self::Impossible { .. } => {
                "a host wrote it so, or it was changed since: restore it from a copy; of a window, move its folder away, and the report counts it as missing"
                    .into()
            }
            Self::Journal { line, .. } => format!(
                "only a line that a crash cut may be unreadable, and this is none: restore line {line} from a copy"
            ),
            Self::Log { source, .. } => source.hint(),
            Self::NoTruth { .. } => {
                "report the error that the controller saw, with `--error received`: this run was measured before the plant kept a log"
                    .into()
            }
            Self::Io { .. } => "see that the file is there and that you may read it".into(),
        }
    }
}

/// The plan of a thousand scenarios, which is the longest of the records, is a third of it.
pub const LONGEST_RECORD: u64 = 16 << 20;

/// What a record has at most: bytes, and values as [`values_in`] counts them. A value of any kind takes up to 256 bytes of memory,
/// and as little as two in a file.
#[derive(Debug, Clone, Copy)]
struct Most {
    bytes: u64,
    values: usize,
}

impl Most {
    /// A plan of a thousand scenarios has 180,000 values, and one more for each environment beyond the first of a scenario.
    const RECORD: Self = Self {
        bytes: LONGEST_RECORD,
        values: 400_000,
    };
    /// That of two scenarios has 83; each host has a dozen.
    const MANIFEST: Self = Self {
        bytes: LONGEST_RECORD,
        values: 1 << 17,
    };
    /// One has 140 to 230 in 5 kB, and a run has a thousand of them in memory.
    const ENVIRONMENT: Self = Self {
        bytes: 64 << 10,
        values: 3 << 8,
    };
    /// One has 180.
    const WINDOW: Self = Self {
        bytes: WindowRecord::MOST_BYTES,
        values: 1 << 12,
    };
}

/// How many values a JSON text has, at most: one for each comma, and two for each beginning of a list or an object, which take more
/// memory. Nothing is kept meanwhile.
#[must_use]
pub fn values_in(json: &[u8]) -> usize {
    let (mut values, mut in_string, mut escaped) = (0, false, false);
    for byte in json {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = in_string,
            b'"' => in_string = !in_string,
            b',' if !in_string => values += 1,
            b'[' | b'{' if !in_string => values += 2,
            _ => {}
        }
    }
    values
}

/// Reads one of the files that every run directory has, of at most so many bytes.
///
/// # Errors
/// When it is not there, is longer, or cannot be read.
pub fn read_file(place: &Place, most_bytes: u64) -> Result<Vec<u8>, ReadError> {
    place
        .read(most_bytes)
        .map_err(|source| ReadError::io(place, source))
}

/// Reads one of the files that carry a `format`.
///
/// # Errors
/// When it cannot be read, is not what it should be, or is of a later format than the `known` one.
pub fn read_record<T: DeserializeOwned>(place: &Place, known: u32) -> Result<T, ReadError> {
    read_record_of(place, known, Most::RECORD, std::iter::empty())
}

/// Reads the plan, which has this SHA-256 where it is known.
///
/// # Errors
/// As [`read_record`], and when it is another.
pub(super) fn read_plan(place: &Place, sha256: Option<&str>) -> Result<PlanRecord, ReadError> {
    checked(
        place,
        read_record_of(place, FORMAT, Most::RECORD, sha256.into_iter())?,
        PlanRecord::check,
    )
}

/// Reads the manifest, which has this SHA-256 where it is known.
///
/// # Errors
/// As [`read_record`], and when it is another.
pub(super) fn read_manifest(place: &Place, sha256: Option<&str>) -> Result<Manifest, ReadError> {
    checked(
        place,
        read_record_of(place, FORMAT, Most::MANIFEST, sha256.into_iter())?,
        Manifest::check,
    )
}

fn checked<T>(place: &Place, record: T, check: fn(&T) -> Result<(), Impossible>) -> Result<T, ReadError> {
    match check(&record) {
        Ok(()) => Ok(record),
        Err(source) => Err(ReadError::impossible(place, source)),
    }
}

/// What a scenario's platform was. The file has one of these SHA-256, if there are any.
///
/// # Errors
/// As [`read_record`], and when it is another.
pub fn read_environment<'a>(
    place: &Place,
    sha256: impl Iterator<Item = &'a str> + Clone,
) -> Result<EnvironmentRecord, ReadError> {
    read_record_of(place, FORMAT, Most::ENVIRONMENT, sha256)
}

fn read_record_of<'a, T: DeserializeOwned>(
    place: &Place,
    known: u32,
    most: Most,
    mut sha256: impl Iterator<Item = &'a str> + Clone,
) -> Result<T, ReadError> {
    #[derive(Deserialize)]
    struct Versioned {
        format: Option<u64>,
    }
    let text = read_file(place, most.bytes)?;
    if sha256.clone().next().is_some() {
        let found = format!("{:x}", Sha256::digest(&text));
        if !sha256.any(|sha256| sha256 == found) {
            return Err(ReadError::Damaged {
                path: place.path(),
                how: "its SHA-256 is not the one that events.jsonl has of it".to_owned(),
            });
        }
    }
    // The format first: what else a later version changed must not be reported as damage.
    let json = |source| ReadError::Json {
        path: place.path(),
        source,
    };
    let Versioned { format } = serde_json::from_slice(&text).map_err(json)?;
    let values = values_in(&text);
    match format {
        Some(found) if found > u64::from(known) => Err(ReadError::FutureFormat {
            path: place.path(),
            found,
            known,
        }),
        _ if values > most.values => Err(ReadError::impossible(place, Impossible::count("values", values))),
        _ => from_json(&text).map_err(json),
    }
}

/// A record as readers may be shown it, in whichever medium: what they would not see in its texts is spelt out. The matrix file's text stays
/// as it is, since it has a checksum of its own.
///
/// # Errors
/// When it is not the JSON of such a record.
pub fn from_json<T: DeserializeOwned>(text: &[u8]) -> serde_json::Result<T> {
    // JSON has no control characters but between values; in a text they are escaped.
    let has_escapes = text
        .windows(2)
        .any(|two| matches!(two, [b'\\', b'u' | b'b' | b'f' | b'r']));
    let is_plain = |it: char| it.is_control() || !is_unseen(it);
    if !has_escapes && std::str::from_utf8(text).is_ok_and(|text| text.chars().all(is_plain)) {
        return serde_json::from_slice(text);
    }
    serde_json::from_value(shown(serde_json::from_slice(text)?))
}

fn shown(value: Value) -> Value {
    match value {
        Value::String(text) => Value::String(visible(&text)),
        Value::Array(values) => values.into_iter().map(shown).collect(),
        Value::Object(fields) => {
            let field = |(name, value): (String, Value)| {
                let value = if name == crate::field!(Manifest, matrix_text) {
                    value
                } else {
                    shown(value)
                };
                (visible(&name), value)
            };
            Value::Object(fields.into_iter().map(field).collect())
        }
        plain => plain,
    }
}

/// Reads the `window.json` of a window's folder, which has this SHA-256 where it is known.
///
/// # Errors
/// As [`read_record`], when it is another, and when it says what no window can be.
pub fn read_window(folder: &Place, sha256: Option<&str>) -> Result<WindowRecord, ReadError> {
    let place = folder.join(layout::WINDOW);
    let sums = sha256.into_iter();
    let record = read_record_of(&place, crate::FORMAT, Most::WINDOW, sums)?;
    checked(&place, record, WindowRecord::check)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use rstest::rstest;
    use serde_json::{Map, Value};

    use super::*;

    #[rstest]
    #[case("", 0)]
    #[case("{}", 2)]
    #[case(r#"{"a":1,"b":[1,2]}"#, 6)]
    #[case(r#"[{"":0},{"":0}]"#, 7)]
    #[case(r#"{"a,[{":"\\\"[,{","b":"\\"}"#, 3)]
    fn values_are_counted_outside_of_strings(#[case] json: &str, #[case] values: usize) {
        assert_eq!(values_in(json.as_bytes()), values);
    }

    fn fixture(name: &str) -> Vec<u8> {
        let recorded = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/recorded/");
        fs::read(format!("{recorded}{name}")).unwrap()
    }

    const SCENARIO: &str = "scenarios/x86-64-debian-12-docker/";

    #[test]
    fn what_a_reader_would_not_see_in_a_record_is_spelt_out() {
        let read = |text: &str| from_json::<Value>(text.as_bytes()).unwrap();
        assert_eq!(
            read(r#"{"a\u202eb": ["\u001b[2J", "one\ntwo", "µ"], "matrix_text": "a\r\n"}"#),
            serde_json::json!({"a\\u{202e}b": ["\\u{1b}[2J", "one\ntwo", "µ"], "matrix_text": "a\r\n"})
        );
        assert_eq!(read("[\"a\u{202e}\"]"), serde_json::json!(["a\\u{202e}"]));
    }

    #[test]
    fn a_real_record_has_a_small_part_of_the_values_that_it_may_have() {
        let values = |name: &str| values_in(&fixture(name));
        assert!(4 * values(&format!("{SCENARIO}environment.json")) < Most::ENVIRONMENT.values);
        assert!(10 * values(&format!("{SCENARIO}window-1/window.json")) < Most::WINDOW.values);
        assert!(100 * values("manifest.json") < Most::MANIFEST.values);
        // Of two scenarios: a thousand are five hundred times as many.
        assert!(2 * 500 * values("plan.json") < Most::RECORD.values);
    }

    /// A record with so many small objects somewhere in it.
    fn with_many(name: &str, pointer: &str, count: usize) -> (tempfile::TempDir, Place) {
        let mut document: Value = serde_json::from_slice(&fixture(name)).unwrap();
        let small = Value::Object(Map::from_iter([(String::new(), 0.into())]));
        document.pointer_mut(pointer).unwrap()["zz"] = vec![small; count].into();
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join(name.rsplit('/').next().unwrap());
        fs::write(place.path(), document.to_string()).unwrap();
        (folder, place)
    }

    #[rstest]
    #[case::plan("plan.json", "/scenarios/0/axes", 1 << 18)]
    #[case::manifest("manifest.json", "/providers", 1 << 18)]
    #[case::environment("environment.json", "/facts", 1 << 11)]
    fn a_record_with_more_values_than_any_real_one_is_refused(
        #[case] name: &str,
        #[case] pointer: &str,
        #[case] count: usize,
    ) {
        let read = |place: &Place| match name {
            "plan.json" => read_plan(place, None).map(drop),
            "manifest.json" => read_manifest(place, None).map(drop),
            _ => read_environment(place, std::iter::empty()).map(drop),
        };
        let path = match name {
            "environment.json" => format!("{SCENARIO}{name}"),
            name => name.to_owned(),
        };
        let (_folder, place) = with_many(&path, pointer, 3);
        read(&place).unwrap();
        let (_folder, place) = with_many(&path, pointer, count);
        let error = read(&place).unwrap_err();
        assert!(
            crate::causes::with_causes(&error).contains("`values` is"),
            "{error:?}"
        );
    }

    #[rstest]
    #[case::many("reasons", Value::from(vec![""; 200]))]
    #[case::very_many("reasons", Value::from(vec![""; 300_000]))]
    #[case::long("reasons", Value::from(vec!["x".repeat(100_000)]))]
    #[case::many_notices("notices", serde_json::json!({"count": 1, "first": vec![""; 100]}))]
    fn a_window_that_says_more_than_any_real_one_is_refused(#[case] field: &str, #[case] said: Value) {
        let mut record: Value =
            serde_json::from_slice(&fixture(&format!("{SCENARIO}window-1/window.json"))).unwrap();
        record[field] = said;
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(layout::WINDOW), record.to_string()).unwrap();
        let error = read_window(&Place::root(folder.path()), None).unwrap_err();
        assert!(matches!(error, ReadError::Impossible { .. }), "{error:?}");
    }
}
