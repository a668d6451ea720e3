//! The files of a run that are not measured.

use std::io;

use record::{
    layout,
    run_directory::{Kind as Entry, Place},
};

/// What is not measured in a scenario's folder.
pub(super) enum Kind {
    /// JSON.
    Document,
    /// Text.
    Text,
    /// What a command printed, which may be anything.
    LeftOut,
}

impl Kind {
    pub(super) fn of(file: &Place) -> Option<Self> {
        match file.name() {
            layout::WINDOW => Some(Self::Document),
            name if layout::is_printed(name) => Some(Self::LeftOut),
            name if name.starts_with("environment") && name.ends_with(".json") => Some(Self::Document),
            name if name.starts_with("network") && name.ends_with(".txt") => Some(Self::Text),
            _ => None,
        }
    }
}

/// The files of a scenario's folder and of its windows, in the order of their names; none of what broke.
pub(super) fn files(scenario: &Place) -> io::Result<Vec<Place>> {
    let mut files = Vec::new();
    if !scenario.exists() {
        return Ok(files);
    }
    for (place, kind) in scenario.entries()? {
        match kind {
            Entry::Folder if layout::window_of(place.name()).is_some() => {
                let inner = place.entries()?;
                files.extend(inner.into_iter().filter(is_file).map(|(place, _)| place));
            }
            Entry::File => files.push(place),
            Entry::Folder | Entry::Other => {}
        }
    }
    Ok(files)
}

fn is_file((_, kind): &(Place, Entry)) -> bool {
    *kind == Entry::File
}
