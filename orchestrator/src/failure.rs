//! What errors of every kind have in common: a cause, and what to do about a file.

use std::{error::Error, io};

use record::limits;

/// The cause of an error, of whichever library it comes from.
pub type Cause = Box<dyn Error + Send + Sync + 'static>;

/// What to do about a file that cannot be read or written.
pub fn file_hint(error: &io::Error) -> Option<String> {
    if let Some(hint) = limits::room_hint(error) {
        return Some(format!("{hint}, then `matrix resume`"));
    }
    match error.kind() {
        io::ErrorKind::PermissionDenied => Some("check who owns it, or choose another directory".to_owned()),
        io::ErrorKind::ReadOnlyFilesystem => {
            Some("choose a directory on a disk that can be written".to_owned())
        }
        _ => None,
    }
}
