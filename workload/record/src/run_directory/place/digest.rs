//! What tells a file's content from another's.

use std::{fs::File, io};

use sha2::{Digest as _, Sha256};

/// What tells a file's content from another's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileDigest {
    /// Its length.
    pub bytes: u64,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
}

impl FileDigest {
    /// Of what is left to read of a file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn of(mut file: File) -> io::Result<Self> {
        let mut hasher = Sha256::new();
        let bytes = io::copy(&mut file, &mut hasher)?;
        let sha256 = format!("{:x}", hasher.finalize());
        Ok(Self { bytes, sha256 })
    }
}
