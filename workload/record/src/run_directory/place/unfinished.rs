//! A file that is written beside its place, and takes it when it is whole.

use std::io;

use super::Place;

/// A file that is not at its place yet. It is removed if it never comes there.
#[derive(Debug)]
pub struct Unfinished {
    pub(super) place: Place,
    pub(super) beside: Place,
}

impl Unfinished {
    /// Gives it its place, over what is there. What was written must be flushed.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn finish(self) -> io::Result<Place> {
        self.beside.rename(&self.place)?;
        Ok(self.place.clone())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // Nothing is there any more if it was finished.
        let _ = self.beside.remove_file();
    }
}
