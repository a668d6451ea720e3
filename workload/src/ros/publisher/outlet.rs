//! One subscriber's end of a publisher: writes whole messages and never waits. The main type is [`Outlet`].

use std::io::{ErrorKind, Write};

/// What became of one message at one subscriber.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Delivery {
    /// The socket took all of it.
    Sent,
    /// The socket took a part of it; the rest goes first at the next call.
    Partial,
    /// The socket took none of it.
    Dropped,
    /// There is no subscriber any more.
    Gone,
}

/// Writes to a socket that does not block. What it took a part of is finished before anything else is begun, so that
/// the subscriber always sees whole messages.
#[derive(Debug)]
pub(super) struct Outlet<W> {
    wire: W,
    /// A message that the socket took a part of; made large enough beforehand.
    backlog: Vec<u8>,
    /// How much of it has been taken.
    taken: usize,
}

impl<W: Write> Outlet<W> {
    /// For frames of at most `largest` bytes.
    pub fn new(wire: W, largest: usize) -> Self {
        Self {
            wire,
            backlog: Vec::with_capacity(largest),
            taken: 0,
        }
    }

    #[cfg(test)]
    pub fn wire(&self) -> &W {
        &self.wire
    }

    /// Writes a frame. Neither blocks nor allocates.
    pub fn send(&mut self, frame: &[u8]) -> Delivery {
        match self.finish_backlog() {
            Ok(true) => {}
            Ok(false) => return Delivery::Dropped,
            Err(_) => return Delivery::Gone,
        }
        match write_some(&mut self.wire, frame) {
            Ok(0) => Delivery::Dropped,
            Ok(count) => match frame.get(count..) {
                None | Some([]) => Delivery::Sent,
                Some(rest) => {
                    self.backlog.extend_from_slice(rest);
                    Delivery::Partial
                }
            },
            Err(_) => Delivery::Gone,
        }
    }

    /// Whether nothing is left of an earlier message.
    fn finish_backlog(&mut self) -> std::io::Result<bool> {
        let rest = self.backlog.get(self.taken..).unwrap_or_default();
        if !rest.is_empty() {
            self.taken += write_some(&mut self.wire, rest)?;
        }
        let finished = self.taken >= self.backlog.len();
        if finished {
            self.backlog.clear();
            self.taken = 0;
        }
        Ok(finished)
    }
}

/// How many bytes a socket takes now: none if it is full.
fn write_some(wire: &mut impl Write, bytes: &[u8]) -> std::io::Result<usize> {
    loop {
        match wire.write(bytes) {
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(0),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            other => return other,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use proptest::prelude::*;

    use super::*;

    /// A socket that has room for so many bytes at each call, as a script says.
    struct Scripted {
        room: std::vec::IntoIter<usize>,
        taken: Vec<u8>,
    }

    impl Write for Scripted {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            match self.room.next().unwrap_or(usize::MAX).min(bytes.len()) {
                0 => Err(ErrorKind::WouldBlock.into()),
                count => {
                    self.taken.extend_from_slice(&bytes[..count]);
                    Ok(count)
                }
            }
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    struct Broken;

    impl Write for Broken {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(ErrorKind::BrokenPipe.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_broken_socket_is_gone() {
        assert_eq!(Outlet::new(Broken, 16).send(b"abc"), Delivery::Gone);
    }

    proptest! {
        #[test]
        fn no_message_is_torn_however_much_the_socket_takes(room in proptest::collection::vec(0_usize..12, 0..40)) {
            let wire = Scripted { room: room.into_iter(), taken: Vec::new() };
            let mut outlet = Outlet::new(wire, 8);
            let mut expected = Vec::new();
            for number in 0..60_u8 {
                let frame = [number; 8];
                match outlet.send(&frame) {
                    Delivery::Sent | Delivery::Partial => expected.extend(frame),
                    Delivery::Dropped => {}
                    Delivery::Gone => prop_assert!(false, "it was never gone"),
                }
                prop_assert_eq!(outlet.backlog.capacity(), 8);
            }
            // The script has ended before, so that all that was begun has been finished.
            prop_assert_eq!(outlet.wire.taken, expected);
        }
    }
}
