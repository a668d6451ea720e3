//! The text of a file that a person wrote, within the limits of a matrix file.

use std::{
    fs::{File, OpenOptions},
    io::{self, Read},
    os::unix::fs::OpenOptionsExt as _,
    path::Path,
    sync::Arc,
};

use record::run_directory::Place;
use rustix::fs::OFlags;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span},
    yaml,
};

pub(super) fn unreadable(name: &str, error: &io::Error) -> Diagnostics {
    let help = match error.kind() {
        io::ErrorKind::NotFound => "check the name; `matrix.yaml` of this project is one to begin with",
        io::ErrorKind::IsADirectory => "name the file in it",
        io::ErrorKind::InvalidInput => "write what it gives to a file, and name that",
        _ => "check who may read it",
    };
    // There is no text to show: the name is what was written wrong.
    let source = Arc::new(Source::new("FILE", name));
    let span = Span {
        start: 0,
        end: name.len(),
    };
    Diagnostic::error(
        &source,
        Code::Unreadable,
        span,
        format!("cannot read `{name}`: {error}"),
    )
    .help(help)
    .into()
}

/// The text of another YAML file that a person wrote, within the limits of a matrix file: its length, its nesting, its nodes.
///
/// # Errors
/// When it cannot be read, is longer or deeper, or is no YAML.
pub fn text_within_limits(path: &Path) -> Result<String, Diagnostics> {
    let name = path.display().to_string();
    within_limits(&name, &beginning_of(open(path), &name)?)
}

/// The same of a file that anybody may have put there.
///
/// # Errors
/// As [`text_within_limits`], and when it is a link.
pub(crate) fn text_at(place: &Place) -> Result<String, Diagnostics> {
    let name = place.to_string();
    within_limits(&name, &beginning_of(place.open(), &name)?)
}

/// Opens a file that a person named, who may name a link. A FIFO that nobody writes to would be waited for.
pub(super) fn open(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(OFlags::NONBLOCK.bits() as i32)
        .open(path)?;
    let kind = file.metadata()?.file_type();
    // To read a folder is an error that says so.
    match kind.is_file() || kind.is_dir() {
        true => Ok(file),
        false => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "it is a device, a socket or a FIFO, and not a regular file",
        )),
    }
}

/// The text of these bytes, within the same limits.
///
/// # Errors
/// As [`text_within_limits`].
pub(crate) fn within_limits(name: &str, bytes: &[u8]) -> Result<String, Diagnostics> {
    let source = Arc::new(decode(name, bytes)?);
    yaml::parse(&source)?;
    Ok(source.text().to_owned())
}

/// One byte more of a file than is allowed, so that one that is too large is seen to be, whatever its size.
pub(super) fn beginning_of(file: io::Result<File>, name: &str) -> Result<Vec<u8>, Diagnostics> {
    let limit = u64::try_from(yaml::BYTES + 1).unwrap_or(u64::MAX);
    let mut bytes = Vec::new();
    file.and_then(|file| file.take(limit).read_to_end(&mut bytes))
        .map_err(|error| unreadable(name, &error))?;
    Ok(bytes)
}

pub(super) fn decode(name: &str, bytes: &[u8]) -> Result<Source, Diagnostics> {
    if bytes.len() > yaml::BYTES {
        let beginning = String::from_utf8_lossy(bytes.get(..80).unwrap_or_default()).into_owned();
        let source = Arc::new(Source::new(name, beginning));
        let message = format!("the file is larger than {} KiB", yaml::BYTES / 1024);
        return Err(
            Diagnostic::error(&source, Code::TooLarge, Span { start: 0, end: 1 }, message)
                .help("a matrix file of a thousand scenarios has some 50 KiB; is this one?")
                .into(),
        );
    }
    match std::str::from_utf8(bytes) {
        // A byte order mark is legal, and would shift every column.
        Ok(text) => Ok(Source::new(name, text.strip_prefix('\u{feff}').unwrap_or(text))),
        Err(error) => {
            let start = error.valid_up_to();
            let source = Arc::new(Source::new(name, String::from_utf8_lossy(bytes)));
            let span = Span {
                start,
                end: start + '\u{fffd}'.len_utf8(),
            };
            Err(
                Diagnostic::error(&source, Code::NotUtf8, span, "the file is not text in UTF-8")
                    .label("not UTF-8 from here")
                    .help("save it as UTF-8; `iconv -f latin1 -t utf8` converts an old one")
                    .into(),
            )
        }
    }
}
