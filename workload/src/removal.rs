//! Removing what a user's program made, whatever rights it gave its folders. The function is [`remove_all`].

use std::{fs, io, os::unix::fs::PermissionsExt as _, path::Path};

/// Removes a folder with all that is in it. Of a link, the link alone.
///
/// Go's module cache, for one, has folders that nobody may write to: their owner may not remove what is in them, until they are his
/// to write again.
///
/// # Errors
/// What the file system says.
pub fn remove_all(folder: &Path) -> io::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
            open_folders(folder)?;
            fs::remove_dir_all(folder)
        }
        removed => removed,
    }
}

/// Has the owner of the folders below that one, and of itself, write and enter them. Links are not followed.
fn open_folders(top: &Path) -> io::Result<()> {
    const OWNERS: u32 = 0o700;
    let mut folders = vec![top.to_owned()];
    while let Some(folder) = folders.pop() {
        let metadata = fs::symlink_metadata(&folder)?;
        if metadata.is_dir() && metadata.permissions().mode() & OWNERS != OWNERS {
            let mode = metadata.permissions().mode() | OWNERS;
            fs::set_permissions(&folder, fs::Permissions::from_mode(mode))?;
        }
        for entry in fs::read_dir(&folder)? {
            let entry = entry?;
            if entry.file_type()?.is_dir() {
                folders.push(entry.path());
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_that_may_not_be_written_to_are_removed_and_what_a_link_leads_to_stays() {
        let place = tempfile::tempdir().unwrap();
        let (kept, doomed) = (place.path().join("kept"), place.path().join("doomed"));
        fs::create_dir_all(doomed.join("a/b")).unwrap();
        fs::create_dir(&kept).unwrap();
        fs::write(doomed.join("a/b/file"), "x").unwrap();
        std::os::unix::fs::symlink(&kept, doomed.join("a/link")).unwrap();
        for folder in ["a/b", "a"] {
            fs::set_permissions(doomed.join(folder), fs::Permissions::from_mode(0o555)).unwrap();
        }
        // Root may do it either way; what it takes for others is tried on its own.
        open_folders(&doomed).unwrap();
        assert_eq!(
            fs::metadata(doomed.join("a/b")).unwrap().permissions().mode() & 0o777,
            0o755
        );
        remove_all(&doomed).unwrap();
        assert!(!doomed.exists() && kept.exists());
    }
}
