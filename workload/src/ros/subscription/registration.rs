//! Whether a publisher is registered with the master, and connected to: what the master's updates and the thread of the
//! connection tell each other. The main type is [`Registration`].

use std::{
    io,
    sync::{Mutex, MutexGuard, PoisonError},
};

use crate::ros::stop::Stop;

/// One publisher, as the master has it and as it is.
#[derive(Debug)]
pub(super) struct Registration {
    /// Ends the connection and all attempts at it.
    pub stop: Stop,
    state: Mutex<State>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct State {
    listed: bool,
    connected: bool,
    ended: bool,
}

impl Registration {
    /// Listed, and not connected yet.
    pub fn new() -> io::Result<Self> {
        let state = State {
            listed: true,
            connected: false,
            ended: false,
        };
        Ok(Self {
            stop: Stop::new()?,
            state: Mutex::new(state),
        })
    }

    /// The master does not list it any more. Whether that was its end: a connection goes on for as long as it works.
    pub fn withdraw(&self) -> bool {
        let mut state = self.lock();
        state.listed = false;
        if !state.connected {
            state.ended = true;
            self.stop.raise();
        }
        state.ended
    }

    /// The master lists it, again or still. False if it has ended.
    pub fn renew(&self) -> bool {
        let mut state = self.lock();
        state.listed |= !state.ended;
        !state.ended
    }

    /// There is a connection. False if none is wanted any more.
    pub fn connected(&self) -> bool {
        let mut state = self.lock();
        state.connected = !state.ended;
        state.connected
    }

    /// The connection has broken, or could not be made. Whether to try again.
    pub fn disconnected(&self) -> bool {
        let mut state = self.lock();
        state.connected = false;
        state.ended |= !state.listed || self.stop.is_raised();
        !state.ended
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_publisher_that_was_not_reached_ends_with_its_registration() {
        let registration = Registration::new().unwrap();
        assert!(registration.withdraw());
        assert!(registration.stop.is_raised());
        assert!(!registration.connected());
        assert!(!registration.renew());
    }

    #[test]
    fn a_connection_that_works_outlives_its_registration_and_is_not_made_again() {
        let registration = Registration::new().unwrap();
        assert!(registration.connected());
        assert!(!registration.withdraw());
        assert!(!registration.stop.is_raised());
        assert!(!registration.disconnected());
        assert!(!registration.renew());
    }

    #[test]
    fn one_that_is_registered_again_in_time_is_as_before() {
        let registration = Registration::new().unwrap();
        assert!(registration.connected());
        assert!(!registration.withdraw());
        assert!(registration.renew());
        assert!(registration.disconnected());
    }
}
