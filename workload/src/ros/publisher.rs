//! The publishing end of a topic. The main types are [`Publisher`], which the control loop holds, and [`Publication`],
//! the part of it that the node's threads hold.
//!
//! The loop writes to the subscribers' sockets itself, so that a message is on its way when `publish` returns. Between
//! the loop and the threads that accept subscribers there are two queues without locks: new subscribers come by one,
//! and those who have left go back by the other, so that the loop neither waits nor gives memory back.

mod outlet;

use std::{
    fmt,
    io::{self, Write},
    net::{Shutdown, TcpStream},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use rtrb::{Consumer, Producer, RingBuffer};
use simulation::ros::message_type::MessageType;

use self::outlet::{Delivery, Outlet};
use super::{RosError, connections::Connections};

/// Connections that one publisher serves; the experiment has one, and a few of those who look on.
const MOST_SUBSCRIBERS: usize = 32;

/// Length before each message on the wire.
const PREFIX: usize = 4;

/// What became of one message, as numbers of subscribers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PublishOutcome {
    /// Their socket took the whole message.
    pub sent: u32,
    /// Their socket took a part; the rest goes first at the next call.
    pub partial: u32,
    /// They do not get it: their socket was full, as they do not read as fast as is written.
    pub dropped: u32,
    /// They have left since the last call.
    pub gone: u32,
}

/// The publishing end of a topic. Dropping it closes its connections.
pub struct Publisher {
    publication: Arc<Publication>,
    outlets: Vec<Outlet<Wire>>,
    arrivals: Consumer<Outlet<Wire>>,
    departures: Producer<Outlet<Wire>>,
    frame: Vec<u8>,
}

impl Publisher {
    /// The largest message that can be published, in bytes.
    pub const LARGEST_MESSAGE: usize = 16 * 1024;

    /// Hands the message to each subscriber's socket. For real-time loops: it never blocks, takes no lock and
    /// allocates nothing. A message longer than [`Self::LARGEST_MESSAGE`] is dropped for all.
    pub fn publish(&mut self, message: &[u8]) -> PublishOutcome {
        let mut outcome = PublishOutcome::default();
        while self.outlets.len() < MOST_SUBSCRIBERS {
            let Ok(outlet) = self.arrivals.pop() else { break };
            self.outlets.push(outlet);
        }
        if message.len() > Self::LARGEST_MESSAGE {
            outcome.dropped = self.outlets.len() as u32;
            return outcome;
        }
        self.frame.clear();
        self.frame
            .extend_from_slice(&(message.len() as u32).to_le_bytes());
        self.frame.extend_from_slice(message);
        let mut position = 0;
        while let Some(outlet) = self.outlets.get_mut(position) {
            match outlet.send(&self.frame) {
                Delivery::Sent => outcome.sent += 1,
                Delivery::Partial => outcome.partial += 1,
                Delivery::Dropped => outcome.dropped += 1,
                Delivery::Gone => {
                    outcome.gone += 1;
                    // There is room for as many as there can be.
                    drop(self.departures.push(self.outlets.swap_remove(position)));
                    continue;
                }
            }
            position += 1;
        }
        outcome
    }

    /// Who is connected, also while somebody else has the publisher.
    #[must_use]
    pub fn subscribers(&self) -> Subscribers {
        Subscribers(Arc::clone(&self.publication))
    }
}

/// The subscribers of a publisher.
#[derive(Debug, Clone)]
pub struct Subscribers(Arc<Publication>);

impl Subscribers {
    /// How many are connected.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.connections.count()
    }

    /// Waits until `count` subscribers are connected.
    ///
    /// # Errors
    /// [`RosError`] if the topic could not be registered or the time is over.
    pub fn wait_for(&self, count: usize, timeout: Duration) -> Result<(), RosError> {
        self.0
            .connections
            .wait_for(count, timeout, &self.0.topic, "subscribers")
    }
}

#[cfg(test)]
impl Publisher {
    /// Of each connection that has been published to, whether TCP_NODELAY is set on it.
    pub(super) fn nodelay(&self) -> Vec<bool> {
        self.outlets
            .iter()
            .map(|outlet| outlet.wire().stream.nodelay().unwrap())
            .collect()
    }
}

impl fmt::Debug for Publisher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Publisher")
            .field("publication", &self.publication)
            .finish_non_exhaustive()
    }
}

/// A subscriber's socket. When it is dropped, the connection is closed, whoever else holds it.
#[derive(Debug)]
struct Wire {
    stream: Arc<TcpStream>,
    _seat: Seat,
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        (&*self.stream).write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        // It fails if the peer was faster.
        let _ = self.stream.shutdown(Shutdown::Both);
    }
}

/// One of a publisher's [`MOST_SUBSCRIBERS`], taken while it lives.
#[derive(Debug)]
pub(super) struct Seat(Arc<AtomicUsize>);

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// What the node's threads know of a publisher.
#[derive(Debug)]
pub(super) struct Publication {
    pub topic: String,
    pub message_type: MessageType,
    pub connections: Arc<Connections>,
    seats: Arc<AtomicUsize>,
    door: Mutex<Door>,
}

/// The other ends of the publisher's two queues.
struct Door {
    arrivals: Producer<Outlet<Wire>>,
    departures: Consumer<Outlet<Wire>>,
}

impl fmt::Debug for Door {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Door")
    }
}

impl Publication {
    /// Both parts of a publisher.
    pub fn new(topic: &str, message_type: MessageType) -> (Publisher, Arc<Self>) {
        let (arrivals_in, arrivals) = RingBuffer::new(MOST_SUBSCRIBERS);
        let (departures, departures_out) = RingBuffer::new(MOST_SUBSCRIBERS);
        let publication = Arc::new(Self {
            topic: topic.to_owned(),
            message_type,
            connections: Arc::default(),
            seats: Arc::default(),
            door: Mutex::new(Door {
                arrivals: arrivals_in,
                departures: departures_out,
            }),
        });
        let publisher = Publisher {
            publication: Arc::clone(&publication),
            outlets: Vec::with_capacity(MOST_SUBSCRIBERS),
            arrivals,
            departures,
            frame: Vec::with_capacity(PREFIX + Publisher::LARGEST_MESSAGE),
        };
        (publisher, publication)
    }

    /// A place for one more subscriber, if there is one and the publisher still exists.
    pub fn take_seat(&self) -> Option<Seat> {
        let mut door = self.lock();
        while door.departures.pop().is_ok() {}
        let more = |taken: usize| (taken < MOST_SUBSCRIBERS).then_some(taken + 1);
        let taken = self
            .seats
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, more)
            .is_ok();
        let seat = taken.then(|| Seat(Arc::clone(&self.seats)));
        seat.filter(|_| !door.arrivals.is_abandoned())
    }

    /// Has messages sent to this subscriber from now on. The stream must not block.
    pub fn admit(&self, seat: Seat, stream: Arc<TcpStream>) {
        let wire = Wire { stream, _seat: seat };
        // There is room for as many as there are seats.
        drop(
            self.lock()
                .arrivals
                .push(Outlet::new(wire, PREFIX + Publisher::LARGEST_MESSAGE)),
        );
    }

    /// Whether the [`Publisher`] has been dropped.
    pub fn is_over(&self) -> bool {
        self.lock().arrivals.is_abandoned()
    }

    fn lock(&self) -> MutexGuard<'_, Door> {
        self.door.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::{io::Read, net::TcpListener};

    use simulation::ros::float64_multi_array::MESSAGE_TYPE;

    use super::*;
    use crate::ros::frames::Frames;

    fn connection() -> (Arc<TcpStream>, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let far = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let near = listener.accept().unwrap().0;
        near.set_nonblocking(true).unwrap();
        (Arc::new(near), far)
    }

    #[test]
    fn a_subscriber_that_does_not_read_neither_blocks_nor_sees_a_torn_message() {
        let (mut publisher, publication) = Publication::new("/state", MESSAGE_TYPE);
        let (near, mut far) = connection();
        publication.admit(publication.take_seat().unwrap(), near);
        let mut accepted = 0_u32;
        let mut number = 0_u32;
        let mut outcome = PublishOutcome::default();
        while outcome.dropped == 0 {
            let message = number.to_le_bytes().repeat(1000);
            outcome = publisher.publish(&message);
            accepted += outcome.sent + outcome.partial;
            number += 1;
        }
        // The first that was dropped is not in the stream, and those before it are, whole and in order.
        far.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
        let mut frames = Frames::new(Publisher::LARGEST_MESSAGE);
        let mut received = 0_u32;
        let last = [0xff; 8];
        while received <= accepted {
            while let Some(frame) = frames.next().unwrap() {
                if frame != last {
                    assert_eq!(frame, received.to_le_bytes().repeat(1000));
                }
                received += 1;
            }
            if received == accepted && publisher.publish(&last).sent == 0 {
                continue;
            }
            match far.read(frames.space()) {
                Ok(count) => frames.filled(count),
                // All is read but the end of a partial message, which goes with the next one.
                Err(_) => drop(publisher.publish(&last)),
            }
        }
    }

    #[test]
    fn a_subscriber_that_left_is_given_back_and_its_seat_is_free_again() {
        let (mut publisher, publication) = Publication::new("/state", MESSAGE_TYPE);
        for _ in 0..3 * MOST_SUBSCRIBERS {
            let (near, far) = connection();
            publication.admit(publication.take_seat().unwrap(), near);
            drop(far);
            while publisher.publish(b"x").gone == 0 {}
        }
        assert!(publisher.outlets.is_empty());
    }

    #[test]
    fn there_is_a_seat_for_so_many_and_no_more() {
        let (publisher, publication) = Publication::new("/state", MESSAGE_TYPE);
        let seats: Vec<_> = (0..MOST_SUBSCRIBERS)
            .map(|_| publication.take_seat().unwrap())
            .collect();
        assert!(publication.take_seat().is_none());
        drop(seats);
        assert!(publication.take_seat().is_some());
        drop(publisher);
        assert!(publication.take_seat().is_none());
    }

    #[test]
    fn dropping_the_publisher_closes_its_connections() {
        let (mut publisher, publication) = Publication::new("/state", MESSAGE_TYPE);
        let (near, mut far) = connection();
        publication.admit(publication.take_seat().unwrap(), Arc::clone(&near));
        publisher.publish(b"x");
        drop(publisher);
        let mut all = Vec::new();
        far.read_to_end(&mut all).unwrap();
        assert_eq!(all, b"\x01\0\0\0x");
    }

    #[test]
    fn nothing_grows_in_publish() {
        let (mut publisher, _publication) = Publication::new("/state", MESSAGE_TYPE);
        let capacity = publisher.frame.capacity();
        publisher.publish(&vec![0; Publisher::LARGEST_MESSAGE]);
        publisher.publish(&vec![0; Publisher::LARGEST_MESSAGE + 1]);
        assert_eq!(publisher.frame.capacity(), capacity);
    }
}
