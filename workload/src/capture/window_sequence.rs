//! Which window a packet belongs to, by its stamp, and when a window is over. Pure. The main type is
//! [`WindowSequence`].

use std::{collections::VecDeque, mem};

/// Where one window ends and the next one begins, if there is a next one.
#[derive(Debug, PartialEq, Eq)]
pub struct Boundary<Window> {
    /// Wall clock, nanoseconds since 1970.
    pub at_unix_ns: i64,
    /// What begins there.
    pub next: Option<Window>,
}

/// The window under way and the boundaries to come.
#[derive(Debug)]
pub struct WindowSequence<Window> {
    /// How long after a boundary its window is completed: no packet comes later than this after its stamp, so that none
    /// of the window before comes after its end.
    grace_ns: i64,
    current: Option<Window>,
    boundaries: VecDeque<Boundary<Window>>,
}

impl<Window> WindowSequence<Window> {
    /// Without a window, of packets that come no later than this after their stamp.
    pub fn with_grace(grace_ns: i64) -> Self {
        Self {
            grace_ns,
            current: None,
            boundaries: VecDeque::new(),
        }
    }

    /// Adds a boundary. Boundaries to come at or after its time are cancelled, and the windows that would have begun
    /// there returned.
    pub fn announce(&mut self, boundary: Boundary<Window>) -> Vec<Window> {
        let keep = self
            .boundaries
            .iter()
            .take_while(|known| known.at_unix_ns < boundary.at_unix_ns)
            .count();
        let cancelled = self
            .boundaries
            .drain(keep..)
            .filter_map(|cancelled| cancelled.next)
            .collect();
        self.boundaries.push_back(boundary);
        cancelled
    }

    /// The window that a packet with this stamp belongs to.
    pub fn at(&mut self, stamp_unix_ns: i64) -> Option<&mut Window> {
        match self
            .boundaries
            .iter_mut()
            .rev()
            .find(|boundary| boundary.at_unix_ns <= stamp_unix_ns)
        {
            Some(boundary) => boundary.next.as_mut(),
            None => self.current.as_mut(),
        }
    }

    /// When the next boundary can be crossed.
    #[must_use]
    pub fn next_crossing_unix_ns(&self) -> Option<i64> {
        self.boundaries
            .front()
            .map(|boundary| boundary.at_unix_ns.saturating_add(self.grace_ns))
    }

    /// Crosses the next boundary, if it is time, and returns the window that ended there, if there was one.
    pub fn cross(&mut self, now_unix_ns: i64) -> Option<Option<Window>> {
        self.next_crossing_unix_ns()
            .filter(|crossing| *crossing <= now_unix_ns)?;
        let boundary = self.boundaries.pop_front()?;
        Some(mem::replace(&mut self.current, boundary.next))
    }

    /// The window under way, and those that have not begun.
    #[must_use]
    pub fn take_windows(&mut self) -> (Option<Window>, Vec<Window>) {
        let to_come = self.boundaries.drain(..);
        (
            self.current.take(),
            to_come.filter_map(|boundary| boundary.next).collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;
    const GRACE_NS: i64 = 10_000_000;

    fn begin(name: &'static str, second: i64) -> Boundary<&'static str> {
        Boundary {
            at_unix_ns: second * SECOND,
            next: Some(name),
        }
    }

    fn end(second: i64) -> Boundary<&'static str> {
        Boundary {
            at_unix_ns: second * SECOND,
            next: None,
        }
    }

    fn sequence(
        boundaries: impl IntoIterator<Item = Boundary<&'static str>>,
    ) -> WindowSequence<&'static str> {
        let mut sequence = WindowSequence::with_grace(GRACE_NS);
        for boundary in boundaries {
            assert_eq!(sequence.announce(boundary), Vec::<&str>::new());
        }
        sequence
    }

    #[rstest::rstest]
    #[case(10 * SECOND - 1, None)]
    #[case(10 * SECOND, Some("first"))]
    #[case(20 * SECOND - 1, Some("first"))]
    #[case(20 * SECOND, Some("second"))]
    #[case(30 * SECOND, None)]
    fn a_packet_belongs_to_the_window_of_its_stamp(#[case] stamp: i64, #[case] window: Option<&str>) {
        let mut sequence = sequence([begin("first", 10), begin("second", 20), end(30)]);
        assert_eq!(sequence.at(stamp).copied(), window);
        // The same once the first window is under way, when its stamp is not before it.
        sequence.cross(11 * SECOND);
        if stamp >= 10 * SECOND {
            assert_eq!(sequence.at(stamp).copied(), window);
        }
    }

    #[test]
    fn a_window_is_over_a_grace_after_its_end_whether_or_not_packets_come() {
        let mut sequence = sequence([begin("first", 10), begin("second", 20)]);
        assert_eq!(sequence.cross(10 * SECOND + GRACE_NS), Some(None));
        assert_eq!(sequence.next_crossing_unix_ns(), Some(20 * SECOND + GRACE_NS));
        assert_eq!(sequence.cross(20 * SECOND + GRACE_NS - 1), None);
        assert_eq!(sequence.cross(20 * SECOND + GRACE_NS), Some(Some("first")));
        assert_eq!(sequence.cross(i64::MAX), None);
        assert_eq!(sequence.take_windows(), (Some("second"), vec![]));
    }

    #[test]
    fn an_early_end_cancels_the_window_that_was_to_come() {
        let mut sequence = sequence([begin("first", 10), begin("second", 20)]);
        assert_eq!(sequence.announce(end(15)), vec!["second"]);
        assert_eq!(sequence.at(25 * SECOND), None);
        sequence.cross(11 * SECOND);
        assert_eq!(sequence.cross(16 * SECOND), Some(Some("first")));
    }
}
