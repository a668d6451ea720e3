//! Images whose workload was looked at: an image's ID is the digest of all that is in it, so that one look at each is enough. To read
//! the workload out of a container takes half as long as the container's start. The main type is [`KnownImages`].

use std::{fs, io, path::PathBuf};

use crate::state_directory::StateDirectory;

/// A file for each image, named by its ID, with the SHA-256 of the workload in it.
pub struct KnownImages(PathBuf);

impl KnownImages {
    /// Those in a state folder, which only its user writes to.
    #[must_use]
    pub fn of(state: &StateDirectory) -> Self {
        Self(state.images())
    }

    /// Whether the image of that ID was found to have that workload.
    #[must_use]
    pub fn has(&self, id: &str, sha256: &str) -> bool {
        let known = self.file(id).and_then(|file| fs::read_to_string(file).ok());
        known.is_some_and(|known| known == sha256)
    }

    /// Keeps that it was found. Where it cannot be kept it is looked at again.
    pub fn keep(&self, id: &str, sha256: &str) {
        let write = |file: PathBuf| -> io::Result<()> {
            fs::create_dir_all(&self.0)?;
            let unfinished = file.with_extension(format!("{}.new", std::process::id()));
            fs::write(&unfinished, sha256)?;
            fs::rename(unfinished, file)
        };
        let _ = self.file(id).map(write);
    }

    /// None for what is no ID: it comes from the engine.
    fn file(&self, id: &str) -> Option<PathBuf> {
        let digest = id.strip_prefix("sha256:")?;
        let is_digest = digest.len() == 64 && digest.bytes().all(|byte| byte.is_ascii_hexdigit());
        is_digest.then(|| self.0.join(digest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_is_known_by_its_id_with_the_workload_that_was_found_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let images = KnownImages::of(&StateDirectory::new(folder.path()));
        let id = format!("sha256:{}", "a1".repeat(32));
        assert!(!images.has(&id, "w"));
        images.keep(&id, "w");
        assert!(images.has(&id, "w") && !images.has(&id, "other"));
        assert!(!images.has(&id.replace('1', "2"), "w"));
    }

    #[test]
    fn what_is_no_id_names_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let images = KnownImages::of(&StateDirectory::new(folder.path()));
        for id in ["matrix-workload:1", "sha256:../../x", "sha256:", ""] {
            images.keep(id, "w");
            assert!(!images.has(id, "w"));
        }
        assert!(!folder.path().join("images").exists());
    }
}
