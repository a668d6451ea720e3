//! Programs that tests put in somebody's `PATH`. The function is [`write`].

use std::{
    fs::{self, Permissions},
    os::unix::fs::PermissionsExt as _,
    path::Path,
};

/// Writes a script that anybody may run.
///
/// # Panics
/// When the folder cannot be written.
pub fn write(folder: &Path, name: &str, script: &str) {
    let file = folder.join(name);
    fs::write(&file, script).expect("the folder can be written");
    fs::set_permissions(&file, Permissions::from_mode(0o755)).expect("the file is ours");
}
