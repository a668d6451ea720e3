//! Links that are logged in and not used just now. The main type is [`IdleLinks`].

use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use super::link::Link;

/// More of them are of no use to anybody.
const MOST: usize = 4;
/// What lies longer may have been forgotten by a firewall on the way.
const LONGEST: Duration = Duration::from_secs(60);

/// They are closed when there are too many of them, or with the host.
#[derive(Default)]
pub struct IdleLinks(Mutex<Vec<(Instant, Link)>>);

impl IdleLinks {
    /// The one that was used last, if one is still good.
    pub fn take(&self) -> Option<Link> {
        let mut links = self.links();
        links.retain(|(since, link)| since.elapsed() < LONGEST && link.is_open());
        links.pop().map(|(_, link)| link)
    }

    /// Keeps one for later.
    pub fn put(&self, link: Link) {
        let mut links = self.links();
        if links.len() == MOST {
            links.remove(0);
        }
        links.push((Instant::now(), link));
    }

    /// Closes all.
    pub fn clear(&self) {
        self.links().clear();
    }

    fn links(&self) -> MutexGuard<'_, Vec<(Instant, Link)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
